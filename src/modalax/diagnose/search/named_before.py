"""Line by line from what the modal domain has named: where it leaves noise alone, only its near rivals are fitted.

Changes of any size are compared in the modal domain in seconds. What is named there without doubt is fitted to all
lines; if the tests at which the search of :mod:`.explain` would stop find nothing left, what that search could add is
what explains as much to first order.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import chosen
from modalax.diagnose.search.candidates import best_of_each, cost_of
from modalax.diagnose.search.compounds import Rest, fit_together, rest_of
from modalax.diagnose.search.look import Look
from modalax.diagnose.search.singles import fit_single
from modalax.diagnose.thresholds import THRESHOLDS

NEAR = 24.0  # chi-square by which a rival may explain less
WAYS = 4  # ways to say the same that are tried: a unit more or less, one channel in the other or the reverse
SHORT = 0.15  # share of the whole effect by which the screening of a rival may fall short, as it is linear


@dataclass(frozen=True)
class NamedCause:
    """A cause as the modal domain names it.

    Attributes
    ----------
    slug, where
        Name and place.
    values
        Parameters in the order of the catalogue's cause.
    variant
        Its form, where the catalogue has several.
    """

    slug: str
    where: tuple[str | int, ...]
    values: tuple[float, ...]
    variant: int = 0


def explained_by(
    look: Look, named: Sequence[NamedCause], causes: Sequence[Cause]
) -> tuple[list[Hypothesis], Rest | None]:
    """The named causes fitted to all lines, and what they leave; with their rivals where that is no more than noise.

    Parameters
    ----------
    look
        The simulation alone.
    named
        What the modal domain has named.
    causes
        What is looked for.
    """
    comparison, null = look.comparison, look.null
    starts = starts_of(comparison, null, named, causes)
    if comparison.nuisance.active and null.theta is not None:
        starts += [replace(h, theta=np.zeros_like(null.theta)) for h in starts]
    fitted = best_of_each([h for one in starts for h in fit_together(comparison, [one])], comparison)
    rest = rest_of(comparison, fitted[0], null, causes) if fitted else None
    if rest is None or rest.p_value < THRESHOLDS.left_by_several:
        return fitted, rest
    least = (1 - SHORT) * (null.chi2 - fitted[0].chi2) - NEAR
    rivals = [t for t in chosen(look.screening.trials) if t.gain > least]
    alike = [h for one in alike_at_places(comparison, fitted[0], causes) for h in fit_together(comparison, [one])]
    return [*fitted, *alike, *fit_single(look.state, rivals)], rest


def alike_at_places(comparison: Comparison, h: Hypothesis, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Hypotheses in which another cause, which FRFs hardly tell from it, takes the place of one; not fitted."""
    out = []
    for k, (one, place, p) in enumerate(zip(h.causes, h.places, h.params, strict=True)):
        for cause in causes:
            start = cause.alike(one, p)
            if start is not None and place.where in {p.where for p in cause.places(comparison.scene)}:
                other = tuple(cause if j == k else c for j, c in enumerate(h.causes))
                params = tuple(start if j == k else q for j, q in enumerate(h.params))
                out.append(replace(h, causes=other, params=params, freedom=cost_of(other, h.extras)))
    return out


def starts_of(
    comparison: Comparison, null: Hypothesis, named: Sequence[NamedCause], causes: Sequence[Cause]
) -> list[Hypothesis]:
    """Hypotheses with the parameters of the modal domain: one for each way in which the catalogue has these causes."""
    each = [
        [
            (c, p, np.array(one.values)) for c in causes if c.slug == one.slug and len(c.parameters) == len(one.values)
            for p in c.places(comparison.scene) if set(p.where) == set(one.where) and p.index[2] == one.variant
        ]
        for one in named
    ]  # fmt: skip
    out = []
    for parts in itertools.islice(itertools.product(*each), WAYS) if named else ():
        which, places, params = zip(*parts, strict=True)
        extras = (None,) * len(which)
        freedom = cost_of(which, extras)
        out.append(replace(null, causes=which, places=places, extras=extras, params=params, freedom=freedom))
    return out
