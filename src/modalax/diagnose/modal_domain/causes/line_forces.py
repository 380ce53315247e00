r"""Linear causes that are no symmetric change of mass, damping or stiffness: a force at one place.

With B the directions at which it acts and :math:`Z(s)` its dynamic stiffness between them, the response :math:`G` of
all coordinates becomes :math:`G - GB(I + ZB^TGB)^{-1}ZB^TG` (Woodbury 1950). A skew coupling makes FRFs that are not
reciprocal, and the stiffness of a joint that relaxes or loses energy alike at all frequencies is none of a spring and a
damper: modes at several frequencies tell them apart, and are predicted with them
(:mod:`modalax.diagnose.modal_domain.structure.loads`). The mass of a roving sensor loads the FRFs of that sensor alone,
which have modes of their own then.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.causes import Cause
from modalax.diagnose.causes.channels import SensorMass
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.modal_domain.causes.change import Change, with_sizes
from modalax.diagnose.modal_domain.structure.loads import Load

SKEW, EVEN = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class LineForce(Change):
    """One such force; its kinds are the classes below.

    Attributes
    ----------
    basis
        Directions B in modal coordinates, shape ``(n, k)``.
    middle
        Circular frequency in the middle of the band [rad/s].
    row
        Output whose FRFs alone show it; None where all do.
    """

    basis: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), compare=False)
    middle: float = 1.0
    row: int | None = None

    @property
    def in_channels(self) -> bool:
        """It is no fault of a channel."""
        return False

    @property
    def local(self) -> bool:
        """It moves modes, but for what only one output shows."""
        return self.row is None

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """None that is symmetric and of one matrix."""
        return {}

    @property
    def count(self) -> int:
        """Its strength alone."""
        return 1

    @property
    def signed(self) -> bool:
        """Whether it may have either sign."""
        return False

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        r"""Dynamic stiffness of strength one, shape ``(f, k, k)``; ``s`` is :math:`\sigma + j\omega` [rad/s]."""
        raise NotImplementedError

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        raise NotImplementedError

    def stiffness(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Dynamic stiffness Z, shape ``(f, k, k)``."""
        return self.scale * u[0] * self.unit(u, s)

    def slopes_of_stiffness(self, u: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
        """Derivatives of Z by each size."""
        return [self.scale * self.unit(u, s)]

    def size(self, u: np.ndarray) -> float:
        """Its stiffness in the middle of the band, of a joint the part that loses energy [N/m]."""
        Z = self.stiffness(u, np.array([1j * self.middle]))[0]
        return float(Z[0, 0].imag if len(Z) == 1 else abs(Z[0, 1]))

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Parameters of the catalogue's cause and their standard deviations."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return [float(self.scale * u[0])], [float(self.scale * std[0])], None

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Parameters by the catalogue's names."""
        values, errors, _ = self.as_catalogue(u, covariance)
        return {
            p.name: {"value": v, "std": e, "unit": p.unit}
            for p, v, e in zip(self.in_catalogue.parameters, values, errors, strict=True)
        }  # fmt: skip


class ModalForce(LineForce, ABC):
    """A force on the structure itself, with which modes are computed."""

    @abstractmethod
    def load(self, u: np.ndarray) -> Load:
        """Its dynamic stiffness by parts, from which modes follow."""

    def slopes_at(self, u: np.ndarray, s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Derivatives of Z [N/m] by each size, and the derivatives of these by s, shapes ``(f, k, k)``."""
        by_strength, slope, _ = self.load(np.append(1.0, u[1:])).expanded(s)  # Z grows in proportion to the strength
        return [(by_strength, slope)]


class SkewCoupling(ModalForce):
    """A gyroscopic coupling of two degrees of freedom, of either sign."""

    @property
    def signed(self) -> bool:
        """It may have either sign."""
        return True

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return Gyroscopic()

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """A skew matrix times s."""
        return s[:, None, None] * SKEW

    def load(self, u: np.ndarray) -> Load:
        """A skew damping matrix."""
        return Load(self.basis, np.zeros((2, 2)), self.scale * u[0] * SKEW)


class EvenCoupling(SkewCoupling):
    """Damping forces on two DoFs, each by the velocity of the other alike: what a skew coupling must not need."""

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """A symmetric matrix times s."""
        return s[:, None, None] * EVEN

    def load(self, u: np.ndarray) -> Load:
        """A symmetric damping matrix without a diagonal."""
        return Load(self.basis, np.zeros((2, 2)), self.scale * u[0] * EVEN)


class RovingMass(LineForce):
    """The mass of a sensor, which loads its own FRFs only."""

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return SensorMass()

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The square of s."""
        return s[:, None, None] ** 2


def loads_of(causes: Sequence[Change], u: np.ndarray) -> tuple[Load, ...]:
    """Those among some causes that are such forces, as modes feel them."""
    return tuple(cause.load(size) for cause, size in with_sizes(causes, u) if isinstance(cause, ModalForce))


def loaded(
    forces: Sequence[tuple[LineForce, np.ndarray]], s: np.ndarray, own: np.ndarray, outer: np.ndarray,
    inner: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Responses to forces at outputs and inputs with some forces; ``own`` is GB of all, shape ``(f, n, k)``."""
    B = bases_of(forces)
    T = joined(forces, s, B.T @ own)
    return outer - own @ T.transpose(0, 2, 1) @ (B.T @ outer), inner - own @ T @ (B.T @ inner)


def bases_of(forces: Sequence[tuple[LineForce, np.ndarray]]) -> np.ndarray:
    """Directions of all forces together, shape ``(n, k)``."""
    return np.concatenate([cause.basis for cause, _ in forces], axis=1)


def joined(forces: Sequence[tuple[LineForce, np.ndarray]], s: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Forces by motions without them, :math:`(I+ZB^TGB)^{-1}Z`; ``between`` is B'GB, shapes ``(f, k, k)``."""
    Z, start = np.zeros_like(between, dtype=complex), 0
    for cause, u in forces:
        end = start + cause.basis.shape[1]
        Z[:, start:end, start:end] = cause.stiffness(u, s)
        start = end
    return np.linalg.solve(np.eye(between.shape[1]) + Z @ between, Z)


def added_stiffness(forces: Sequence[tuple[LineForce, np.ndarray]], s: np.ndarray) -> np.ndarray | float:
    """What forces add to the dynamic stiffness of all coordinates, shape ``(f, n, n)``."""
    return sum(cause.basis @ cause.stiffness(u, s) @ cause.basis.T for cause, u in forces)
