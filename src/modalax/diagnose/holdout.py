r"""Prediction of data held out of the fit: a force level, a repeat, a column, or blocks of lines."""

from dataclasses import replace

import numpy as np

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis, searched
from modalax.diagnose.fitting.residual import jacobian_of
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.search.rows import force_taken
from modalax.diagnose.search.singles import refit

BLOCKS = 16  # stretches of the band where there is nothing else to hold out; every fourth is
RESAMPLED = 400  # draws of blocks of lines for the standard deviation of the gain


def held_out_block(
    level: np.ndarray, inputs: tuple[str, ...], shape: tuple[int, ...], lines: int, alike: bool = True,
    foretold: bool = True,
) -> tuple[str, np.ndarray]:  # fmt: skip
    """Choose the block that is held out, and mark it in a mask of shape ``(run, f, o, i)``.

    It is the highest force level with all its runs, else a repeat, else a column, else every fourth stretch of lines.

    Parameters
    ----------
    level
        Force amplitude of each run [N].
    inputs
        Names of the inputs.
    shape
        Shape of the mask, which may be padded.
    lines
        True number of lines.
    alike
        Whether runs differ by their level only; others have parameters of their own and cannot be held out.
    foretold
        Whether the other columns tell enough of the last to foretell it.
    """
    mask = np.zeros(shape, bool)
    runs, n_in = shape[0], len(inputs)
    known = bool(np.isfinite(level).all())
    if alike and known and len(np.unique(level)) > 1:
        top = np.flatnonzero(level == level.max())
        mask[top] = True
        which = f"run{'s' * (len(top) > 1)} {', '.join(str(k + 1) for k in top)}"
        return f"{which} at {level.max():.4g} N, the highest level", mask
    if alike and runs > 1:
        mask[-1] = True
        return f"run {runs}, the last repeat", mask
    why = "" if alike else "; no run, as each has parameters of its own"
    if n_in > 1 and foretold:
        mask[..., n_in - 1] = True
        return f"the column of input {inputs[-1]}{why}", mask
    edges = np.linspace(0, lines, min(BLOCKS, max(lines // 4, 2)) + 1).astype(int)
    for k in range(1, len(edges) - 1, 4):
        mask[:, edges[k] : edges[k + 1]] = True
    return f"every fourth of {len(edges) - 1} blocks of neighbouring lines{why}", mask


def measure(
    comparisons: tuple[Comparison, Comparison], null: Hypothesis, found: Hypothesis, tolerated: float = 0.0
) -> Gain:
    """Fit the simulation and the extended one without the held-out block, and compare them on it.

    Parameters
    ----------
    comparisons
        In which each of the two was fitted.
    null
        The simulation alone.
    found
        The leading set of causes.
    tolerated
        Chi-square that the inexactness of the laws may leave.
    """
    comparison = comparisons[0]
    weight = np.asarray(comparison.problem.weight)
    level, lines = np.asarray(comparison.measurement.level), comparison.problem.lines
    alike = not any(c.each_run for c in found.causes)
    own_sizes = any(isinstance(c, PatternCause) for c in found.causes)
    words, mask = held_out_block(level, comparison.measurement.inputs, weight.shape, lines, alike, not own_sizes)
    drop = np.zeros(weight.shape[1], bool)
    if found.hum is not None:
        drop[: len(found.hum.lines)] = found.hum.lines
    weight = np.where(drop[None, :, None, None] | force_taken(found)[:, :, None], 0.0, weight)
    kept, left = np.where(mask, 0.0, weight), np.where(mask, weight, 0.0)
    before = _on(comparisons[0], kept, left, replace(null, theta=np.zeros_like(null.theta)))[0]
    after, missed = (before, 0.0) if not found.causes else _on(comparisons[1], kept, left, found, tolerated)
    within = np.abs(comparisons[1].reweighted(left).residual(found)) ** 2
    live = left > 0
    count = 2 * int(live.sum())
    if count == 0:
        return Gain(words, float("nan"), float("nan"), 0.0, 0.0)
    by_line = 0.5 * (np.abs(before) ** 2 - np.abs(after) ** 2).sum(axis=(0, 2, 3))[:lines]
    blocks = np.array([b.sum() for b in np.array_split(by_line, min(BLOCKS, len(by_line)))])
    rng = np.random.default_rng(0)
    draws = blocks[rng.integers(len(blocks), size=(RESAMPLED, len(blocks)))].sum(axis=1)
    return Gain(
        words, float((np.abs(before) ** 2).sum() / count), float((np.abs(after) ** 2).sum() / count),
        float(by_line.sum()), float(draws.std()), missed, float(within.sum() / count),
    )  # fmt: skip


def _on(
    comparison: Comparison, kept: np.ndarray, left: np.ndarray, h: Hypothesis, tolerated: float = 0.0
) -> tuple[np.ndarray, float]:
    """Whitened residuals on the held-out block after a fit to the rest, and the excess of their chi-square."""
    seen, unseen = comparison.reweighted(kept), comparison.reweighted(left)
    null = seen.fit([replace(h, causes=(), places=(), extras=(), params=(), hum=None)], ROUNDS)[0]
    if not h.causes:
        return unseen.residual(null), 0.0
    if len(h.causes) == 1 and h.extras[0] is None and not seen.nuisance.active:
        fitted = refit(score_state_of(seen, null), [h])[0]
    else:
        fitted = seen.fit([h], ROUNDS)[0]
    residual = unseen.residual(fitted)
    return residual, _missed(unseen, residual, h, fitted, tolerated)


def _missed(unseen: Comparison, residual: np.ndarray, h: Hypothesis, fitted: Hypothesis, tolerated: float) -> float:
    r"""Excess of the block's chi-square over that of ``h``, in standard deviations of what parameter errors add.

    Errors of covariance C add :math:`|J\delta|^2 - 2 e^T J\delta`, of mean :math:`\mathrm{tr}\,S`, :math:`S = J^T J C`,
    and variance :math:`2\,\mathrm{tr}\,S^2 + 4\,\mathrm{tr}\,S`. What a law is too inexact for, ``tolerated``, is no
    excess.
    """
    if fitted.covariance is None or not len(searched(fitted)):
        return 0.0
    slopes = jacobian_of(
        fitted.causes, fitted.index, fitted.extras, searched(fitted), fitted.theta, unseen.nuisance.spread,
        unseen.nuisance.basis, unseen.problem,
    )  # fmt: skip
    J = np.asarray(slopes).reshape(len(searched(fitted)), -1)
    S: np.ndarray = J @ J.T @ fitted.covariance[: len(J), : len(J)]
    free = float((np.asarray(fitted.theta) != 0).sum())
    mean, spread = np.trace(S) + free, np.sqrt(max(2 * np.trace(S @ S) + 4 * np.trace(S) + 6 * free, 1.0))
    excess = float((np.abs(residual) ** 2).sum() - (np.abs(unseen.residual(h)) ** 2).sum())
    return float((excess - mean - tolerated) / spread)
