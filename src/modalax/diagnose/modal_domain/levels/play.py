r"""Shapes of forces in a motion of many harmonics: the play of a slider, a stop, a cube and drag.

A slider of a spring ``k`` of the structure has slipped by :math:`z`, the play of half-width ``w`` about ``x``, where
``w`` is the slip displacement (Visintin 1994, Differential Models of Hysteresis, section III.2), and pushes the
structure that has the spring by :math:`-kz`. Each :math:`z` is the ``x`` of the last instant of slipping, less or plus
``w``, so that its derivative is known with it.
"""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.levels.balance import HIGHER, ORDERS, POINTS

NEARLY = 0.7  # amplitude over the free way below which no harmonics reach a stop
TOGETHER = 1024  # motions followed at once, which a processor's cache holds
_INSTANTS = np.arange(2 * POINTS, dtype=np.int16)[:, None]
_LATER = HIGHER[:, POINTS:].T  # the harmonics over the second half of a cycle


@dataclass(frozen=True)
class Play:
    """What has slipped of a displacement, of half-width ``w`` [m]."""

    w: float

    def acts(self, A: np.ndarray) -> np.ndarray:
        """Above the slip displacement."""
        return A > self.w

    def force(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The play, and the instants of the cycle at which it last slipped, or -1.

        From rest the first half of a cycle ends as every other one does: what was before the greatest excursion does
        not count.
        """
        z, instants = np.empty_like(x), np.empty(x.shape, np.int16)
        for k in range(0, len(x), TOGETHER):
            y = np.concatenate([x[k : k + TOGETHER].T, -x[k : k + TOGETHER].T])
            low, high, play = y - self.w, y + self.w, np.zeros((2 * POINTS + 1, y.shape[1]))
            for n in range(2 * POINTS):
                np.maximum(play[n], low[n], out=play[n + 1])
                np.minimum(play[n + 1], high[n], out=play[n + 1])
            moved = np.where(play[1:] != play[:-1], _INSTANTS, np.int16(-1))
            z[k : k + TOGETHER] = play[POINTS + 1 :].T
            instants[k : k + TOGETHER] = np.maximum.accumulate(moved)[POINTS:].T
        return z, instants

    def slope(self, kept: np.ndarray) -> np.ndarray:
        """The motion at the last instants of slipping."""
        return np.where(kept[..., None] < 0, 0.0, HIGHER.T[kept])


@dataclass(frozen=True)
class Stop:
    """A displacement beyond a free way ``w`` [m] on both sides."""

    w: float

    def acts(self, A: np.ndarray) -> np.ndarray:
        """Beyond the free way, which higher harmonics may lead to a little before the first."""
        return A > NEARLY * self.w

    def force(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is beyond, and where it is."""
        return -np.sign(x) * np.maximum(np.abs(x) - self.w, 0.0), np.abs(x) > self.w

    def slope(self, kept: np.ndarray) -> np.ndarray:
        """The motion while it is beyond."""
        return np.where(kept[..., None], _LATER, 0.0)


@dataclass(frozen=True)
class Cube:
    """The third power of a displacement [m^3]."""

    def acts(self, A: np.ndarray) -> np.ndarray:
        """Always."""
        return A > 0

    def force(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cube, and its derivative by the displacement."""
        square = x * x
        return -(square * x), 3 * square

    def slope(self, kept: np.ndarray) -> np.ndarray:
        """By each harmonic of the displacement."""
        return kept[..., None] * _LATER


@dataclass(frozen=True)
class Drag:
    r"""A velocity times its size, both over :math:`\omega` [m^2]."""

    def acts(self, A: np.ndarray) -> np.ndarray:
        """Always."""
        return A > 0

    def force(self, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The square with the velocity's sign, and its derivative by the velocity."""
        return -v * np.abs(v), 2 * np.abs(v)

    def slope(self, kept: np.ndarray) -> np.ndarray:
        """By each harmonic of the displacement."""
        return kept[..., None] * (1j * ORDERS * _LATER)
