"""Automatic selection of modes from a stabilization diagram."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.cuts import cut
from modalax.identify.overview import of_selection
from modalax.identify.tables import PoleTable
from modalax.model.entry import refuse_traced

SHARP = 1e-6  # change of the diagram's poles from order to order below which they are kept where the model lacks modes


class Selection(eqx.Module):
    r"""Poles taken for modes, by rising frequency.

    Attributes
    ----------
    poles
        Shape ``(n,)`` [rad/s].
    participation
        Shape ``(n, i)``, or None where the estimator has none.
    score
        Part of the orders (from the first at which the mode showed) that have the mode, in 0..1, shape ``(n,)``: the
        stability, the only evidence in a diagram. ``Fit.score`` adds shape and energy.
    spread
        Median change from order to order, relative to :math:`|\lambda|`, shape ``(n,)``.
    order
        Order that each pole was taken from, shape ``(n,)``.
    """

    poles: Complex[Array, " n"]
    participation: Complex[Array, "n i"] | None
    score: Float[Array, " n"]
    spread: Float[Array, " n"]
    order: Int[Array, " n"]

    @property
    def sharp(self) -> bool:
        """Whether the poles repeat from order to order within ``SHARP``, as those of FRFs all but free of noise do."""
        return self.poles.size > 0 and float(jnp.median(self.spread)) <= SHARP

    def __str__(self) -> str:
        """A table of the poles."""
        return of_selection(self)


class _Track:
    """One mode followed over the orders; local to :func:`select`."""

    def __init__(self, row: int, pole: complex, part: np.ndarray | None):
        self.rows, self.poles, self.parts = [row], [pole], [part]


def select(
    table: PoleTable,
    *,
    band: tuple[float, float] | None = None,
    max_damping: float = 0.2,
    min_score: float = 0.35,
    min_orders: int = 4,
    reach: float = 0.01,
) -> Selection:
    r"""Follow poles from order to order and keep those that last.

    Every pole joins at most one track of the orders before it, the assignment of least total distance, with
    :math:`d = |\Delta\lambda|/(\texttt{reach}\,|\lambda|) + 1 - \mathrm{MAC}` and :math:`d < 1`; so two close modes
    stay two. A track is a mode if it lasts over ``min_score`` of the orders since it began.

    Parameters
    ----------
    table
        Poles of rising orders; with few orders ``min_orders`` shrinks to half of them.
    band
        Frequencies to keep [Hz].
    max_damping
        Poles with a larger damping ratio are no modes.
    min_score, min_orders
        How much of its possible length, and how many orders, a track must have.
    reach
        Largest change of a pole from one order to the next, relative to :math:`|\lambda|`.

    Returns
    -------
    Selection
        Each mode by the pole of its track that changes least between neighbouring orders.
    """
    refuse_traced(table, "select")
    lower, upper = (0.0, float("inf")) if band is None else band
    physical = np.asarray(table.physical(lower, upper, max_damping))
    poles = np.asarray(table.poles)
    parts = None if table.participation is None else np.asarray(table.participation)
    tracks: list[_Track] = []
    for row in range(len(table.orders)):
        columns = np.flatnonzero(physical[row])
        own = [None if parts is None else parts[row, c] for c in columns]
        _extend(tracks, row, poles[row, columns], own, reach)
    need = min(min_orders, max(1, len(table.orders) // 2))
    rows = len(table.orders)
    kept = [t for t in tracks if len(t.rows) >= need and len(t.rows) / (rows - t.rows[0]) >= min_score]
    kept = _separate(kept)
    return _selection(kept, table, rows)


def _extend(tracks: list[_Track], row: int, poles: np.ndarray, parts: list[np.ndarray | None], reach: float) -> None:
    """Give the poles of one order to the tracks they continue; the rest begin new ones."""
    taken: set[int] = set()
    if tracks and len(poles):
        last = np.array([t.poles[-1] for t in tracks])
        cost = np.abs(last[:, None] - poles[None, :]) / (reach * np.abs(poles)[None, :])
        if parts[0] is not None:
            cost = cost + 1 - np.abs(np.array([t.parts[-1] for t in tracks]).conj() @ np.array(parts).T) ** 2
        far = 10.0
        for k, c in zip(*scipy.optimize.linear_sum_assignment(np.where(cost < 1, cost, far)), strict=True):
            if cost[k, c] < 1:
                tracks[k].rows.append(row)
                tracks[k].poles.append(poles[c])
                tracks[k].parts.append(parts[c])
                taken.add(int(c))
    for c in range(len(poles)):
        if c not in taken:
            tracks.append(_Track(row, poles[c], parts[c]))


def _representative(track: _Track) -> tuple[int, float]:
    """Index of the pole that agrees best with its neighbours, and the median relative change."""
    poles = np.array(track.poles)
    if len(poles) < 3:
        return len(poles) - 1, float("inf") if len(poles) < 2 else float(abs(poles[1] - poles[0]) / abs(poles[1]))
    change = np.abs(np.diff(poles)) / np.abs(poles[1:])
    around = np.maximum(change[:-1], change[1:])
    return int(np.argmin(around)) + 1, float(np.median(change))


def _separate(tracks: list[_Track]) -> list[_Track]:
    """Keep the longer of two tracks of the same mode: nearer than their spread, and at few orders both present."""
    tracks = sorted(tracks, key=lambda t: -len(t.rows))
    kept: list[_Track] = []
    for t in tracks:
        pole = t.poles[_representative(t)[0]]
        twin = False
        for k in kept:
            other = k.poles[_representative(k)[0]]
            close = abs(pole - other) < 0.35 * max(abs(pole.real), abs(other.real))
            shared = len(set(t.rows) & set(k.rows))
            twin = twin or (close and (shared < 0.5 * len(t.rows)))
        if not twin:
            kept.append(t)
    return kept


def _selection(tracks: list[_Track], table: PoleTable, rows: int) -> Selection:
    chosen = [(t, *_representative(t)) for t in tracks]
    chosen.sort(key=lambda c: abs(c[0].poles[c[1]]))
    count = 0 if table.participation is None else table.participation.shape[2]
    parts = None
    if table.participation is not None:
        parts = jnp.asarray(np.array([t.parts[k] for t, k, _ in chosen]).reshape(-1, count), jnp.complex128)
    return Selection(
        jnp.asarray(np.array([t.poles[k] for t, k, _ in chosen]), jnp.complex128),
        parts,
        jnp.asarray(np.array([len(t.rows) / (rows - t.rows[0]) for t, _, _ in chosen]), float),
        jnp.asarray(np.array([s for _, _, s in chosen]), float),
        jnp.asarray(np.array([table.orders[t.rows[k]] for t, k, _ in chosen]), int),
    )


def best_order(table: PoleTable, selection: Selection) -> int:
    """The order whose poles, over all selected modes, agree best with those of the orders next to it."""
    if selection.poles.size == 0:
        return table.orders[-1]
    poles = np.where(np.asarray(table.valid), np.asarray(table.poles), np.inf)
    found = np.asarray(selection.poles)
    nearest = np.array([row[np.abs(row[None, :] - found[:, None]).argmin(axis=1)] for row in poles])
    change = np.abs(np.diff(nearest, axis=0)) / np.abs(found.real)
    if len(change) < 2:
        return table.orders[-1]
    worst = np.median(np.maximum(change[:-1], change[1:]), axis=1) + 0.1 * np.maximum(change[:-1], change[1:]).max(
        axis=1
    )
    return table.orders[int(np.argmin(worst)) + 1]


def select_near(
    table: PoleTable, frequencies_hz: Sequence[float] | Any, *, reach: float = 0.02, max_damping: float = 0.2
) -> Selection:
    r"""The mode nearest each given frequency, out of those that :func:`select` finds, each given only once.

    Parameters
    ----------
    frequencies_hz
        Where modes are expected [Hz].
    reach
        Largest distance from the given frequency, relative to it.

    Raises
    ------
    ValueError
        If a frequency has no mode within reach that is not another's; the message names the modes there are.
    """
    found = select(table, max_damping=max_damping, min_score=0.2, min_orders=3)
    have = np.abs(np.asarray(found.poles)) / (2 * np.pi)
    wanted = np.atleast_1d(np.asarray(frequencies_hz, float))
    listed = ", ".join(f"{f:.4g}" for f in have)
    if len(have) < len(wanted):
        raise ValueError(f"{len(wanted)} frequencies asked for, {len(have)} modes found: {listed} Hz")
    cost = np.abs(have[None, :] - wanted[:, None]) / wanted[:, None]
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(cost < reach, cost, 1e3))
    for r, c in zip(rows, columns, strict=True):
        if cost[r, c] >= reach:
            raise ValueError(f"no mode of its own within {reach:.1%} of {wanted[r]:g} Hz; modes found: {listed} Hz")
    keep = columns[np.argsort(have[columns])]
    part = None if found.participation is None else cut(found.participation, keep)
    score, spread, order = (cut(a, keep) for a in (found.score, found.spread, found.order))
    return Selection(cut(found.poles, keep), part, score, spread, order)
