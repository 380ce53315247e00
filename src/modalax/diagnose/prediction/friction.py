r"""Steady motion of dry friction in a linear structure, without a truncated series of its force.

Friction carries a force f up to a limit F, and its ends slide on each other only where that is reached:

.. math:: |f| \le F,\qquad v \ge 0 \text{ at } f = F,\quad v \le 0 \text{ at } f = -F,\quad v = 0 \text{ between}.

With the motion :math:`x_h = u_h - G_h f_h` at every odd harmonic, the velocities at the instants of a cycle are affine
in the forces there, :math:`v = v_0 - Af`, and A is positive, since a passive structure takes up work. So the motion is
the root of :math:`f = \mathrm{clip}(f + \gamma(v_0 - Af), -F, F)`, found by Newton's method for such equations: samples
are sorted into sticking and sliding ones, and the former are solved for, until none changes sides (Hintermueller, Ito
and Kunisch 2002, SIAM J. Optim. 13:865); where that goes round in circles it begins nearer, by the splitting of Lions
and Mercier (1979, SIAM J. Numer. Anal. 16:964). A turn of the sliding falls between two instants; the mean over
grids that are shifted by parts of a step finds it to so much less than a step. What instants miss falls in proportion
to their distance where the sliding turns without a stop, and faster than its 3/2 power where the ends stick, so that
half as many instants tell most of it (Richardson 1911).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

SHIFTS = tuple(k / 8 for k in range(8))  # of the instants, over their distance
ROUNDS = 15  # of sorting; few are needed
TURNS = 400  # between structure and limit, where sorting does not end
WEIGHT = 3.0  # of velocity against force, relative to the usual admittance
CLOSED = 1e-9  # change of the force, over its limit, below which samples are sorted
TOGETHER = 2**19  # numbers of the matrices that are worked on at once


BEYOND = 1 / (2**1.5 - 1)  # of the change from half as many instants, what is left to change


class Sliding(NamedTuple):
    """A steady motion.

    Attributes
    ----------
    force
        First harmonic of the force [N], shape ``(p,)``.
    sound
        Whether it was found on half of the grids at least, shape ``(p,)``.
    """

    force: np.ndarray
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
    force, found = np.zeros(len(u), complex), np.zeros(len(u))
    for part in np.array_split(np.arange(len(u)), -(-len(u) * count**2 // TOGETHER)):
        for one in _on_grids(G[part], u[part] / max(limit, 1e-300), omega[part], count, shifts):
            force[part] += np.where(one.sound, limit * one.force, 0.0)
            found[part] += one.sound
    return Sliding(force / np.maximum(found, 1), found >= len(shifts) / 2)


def with_more_instants(coarse: Sliding, fine: Sliding) -> Sliding:
    """The motion as it would be with ever more instants, from that with some and with twice as many."""
    return Sliding(fine.force + BEYOND * (fine.force - coarse.force), coarse.sound & fine.sound)


def _on_grids(
    G: np.ndarray, u: np.ndarray, omega: np.ndarray, count: int, shifts: tuple[float, ...]
) -> Iterator[Sliding]:
    """For a limit of 1 on each grid in turn; each but the first begins from the forces on the one before."""
    h = np.arange(1, count, 2)
    turning = lambda shift: np.exp(1j * np.outer(np.pi * (np.arange(count) + shift) / count, h))
    rate, wave = 1j * h * omega[:, None], turning(0.0)
    A = ((wave * (rate * G[:, : len(h)])[:, None]) @ ((2 / count) * wave.conj().T)).real  # on every grid
    gamma = WEIGHT * np.sqrt(count) / np.maximum(np.linalg.norm(A, axis=(1, 2)), 1e-300)
    start = None
    for shift in shifts:
        wave = turning(shift)
        v = (wave[:, 0] * (rate[:, 0] * u)[:, None]).real
        with np.errstate(all="ignore"):
            begun = np.clip(np.nan_to_num(_solved(A, v)), -1.0, 1.0) if start is None else start
            f, sound = _sorted(A, v, gamma, begun)
            left = np.flatnonzero(~sound)
            if len(left):
                split = _split(A[left], v[left], gamma[left])
                f[left], sound[left] = _sorted(A[left], v[left], gamma[left], split)
        start = f
        yield Sliding(f @ ((2 / count) * wave[:, 0].conj()), sound)


def _split(A: np.ndarray, v: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Forces near the motion, by turns of structure and limit, which come nearer from anywhere."""
    turn = np.linalg.inv(np.eye(v.shape[1]) + gamma[:, None, None] * A)
    z = np.zeros(v.shape)
    for _ in range(TURNS):
        f = np.clip(z, -1.0, 1.0)
        z += (turn @ (2 * f - z + gamma[:, None] * v)[..., None])[..., 0] - f
    return np.clip(z, -1.0, 1.0)


def _sorted(A: np.ndarray, v: np.ndarray, gamma: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces at the instants, and whether each motion's sticking and sliding samples are told apart."""
    f, left = start.copy(), np.arange(len(v))
    for _ in range(ROUNDS):
        g = f[left] + gamma[left, None] * (v[left] - (A[left] @ f[left][..., None])[..., 0])
        open_ = ~(np.abs(f[left] - np.clip(g, -1.0, 1.0)).max(axis=1) < CLOSED)
        left, g = left[open_], g[open_]
        if not len(left):
            break
        sticks = np.abs(g) <= 1
        M = np.where(sticks[:, :, None], A[left], np.eye(v.shape[1]))
        f[left] = np.nan_to_num(_solved(M, np.where(sticks, v[left], np.sign(g))))
    sound = np.ones(len(v), bool)
    sound[left] = False
    return f, sound


def _solved(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Solutions of many systems; not numbers where a matrix is singular."""
    try:
        return np.linalg.solve(A, v[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.stack([_alone(a, b) for a, b in zip(A, v, strict=True)])


def _alone(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.solve(A, v)
    except np.linalg.LinAlgError:
        return np.full(len(v), np.nan)
