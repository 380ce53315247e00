r"""Damping that goes with a change of stiffness or mass, in coordinates of unit mass and stiffness :math:`\Lambda`.

Either it is in proportion to the change (Rayleigh 1877), or all modes of the changed structure have the damping ratio
of those before, however large the change: with :math:`(\Lambda+\Delta K)\Phi=(I+\Delta M)\Phi\Omega^2` and modes of
unit mass, :math:`\Delta C=2\zeta[(I+\Delta M)\Phi\Omega\Phi^T(I+\Delta M)-\Lambda^{1/2}]`. By small further changes
that moves by :math:`2\zeta\,\delta K_{ij}/(\omega_i+\omega_j)` and :math:`2\zeta\,\delta
M_{ij}\,\omega_i\omega_j/(\omega_i+\omega_j)` between its modes (Higham 2008, theorem 3.11).
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg

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
    """Damping with which all modes keep half of ``twice`` as damping ratio.

    Attributes
    ----------
    twice
        Two times that ratio.
    frequencies, least
        Of the modes before [rad/s], shape ``(n,)``, and the least that a mode counts with.
    of_mass
        Whether the mass changes, and not the stiffness.
    """

    twice: float
    frequencies: np.ndarray
    least: float
    of_mass: bool

    def change(self, x: float, A: np.ndarray) -> np.ndarray:
        """Damping of the changed structure, less that before."""
        w, P = self._modes(x, A)
        return self.twice * ((P * w) @ P.T - np.diag(self.frequencies))

    def slope(self, x: float, A: np.ndarray) -> np.ndarray:
        """Its derivative by ``x``."""
        w, P = self._modes(x, A)
        shapes = np.linalg.inv(P).T if self.of_mass else P
        moved = shapes.T @ A @ shapes / np.add.outer(w, w)
        return self.twice * P @ (moved * np.multiply.outer(w, w) if self.of_mass else moved) @ P.T

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
