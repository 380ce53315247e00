r"""A law's force with the higher harmonics of its motion as the structure answers them.

The displacement across a joint is :math:`x = \Re\sum_h X_h e^{ih\omega t}`, ``h`` odd, with the measured :math:`X_1`.
A force of strength ``k`` and shape :math:`f(x)` pulls it back:

.. math:: X_h = -g_h\,k\,F_h,\quad h = 3, 5, \ldots,\qquad g_h = b^T D^{-1}(ih\omega)\,b.

Where a harmonic meets a mode, :math:`g_h k` is ten and more, and no law of one harmonic comes near. Harmonic balance
after Cameron and Griffin (1989, J. Appl. Mech. 56:149), by Newton's method.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

ORDERS = np.array([3, 5, 7, 9, 11, 13])
POINTS = 64  # of half a cycle
STEPS, FURTHER = 8, 4  # most steps of Newton's method, from rest and from what is known
HALVINGS, SHORTER = 2, 0.4  # how often each is made shorter, and by what
BALANCED = 1e-6  # residual over the amplitude
_TIMES = np.pi * np.arange(2 * POINTS) / POINTS
_FIRST = np.exp(1j * _TIMES)
HIGHER = np.exp(1j * np.outer(ORDERS, _TIMES))
_ANALYSED = 2 / POINTS * HIGHER[:, POINTS:].conj()  # harmonics of what changes its sign from half a cycle to the next
# In real products, which cost a fourth of complex ones: displacement and its derivative over half a cycle by amplitude
# and real and imaginary parts of the higher harmonics, and these parts by the force over half a cycle.
_DERIVED = 1j * ORDERS[:, None] * HIGHER[:, :POINTS]
_MOTION = np.concatenate([
    np.concatenate([_FIRST[None, :POINTS].real, -_FIRST[None, :POINTS].imag], axis=1),
    np.concatenate([HIGHER[:, :POINTS].real, _DERIVED.real], axis=1),
    np.concatenate([-HIGHER[:, :POINTS].imag, -_DERIVED.imag], axis=1),
])  # fmt: skip
_PARTS = np.concatenate([_ANALYSED.real, _ANALYSED.imag]).T


@runtime_checkable
class Shape(Protocol):
    """A force over its strength, in a motion that changes its sign from half a cycle to the next."""

    def acts(self, A: np.ndarray) -> np.ndarray:
        """Whether it acts at all at some amplitudes."""
        ...

    def force(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r"""Force over the second half of a cycle, and what its derivative needs, both of shape ``(s, t)``.

        ``x`` is the displacement over the first half, and ``v`` its derivative by :math:`\omega t`.
        """
        ...

    def slope(self, kept: np.ndarray) -> np.ndarray:
        """Derivative of that force by each of the motion's higher harmonics, shape ``(s, t, h)``."""
        ...


@dataclass(frozen=True)
class _Balance:
    """A trial of the harmonics: what they miss, the force, and what its derivative needs."""

    X: np.ndarray
    miss: np.ndarray
    kept: np.ndarray
    f: np.ndarray

    def at(self, some: np.ndarray) -> "_Balance":
        return _Balance(self.X[some], self.miss[some], self.kept[some], self.f[some])

    def put(self, some: np.ndarray, other: "_Balance") -> None:
        for name in ("X", "miss", "kept", "f"):
            getattr(self, name)[some] = getattr(other, name)

    def left(self, A: np.ndarray) -> np.ndarray:
        return np.abs(self.miss).max(axis=1) / A


def balanced(
    shape: Shape, A: np.ndarray, pushed: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """First harmonic of a force over that of the displacement, and the displacement's higher harmonics.

    Parameters
    ----------
    A
        Amplitudes of the displacement's first harmonic, shape ``(s,)`` [m].
    pushed
        Displacement by a force of the shape's unit, of each of ``ORDERS``, shape ``(s, h)``.
    start
        Higher harmonics to start from, shape ``(s, h)`` [m]; none if None.

    Returns
    -------
    share, harmonics
        Shapes ``(s,)`` and ``(s, h)``; what does not act at all has neither.
    """
    share, X = np.zeros(len(A), complex), np.zeros(pushed.shape, complex)
    live = np.flatnonzero(shape.acts(A))
    if not len(live):
        return share, X
    a, g = A[live], pushed[live]
    now = _balance(shape, a, g, X[live] if start is None else start[live])
    for _ in range(STEPS if start is None else FURTHER):
        open_ = np.flatnonzero(now.left(a) > BALANCED)
        if not len(open_):
            break
        now.put(open_, _better(shape, a[open_], g[open_], now.at(open_)))
    share[live] = 2 / POINTS * (now.f @ _FIRST[POINTS:].conj()) / a
    X[live] = now.X
    return share, X


def _balance(shape: Shape, A: np.ndarray, pushed: np.ndarray, X: np.ndarray) -> _Balance:
    motion = np.concatenate([A[:, None], X.real, X.imag], axis=1) @ _MOTION
    f, kept = shape.force(motion[:, :POINTS], motion[:, POINTS:])
    parts = f @ _PARTS
    return _Balance(X, X - pushed * (parts[:, : len(ORDERS)] + 1j * parts[:, len(ORDERS) :]), kept, f)


def _better(shape: Shape, A: np.ndarray, pushed: np.ndarray, now: _Balance) -> _Balance:
    """One step of Newton's method, made shorter where it leads astray."""
    n = len(ORDERS)
    at = shape.slope(now.kept)
    same, turned = 0.5 * (_ANALYSED @ at), 0.5 * (_ANALYSED @ at.conj())  # dF = same dX + turned dX*
    same, turned = np.eye(n) - pushed[:, :, None] * same, -pushed[:, :, None] * turned
    J = np.block([[(same + turned).real, (turned - same).imag], [(same + turned).imag, (same - turned).real]])
    d = np.linalg.solve(J, -np.concatenate([now.miss.real, now.miss.imag], axis=1)[..., None])[..., 0]
    d = d[:, :n] + 1j * d[:, n:]
    best, before = _balance(shape, A, pushed, now.X + d), now.left(A)
    size = 1.0
    for _ in range(HALVINGS):
        worse = np.flatnonzero(best.left(A) >= before)
        if not len(worse):
            break
        size *= SHORTER
        best.put(worse, _balance(shape, A[worse], pushed[worse], now.X[worse] + size * d[worse]))
    return best
