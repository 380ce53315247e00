r"""Screening: what every cause at every place would explain, by its efficient score and at a few finite sizes.

With g the change of the whitened prediction and r the residual, nuisances projected out,
:math:`z = \langle g, r\rangle/|g|` is standard normal where the cause is absent, and
:math:`2\langle g,r\rangle - |g|^2` is the chi-square that exactly this size would take away.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, Place, Scene
from modalax.diagnose.causes.patterns import PatternCause
from modalax.diagnose.changes import Residual, changes_in_batches, plain, rows_of
from modalax.diagnose.fit import Hypothesis, Nuisance, modal_directions
from modalax.diagnose.problem import Problem
from modalax.diagnose.quick import Target, fit_quick
from modalax.diagnose.study import Study

MANY_PLACES = 40  # beyond this, finite sizes are tried only where the derivative looks promising
KEPT = 12
KEPT_PLACES, KEPT_SHAPES = 8, 4
SETTLED = 1e-5  # change of a shape of length one at which it counts as found


@dataclass
class Trial:
    """One cause at one place: the best start found and what it explains.

    Attributes
    ----------
    gain
        Chi-square that the start takes away, with the size optimal where the effect is linear.
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


def nuisance_of(theta: np.ndarray, study: Study) -> np.ndarray:
    """Directions of the modal parameters times their spread, those that show."""
    problem, nuisance = study.problem, study.nuisance
    if not nuisance.active:
        return np.zeros((0, *problem.data.shape[2:], 2 * problem.data.shape[0] * problem.data.shape[1]))
    return np.asarray(modal_directions(theta, nuisance.spread, nuisance.basis, problem))[nuisance.live]


def screen(
    causes: list[tuple[Cause, Place, np.ndarray]], theta: np.ndarray, residual: Residual, problem: Problem,
    nuisance: Nuisance, keep: bool = False,
) -> list[Trial]:  # fmt: skip
    """Scores of one kind of cause at all the places and parameters given.

    Parameters
    ----------
    causes
        The same cause, its places and the parameters to try there.
    keep
        Whether to keep the unit directions.
    """
    if not causes:
        return []
    cause = causes[0][0]
    index = np.concatenate([np.repeat([place.index], len(grid), axis=0) for _, place, grid in causes])
    params = np.concatenate([grid for *_, grid in causes])
    owner = np.concatenate([np.full(len(grid), k) for k, (*_, grid) in enumerate(causes)])
    base = plain(theta, nuisance.spread, problem)
    small = np.concatenate([smallest(grid) for *_, grid in causes])
    # a few places stand for all where only the likeness of directions is wanted
    some = np.unique(np.linspace(0, len(causes) - 1, KEPT_PLACES).astype(int))
    wanted = small & np.isin(owner, some) & keep
    rows = rows_of(cause, index, problem)
    directions: dict[int, np.ndarray] = {}
    parts, row = [], 0
    for y in changes_in_batches(cause, index, params, base, theta, nuisance, problem):
        here = None if rows is None else rows[row : row + len(y)]
        parts.append(_products(y, residual.target(here)))
        for k in np.flatnonzero(wanted[row : row + len(y)]):
            directions[row + int(k)] = _whole(y[k], None if here is None else here[k], residual.value.shape)
        row += len(y)
    square, product, across = (np.concatenate(p) for p in zip(*parts, strict=True))
    if len(residual.inner):
        square = square - np.einsum("pk,kl,pl->p", across, residual.inner, across)
    out = []
    for k, (_, place, grid) in enumerate(causes):
        mine = np.flatnonzero(owner == k)
        kept = [directions[r] for r in mine if r in directions]
        trial = best_trial(cause, place, grid, square[mine], product[mine])
        out.append(replace(trial, direction=np.stack(kept[:KEPT_SHAPES])) if kept else trial)
    return out


