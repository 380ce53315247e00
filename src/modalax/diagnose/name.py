"""Naming: detection, single causes, compounds up to three, and whether anything is left over."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.decide import CERTAIN, RIVAL, Detection, Ranked, detect, posterior
from modalax.diagnose.fit import ROUNDS, Hypothesis, jacobian_of, searched
from modalax.diagnose.omnibus import Omnibus, omnibus
from modalax.diagnose.screen import Trial
from modalax.diagnose.search import Screening, chosen, evidence, fit_further, fit_single, screen_all, state_of
from modalax.diagnose.study import Study

LEFT = 0.002  # chance under noise below which a residual is said to hold something more
DEEPEST = 3  # causes in one answer
LEADING = 2  # hypotheses that a further cause is added to
FURTHER = 3  # causes tried on each


@dataclass(frozen=True)
class Naming:
    """What was found.

    Attributes
    ----------
    verdict
        ``clean``, ``named``, ``ambiguous`` or ``unknown``.
    ranked
        Sets of causes by falling probability.
    null
        The simulation alone, its modal parameters adapted within their spread.
    screening
        Of the null.
    detection
        Significance of what the simulation leaves.
    before, after
        Omnibus tests of the null and of the best hypothesis.
    """

    verdict: str
    ranked: list[Ranked]
    null: Hypothesis
    screening: Screening
    detection: Detection
    before: Omnibus
    after: Omnibus

    @property
    def best(self) -> Hypothesis:
        """The leading hypothesis; the null where nothing was found."""
        return self.ranked[0].best if self.ranked else self.null


def name(study: Study, causes: Sequence[Cause]) -> Naming:
    """Search the causes of one study."""
    null = study.fit([_empty(study)], ROUNDS)[0]
    freedom = study.noise.freedom
    live = study.live()
    before = omnibus(study.residual(null), live, freedom)
    state = state_of(study, null)
    screening = screen_all(study, null, causes, state)
    detection = detect(screening.trials, state.sides, before, _spread(freedom))
    if not detection.anything:
        return Naming("clean", [], null, screening, detection, before, before)
    many = _multiplicity(screening.trials)
    samples = study.problem.samples

    def weigh(found: list[Hypothesis]) -> list[Ranked]:
        return posterior([(h, evidence(h, study, many, samples)) for h in found])

    found = fit_single(study, null, chosen(screening.trials), state)
    ranked = weigh(found)
    if not ranked or ranked[0].best.chi2 > null.chi2 - 9.0:
        return Naming("unknown", [], null, screening, detection, before, before)
    after = _remains(study, ranked[0].best, null)
    for depth in range(2, DEEPEST + 1):
        further = _further(study, ranked, causes)
        if not further and after.p_value > LEFT:
            break
        deeper = []
        for base, trials in further or _any_further(study, ranked, causes):
            deeper += fit_further(study, base, trials)
        new = weigh(found + deeper)
        if not new or len(new[0].names) < depth:
            ranked = new or ranked
            break
        found, ranked = found + deeper, new
        after = _remains(study, ranked[0].best, null)
    return Naming(_verdict(ranked, after), ranked, null, screening, detection, before, after)


def _verdict(ranked: list[Ranked], after: Omnibus) -> str:
    if after.p_value < LEFT:
        return "unknown"
    return "named" if ranked[0].probability >= CERTAIN else "ambiguous"


def rivals(ranked: list[Ranked]) -> list[Ranked]:
    """Sets worth telling beside the leading one."""
    return [r for r in ranked[1:] if r.probability >= RIVAL]


def _empty(study: Study) -> Hypothesis:
    return Hypothesis(theta=np.zeros((2, study.problem.plant.stiffness.shape[0])))


def _spread(freedom: float) -> float:
    """By how much estimated variances widen the scores."""
    return 1.0 + (0.1 / freedom if np.isfinite(freedom) else 0.0)


def _multiplicity(trials: Sequence[Trial]) -> dict[Cause, int]:
    count: dict[Cause, int] = {}
    for t in trials:
        count[t.cause] = count.get(t.cause, 0) + 1
    return count


def _remains(study: Study, h: Hypothesis, null: Hypothesis) -> Omnibus:
    """Omnibus test of what a hypothesis leaves, less what the laws' own inexactness may leave."""
    used = study if h.hum is None else study.without(h.hum.lines)
    fidelity = max((c.fidelity for c in h.causes), default=0.0)
    effect = max(null.chi2 - h.chi2, 0.0)
    return omnibus(used.residual(h), used.live(), study.noise.freedom, fidelity**2 * effect)


def _further(study: Study, ranked: list[Ranked], causes: Sequence[Cause]) -> list[Any]:
    """Leading hypotheses whose residual still scores significantly, with the causes to add."""
    return [pair for pair in _any_further(study, ranked, causes) if pair[1][0].gain > _worth(study)]


def _worth(study: Study) -> float:
    """Chi-square that a further cause must promise."""
    return 22.0 + math.log(max(study.problem.samples, 30))


def _any_further(study: Study, ranked: list[Ranked], causes: Sequence[Cause]) -> list[Any]:
    out = []
    top = ranked[0].log_evidence
    for r in [r for r in ranked if r.log_evidence > top - 40.0][:LEADING]:
        h = r.best
        used = study if h.hum is None else study.without(h.hum.lines)
        trials = screen_all(used, h, causes, state_of(used, h, _jacobian(used, h)), finite=False).trials
        if h.hum is not None:
            trials = [t for t in trials if t.cause.stage != "lines"]
        known = h.names
        trials = [t for t in chosen(trials) if (t.cause.slug, t.place.where) not in known]
        if trials:
            out.append((h, sorted(trials, key=lambda t: -t.gain)[:FURTHER]))
    return out


def _jacobian(study: Study, h: Hypothesis) -> np.ndarray:
    """Directions of the fitted parameters, long enough to count as free."""
    problem, nuisance = study.problem, study.nuisance
    if not h.causes or not len(searched(h)):
        return np.zeros((0, *problem.data.shape[2:], 2 * problem.data.shape[0] * problem.data.shape[1]))
    J = np.asarray(
        jacobian_of(h.causes, h.index, h.extras, searched(h), h.theta, nuisance.spread, nuisance.basis, problem)
    )
    norm = np.sqrt((J**2).sum(axis=(1, 2, 3), keepdims=True))
    return J / np.where(norm > 0, norm, 1.0) * 1e4
