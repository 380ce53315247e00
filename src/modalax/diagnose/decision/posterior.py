r"""Probabilities of hypotheses: Schwarz's criterion, with prior probabilities of causes and places."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.thresholds import THRESHOLDS


def evidence(h: Hypothesis, scene: Scene, samples: int, null_chi2: float) -> float:
    r"""Logarithm of the evidence: Schwarz's criterion plus the priors of the causes and of their places.

    The shape of a missing mode over the channels, of D sizes, is weighed with a prior as wide as the effect is large
    instead, :math:`\frac D2(1 + \ln(\Delta\chi^2/D))` (empirical Bayes; George and Foster 2000, Biometrika 87:731):
    a few lines tell each size, not all.

    Parameters
    ----------
    h
        Fitted causes.
    samples
        Number of real samples.
    null_chi2
        Chi-square of the simulation alone.
    """
    each = math.log(max(samples, 30))
    value = -0.5 * h.chi2 - 0.5 * h.freedom * each
    for cause, extra in zip(h.causes, h.extras, strict=True):
        sizes = cause.free_sizes(extra)
        if sizes:
            value += 0.5 * sizes * max(each - 1 - math.log(max((null_chi2 - h.chi2) / sizes, 1.0)), 0.0)
    value -= THRESHOLDS.several_causes * max(len(h.names) - 1, 0)
    for cause, place, p in zip(h.causes, h.places, h.params, strict=True):  # hum has one place and weight 1
        value += math.log(cause.prior) + believed(cause.slug)
        value += math.log(_weight(cause, place, scene)) + math.log(cause.likely(p, scene))
    return value


def promise(t: Trial, scene: Scene, samples: int) -> float:
    """Twice the log evidence that a trial promises to add: its gain, less what its unknowns and its place cost.

    Parameters
    ----------
    t
        A screened cause at a place, not fitted yet.
    scene
        Where places have their prior weights.
    samples
        Number of real samples.
    """
    each = math.log(max(samples, 30))
    cost, sizes = t.cause.promised_cost(t.extra) * each, t.cause.free_sizes(t.extra)
    if sizes:
        cost += sizes * min(each, 1 + math.log(max(t.gain / sizes, 1.0)))
    before = math.log(t.cause.prior) + believed(t.cause.slug) + math.log(_weight(t.cause, t.place, scene))
    return t.gain - cost + 2 * before


def _weight(cause: Cause, place: Place, scene: Scene) -> float:
    """How likely a place of a cause is before the data."""
    key = ("weights", cause)
    if key not in scene.cache:
        places = cause.places(scene)
        scene.cache[key] = {p.index: float(w) for p, w in zip(places, cause.weights(scene, places), strict=True)}
    return scene.cache[key].get(place.index, 1.0)


@dataclass(frozen=True)
class Ranked:
    """One set of causes, the best hypothesis that says so, and its probability among all that were fitted."""

    names: frozenset[tuple[str, tuple[Any, ...]]]
    best: Hypothesis
    log_evidence: float
    probability: float


def posterior(hypotheses: Sequence[tuple[Hypothesis, float]]) -> list[Ranked]:
    """Probabilities of sets of causes from log evidences; forms of one cause at one place add up."""
    if not hypotheses:
        return []
    top = max(value for _, value in hypotheses)
    groups: dict[Any, list[tuple[Hypothesis, float]]] = {}
    for h, value in hypotheses:
        groups.setdefault(h.names, []).append((h, value))
    weights = {names: sum(math.exp(v - top) for _, v in members) for names, members in groups.items()}
    total = sum(weights.values())
    ranked = []
    for names, members in groups.items():
        best, value = max(members, key=lambda m: m[1])
        ranked.append(Ranked(names, best, value, weights[names] / total))
    return sorted(ranked, key=lambda r: -r.probability)
