"""Hypotheses to start from, what they cost, and which of them still mean what they say."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.causes.signals import HumLines
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.frf import GIVEN
from modalax.diagnose.screening.screen import Trial

FAR = 1e4  # strength of a fit, relative to the largest that is screened, beyond which it is no explanation
ONE_SENSOR = 0.97  # share of a mode's energy at one output beyond which it is that sensor's fault


def start_from(base: Hypothesis, trial: Trial, p: np.ndarray) -> Hypothesis:
    """Add the cause of a trial to a hypothesis, at parameters within its bounds, not fitted yet.

    Parameters
    ----------
    base
        The hypothesis.
    trial
        The cause and its place.
    p
        Parameters to start from.
    """
    within = np.array([q.within(v) for q, v in zip(trial.cause.parameters, p, strict=True)])
    h = base.with_cause(trial.cause, trial.place, trial.extra, within)
    return replace(h, freedom=cost_of(h.causes, h.extras) + (h.hum.freedom if h.hum is not None else 0.0))


def cost_of(causes: Sequence[Cause], extras: Sequence[Any]) -> float:
    """Number of unknowns that causes cost; a force that was measured, where a joint obeys no law, is two."""
    measured = sum(2 * set_aside(cause, extra) for cause, extra in zip(causes, extras, strict=True))
    return float(sum(cause.cost(extra) for cause, extra in zip(causes, extras, strict=True)) + measured)


def set_aside(cause: Cause, extra: Any) -> int:
    """Number of lines, over all runs and inputs, at which the law of a joint is not asked."""
    return int(np.count_nonzero(extra[GIVEN])) if isinstance(cause, JointCause) and extra is not None else 0


def with_hum(h: Hypothesis, lines: HumLines) -> Hypothesis:
    """The hypothesis with some lines explained by hum in addition, not fitted again."""
    return replace(h, chi2=h.chi2 + lines.chi2, freedom=h.freedom + lines.freedom, hum=lines)


def _sensible(h: Hypothesis, comparison: Comparison) -> bool:
    """Whether every cause still means what its name says, and every mode that was added is more than one sensor's."""
    for c, p, extra in zip(h.causes, h.params, h.extras, strict=True):
        if not c.fits(p, comparison.scene) or (c.needs_several_outputs and _one_sensor(extra, comparison)):
            return False
    return True


def moderate(h: Hypothesis, comparison: Comparison) -> bool:
    """Whether every strength is within reach of those that the cause is looked for with; no damper of 1e9 N s/m."""
    for cause, place, p in zip(h.causes, h.places, h.params, strict=True):
        if not cause.strength_is_bounded or not len(p):
            continue
        key = ("reach", cause, place)
        if key not in comparison.scene.cache:
            comparison.scene.cache[key] = float(np.abs(cause.grid(comparison.scene, place)[:, 0]).max())
        if abs(p[0]) > FAR * comparison.scene.cache[key]:
            return False
    return True


def _one_sensor(sizes: np.ndarray, comparison: Comparison) -> bool:
    """Whether a mode shows at one output and in the noise of the others: no mode of a structure does.

    ``sizes`` has the shape ``(term, o, i)``; they are compared in units of each channel's noise.
    """
    unit = np.asarray(comparison.pooled.weight)[0].max(axis=0)
    energy = ((np.asarray(sizes) * unit) ** 2).sum(axis=(0, 2))
    live = int((energy > 0).sum())
    return live > 2 and float(energy.max()) > ONE_SENSOR * float(energy.sum())


def best_of_each(hypotheses: list[Hypothesis], comparison: Comparison) -> list[Hypothesis]:
    """The best fit of each set of causes and places, by rising chi-square."""
    best: dict[Any, Hypothesis] = {}
    for h in hypotheses:
        if not _sensible(h, comparison):
            continue
        key = (frozenset(zip(h.causes, h.places, strict=True)), h.hum is None)
        if np.isfinite(h.chi2) and (key not in best or h.chi2 < best[key].chi2):
            best[key] = h
    return sorted(best.values(), key=lambda h: h.chi2)
