r"""Levenberg-Marquardt search for the poles of largest likelihood, on the host.

The steps are those of :class:`modalax._numerics.levenberg.LevenbergMarquardt`. The search may end where further steps
do not matter statistically: when one would lower the sum of squares by a small part of what a degree of freedom has.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from modalax.identify.kernels import limits, turned_to_largest
from modalax.identify.projection import Projection
from modalax.identify.reduced import Sums

PATIENCE = 10  # steps that a mode may spend out of range before it is dropped
ROUNDING = 1e-31  # sum of squares that rounding of the data may leave, relative to that of the data
LOST = (-50.0, 50.0)  # logarithms of frequencies and damping ratios well beyond their limits
LARGE = 1e8  # participation beside the pivot's from which on its square is lost in rounding, and another is the pivot
STATISTICAL = 1e-3  # part of the sum of squares a degree of freedom that a step must gain


class Ascent(NamedTuple):
    """The end of a search.

    Attributes
    ----------
    theta, pivot, held
        Unknowns, pivots and held dampings of the modes that were kept.
    kept
        Which of the given modes these are, shape ``(n,)``, indices.
    sums
        Cost, gradient and Gauss-Newton matrix there.
    steps, finished
        Number of evaluations, and whether the search ended before its limit of them.
    """

    theta: np.ndarray
    pivot: np.ndarray
    held: np.ndarray
    kept: np.ndarray
    sums: Sums
    steps: int
    finished: bool


def frozen(theta: np.ndarray, held: np.ndarray, real_modes: bool) -> np.ndarray:
    """1 for unknowns without effect: dampings held, and dampings and frequencies at their limits, shape ``(n, q)``."""
    gone, stuck = limits(theta)
    blind = np.zeros(theta.shape)
    blind[:, 0], blind[:, 1] = gone, np.maximum(held, stuck)
    if real_modes:
        blind[:, 1 + theta.shape[1] // 2 :] = 1
    return blind


def climb(
    projection: Projection,
    theta: np.ndarray,
    pivot: np.ndarray,
    held: np.ndarray,
    *,
    max_steps: int = 60,
    tol: float = STATISTICAL,
    runaway: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Ascent:
    r"""Search the largest likelihood from given unknowns.

    Parameters
    ----------
    projection
        The data.
    theta, pivot, held
        As for :meth:`Projection.sums`.
    max_steps
        Most evaluations.
    tol
        The search ends when a step would lower half the sum of squares by less than this part of the sum of squares a
        degree of freedom; 0 for an end at rounding.
    runaway
        Tells of unknowns ``(n, q)`` which modes are out of range. One that stays so for ``PATIENCE`` steps is dropped.

    Returns
    -------
    Ascent
        The best point seen.
    """
    kept, count = np.arange(len(theta)), np.zeros(len(theta), int)
    best, trial, state, steps, finished = None, theta, _State(), 0, False
    dof = max(projection.degrees_of_freedom(len(theta)), 1)
    rounding = ROUNDING * float(np.sum(np.abs(projection.y) ** 2))
    while steps <= max_steps and not finished:
        value = _try(projection, trial, pivot, held)
        steps += 1
        good = best is None or (np.isfinite(value.cost) and value.cost <= best.cost and _finite(value))
        cost = value.cost if best is None else best.cost
        small = (2 * tol / dof + 4e-16) * cost + rounding
        finished = state.judge(None if best is None else best.cost, value.cost, good, small)
        if good:
            theta, best = trial, value
            out = np.zeros(len(theta), bool) if runaway is None else runaway(theta)
            count = np.where(out, count + 1, 0)
            if (count >= PATIENCE).any() and not (count >= PATIENCE).all():
                stay = count < PATIENCE
                theta, pivot, held, kept, count = theta[stay], pivot[stay], held[stay], kept[stay], count[stay]
                best, trial, state, finished = None, theta, _State(), False
                continue
        if not np.isfinite(best.cost):
            break
        if (np.abs(theta[:, 2:]) > LARGE).any():  # the mode leaves its pivot: its shape is next to nothing there
            theta, pivot = turned_to_largest(theta, pivot)
            best = _try(projection, theta, pivot, held)
        trial, ended = state.step(theta, best, frozen(theta, held, projection.real_modes), small)
        finished = finished or ended
    best = _try(projection, theta, pivot, held) if best is None else best
    return Ascent(theta, pivot, held, kept, best, steps - 1, finished)


def _try(projection: Projection, theta: np.ndarray, pivot: np.ndarray, held: np.ndarray) -> Sums:
    """The sums at a trial; an infinite cost where its columns depend on each other."""
    with np.errstate(all="ignore"):
        try:
            return projection.sums(theta, pivot, held)
        except np.linalg.LinAlgError:
            return Sums(np.inf, np.zeros(theta.size), np.eye(theta.size))


def _finite(value: Sums) -> bool:
    return bool(np.isfinite(value.gradient).all() and np.isfinite(value.matrix).all())


class _State:
    """Damping of the steps, and the reduction that the last step promised."""

    def __init__(self) -> None:
        self.damping, self.predicted, self.rejected = 1e-3, np.inf, 0

    def judge(self, before: float | None, cost: float, good: bool, small: float) -> bool:
        """Adapt the damping to the outcome of a trial; True if the trial gained next to nothing."""
        if not good:
            self.damping, self.rejected = min(self.damping * 8.0, 1e14), self.rejected + 1
            return False
        self.rejected = 0
        if before is None:
            return False
        drop = before - cost
        if drop > 0.75 * self.predicted:
            self.damping = max(self.damping * 0.1, 1e-14)
        return drop <= small and abs(self.predicted) <= 10 * small

    def step(self, theta: np.ndarray, at: Sums, blind: np.ndarray, small: float) -> tuple[np.ndarray, bool]:
        """The next trial, and whether its promised gain is too small to continue."""
        free = blind.ravel() == 0
        scale = np.sqrt(np.where(np.diag(at.matrix) > 0, np.diag(at.matrix), 1.0))
        # In scaled variables the matrix has a unit diagonal, so one damping suits all unknowns.
        matrix = at.matrix / (scale[:, None] * scale) * np.outer(free, free)
        system = matrix + np.diag(np.where(free, self.damping, 1.0))
        slope = np.where(free, at.gradient / scale, 0.0)
        step = -np.linalg.solve(system, slope)
        self.predicted = float(-step @ slope - 0.5 * step @ (system @ step) + 0.5 * self.damping * step @ step)
        move = step / scale
        size = float(np.max(np.abs(move)))
        ended = (abs(self.predicted) <= small or size <= 4e-15) and self.damping < 1.0
        ended = ended or (self.rejected >= 4 and size < 1e-9) or self.rejected > 20
        trial = theta + move.reshape(theta.shape)
        for k in (0, 1):  # frequency and damping have no slope there, and their exponentials no meaning
            trial[:, k] = np.clip(trial[:, k], *LOST)
        return trial, ended
