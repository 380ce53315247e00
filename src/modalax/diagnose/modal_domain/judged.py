"""What stands out in each explanation beyond the general inaccuracy, made ready for the verdict."""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.decision.beyond import BeyondUsual, ModalCase, Names, modal_verdict, usual_size
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.explain import Explanation
from modalax.diagnose.modal_domain.fit import LARGEST
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Judged:
    """The verdict and what it is about.

    Attributes
    ----------
    word, reasons
        The verdict, and why.
    chosen
        The explanation that the answer is about: the likeliest one, or the general inaccuracy alone if nothing stands
        out.
    sets
        What stands out, the set of the likeliest explanation first, the others by falling probability.
    """

    word: str
    reasons: tuple[str, ...]
    chosen: Explanation
    sets: tuple[BeyondUsual, ...]


def judge(stage: Stage) -> Judged:
    """Bring what the rules look at together, and apply them."""
    best = stage.explanations[0]
    plain = next((e for e in stage.explanations if not e.causes), None)
    sets = sets_beyond(stage)
    case = ModalCase(
        sets, [(c.slug, c.where) for c in best.causes], inaccuracy_of_fit(stage, best),
        float(np.max(best.fit.epsilon[:2] / LARGEST[:2])), best.fit.chi2 / best.fit.state.difference.size,
        None if plain is None else best.log_posterior - plain.log_posterior, THRESHOLDS,
    )  # fmt: skip
    word, reasons = modal_verdict(case)
    return Judged(word, reasons, plain if word == "clean" and plain is not None else best, sets)


def sets_beyond(stage: Stage) -> tuple[BeyondUsual, ...]:
    """What stands out in the likeliest explanation, then in the others, the same causes at the same places as one."""
    written: dict[
        tuple[str | int, ...], tuple[str, tuple[str | int, ...]]
    ] = {}  # a pair of DoFs is the same in either order
    total: dict[Names, tuple[Names, float]] = {}
    for e in stage.explanations:
        causes = standing_out(stage, e)
        names = tuple(written.setdefault((c.slug, *sorted(c.where)), (c.slug, tuple(c.where))) for c in causes)
        key = tuple(sorted(names))
        first, p = total.get(key, (names, 0.0))
        total[key] = first, p + e.probability
    leading, *others = (BeyondUsual(*v) for v in total.values())
    return (leading, *sorted(others, key=lambda s: -s.probability))


def standing_out(stage: Stage, e: Explanation) -> tuple[Change, ...]:
    """Causes of an explanation that are larger than is usual."""
    off, highest = inaccuracy_of_fit(stage, e), float(stage.measured.freq[-1])
    out = []
    for c, u in zip(e.causes, e.fit.u, strict=True):
        whole = 1.0 if c.pattern is not None else c.reference
        if abs(float(u) * c.scale) > usual_size(c.slug, whole, off, highest):
            out.append(c)
    return tuple(out)


def inaccuracy_of_fit(stage: Stage, e: Explanation) -> dict[str, float]:
    """General relative inaccuracy of stiffness, mass and damping that goes with an explanation."""
    return {name: float(x) for name, x in zip(stage.setting.inaccuracy.groups, e.fit.epsilon, strict=True)}
