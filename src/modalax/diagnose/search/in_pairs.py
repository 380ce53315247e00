r"""Two causes at once: what every pair of causes and places would explain, by their derivatives.

Of two things that are wrong, either may explain less alone than a third thing that stands between them, and beside that
one no further cause is a help. With unit directions g of the whitened prediction, nuisances projected out, scores
:math:`z = \langle g, r\rangle` and likeness :math:`\rho = \langle g_1, g_2\rangle`, the best sizes of two causes are
:math:`a_1 = (z_1 - \rho z_2)/(1 - \rho^2)` and :math:`a_2` likewise, and together they take :math:`a_1 z_1 + a_2 z_2`
from chi-square (least squares). One matrix of likenesses weighs all pairs, without a fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.causes.base import Cause, ElementCause, LinesCause, LocalCause, PatternCause
from modalax.diagnose.decision.posterior import promise
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.local_elements import changes, direction_of
from modalax.diagnose.screening.products import at_places
from modalax.diagnose.screening.score_state import ScoreState
from modalax.diagnose.screening.screen import Trial, smallest, whole_change
from modalax.diagnose.screening.sensitivities import changes_in_batches, plain, rows_of
from modalax.diagnose.search.candidates import start_from
from modalax.diagnose.thresholds import THRESHOLDS

ROWS = 1500  # most directions that are compared, those that promise most alone
BYTES = 3e8  # of memory that they may take
ALIKE = 0.999  # likeness of two directions beyond which they are one
NEAR = 24.0  # twice the log evidence that a pair may promise less than the best to be fitted
PAIRS, KINDS = 12, 4  # pairs that are fitted, and kinds of pairs, each of which is a program to compile


@dataclass(frozen=True)
class Pair:
    """Two causes at their places, with sizes to start from.

    Attributes
    ----------
    trials
        Each cause at its place.
    gain
        Chi-square that they promise to take away.
    worth
        Twice the log evidence that they promise.
    """

    trials: tuple[Trial, Trial]
    gain: float
    worth: float

    def start(self, null: Hypothesis) -> Hypothesis:
        """Both beside the simulation alone, not fitted yet."""
        first, second = self.trials
        return start_from(start_from(null, first, first.start), second, second.start)


@dataclass(frozen=True)
class _Row:
    """The direction of one trial, of one form: its parameters, what they promise alone, and what they cost.

    ``unit`` is the change by the parameters with nuisances in it, over its length without; ``score`` belongs to it.
    """

    trial: Trial
    params: np.ndarray
    unit: np.ndarray
    length: float
    score: float
    cost: float

    @property
    def alone(self) -> float:
        """Twice the log evidence that it promises alone."""
        return self.score**2 + self.cost


def best_pairs(state: ScoreState, trials: Sequence[Trial]) -> list[Pair]:
    """The pairs of causes that promise most, by falling evidence; the best few kinds, each at its likeliest places.

    Parameters
    ----------
    state
        The simulation alone and its residual.
    trials
        Causes at places, as screened; causes without a size, patterns over channels and hum are in no pair.
    """
    rows = _rows(state, trials)
    if len(rows) < 2:
        return []
    gain, a = _together(state, rows)
    cost = np.array([r.cost for r in rows])
    worth = np.where(gain > 0, gain + cost + cost[:, None] - 2 * THRESHOLDS.several_causes, -np.inf)
    worth[np.tril_indices(len(rows))] = -np.inf
    order = np.argsort(-worth, axis=None)[: 100 * PAIRS]
    out: dict[frozenset, Pair] = {}
    for i, j in zip(*np.unravel_index(order, worth.shape), strict=True):
        if worth[i, j] < worth.flat[order[0]] - NEAR or len(out) == PAIRS:
            break
        both = [replace(rows[k].trial, start=_sized(rows[k], a[k, m])) for k, m in ((i, j), (j, i))]
        key = frozenset((t.cause, t.place) for t in both)
        kinds = {frozenset(t.cause for t in p.trials) for p in out.values()}
        if len(key) == 2 and key not in out and (len(kinds) < KINDS or frozenset(t.cause for t in both) in kinds):
            out[key] = Pair((both[0], both[1]), float(gain[i, j]), float(worth[i, j]))
    return list(out.values())


def _sized(row: _Row, size: float) -> np.ndarray:
    """Parameters whose strength is that of a size in units of the direction's length."""
    p = row.params.copy()
    p[0] *= size / row.length
    return p


