"""A large simulation, made exact about the places of the leading causes.

It keeps few shapes, by which it moves a little otherwise once an element is far off. What is compared with measured
modes is therefore posed again with the static responses to forces at those places, and to the forces of the errors of
all elements that were found, so that what the causes leave is what they do not explain.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from modalax.diagnose.modal_domain.attempts import attempt
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.explanation import Explanation, ranked_by
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.prior import Prior
from modalax.diagnose.modal_domain.refitted import AGAIN, near_the_first
from modalax.diagnose.modal_domain.state import Setting
from modalax.diagnose.modal_domain.throughout import start_in

LEADING = 3  # explanations about whose places it is made exact

Found = dict[tuple[Change, ...], Fit]
# Of DoFs about which, and the errors of a fit with which, the simulation is to be exact: it, and the candidates there.
Finer = Callable[[tuple[str, ...], Fit], tuple[Setting, list[Change]]]


def made_exact(
    setting: Setting, candidates: list[Change], found: Found, finer: Finer | None, tell: Callable[[str], None],
) -> tuple[Setting, list[Change], Found]:  # fmt: skip
    """The setting, its candidates and the leading fits with the simulation exact about the places that lead.

    The same as before where ``finer`` is None, as the simulation has all its exactness everywhere.
    """
    ranked = ranked_by(found, Prior(candidates))
    leading = [e for e in near_the_first(ranked[:AGAIN], math.inf) if _places(e)][:LEADING]
    if finer is None:
        return setting, candidates, found
    tell(f"making the simulation exact about {'the leading places' if leading else 'what its elements are off by'}")
    exact, there = finer(tuple(dict.fromkeys(name for e in leading for name in _places(e))), ranked[0].fit)
    exact = replace(exact, features=setting.features, whitener=setting.whitener, late=setting.late)
    again: Found = {}
    others = [e for e in ranked[:AGAIN] if not _places(e)] + [e for e in ranked[AGAIN:] if not e.causes]
    for e in [*leading, *others]:
        causes = tuple(same for c in e.causes for same in _same(c, candidates, there))
        if len(causes) == len(e.causes):
            attempt(exact, again, causes, e.fit.u, start_in(exact, e.fit), gentle=False)
    same = () in again and (not leading or any(causes for causes in again))
    return (exact, there, again) if same else (setting, candidates, found)


def _places(e: Explanation) -> list[str]:
    """DoFs at which causes of an explanation change mass, damping or stiffness."""
    return [str(name) for c in e.causes if c.local for name in c.where]


def _same(cause: Change, before: Sequence[Change], after: Sequence[Change]) -> list[Change]:
    """The cause among those ``after`` that one of those ``before`` is; none where there are more or fewer alike."""
    alike = [[c for c in some if (c.slug, c.where) == (cause.slug, cause.where)] for some in (before, after)]
    which = [k for k, c in enumerate(alike[0]) if c is cause]
    return [alike[1][k] for k in which] if len(alike[0]) == len(alike[1]) else []
