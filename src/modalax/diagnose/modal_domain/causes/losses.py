r"""Damping that goes with a change of stiffness or mass, in coordinates of unit mass and stiffness :math:`\Lambda`.

Either it is in proportion to the change (Rayleigh 1877), or each mode of the changed structure has the damping ratio
:math:`\zeta_r` of that before it, by the order of frequencies, however large the change: with
:math:`(\Lambda+\Delta K)\Phi=(I+\Delta M)\Phi\Omega^2` and modes of unit mass,

.. math:: \Delta C=(I+\Delta M)\Phi\,2\zeta\Omega\,\Phi^T(I+\Delta M)-2\zeta\Lambda^{1/2}.

By small further changes that moves, between its modes and with :math:`f=2\zeta\omega`, by :math:`\delta
K_{ij}(f_i-f_j)/(\omega_i^2-\omega_j^2)` and :math:`\delta
M_{ij}(f_i\omega_j^2-f_j\omega_i^2)/(\omega_j^2-\omega_i^2)` (Higham 2008, theorem 3.11, for one ratio).
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg

CLOSE = 1e-6  # distance of two frequencies, over their sum, within which the modes count as one
SMALLEST = 1e-6  # mass of a mode, relative to that before, below which a change leaves none


@runtime_checkable
class Loss(Protocol):
    """Damping that goes with a change ``x A`` of stiffness or mass."""

    def change(self, x: float, A: np.ndarray) -> np.ndarray:
        """Change of the damping, shape ``(n, n)``."""
        ...

    def slope(self, x: float, A: np.ndarray) -> np.ndarray:
        """Its derivative by ``x``."""
        ...

    def turn(self, x: float, A: np.ndarray) -> np.ndarray | None:
        """``T`` that carries the modes' damping ``D`` to the changed structure's modes, :math:`TDT^T`; None if none."""
        ...


@dataclass(frozen=True)
class InProportion:
    """As much damping as ``ratio`` [s, or 1/s of a mass] times the change."""

    ratio: float

    def change(self, x: float, A: np.ndarray) -> np.ndarray:
        """That times the change."""
        return self.ratio * x * A

    def slope(self, x: float, A: np.ndarray) -> np.ndarray:
        """That times the matrix."""
        return self.ratio * A

    def turn(self, x: float, A: np.ndarray) -> np.ndarray | None:
        """The modes' own damping stays as it is."""
        return None


@dataclass(frozen=True)
class AtEqualRatios:
    """Damping with which each mode keeps half of ``twice`` as damping ratio.

    Attributes
    ----------
    twice, frequencies
        Two times the damping ratio and the frequency [rad/s] of each mode before, shape ``(n,)``.
    least
        Frequency that a mode counts with at least [rad/s].
    of_mass
        Whether the mass changes, and not the stiffness.
    """

    twice: np.ndarray
    frequencies: np.ndarray
    least: float
    of_mass: bool

    def change(self, x: float, A: np.ndarray) -> np.ndarray:
        """Damping of the changed structure, less that before."""
        w, P = self._modes(x, A)
        return (P * (self.twice * w)) @ P.T - np.diag(self.twice * self.frequencies)

    def slope(self, x: float, A: np.ndarray) -> np.ndarray:
        """Its derivative by ``x``."""
        w, P = self._modes(x, A)
        shapes = np.linalg.inv(P).T if self.of_mass else P
        both, apart = np.add.outer(w, w), np.subtract.outer(w, w)
        mean, half = np.add.outer(self.twice, self.twice) / 2, np.subtract.outer(self.twice, self.twice) / 2
        unlike = half * apart / (apart**2 + (CLOSE * both) ** 2)
        q = np.multiply.outer(w, w) * (mean / both - unlike) if self.of_mass else mean / both + unlike
        return P @ (shapes.T @ A @ shapes * q) @ P.T

    def turn(self, x: float, A: np.ndarray) -> np.ndarray | None:
        """What is off of a mode's damping ratio is so of the changed structure's modes, in the order of frequencies."""
        w, P = self._modes(x, A)
        sign = np.copysign(1.0, P[np.abs(P).argmax(axis=0), np.arange(len(P))])
        return P * (sign * np.sqrt(w / self.frequencies))

    def _modes(self, x: float, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies with the change, and shapes times the mass, shape ``(n, n)``; what has none keeps a little."""
        K = np.diag(self.frequencies**2)
        if not self.of_mass:
            values, shapes = np.linalg.eigh(K + x * A)
            return np.sqrt(np.maximum(values, self.least**2)), shapes
        mass, turned = np.linalg.eigh(np.eye(len(A)) + x * A)
        root = (turned * np.sqrt(np.maximum(mass, SMALLEST))) @ turned.T
        half = np.linalg.solve(root, K)
        values, shapes = scipy.linalg.eigh(np.linalg.solve(root, half.T))
        return np.sqrt(np.maximum(values, self.least**2)), root @ shapes
