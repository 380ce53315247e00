r"""Steady motion of dry friction in a linear structure, without a truncated series of its force.

Friction carries a force f up to a limit F, and its ends slide on each other only where that is reached:

.. math:: |f| \le F,\qquad v \ge 0 \text{ at } f = F,\quad v \le 0 \text{ at } f = -F,\quad v = 0 \text{ between}.

With the motion :math:`x_h = u_h - G_h f_h` at every odd harmonic, the velocities at the instants of a cycle are affine
in the forces there, :math:`v = v_0 - Af`, and A is positive, since a passive structure takes up work. So there is one
motion for each :math:`v_0`, and it changes piecewise linearly with that: from one known motion another is followed
exactly, sample by sample as they begin to stick or to slide (parametric principal pivoting; Cottle, Pang and Stone
1992, The Linear Complementarity Problem, section 4.5). The first is the root of
:math:`f = \mathrm{clip}(f + \gamma(v_0 - Af), -F, F)`, sought by the splitting of Lions and Mercier (1979, SIAM J.
Numer. Anal. 16:964) and Newton's method for such equations (Hintermueller, Ito and Kunisch 2002, SIAM J. Optim.
13:865); where these go round in circles it is followed from rest. A turn of the sliding falls between two instants; the
mean over grids that are shifted by parts of a step finds it to so much less than a step. What instants miss falls in
proportion to their distance where the sliding turns without a stop, and faster than its 3/2 power where the ends stick,
so that half as many instants tell most of it (Richardson 1911).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

SHIFTS = tuple(k / 8 for k in range(8))  # of the instants, over their distance
SOUGHT = (60, 6), (200, 8), (400, 15)  # turns between structure and limit, and rounds of sorting after them
WEIGHT = 3.0  # of velocity against force, relative to the usual admittance
CLOSED = 1e-9  # change of the force, over its limit, below which samples are sorted
PIVOTS, FROM_REST = 50, 400  # samples that change sides from one grid to the next, and from rest, at most
SAME = 1e-9  # part of a way below which a sample has not moved since it changed
STEP = 1e-2  # of the limit, relatively, by which a slope is taken; far smaller ones meet no sample that begins to stick
TOGETHER = 2**19  # numbers of the matrices that are worked on at once
BEYOND = 1 / (2**1.5 - 1)  # of the change from half as many instants, what is left to change


class Sliding(NamedTuple):
    """A steady motion.

    Attributes
    ----------
    force
        First harmonic of the force [N], shape ``(p,)``.
    slope
        Its derivative by the limit, shape ``(p,)``: by a difference wide enough for samples to change sides.
    sound
        Whether it was found on half of the grids at least, shape ``(p,)``.
    """

    force: np.ndarray
    slope: np.ndarray
    sound: np.ndarray


def sliding(
    G: np.ndarray, u: np.ndarray, omega: np.ndarray, limit: float, count: int, shifts: tuple[float, ...] = SHIFTS
) -> Sliding:
    """Steady motion at many lines, each by itself.

    Parameters
    ----------
    G
        Receptance across the joint at harmonics 1, 3, 5, ... below ``count``, shape ``(p, h)`` [m/N].
    u
        Displacement across it without its force, shape ``(p,)`` [m].
    omega
        Circular frequency, shape ``(p,)`` [rad/s].
    limit
        Largest force [N].
    count
        Instants of half a cycle, an even number.
    shifts
        Of the grids of instants over whose forces the mean is taken, over the distance of two instants.

    Raises
    ------
    ValueError
        If the instants are odd in number, or more than the harmonics tell.
    """
    if count % 2 or G.shape[1] < count // 2:
        raise ValueError(f"{count} instants need to be even, with {count // 2} odd harmonics; {G.shape[1]} are given")
    sums, counts = np.zeros((2, len(u)), complex), np.zeros((2, len(u)))
    for part in np.array_split(np.arange(len(u)), -(-len(u) * count**2 // TOGETHER)):
        with np.errstate(all="ignore"):  # a motion that is lost becomes too large for numbers, and is not sound
            for force, sound, slope, also in _on_grids(
                G[part], u[part] / max(limit, 1e-300), omega[part], count, shifts
            ):
                sums[:, part] += np.where([sound, also], [limit * force, slope], 0.0)
                counts[:, part] += sound, also
    force, slope = sums / np.maximum(counts, 1)
    return Sliding(force, slope, counts[0] >= len(shifts) / 2)


def with_more_instants(coarse: Sliding, fine: Sliding) -> Sliding:
    """The motion as it would be with ever more instants, from that with some and with twice as many."""
    force, slope = (b + BEYOND * (b - a) for a, b in zip(coarse[:2], fine[:2], strict=True))
    return Sliding(force, slope, coarse.sound & fine.sound)


def _on_grids(
    G: np.ndarray, u: np.ndarray, omega: np.ndarray, count: int, shifts: tuple[float, ...]
) -> Iterator[tuple[np.ndarray, ...]]:
    """For a limit of 1 on each grid in turn: force and whether it was found, slope and whether that was.

    Each grid but the first begins from the forces on the one before.
    """
    h = np.arange(1, count, 2)
    turning = lambda shift: np.exp(1j * np.outer(np.pi * (np.arange(count) + shift) / count, h))
    rate, wave = 1j * h * omega[:, None], turning(0.0)
    # velocity by the force of so many instants before; half a cycle later both have changed their signs
    before, later = (2 / count) * ((rate * G[:, : len(h)]) @ wave.T).real, np.arange(count)
    ago = later[:, None] - later
    A = np.where(ago < 0, -1.0, 1.0) * before[:, ago]  # on every grid
    gamma = WEIGHT / np.maximum(np.linalg.norm(before, axis=1), 1e-300)
    f, sound, before = np.zeros((len(u), count)), np.zeros(len(u), bool), np.zeros((len(u), count))
    for shift in shifts:
        wave = turning(shift)
        v = (wave[:, 0] * (rate[:, 0] * u)[:, None]).real
        f[sound], sound[sound] = _followed(A[sound], before[sound], v[sound], gamma[sound], f[sound], PIVOTS)
        for turns, rounds in SOUGHT:
            left = np.flatnonzero(~sound)
            if not len(left):
                break
            given = A[left], v[left], gamma[left]
            f[left], sound[left] = _sorted(*given, _split(*given, turns), rounds)
        left = np.flatnonzero(~sound)
        rest = np.zeros((len(left), count))
        f[left], sound[left] = _followed(A[left], rest, v[left], gamma[left], rest, FROM_REST)
        more, also = _followed(A, v, v / (1 + STEP), gamma, f, PIVOTS)
        before, first = v, (2 / count) * wave[:, 0].conj()
        yield f @ first, sound, ((1 + STEP) * more - f) @ first / STEP, sound & also


def _followed(
    A: np.ndarray, start: np.ndarray, end: np.ndarray, gamma: np.ndarray, f: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Forces at the instants as the motion without them goes from ``start``, where they are f, to ``end``.

    Whether each was followed to its end is returned, too.
    """
    f, ended, left, eye = f.copy(), np.zeros(len(f), bool), np.arange(len(f)), np.eye(f.shape[1])
    side = np.where(np.abs(f) > 1 - CLOSED, np.sign(f), 0.0)  # 0 of what sticks
    way, last, both = np.zeros(len(f)), np.full(len(f), -1), np.stack([start, end - start], axis=-1)
    for _ in range(most + 1 if len(f) else 0):
        s, v, at, rows = side[left], both[left], way[left, None], np.arange(len(left))
        sticks = s == 0
        fixed = np.stack([s, np.zeros_like(s)], axis=-1)
        x = _solved(np.where(sticks[..., None], A[left], eye), np.where(sticks[..., None], v, fixed))
        w = s[..., None] * (v - A[left] @ x)
        stuck = np.where(x[..., 1] != 0, (np.sign(x[..., 1]) - x[..., 0]) / x[..., 1], np.inf)
        until = np.where(sticks, stuck, np.where(w[..., 1] < 0, -w[..., 0] / w[..., 1], np.inf))
        moved = until[rows, last[left]] > at[:, 0] + SAME
        until[rows, last[left]] = np.where((last[left] < 0) | moved, until[rows, last[left]], np.inf)
        until = np.maximum(until, at)
        k = until.argmin(axis=1)
        there = until[rows, k] >= 1
        f[left[there]], ended[left[there]] = x[there].sum(axis=-1), True
        on, k, x = left[~there], k[~there], x[~there]
        if not len(on):
            break
        sign = np.sign(x[np.arange(len(on)), k, 1])
        way[on], last[on] = until[~there, k], k
        side[on, k] = np.where(side[on, k] == 0, sign, 0.0)
        left = on
    return f, ended & (_missed(A, end, gamma, f)[1] < CLOSED)


