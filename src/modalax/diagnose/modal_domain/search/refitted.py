"""Explanations fitted again in another setting: beside factors throughout, uneven errors, the rest, or all features.

Or with a simulation that is exact about the places of the leading causes. A large one keeps few shapes, by which it
moves a little otherwise once an element is far off. What is compared with measured modes is therefore posed again with
the static responses to forces at those places, and to the forces of the errors of all elements that were found, so that
what the causes leave is what they do not explain.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.attempts import attempt, explains, key_of
from modalax.diagnose.modal_domain.fitting.discrepancy import learnt_rest, with_rest
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found, fit, without_causes
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.fitting.throughout import start_in, with_more
from modalax.diagnose.modal_domain.modes.features import whitener_of

AGAIN = 6  # leading explanations that are fitted again,
NEAR = 12.0  # and nats behind the first up to which they are, where few features told of them
FAR = 60.0  # the same where the first explains the modes, and the rest that no element explains is fitted as well
HARDLY = -math.log(0.05)  # the same where no cause is needed: one that is as much less likely is not told
LEADING = 3  # explanations about whose places the simulation is made exact

# Of DoFs about which, and the errors of a fit with which, the simulation is to be exact: it, and the candidates there.
Finer = Callable[[tuple[str, ...], Fit], tuple[Setting, list[Change]]]


def from_the_simulation(setting: Setting, found: Found, prior: Prior) -> None:
    """Fit the leading explanations again from a simulation that is not off.

    Without elements that would resist, an inaccuracy that had stood for a cause stays where it was beside it. And none
    from the inaccuracy of each: it must be no less likely than a cause of no size.
    """
    for e in ranked_by(found, prior)[:AGAIN]:
        attempt(setting, found, e.causes, e.fit.u, None)
        if e.causes:
            attempt(setting, found, (), np.zeros(0), without_causes(e.fit), gentle=False)


def beside_a_factor(bare: Setting, setting: Setting, found: Found, prior: Prior) -> tuple[Setting, Found]:
    """Fit the leading explanations again with the factors throughout and uneven errors that the data ask for.

    Without a cause these may stand for it, and with one may have been hidden; ``bare`` is the setting without any.
    """
    ranked = ranked_by(found, prior)
    leading = ranked[:AGAIN] + [e for e in ranked[AGAIN:] if not e.causes]
    if explains(leading[0].fit):
        asked = _asked_beside(bare, setting, leading[0])
        if asked.inaccuracy.groups == setting.inaccuracy.groups:
            return setting, found
        again = _fitted_again(asked, leading)
        return (asked, again) if again else (setting, found)
    trials = [(setting, found)]  # several causes may stand for what elements are off unevenly
    for e in leading[:1] + [e for e in ranked if len(e.causes) == 1][:1]:
        asked = _asked_beside(bare, setting, e)
        if all(asked.inaccuracy.groups != other.inaccuracy.groups for other, _ in trials):
            trials.append((asked, _fitted_again(asked, [*leading, e])))
    return max((t for t in trials if t[1]), key=lambda t: ranked_by(t[1], prior)[0].log_posterior)


def _asked_beside(bare: Setting, setting: Setting, e: Explanation) -> Setting:
    """The setting with what the data ask for beside the causes of an explanation."""
    f = e.fit
    alone = fit(bare, e.causes, start_in(bare, f), f.u, temperatures=(3.0,)) if e.causes else None
    keep = explains(f) and alone is not None and setting is not bare and f.log_evidence > alone.log_evidence
    if alone is None or keep:
        return setting
    if any(c.scales_all for c in e.causes):  # which stand for one of the mass
        bare = replace(bare, sought=tuple(name for name in bare.sought if name != "mass"))
    return with_more(bare, alone)


def _fitted_again(setting: Setting, explanations: Sequence[Explanation]) -> Found:
    """Explanations in another setting; what explains nothing also from a simulation that is not off."""
    again: Found = {}
    for e in explanations:
        attempt(setting, again, e.causes, e.fit.u, start_in(setting, e.fit), gentle=False)
        if e.causes and not explains(e.fit):
            attempt(setting, again, e.causes, e.fit.u, None)
    return again


def beside_the_rest(setting: Setting, found: Found, prior: Prior, late: Callable[[], bool]) -> tuple[Setting, Found]:
    """Fit the leading explanations again, together with the rest that no element explains.

    Not where nothing is known of elements: all that is off is such a rest.
    """
    if setting.inaccuracy.between_modes:
        return setting, found
    ranked = ranked_by(found, prior)
    leading, bare = near_the_first(ranked[:AGAIN], FAR), [e for e in ranked if not e.causes]
    leading = leading if explains(ranked[0].fit) else ranked[:AGAIN]
    singles = [e for e in ranked if len(e.causes) == 1][:2]
    leading += [e for e in bare + singles if all(e is not other for other in leading)]
    some = [*leading[:2], *bare, *singles[:1]]
    new, size = learnt_rest(setting, [e.fit for e in some], [prior.of(e.causes) for e in some])
    if size == 0.0 or late():
        return setting, found
    again: Found = {}
    for e in leading:
        attempt(new, again, e.causes, e.fit.u, without_causes(e.fit), gentle=False)
    return (new, again) if key_of(leading[0].causes) in again else (setting, found)


def rest_anew(setting: Setting, found: Found, prior: Prior, late: Callable[[], bool]) -> tuple[Setting, Found]:
    """Learn the rest again about what leads now: beside what explained nothing it was as large as may be."""
    if setting.rest == 0.0:
        return beside_the_rest(setting, found, prior, late)
    plain = replace(setting, whitener=whitener_of(setting.features), rest=0.0)
    ranked = ranked_by(found, prior)
    again: Found = {}
    for e in near_the_first(ranked[:AGAIN], FAR) + [e for e in ranked if not e.causes]:
        attempt(plain, again, e.causes, e.fit.u, without_causes(e.fit), gentle=False)
    found_again = key_of(ranked[0].causes) in again
    return beside_the_rest(plain, again, prior, late) if found_again else (setting, found)


def near_the_first(ranked: Sequence[Explanation], nats: float) -> list[Explanation]:
    """Those hardly less likely than the first, by so many nats at most; by fewer where that needs no cause."""
    nats = nats if ranked[0].causes or not explains(ranked[0].fit) else HARDLY
    return [e for e in ranked if e.log_posterior > ranked[0].log_posterior - nats]


def in_full(
    whole: Setting, few: Setting, explanations: Sequence[Explanation], late: Callable[[], bool]
) -> tuple[Setting, Found]:
    """Fit the leading explanations of a search by ``few`` features again, to the whole of them.

    Beside what the search has learnt of the simulation: what it is off by, and the rest.
    """
    setting = replace(few, features=whole.features, whitener=whole.whitener, rest=0.0)
    best = explanations[0]
    if few.rest:
        setting = with_rest(setting, best.fit, few.rest)
    leading = near_the_first(explanations[:AGAIN], NEAR)
    again: Found = {}
    bare = [e for e in explanations if not e.causes and all(e is not other for other in leading)]
    for e in leading + bare:
        if not (again and late()):
            within = setting if again else replace(setting, late=NEVER)  # what leads is fitted to its end
            attempt(within, again, e.causes, e.fit.u, without_causes(e.fit), gentle=False)
    return setting, again


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
