"""Leading joints fitted again with the higher harmonics of their motion, where the data is exact enough to ask."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.harmonics import harmonic_factor
from modalax.diagnose.search.singles import PATIENT

HIGHEST = 9  # harmonic kept
FEWER = 5  # harmonic kept for what the truncation may leave
TIMES = 3  # that harmonics and fit follow each other, at most
ASKED = 0.3  # standard deviations by which the idealisation may bend a parameter before it is worth the work
SETTLED = 1e-2  # change of chi-square at which harmonics and fit have settled
TRIED = 6  # leading hypotheses that are fitted so
ONE_LAW = 2  # of these, most with the same causes


def joints_in_full(comparison: Comparison, null: Hypothesis, ranked: list[Hypothesis]) -> list[Hypothesis]:
    r"""Fit the leading hypotheses that hold a joint with all harmonics that its force needs.

    One harmonic leaves a relative error :math:`\varepsilon` of the joint's effect (the cause's ``fidelity``). An effect
    :math:`d` standard deviations long then bends parameters by up to :math:`\varepsilon d` of theirs, and chi-square
    by up to :math:`\varepsilon^2 d^2`: all hypotheses within that of the best are fitted again.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    ranked
        Hypotheses, the best first.
    """
    best = ranked[0].chi2
    effect = max(null.chi2 - best, 0.0)
    out: list[Hypothesis] = []
    for h in ranked:
        if len(out) == TRIED:
            break
        bend = max((c.fidelity for c in h.causes), default=0.0) * np.sqrt(effect)
        alike = sum(h.causes == other.causes for other in out) < ONE_LAW
        if bend > ASKED and h.chi2 < best + 4 * bend**2 + 1 and alike and one_joint(comparison, h):
            out.append(h)
    return [fitted_in_full(comparison, null, h) for h in out]


def one_joint(comparison: Comparison, h: Hypothesis) -> bool:
    """Whether a hypothesis holds one joint with a force law, on a structure that has none."""
    held = comparison.problem.held
    if held is not None and any(isinstance(c, JointCause) for c in held.causes):
        return False
    joints = [c for c in h.causes if isinstance(c, JointCause)]
    return h.hum is None and len(joints) == 1 and type(joints[0]).law is not JointCause.law


def fitted_in_full(comparison: Comparison, null: Hypothesis, h: Hypothesis) -> Hypothesis:
    """Find the effect of higher harmonics and fit again, until both stand still.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    h
        A hypothesis with one joint.
    """
    k = next(k for k, c in enumerate(h.causes) if isinstance(c, JointCause))
    for _ in range(TIMES):
        factor = _factor(comparison, h, HIGHEST)
        before = h.chi2
        h = replace(h, extras=(*h.extras[:k], factor, *h.extras[k + 1 :]))
        h = comparison.fit([h], PATIENT)[0]
        if abs(before - h.chi2) < SETTLED:
            break
    return replace(h, fidelity=_left_out(comparison, null, h, k))


def _factor(comparison: Comparison, h: Hypothesis, highest: int) -> np.ndarray:
    theta = jnp.asarray(h.theta * comparison.nuisance.spread)
    params = tuple(jnp.asarray(p) for p in h.params)
    plain = tuple(None if isinstance(c, JointCause) else e for c, e in zip(h.causes, h.extras, strict=True))
    return np.asarray(harmonic_factor(h.causes, h.index, plain, params, theta, comparison.problem, highest))


def _left_out(comparison: Comparison, null: Hypothesis, h: Hypothesis, k: int) -> float:
    """Relative error of the joint's effect that the harmonics left out may make: the change from fewer to these."""
    fewer = _factor(comparison, h, FEWER)
    other = replace(h, extras=(*h.extras[:k], fewer, *h.extras[k + 1 :]))
    change = comparison.residual(h) - comparison.residual(other)
    effect = comparison.residual(h) - comparison.residual(null)
    return float(np.linalg.norm(change) / max(np.linalg.norm(effect), 1e-300))
