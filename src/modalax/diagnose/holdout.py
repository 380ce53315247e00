r"""Prediction of data held out of the fit: a force level, a repeat, a column, or blocks of lines."""

from dataclasses import replace

import numpy as np
import scipy.special

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis, searched
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import nuisance_of
from modalax.diagnose.search.rows import force_taken
from modalax.diagnose.search.singles import refit

BLOCKS = 16  # stretches of the band where there is nothing else to hold out; every fourth is
RESAMPLED = 400  # draws of blocks of lines for the standard deviation of the gain


def held_out_block(
    level: np.ndarray, inputs: tuple[str, ...], shape: tuple[int, ...], lines: int, alike: bool = True,
    foretold: bool = True, lowest: bool = False,
) -> tuple[str, np.ndarray]:  # fmt: skip
    """Choose the block that is held out, and mark it in a mask of shape ``(run, f, o, i)``.

    It is the highest force level with all its runs, or the lowest, else a repeat, else a column, else every fourth
    stretch of lines.

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
    lowest
        Whether it is the lowest level, as of what was fitted from the highest on.
    foretold
        Whether the other columns tell enough of the last to foretell it.
    """
    mask = np.zeros(shape, bool)
    runs, n_in = shape[0], len(inputs)
    known = bool(np.isfinite(level).all())
    if alike and known and len(np.unique(level)) > 1:
        end = level.min() if lowest else level.max()
        some = np.flatnonzero(level == end)
        mask[some] = True
        which = f"run{'s' * (len(some) > 1)} {', '.join(str(k + 1) for k in some)}"
        return f"{which} at {end:.4g} N, the {'lowest' if lowest else 'highest'} level", mask
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
    return Gain(
        words, float((np.abs(before) ** 2).sum() / count), float((np.abs(after) ** 2).sum() / count),
        float(by_line.sum()), deviation_of_sum(by_line), missed, float(within.sum() / count),
    )  # fmt: skip


def deviation_of_sum(by_line: np.ndarray) -> float:
    """Standard deviation of a sum over lines, by resampling blocks of neighbours."""
    blocks = np.array([b.sum() for b in np.array_split(by_line, min(BLOCKS, len(by_line)))])
    draws = blocks[np.random.default_rng(0).integers(len(blocks), size=(RESAMPLED, len(blocks)))].sum(axis=1)
    return float(draws.std())


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
    return unseen.residual(fitted), _missed(seen, unseen, h, fitted, tolerated)


def _missed(seen: Comparison, unseen: Comparison, h: Hypothesis, fitted: Hypothesis, tolerated: float) -> float:
    r"""How much worse parameters fitted to all explain what was kept, as a normal variable of the same chance.

    With the block the parameters move; what that adds to the chi-square of the rest is the block's predictive
    chi-square less the one within it. Of parameters with information :math:`A` in the rest (the claimed spread of modal
    parameters included) and :math:`B` in the block it is a sum of squares of normal variables with the weights
    :math:`\lambda` that are the eigenvalues of :math:`B(A+B)^{-1}`. A mode that only the block shows weighs one,
    however far it is off. That sum is taken for a multiple of a chi-square of the same mean and variance (Satterthwaite
    1946, Biometrics Bulletin 2:110). What a law is too inexact for, ``tolerated``, does not count.
    """
    if fitted.covariance is None or not len(searched(fitted)):
        return 0.0
    kept, J = _slopes(seen, fitted), _slopes(unseen, fitted)
    claimed = 1.0 * (np.arange(len(J)) >= len(searched(fitted)))
    weights = np.linalg.lstsq(kept @ kept.T + J @ J.T + np.diag(claimed), J @ J.T, rcond=None)[0]
    total, squares = (max(float(np.trace(w)), 1e-300) for w in (weights, weights @ weights))
    worse = max(seen.chi2(h) - seen.chi2(fitted) - tolerated, 0.0)
    chance = scipy.special.chdtrc(total**2 / squares, worse * total / squares)
    return -float(scipy.special.ndtri(min(chance, 0.5)))


def _slopes(comparison: Comparison, h: Hypothesis) -> np.ndarray:
    """Derivatives of the whitened residual by what is searched, then by the modal parameters over their spread."""
    assert h.theta is not None
    J = comparison.slopes(h).reshape(len(searched(h)), -1)
    return np.concatenate([J, nuisance_of(h.theta, comparison).reshape(-1, J.shape[1])])