def _together(state: ScoreState, rows: list[_Row]) -> tuple[np.ndarray, np.ndarray]:
    """What each pair takes from chi-square, 0 where a size has the wrong sign, and the size of one beside the other."""
    residual = state.sides[True]
    units = np.stack([r.unit for r in rows])
    flat = residual.nuisance.reshape(len(residual.nuisance), -1).astype(np.float32)
    across = (units @ flat.T).astype(float)
    like = (units @ units.T).astype(float) - across @ residual.inner @ across.T
    z = np.array([r.score for r in rows])
    apart = np.abs(like) < ALIKE
    a = (z[:, None] - like * z) / np.where(apart, 1 - like**2, 1.0)
    forward = np.array([r.trial.cause.parameters[0].lower >= 0 for r in rows])
    allowed = ~forward[:, None] | (a * np.sign([r.params[0] for r in rows])[:, None] > 0)
    return np.where(apart & allowed & allowed.T, a * z[:, None] + a.T * z, 0.0), a


def _rows(state: ScoreState, trials: Sequence[Trial]) -> list[_Row]:
    """The directions that promise most alone, in units of their length without nuisances."""
    residual, scene = state.sides[True], state.comparison.scene
    flat, value = residual.nuisance.reshape(len(residual.nuisance), -1), residual.value.ravel()
    most, samples = int(min(ROWS, BYTES / (4 * value.size))), state.comparison.problem.samples
    rows: list[_Row] = []
    for cause in dict.fromkeys(t.cause for t in trials if t.cause.parameters):
        if isinstance(cause, LinesCause | PatternCause) or state.comparison.late():
            continue
        mine = [t for t in trials if t.cause == cause]
        for k, params, y in _changes(state, cause, mine):
            across = flat @ y
            square = float(y @ y - across @ residual.inner @ across)
            if square <= 1e-9 * float(y @ y) or not np.isfinite(square):
                continue
            length, cost = np.sqrt(square), promise(mine[k], scene, samples) - mine[k].gain
            unit, score = (y / length).astype(np.float32), float(y @ value) / length
            rows.append(_Row(mine[k], params, unit, float(length), score, cost))
            if len(rows) > 2 * most:
                rows = sorted(rows, key=lambda r: -r.alone)[:most]
    return sorted(rows, key=lambda r: -r.alone)[:most]


def _changes(state: ScoreState, cause: Cause, trials: list[Trial]) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Number of the trial, parameters and whitened change, flat and runs apart, for the smallest sizes of a cause."""
    comparison, places = state.comparison, [t.place for t in trials]
    weight = np.ascontiguousarray(np.asarray(comparison.problem.weight).transpose(2, 3, 0, 1))
    grids = [g[smallest(g)] for g in (cause.grid(comparison.scene, place) for place in places)]
    if isinstance(cause, ElementCause):
        if not state.reduced:
            return
        reduced = state.reduced[True]
        for k, (place, params) in enumerate(zip(places, grids, strict=True)):
            at = at_places(reduced, [place], targets=False)
            column = np.ascontiguousarray(reduced.column_at(place).T)
            every = changes(cause, isinstance(cause, LocalCause), params, np.zeros(len(params), int), at, reduced)
            for p, y in zip(params, every, strict=True):
                yield k, p, direction_of(weight, column, y)
        return
    problem, nuisance, _ = comparison.side(cause.per_run)
    index = np.concatenate([np.repeat([p.index], len(g), axis=0) for p, g in zip(places, grids, strict=True)])
    owner, params = np.repeat(np.arange(len(grids)), [len(g) for g in grids]), np.concatenate(grids)
    theta, rows = state.hypothesis.theta, rows_of(cause, index, problem)
    before = plain(theta, nuisance.spread, problem)
    pooled = np.asarray(problem.weight).transpose(2, 3, 0, 1)
    share = (weight / np.where(pooled > 0, pooled, 1.0))[..., None]  # 1 with the runs apart
    shape, n = (*pooled.shape, 2), 0
    assert theta is not None
    for batch in changes_in_batches(cause, index, params, before, theta, nuisance, problem):
        for y in batch:
            whole = whole_change(y, None if rows is None else rows[n], (*shape[:2], 2 * shape[2] * shape[3]))
            yield int(owner[n]), params[n], (whole.reshape(shape) * share).ravel()
            n += 1
