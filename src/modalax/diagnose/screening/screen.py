r"""Screening: what every cause at every place would explain, by its efficient score and at a few finite sizes.

With g the change of the whitened prediction and r the residual, nuisances projected out,
:math:`z = \langle g, r\rangle/|g|` is standard normal where the cause is absent, and
:math:`2\langle g,r\rangle - |g|^2` is the chi-square that exactly this size would take away.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, ChannelCause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.fitting.nuisance import Nuisance
from modalax.diagnose.fitting.residual import modal_directions
from modalax.diagnose.screening.in_place import InPlace
from modalax.diagnose.screening.screening_fit import Target, fit_from_screening
from modalax.diagnose.screening.sensitivities import Residual, changes_in_batches, plain, rows_of
from modalax.diagnose.setup.problem import Problem

MANY_PLACES = 40  # places beyond which finite sizes are tried only where the derivative is largest
KEPT = 12  # leading places at which every finite size is tried
KEPT_PLACES, KEPT_SHAPES = 8, 4  # places, and shapes at each, whose directions count the independent tests
STARTS_KEPT = 3  # starts of finite size kept for the fit, times two


@dataclass
class Trial:
    """One cause at one place: the best start found and what it explains.

    Attributes
    ----------
    gain
        Chi-square that the start takes away: exactly where a finite size was tried, else as the derivative promises.
    linear
        Chi-square that the derivative promises; by this, too, it is judged whether anything is wrong.
    z
        Score at the derivative, standard normal without the cause; NaN where there is none.
    start
        Parameters to start from; ``starts`` holds further ones.
    direction
        Unit directions of the derivative, shape ``(shape, samples)``.
    error
        Standard deviation of the strength from the derivative.
    trials
        Number of derivatives looked at.
    ripples
        Number of independent sizes that were tried, where these are so many that the best is judged by itself; else 0.
    """

    cause: Cause
    place: Place
    gain: float
    z: float
    start: np.ndarray
    starts: list[np.ndarray] = field(default_factory=list)
    extra: Any = None
    direction: np.ndarray | None = None
    error: float = np.nan
    trials: int = 1
    linear: float = 0.0
    ripples: float = 0.0


def nuisance_of(theta: np.ndarray, comparison: Comparison) -> np.ndarray:
    """Directions of the modal parameters times their spread, those that show."""
    problem, nuisance = comparison.problem, comparison.nuisance
    if not nuisance.active:
        return np.zeros((0, *problem.data.shape[2:], 2 * problem.data.shape[0] * problem.data.shape[1]))
    return np.asarray(modal_directions(theta, nuisance.spread, nuisance.basis, problem))[nuisance.live]


def screen(
    causes: list[tuple[Cause, Place, np.ndarray]], theta: np.ndarray, residual: Residual, problem: Problem,
    nuisance: Nuisance, keep: bool = False, exact: bool = False, there: InPlace | None = None,
) -> list[Trial]:  # fmt: skip
    """Scores of one kind of cause at all the places and parameters given.

    Parameters
    ----------
    causes
        The same cause, its places and the parameters to try there.
    keep
        Whether to keep the unit directions.
    exact
        Whether parameters stand for their own size alone, none for the derivative.
    there
        Linear elements in place, beside which channels are at fault; None where there are none.
    """
    if not causes:
        return []
    cause = causes[0][0]
    index = np.concatenate([np.repeat([place.index], len(grid), axis=0) for _, place, grid in causes])
    params = np.concatenate([grid for *_, grid in causes])
    owner = np.concatenate([np.full(len(grid), k) for k, (*_, grid) in enumerate(causes)])
    before = plain(theta, nuisance.spread, problem)
    if there is not None and isinstance(cause, ChannelCause):
        H, channels = before
        before = there.on(H, channels, np.asarray(problem.outputs), np.asarray(problem.inputs))
    small = np.concatenate([smallest(grid) for *_, grid in causes])
    # a few places stand for all where only the likeness of directions is wanted
    some = np.unique(np.linspace(0, len(causes) - 1, KEPT_PLACES).astype(int))
    wanted = small & np.isin(owner, some) & keep
    rows = rows_of(cause, index, problem)
    directions: dict[int, np.ndarray] = {}
    parts, row = [], 0
    for y in changes_in_batches(cause, index, params, before, theta, nuisance, problem):
        here = None if rows is None else rows[row : row + len(y)]
        parts.append(_products(y, residual.target(here)))
        for k in np.flatnonzero(wanted[row : row + len(y)]):
            directions[row + int(k)] = whole_change(y[k], None if here is None else here[k], residual.value.shape)
        row += len(y)
    square, product, across = (np.concatenate(p) for p in zip(*parts, strict=True))
    if len(residual.inner):
        square = square - np.einsum("pk,kl,pl->p", across, residual.inner, across)
    out = []
    for k, (_, place, grid) in enumerate(causes):
        mine = np.flatnonzero(owner == k)
        kept = [directions[r] for r in mine if r in directions]
        trial = best_trial(cause, place, grid, square[mine], product[mine])
        trial = with_sizes(trial, grid, square[mine], product[mine], not nuisance.active) if exact else trial
        out.append(replace(trial, direction=np.stack(kept[:KEPT_SHAPES])) if kept else trial)
    return out


def _products(y: np.ndarray, aim: Target) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of changes ``(trial, sample)``, and their products with the residual and with the nuisances."""
    square = np.einsum("pn,pn->p", y, y)
    if len(aim.toward) == 1 < len(y):
        return square, y @ aim.toward[0], y @ aim.nuisance[0].T
    return square, np.einsum("pn,pn->p", y, aim.toward), (aim.nuisance @ y[..., None])[..., 0]


