r"""Elements at one place, for all places at little cost.

An element between two points changes the receptance by :math:`H_b\,y`, one column over the outputs times one number
for each run, line and input, :math:`y = -\frac{Z}{1 + Z\,b^THb}\,b^TH`. Its scores and its fit need the outputs only
through :math:`S = H_b^H w r`, :math:`N = H_b^H w^2 H_b` and the same products with the nuisance directions, which are
made once for all places; then every law and threshold costs no more than a few numbers a line.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, LocalCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.element_response import coefficients
from modalax.diagnose.screening.products import At, Reduced, at_places
from modalax.diagnose.screening.screen import (
    KEPT_PLACES,
    KEPT_SHAPES,
    Trial,
    best_trial,
    linear_size,
    smallest,
    with_sizes,
)
from modalax.diagnose.screening.screening_fit import Target, fit_from_screening

LARGE = 50_000  # samples from which fewer directions are kept
PROMISING = 4  # places at which finite sizes of a joint are tried: the best by its derivative, and by linear elements
SIZES = np.geomspace(0.01, 4.0, 14)  # sizes over the largest in a cause's grid, tried where size is the only unknown
SAMPLES = 2**20  # trials times lines times inputs that are computed together: some 100 MB


def changes(cause: Cause, solve: bool, params: np.ndarray, owner: np.ndarray, at: At, reduced: Reduced) -> np.ndarray:
    """The factor y by which an element changes the column of its place, shape ``(trial, run, f, i)``.

    Parameters
    ----------
    cause
        The element.
    solve
        Whether the amplitude across a joint is solved for, or that without the joint is taken.
    params, owner
        Parameters of each trial, shape ``(trial, parameter)``, and the number of its place.
    at, reduced
        Products at the places, and of the residual.
    """
    y = coefficients(cause, solve, params, owner, at.motion, at.drive, reduced.omega, reduced.level)
    return np.broadcast_to(y, (len(y), *at.S.shape[1:]))


def _parts(z: np.ndarray, first: int) -> np.ndarray:
    """Real numbers of complex arrays whose axes from ``first`` on are samples."""
    return np.ascontiguousarray(z).reshape(*z.shape[:first], -1).view(np.float64)


def score(
    cause: Cause, reduced: Reduced, at: At, grids: list[np.ndarray], finite: bool
) -> tuple[list[np.ndarray], list[np.ndarray], dict[tuple[int, int], np.ndarray]]:
    """Squared lengths of the changes of every trial and their products with the residual, nuisances projected out.

    Parameters
    ----------
    cause
        The element.
    reduced, at
        Products of the residual, and at the places.
    grids
        Parameters to try at each place, shape ``(trial, parameter)`` each.
    finite
        Whether sizes are finite, or stand for the derivative; of the latter a few changes are kept.
    """
    solve = finite or isinstance(cause, LocalCause)
    kinds = KEPT_PLACES if reduced.weight2.size < LARGE else KEPT_PLACES // 3
    some = set(np.unique(np.linspace(0, len(grids) - 1, kinds).astype(int)).tolist())
    square, product, kept = [], [], {}
    most = max(1, int(SAMPLES / (max(len(g) for g in grids) * at.S[0].size)))
    for start in range(0, len(grids), most):
        places = range(start, min(start + most, len(grids)))
        params = np.concatenate([grids[k] for k in places])
        owner = np.concatenate([np.full(len(grids[k]), k) for k in places])
        every = changes(cause, solve, params, owner, at, reduced)
        for k in places:
            y = every[owner == k]
            flat = _parts(y, 1)
            across = flat @ _parts(reduced.nuisances(at.a[k], at.b[k]), 1).T
            length = (flat**2) @ np.repeat(at.N[k].ravel(), 2)
            square.append(length - np.einsum("pk,kl,pl->p", across, reduced.inner, across))
            product.append(flat @ _parts(at.S[k], 0))
            if not finite and k in some:
                kept |= {(k, j): y[j] for j in range(len(y))}
    return square, product, kept


def grids_of(cause: Cause, scene: Any, places: list[Place]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Parameters to try at each place, and those among them that stand for the derivative; made once a scene.

    Parameters
    ----------
    cause
        The element.
    scene
        What causes may look at; it keeps the result.
    places
        Where the element may sit.
    """
    key = ("grids", cause, len(places))
    if key not in scene.cache:
        grids = [cause.grid(scene, place) for place in places]
        scene.cache[key] = grids, [g[smallest(g)] for g in grids]
    return scene.cache[key]