def _missed(A: np.ndarray, v: np.ndarray, gamma: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces that structure and limit ask for beside given ones, before they are cut, and the most that is missed."""
    g = f + gamma[:, None] * (v - (A @ f[..., None])[..., 0])
    return g, np.abs(f - np.clip(g, -1.0, 1.0)).max(axis=1, initial=0.0)


def _split(A: np.ndarray, v: np.ndarray, gamma: np.ndarray, turns: int) -> np.ndarray:
    """Forces near the motion, by turns of structure and limit, which come nearer from anywhere."""
    turn = np.linalg.inv(np.eye(v.shape[1]) + gamma[:, None, None] * A)
    z = np.zeros(v.shape)
    for _ in range(turns):
        f = np.clip(z, -1.0, 1.0)
        z += (turn @ (2 * f - z + gamma[:, None] * v)[..., None])[..., 0] - f
    return np.clip(z, -1.0, 1.0)


def _sorted(
    A: np.ndarray, v: np.ndarray, gamma: np.ndarray, start: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Forces at the instants, and whether each motion's sticking and sliding samples are told apart."""
    f, left = start.copy(), np.arange(len(v))
    for _ in range(rounds):
        g, missed = _missed(A[left], v[left], gamma[left], f[left])
        left, g = left[~(missed < CLOSED)], g[~(missed < CLOSED)]
        if not len(left):
            break
        sticks = np.abs(g) <= 1
        M = np.where(sticks[:, :, None], A[left], np.eye(v.shape[1]))
        f[left] = np.nan_to_num(_solved(M, np.where(sticks, v[left], np.sign(g))[..., None]))[..., 0]
    sound = np.ones(len(v), bool)
    sound[left] = False
    return f, sound


def _solved(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Solutions of many systems; not numbers where a matrix is singular."""
    try:
        return np.linalg.solve(A, v)
    except np.linalg.LinAlgError:
        return np.stack([_alone(a, b) for a, b in zip(A, v, strict=True)])


def _alone(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.solve(A, v)
    except np.linalg.LinAlgError:
        return np.full(v.shape, np.nan)
