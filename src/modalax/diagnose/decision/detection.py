r"""Detection: the significance of what the screening and the omnibus tests saw."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special

from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.screening.patterns import independent
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.thresholds import THRESHOLDS

WHEREABOUTS = 3  # places of modes that the simulation may lack: in the band, above it, below it


@dataclass(frozen=True)
class Detection:
    """Chance, under noise alone, of what each kind of test saw, and what it stands for.

    Attributes
    ----------
    p_values
        By kind of test, corrected for the number of trials of that kind.
    threshold
        Size of a score that counts as significant.
    """

    p_values: dict[str, float]
    threshold: float

    @property
    def p_value(self) -> float:
        """Of all tests together."""
        return min(1.0, min(self.p_values[k] / THRESHOLDS.shares[k] for k in self.p_values))

    @property
    def anything(self) -> bool:
        """Whether something is wrong."""
        return self.p_value < THRESHOLDS.alarm


def effective_number(directions: np.ndarray, state: Residual) -> float:
    """Number of independent directions that scores behave like."""
    if not len(directions):
        return 1.0
    C = directions @ directions.T
    if len(state.inner):
        across = directions @ state.nuisance.reshape(len(state.nuisance), -1).T
        C = C - across @ state.inner @ across.T
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    return independent(C / scale[:, None] / scale[None])


def detect(
    trials: Sequence[Trial], states: dict[bool, Residual], remains: Omnibus, spread: float = 1.0,
    tolerated: float = 0.0,
) -> Detection:  # fmt: skip
    """Significance of the largest score, of patterns over channels, of hum and of the omnibus test.

    Parameters
    ----------
    spread
        By how much estimated variances widen the scores.
    tolerated
        Chi-square that the known inexactness of a law may leave.
    """
    count, top = 0.0, 0.0
    scored = [t for t in trials if np.isfinite(t.z)]
    for side in states:
        mine = [t for t in scored if t.cause.per_run == side]
        kept = [t.direction for t in mine if t.direction is not None]
        D = np.concatenate(kept) if kept else np.zeros((0, 1))
        D = D[np.isfinite(D).all(axis=1)]  # where the modes were driven far off, some effects overflow
        if len(D):
            looked = sum(t.trials for t in mine)
            # places that were not kept add to the number of tests no more than as many of those kept
            count += effective_number(D, states[side]) * max(1.0, (looked / len(D)) ** 0.5)
    top = max((math.sqrt(max(t.gain - tolerated, t.linear - tolerated, 0.0)) for t in scored), default=0.0)
    count = max(count, 1.0)
    # one mode a side shows nearly all that several would
    patterns = [t for t in trials if t.cause.judged_by == "patterns"]
    p = {
        "scores": -math.expm1(count * math.log1p(-min(2 * scipy.special.ndtr(-top / spread), 1 - 1e-12))),
        "patterns": min((_pattern_p(t, spread, tolerated) for t in patterns), default=1.0),
        "hum": min((_hum_p(t) for t in trials if t.cause.judged_by == "hum"), default=1.0),
        "lengths": min((_ripple_p(t, spread, tolerated) for t in trials if t.ripples), default=1.0),
        "omnibus": remains.p_value,
    }
    single = -math.expm1(math.log1p(-THRESHOLDS.alarm * THRESHOLDS.share_of_scores) / count)
    return Detection(p, float(-scipy.special.ndtri(single / 2)) * spread)


def _pattern_p(t: Trial, spread: float, tolerated: float) -> float:
    r"""Chance of so large a gain: the largest singular value of noise, at every separate frequency.

    The square of the largest singular value of ``o x i`` normal numbers exceeds a high level with the chance
    :math:`\kappa\,P(\chi^2_{o+i-1} > x)`, :math:`\kappa = \sqrt\pi\,\Gamma(\tfrac{o+i-1}2) / (\Gamma(\tfrac o2)
    \Gamma(\tfrac i2))`: the leading term of Adler's and Taylor's expansion (2007) over the two unit spheres. It is
    never above the sum of all squares.
    """
    terms, outputs, inputs = t.extra.shape
    o = int((np.abs(t.extra).max(axis=(0, 2)) > 0).sum())
    i = int((np.abs(t.extra).max(axis=(0, 1)) > 0).sum())
    gamma = scipy.special.gammaln
    log_kappa = 0.5 * math.log(math.pi) + gamma((o + i - 1) / 2) - gamma(o / 2) - gamma(i / 2)
    gain = max(t.gain - tolerated, 0.0) / spread**2
    one_shape = math.exp(terms * log_kappa) * scipy.special.chdtrc(terms * (o + i - 1), gain)
    return float(min(1.0, WHEREABOUTS * t.trials * min(one_shape, scipy.special.chdtrc(terms * o * i, gain))))


def _ripple_p(t: Trial, spread: float, tolerated: float) -> float:
    """Chance that one of many sizes takes away so much; a change e does by 2<e, r> - |e|^2, never more than its z^2."""
    return min(1.0, t.ripples * float(scipy.special.ndtr(-math.sqrt(max(t.gain - tolerated, 0.0)) / spread)))


def _hum_p(t: Trial) -> float:
    return min(1.0, t.trials * t.extra.p_value)