def whole_change(y: np.ndarray, rows: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """A change in all samples, from that of some outputs."""
    if rows is None:
        return y.copy()
    out = np.zeros(shape)
    out[rows] = y.reshape(len(rows), *shape[1:])
    return out.ravel()


def with_sizes(
    trial: Trial, rows: np.ndarray, square: np.ndarray, product: np.ndarray, fixed: bool = True
) -> Trial:  # fmt: skip
    """A trial of the derivative with finite sizes tried: what the best of these takes away is its gain.

    Where modal parameters follow, they do so in linear order only, and a finite size tells no more than the derivative:
    then the larger of the two counts.

    Parameters
    ----------
    trial
        What the derivative promises.
    rows
        Parameters tried, shape ``(start, parameter)``.
    square, product
        Squared length of the change by each, and its product with the residual.
    fixed
        Whether no modal parameter follows, so that these are exact.
    """
    exact = np.where(np.isfinite(square) & np.isfinite(product), 2 * product - square, -np.inf)
    order = np.argsort(-exact)
    if not np.isfinite(exact[order[0]]):
        return trial
    if not fixed and trial.gain >= exact[order[0]]:
        return replace(trial, starts=[*(rows[k] for k in order[:STARTS_KEPT]), *trial.starts])
    starts = [rows[k] for k in order[: 2 * STARTS_KEPT]]
    starts = [*starts[:2], trial.start, *starts[2:]]
    return replace(trial, gain=float(exact[order[0]]), start=starts[0], starts=starts[1:])


def linear_size(trial: Trial, cause: Cause) -> np.ndarray | None:
    """The parameters at the size that the derivative promises most of, within bounds; None if that is no size."""
    if not cause.parameters or not np.isfinite(trial.start).all() or trial.start[0] == 0:
        return None
    low, high = (np.array([getattr(q, name) for q in cause.parameters]) for name in ("lower", "upper"))
    return np.clip(trial.start, low, high)


def best_trial(cause: Cause, place: Place, grid: np.ndarray, square: np.ndarray, product: np.ndarray) -> Trial:
    """Choose the best start at one place from squared lengths and products.

    Parameters
    ----------
    cause, place
        What is tried where.
    grid
        Parameters tried, shape ``(start, parameter)``.
    square, product
        Squared length of the change by each, and its product with the residual.
    """
    ok = np.isfinite(square) & np.isfinite(product) & (square > 1e-300)
    square, product = np.where(ok, square, 1.0), np.where(ok, product, 0.0)
    z = product / np.sqrt(square)
    exact = 2 * product - square
    if not len(cause.parameters):
        best = int(np.argmax(np.where(ok, exact, -np.inf)))
        return Trial(cause, place, float(exact[best]), float(z[best]), grid[best])
    small = smallest(grid)
    size = product / square
    lower = cause.parameters[0].lower
    linear = np.where(small & ok, z**2, -np.inf)
    linear = np.where((lower >= 0) & (size < 0), -np.inf, linear)
    # a linear estimate is a start, not a promise: the effect of that size may be quite different
    value = np.maximum(np.where(ok, exact, -np.inf), linear)
    order = np.argsort(-value)
    starts = []
    for k in order[:6]:
        p = grid[k].copy()
        if linear[k] >= exact[k]:
            p[0] = p[0] * size[k]
        starts.append(p)
    derivative = int(np.argmax(np.where(small & ok, np.abs(z), -1.0)))
    error = abs(float(grid[derivative, 0])) / np.sqrt(float(square[derivative]))
    gain = float(value[order[0]])
    return Trial(
        cause, place, gain if np.isfinite(gain) else 0.0, float(z[derivative]), starts[0], starts[1:],
        error=error, trials=int(small.sum()), linear=max(float(linear.max(initial=0.0)), 0.0),
    )  # fmt: skip


def smallest(grid: np.ndarray) -> np.ndarray:
    """Rows that stand for the derivative: the least strength of each set of other parameters."""
    if not grid.shape[1]:
        return np.ones(len(grid), bool)
    size = np.abs(grid[:, 0])
    return size <= size.min() * 1.001 if grid.shape[1] == 1 else size <= _least_by_shape(grid)


def _least_by_shape(grid: np.ndarray) -> np.ndarray:
    _, which = np.unique(grid[:, 1:], axis=0, return_inverse=True)
    least = np.array([np.abs(grid[which == k, 0]).min() for k in range(which.max() + 1)])
    return least[which] * 1.001


def screen_cause(
    cause: Cause, scene: Scene, places: Sequence[Place], theta: np.ndarray, residual: Residual, problem: Problem,
    nuisance: Nuisance, there: InPlace | None = None,
) -> list[Trial]:  # fmt: skip
    """Screen one kind of cause at its places: the derivative at all, finite sizes where they may matter.

    Directions of the derivative are kept, to count independent tests.

    Parameters
    ----------
    places
        Where the cause may sit.
    theta
        Modal parameters in units of their spread.
    residual
        What is to be explained.
    nuisance
        Modal parameters that may adapt.
    there
        Linear elements in place; None where there are none.
    """
    if not places:
        return []
    grids = [(cause, place, cause.grid(scene, place)) for place in places]
    if len(places) <= MANY_PLACES or not cause.parameters:
        return screen(grids, theta, residual, problem, nuisance, True, there=there)
    first = [(c, place, grid[smallest(grid)]) for c, place, grid in grids]
    trials = screen(first, theta, residual, problem, nuisance, True, there=there)
    rows = {k: row for k, t in enumerate(trials) if (row := linear_size(t, cause)) is not None}
    sized = [(cause, places[k], row[None]) for k, row in rows.items()]
    gains = np.array([t.gain for t in trials])
    sizes = screen(sized, theta, residual, problem, nuisance, exact=True, there=there)
    for k, t in zip(rows, sizes, strict=True):
        gains[k] = t.gain
    order = np.argsort(-gains)[:KEPT]
    better = screen([grids[k] for k in order], theta, residual, problem, nuisance, False, there=there)
    for k, trial in zip(order, better, strict=True):
        old = trials[k]
        trials[k] = replace(trial, direction=old.direction, z=old.z, error=old.error, trials=old.trials)
    return trials


def fit_screened(
    comparison: Comparison, starts: list[Hypothesis], state: Residual, base: Hypothesis, rounds: int
) -> list[Hypothesis]:
    """Fit single causes, other than elements and patterns, through the changes that screening computes.

    Parameters
    ----------
    comparison
        Data and simulation.
    starts
        Hypotheses of one cause each, all of one kind.
    state
        What is to be explained.
    base
        The hypothesis that leaves it.
    rounds
        Most steps of the search.
    """
    cause = starts[0].causes[0]
    problem, nuisance, _ = comparison.side(cause.per_run)
    before = plain(base.theta, nuisance.spread, problem)
    whole = state.target()

    def places(part: list[Hypothesis]) -> np.ndarray:
        return np.stack([h.index[0] for h in part])

    def target(part: list[Hypothesis]) -> Target:
        rows = rows_of(cause, places(part), problem)
        return whole if rows is None else state.target(rows)

    def changes(part: list[Hypothesis], owner: np.ndarray, params: np.ndarray) -> np.ndarray:
        index = places(part)[owner]
        batches = changes_in_batches(cause, index, params, before, base.theta, nuisance, problem)
        return np.concatenate(list(batches))

    return fit_from_screening(comparison, base, starts, target, changes, rounds)