def screen_elements(
    cause: Cause, scene: Any, reduced: Reduced, at: At, places: list[Place], weight: np.ndarray,
    finite: bool = True, likely: np.ndarray | None = None, fixed: bool = True,
) -> list[Trial]:  # fmt: skip
    """Screen an element at all places by its derivative and, exactly, at finite sizes.

    Where peaks move by more than their width, the derivative at zero says nothing of which place is right. A linear
    element is therefore tried at finite sizes everywhere; a joint, which costs more, where its derivative or linear
    elements explain most.

    Parameters
    ----------
    cause
        The element.
    scene
        What causes may look at.
    reduced, at
        Products of the residual, and at the places.
    places
        Where the element may sit.
    weight
        Square roots of the inverse variances, shape ``(run, f, o, i)``.
    finite
        Whether finite sizes of joints are tried.
    likely
        Chi-square that linear elements take away at each place; None where that is not known.
    fixed
        Whether no modal parameter follows, so that finite sizes are exact.
    """
    grids, small = grids_of(cause, scene, places)
    square, product, kept = score(cause, reduced, at, small, False)
    trials, laid_out = [], np.ascontiguousarray(weight.transpose(2, 3, 0, 1))
    for k, place in enumerate(places):
        trial = best_trial(cause, place, small[k], square[k], product[k])
        mine = [kept[k, j] for j in range(len(small[k])) if (k, j) in kept][:KEPT_SHAPES]
        if mine:
            column = np.ascontiguousarray(reduced.column_at(place).T)
            trial = replace(trial, direction=np.stack([direction_of(laid_out, column, y) for y in mine]))
        trials.append(trial)
    linear = isinstance(cause, LocalCause)
    if not finite and not linear:
        return trials
    order = np.arange(len(places)) if linear else _promising(trials, likely)
    rows = [_sizes(trials[k], grids[k], linear) for k in order]
    square, product, _ = score(cause, reduced, at.of(order), rows, True)
    for j, k in enumerate(order):
        trials[k] = with_sizes(trials[k], rows[j], square[j], product[j], fixed)
    if not fixed:
        return trials
    tried = set(order.tolist())
    best = max(trials[k].gain for k in tried)
    return [t if k in tried else replace(t, gain=min(t.gain, max(best, 0.0))) for k, t in enumerate(trials)]


def _promising(trials: list[Trial], likely: np.ndarray | None) -> np.ndarray:
    """Numbers of the places at which the derivative, or linear elements, explain most."""
    order = np.argsort([-t.gain for t in trials])[:PROMISING].tolist()
    others = [] if likely is None else np.argsort(-likely)[:PROMISING].tolist()
    return np.array([*order, *(k for k in others if k not in order)])


def _sizes(trial: Trial, grid: np.ndarray, linear: bool) -> np.ndarray:
    """Parameters of finite size to try: those of the grid, of many sizes where there is no other unknown."""
    rows = grid[~smallest(grid)]
    if linear and grid.shape[1] == 1:
        sizes = np.abs(grid[:, 0]).max() * SIZES
        rows = np.concatenate([sizes, -sizes] if (grid < 0).any() else [sizes])[:, None]
    own = linear_size(trial, trial.cause)
    return rows if own is None else np.concatenate([rows, own[None]])


def direction_of(weight: np.ndarray, column: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whitened change, flat, of weights ``(o, i, run, f)``, a column ``(o, f)`` and numbers ``(run, f, i)``."""
    change = column[:, None, None] * np.ascontiguousarray(y.transpose(2, 0, 1))
    change *= weight
    return change.view(np.float64).ravel()


def element_target(reduced: Reduced, starts: list[Hypothesis]) -> Target:
    """Products at the places of some hypotheses, real and imaginary parts in turn."""
    at = at_places(reduced, [h.places[0] for h in starts])
    nuisance = np.stack([_parts(reduced.nuisances(a, b), 1) for a, b in zip(at.a, at.b, strict=True)])
    return Target(np.repeat(at.N.reshape(len(starts), -1), 2, axis=1), _parts(at.S, 1), nuisance, reduced.inner)


def fit_elements(
    comparison: Any, starts: list[Hypothesis], reduced: Reduced, base: Hypothesis, rounds: int
) -> list[Hypothesis]:
    """Fit single elements from several starts, the modal parameters marginalised in linear order.

    Parameters
    ----------
    comparison
        Data and simulation.
    starts
        Hypotheses of one element each, all of one kind.
    reduced
        Products of the residual.
    base
        The hypothesis that leaves this residual.
    rounds
        Most steps of the search.
    """

    def moved(part: list[Hypothesis], owner: np.ndarray, params: np.ndarray) -> np.ndarray:
        at = at_places(reduced, [h.places[0] for h in part], targets=False)
        return _parts(changes(part[0].causes[0], True, params, owner, at, reduced), 1)

    return fit_from_screening(comparison, base, starts, lambda part: element_target(reduced, part), moved, rounds)
