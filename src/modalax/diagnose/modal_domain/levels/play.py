r"""A spring of the structure that slips, with the higher harmonics of its motion as the structure answers them.

The displacement across a joint is :math:`x = \Re\sum_h X_h e^{ih\omega t}`, ``h`` odd. Its slider has slipped by
:math:`z`, the play of half-width ``w`` about ``x``, where ``w`` is the slip displacement (Visintin 1994, Differential
Models of Hysteresis, section III.2), and pushes the structure that has the spring ``k`` by :math:`-kz`:

.. math:: X_h = g_h\,k\,Z_h,\quad h = 3, 5, \ldots,\qquad g_h = b^T D^{-1}(ih\omega)\,b,

with the measured :math:`X_1`. Where a harmonic meets a mode, :math:`g_h k` is ten and more, and no law of one harmonic
comes near. Harmonic balance after Cameron and Griffin (1989, J. Appl. Mech. 56:149), by Newton's method: each
:math:`z` is the ``x`` of the last instant of slipping, less or plus ``w``, so that its derivative is known with it.
"""

from dataclasses import dataclass

import numpy as np

ORDERS = np.array([3, 5, 7, 9, 11, 13])
POINTS = 64  # of half a cycle
STEPS, FURTHER = 8, 4  # most steps of Newton's method, from rest and from what is known
HALVINGS, SHORTER = 2, 0.4  # how often each is made shorter, and by what
BALANCED = 1e-6  # residual over the amplitude
_TIMES = np.pi * np.arange(2 * POINTS) / POINTS
_FIRST = np.exp(1j * _TIMES)
_HIGHER = np.exp(1j * np.outer(ORDERS, _TIMES))
_ANALYSED = 2 / POINTS * _HIGHER[:, POINTS:].conj()  # harmonics of what changes its sign from half a cycle to the next


@dataclass(frozen=True)
class _Balance:
    """A trial of the harmonics: what they miss, where the play last slipped, and the play itself."""

    X: np.ndarray
    miss: np.ndarray
    last: np.ndarray
    z: np.ndarray

    def at(self, some: np.ndarray) -> "_Balance":
        return _Balance(self.X[some], self.miss[some], self.last[some], self.z[some])

    def put(self, some: np.ndarray, other: "_Balance") -> None:
        for name in ("X", "miss", "last", "z"):
            getattr(self, name)[some] = getattr(other, name)

    def left(self, A: np.ndarray) -> np.ndarray:
        return np.abs(self.miss).max(axis=1) / A


def slipped(A: np.ndarray, w: float, gk: np.ndarray, start: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """First harmonic of what has slipped over that of the displacement, and the displacement's higher harmonics.

    Parameters
    ----------
    A
        Amplitudes of the displacement's first harmonic, shape ``(s,)`` [m].
    w
        Slip displacement [m].
    gk
        Receptance across the joint at each of ``ORDERS``, times its stiffness, shape ``(s, h)``.
    start
        Higher harmonics to start from, shape ``(s, h)`` [m]; none if None.

    Returns
    -------
    share, harmonics
        Shapes ``(s,)`` and ``(s, h)``; what does not slip at all has neither.
    """
    share, X = np.zeros(len(A), complex), np.zeros(gk.shape, complex)
    live = np.flatnonzero(A > w)
    if not len(live):
        return share, X
    a, g = A[live], gk[live]
    now = _balance(a, w, g, X[live] if start is None else start[live])
    for _ in range(STEPS if start is None else FURTHER):
        open_ = np.flatnonzero(now.left(a) > BALANCED)
        if not len(open_):
            break
        now.put(open_, _better(a[open_], w, g[open_], now.at(open_)))
    share[live] = 2 / POINTS * (now.z @ _FIRST[POINTS:].conj()) / a
    X[live] = now.X
    return share, X


def _balance(A: np.ndarray, w: float, gk: np.ndarray, X: np.ndarray) -> _Balance:
    half = slice(POINTS)
    z, last = _play((A[:, None] * _FIRST[half]).real + (X @ _HIGHER[:, half]).real, w)
    return _Balance(X, X - gk * (z @ _ANALYSED.T), last, z)


def _better(A: np.ndarray, w: float, gk: np.ndarray, now: _Balance) -> _Balance:
    """One step of Newton's method, made shorter where it leads astray."""
    n = len(ORDERS)
    at = np.where(now.last[..., None] < 0, 0.0, _HIGHER.T[now.last])  # (s, t, h)
    same, turned = 0.5 * (_ANALYSED @ at), 0.5 * (_ANALYSED @ at.conj())  # dZ = same dX + turned dX*
    same, turned = np.eye(n) - gk[:, :, None] * same, -gk[:, :, None] * turned
    J = np.block([[(same + turned).real, (turned - same).imag], [(same + turned).imag, (same - turned).real]])
    d = np.linalg.solve(J, -np.concatenate([now.miss.real, now.miss.imag], axis=1)[..., None])[..., 0]
    d = d[:, :n] + 1j * d[:, n:]
    best, before = _balance(A, w, gk, now.X + d), now.left(A)
    size = 1.0
    for _ in range(HALVINGS):
        worse = np.flatnonzero(best.left(A) >= before)
        if not len(worse):
            break
        size *= SHORTER
        best.put(worse, _balance(A[worse], w, gk[worse], now.X[worse] + size * d[worse]))
    return best


def _play(x: np.ndarray, w: float) -> tuple[np.ndarray, np.ndarray]:
    """Play about ``x`` over the second half of a cycle, and the instants of the cycle at which it last slipped, or -1.

    ``x`` is known over the first half, shape ``(s, t)``, and changes its sign from half to half. What was before its
    greatest excursion does not count.
    """
    rows, count = np.arange(len(x))[:, None], POINTS
    peak = np.abs(x).argmax(axis=1)[:, None]
    at = (peak + np.arange(count)) % (2 * count)
    sign = np.sign(x[rows, peak])
    y = np.ascontiguousarray((np.where(at < count, sign, -sign) * x[rows, at % count]).T)
    low, high = y - w, y + w
    play = np.maximum(low, 0.0)
    for n in range(1, count):
        np.maximum(play[n - 1], low[n], out=play[n])
        np.minimum(play[n], high[n], out=play[n])
    moved = np.zeros(at.shape, int)
    moved[:, 1:] = np.where(play[1:] != play[:-1], np.arange(1, count)[:, None], 0).T
    last = at[rows, np.maximum.accumulate(moved, axis=1)]
    z, instants = np.empty_like(x), np.empty_like(at)
    z[rows, at % count] = np.where(at < count, -sign, sign) * play.T
    instants[rows, at % count] = np.where(at < count, last + count, last) % (2 * count)
    instants[low[0] <= 0] = -1
    return z, instants