def _products(y: np.ndarray, aim: Target) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of changes ``(trial, sample)``, and their products with the residual and with the nuisances."""
    square = np.einsum("pn,pn->p", y, y)
    if len(aim.toward) == 1 < len(y):
        return square, y @ aim.toward[0], y @ aim.nuisance[0].T
    return square, np.einsum("pn,pn->p", y, aim.toward), (aim.nuisance @ y[..., None])[..., 0]


def _whole(y: np.ndarray, rows: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """A change in all samples, from that of some outputs."""
    if rows is None:
        return y.copy()
    out = np.zeros(shape)
    out[rows] = y.reshape(len(rows), *shape[1:])
    return out.ravel()


def best_trial(cause: Cause, place: Place, grid: np.ndarray, square: np.ndarray, product: np.ndarray) -> Trial:
    """The best start at one place."""
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
        error=error, trials=int(small.sum()),
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
    nuisance: Nuisance, keep: bool,
) -> list[Trial]:  # fmt: skip
    """One kind of cause at its places: derivatives everywhere, finite sizes where they may matter."""
    if not places:
        return []
    grids = [(cause, place, cause.grid(scene, place)) for place in places]
    if len(places) <= MANY_PLACES or not cause.parameters:
        return screen(grids, theta, residual, problem, nuisance, keep)
    first = [(c, place, grid[smallest(grid)]) for c, place, grid in grids]
    trials = screen(first, theta, residual, problem, nuisance, keep)
    order = np.argsort([-t.gain for t in trials])[:KEPT]
    better = screen([grids[k] for k in order], theta, residual, problem, nuisance, False)
    for k, trial in zip(order, better, strict=True):
        old = trials[k]
        trials[k] = replace(trial, direction=old.direction, z=old.z, error=old.error, trials=old.trials)
    return trials


def fit_screened(
    study: Study, starts: list[Hypothesis], state: Residual, base: Hypothesis, rounds: int
) -> list[Hypothesis]:
    """Fit single causes of any kind but elements and patterns, through the changes that screening computes."""
    cause = starts[0].causes[0]
    problem, nuisance, _ = study.side(cause.per_run)
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

    return fit_quick(study, base, starts, target, changes, rounds)


def screen_pattern(cause: PatternCause, scene: Scene, residual: Residual, problem: Problem) -> Trial:
    """Best shape parameters and real sizes in every channel, by linear least squares at each trial."""
    s = 1j * np.asarray(problem.omega)
    weight = np.asarray(problem.weight)
    runs = weight.shape[0]
    r = residual.value.reshape(*residual.value.shape[:2], runs, -1, 2)
    r = (r[..., 0] + 1j * r[..., 1]).transpose(2, 3, 0, 1)
    best, found, at = -np.inf, None, None
    w2 = (weight**2).sum(axis=0)
    wr = (weight * r).sum(axis=0)
    drawn = []
    for q in cause.shapes(scene):
        B = np.asarray(cause.curves(s, q))
        drawn.append(B)
        gram = np.real(np.einsum("tf,uf,foi->oitu", B.conj(), B, w2))
        right = np.real(np.einsum("tf,foi->oit", B.conj(), wr))
        a = _solved(gram, right)
        a = a if cause.several else low_rank(a, gram)
        value = _explained(a, gram, right)
        if value > best:
            best, found, at = value, q, (a, gram, right)
    assert found is not None and at is not None
    sizes = at[0] if cause.several else settled_rank(*at)
    best = max(best, _explained(sizes, *at[1:]))
    extra = np.moveaxis(sizes, -1, 0)
    start = np.concatenate([np.ones(cause.terms), found])
    looked = np.prod([independent(_over_lines(curves, w2)) for curves in np.swapaxes(drawn, 0, 1)])
    return Trial(cause, Place(()), best, np.nan, start, extra=extra, trials=round(looked))


def _over_lines(curves: np.ndarray, weight2: np.ndarray) -> np.ndarray:
    """Correlation of curves (trial, f) as they stand in weighted lines, with real sizes."""
    scaled = curves * np.sqrt(weight2.mean(axis=(1, 2)))
    unit = scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-300)
    return np.real(unit @ unit.conj().T)


def independent(correlation: np.ndarray) -> float:
    r"""Number of independent scores that correlated ones behave like, :math:`(\sum\sqrt\lambda)^2/\sum\lambda`.

    Galwey (2009), Genetic Epidemiology 33:559, for the eigenvalues of the correlation matrix.
    """
    values = np.maximum(np.linalg.eigvalsh(correlation), 0.0)
    return float(np.sqrt(values).sum() ** 2 / values.sum())


def low_rank(a: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Sizes of rank one over outputs and inputs for each term, weighted alike (one mode has one shape)."""
    if min(a.shape[:2]) < 2:
        return a
    out = np.empty_like(a)
    for t in range(a.shape[-1]):
        row = np.sqrt(np.maximum(gram[..., t, t].mean(axis=1), 1e-300))
        col = np.sqrt(np.maximum(gram[..., t, t].mean(axis=0), 1e-300))
        U, d, V = np.linalg.svd(a[..., t] * row[:, None] * col[None], full_matrices=False)
        out[..., t] = d[0] * np.outer(U[:, 0], V[0]) / row[:, None] / col[None]
    return out


def settled_rank(a: np.ndarray, gram: np.ndarray, right: np.ndarray, rounds: int = 300) -> np.ndarray:
    r"""Sizes of rank one :math:`u_{to}v_{ti}` that explain most, however unlike the weights of the channels are.

    Outputs' and inputs' shapes are solved for in turn, which only ever gains (Gabriel and Zamir 1979, Technometrics
    21:489, for one term).

    Parameters
    ----------
    a
        Where to start, shape ``(o, i, t)``, in the units of the sizes.
    gram, right
        Products of the whitened terms with one another and with the residual, ``(o, i, t, t)`` and ``(o, i, t)``.
    """
    if min(a.shape[:2]) < 2:
        return a
    v = np.stack([np.linalg.svd(a[..., t])[2][0] for t in range(a.shape[-1])], axis=-1)
    u = np.zeros((a.shape[0], a.shape[-1]))
    for _ in range(rounds):
        before = v
        u = _solved(np.einsum("oitu,it,iu->otu", gram, v, v), np.einsum("oit,it->ot", right, v))
        v = _solved(np.einsum("oitu,ot,ou->itu", gram, u, u), np.einsum("oit,ot->it", right, u))
        size = np.maximum(np.linalg.norm(v, axis=0), 1e-300)
        u, v = u * size, v / size
        if np.abs(v - before).max() < SETTLED:
            break
    return u[:, None] * v[None]


def _explained(a: np.ndarray, gram: np.ndarray, right: np.ndarray) -> float:
    return float(2 * np.sum(a * right) - np.einsum("oit,oitu,oiu->", a, gram, a))


def _solved(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    ridge = 1e-12 * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] + 1e-300
    return np.linalg.solve(gram + ridge * np.eye(gram.shape[-1]), right[..., None])[..., 0]
