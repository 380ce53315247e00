r"""Linear causes that are no symmetric change of mass, damping or stiffness: a force at one place.

With B the directions at which it acts and :math:`Z(s)` its dynamic stiffness between them, the response :math:`G` of
all coordinates becomes :math:`G - GB(I + ZB^TGB)^{-1}ZB^TG` (Woodbury 1950). A skew coupling makes FRFs that are not
reciprocal, and the stiffness of a joint that relaxes or loses energy alike at all frequencies is none of a spring and a
damper: modes at several frequencies tell them apart, and are predicted with them
(:mod:`modalax.diagnose.modal_domain.loads`). The mass of a roving sensor loads the FRFs of that sensor alone, which
have modes of their own then.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes import Cause
from modalax.diagnose.causes.channels import SensorMass
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.causes.viscoelastic import HystereticJoint, MaxwellJoint
from modalax.diagnose.modal_domain.causes import Change, with_sizes
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.loads import Load
from modalax.diagnose.thresholds import THRESHOLDS

FEW = 40  # DoFs up to which any two may be coupled; of more, measured ones only
COUPLED = 0.1  # usual skew coupling, relative to what would hold both DoFs as much as they hold themselves
MASS = 0.1  # usual mass of a sensor, relative to the modal mass seen from its place
DECADE = math.log(10)  # standard deviation of the logarithm of a relaxation time about mid-band
APART, TIMES = math.log(4), (-1, 0, 1)  # of its logarithm, the distance of times about which modes are asked for one
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
    def at_dofs(self) -> bool:
        """All but a sensor's mass."""
        return self.row is None

    @property
    def local(self) -> bool:
        """It moves modes, but for what only one output shows."""
        return self.row is None

    @property
    def linear(self) -> bool:
        """Small strengths act in proportion."""
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

    @property
    def starts(self) -> list[np.ndarray]:
        """Sizes about which its strength is screened."""
        return [np.zeros(1)]

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
            for p, v, e in zip(self.in_catalogue.parameters, values, errors, strict=True) if p.name != "lasting_share"
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


class LossyJoint(ModalForce):
    """A joint that loses energy alike at all frequencies."""

    @property
    def dissipates(self) -> bool:
        """It loses energy."""
        return True

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return HystereticJoint()

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The imaginary unit."""
        return 1j * np.ones_like(s)[:, None, None]

    def load(self, u: np.ndarray) -> Load:
        """An imaginary stiffness."""
        return Load(self.basis, np.full((1, 1), 1j * self.scale * u[0]), np.zeros((1, 1)))


@dataclass(frozen=True)
class RelaxingJoint(ModalForce):
    """A joint of a spring in series with a damper, whose time is sought too.

    Attributes
    ----------
    about
        Logarithm of its usual time over that of mid-band.
    width
        Standard deviation of the logarithm of its time.
    """

    about: float = 0.0
    width: float = DECADE

    @property
    def dissipates(self) -> bool:
        """It loses energy."""
        return True

    @property
    def limits(self) -> tuple[tuple[str, ...], float]:
        """A joint that relaxes slowly is a spring, and one that relaxes at once a damper."""
        return ("joint_stiffness", "local_damper"), 0.5 * THRESHOLDS.stands_out**2

    @property
    def count(self) -> int:
        """Its strength and its time."""
        return 2

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return MaxwellJoint()

    @property
    def starts(self) -> list[np.ndarray]:
        """Three times, a factor of three apart."""
        return [np.array([0.0, x * math.log(3) / self.width]) for x in (-1.0, 0.0, 1.0)]

    def _time(self, u: np.ndarray) -> float:
        return math.exp(self.about + float(np.clip(u[1], -4.0, 4.0)) * self.width) / self.middle

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        r""":math:`s\tau / (1 + s\tau)`."""
        x = s[:, None, None] * self._time(u)
        return x / (1 + x)

    def slopes_of_stiffness(self, u: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
        """By strength and by the logarithm of the time."""
        x = s[:, None, None] * self._time(u)
        return [self.scale * self.unit(u, s), self.scale * u[0] * self.width * x / (1 + x) ** 2]

    def load(self, u: np.ndarray) -> Load:
        """A stiffness less what relaxes of it."""
        k = self.scale * float(u[0])
        return Load(self.basis, np.full((1, 1), k), np.zeros((1, 1)), k, 1 / self._time(u))

    def slopes_at(self, u: np.ndarray, s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """By strength and by the logarithm of the time."""
        time = self._time(u)
        x, by_time = s[:, None, None] * time, self.slopes_of_stiffness(u, s)[1]
        grown = self.scale * u[0] * self.width * time * (1 - x) / (1 + x) ** 3
        return [*super().slopes_at(u, s), (by_time, grown)]

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """With its time; no stiffness lasts."""
        values, errors, extra = super().as_catalogue(u, covariance)
        spread = math.sqrt(max(float(covariance[1, 1]), 0.0))
        return [*values, self._time(u), 0.0], [*errors, self._time(u) * self.width * spread, 0.0], extra


class RovingMass(LineForce):
    """The mass of a sensor, which loads its own FRFs only."""

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return SensorMass()

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The square of s."""
        return s[:, None, None] ** 2


KINDS: dict[str, type[LineForce]] = {
    "gyroscopic": SkewCoupling, "hysteretic_joint": LossyJoint, "maxwell_joint": RelaxingJoint,
    "sensor_mass": RovingMass,
}  # fmt: skip
JOINTS = ("hysteretic_joint", "maxwell_joint")


def loads_of(causes: Sequence[Change], u: np.ndarray) -> tuple[Load, ...]:
    """Those among some causes that are such forces, as modes feel them."""
    return tuple(cause.load(size) for cause, size in with_sizes(causes, u) if isinstance(cause, ModalForce))


def loaded(
    forces: Sequence[tuple[LineForce, np.ndarray]], s: np.ndarray, own: np.ndarray, outer: np.ndarray,
    inner: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Responses to forces at outputs and inputs with some forces; ``own`` is GB of all, shape ``(f, n, k)``."""
    B = np.concatenate([cause.basis for cause, _ in forces], axis=1)
    Z, start = np.zeros((len(s), B.shape[1], B.shape[1]), complex), 0
    for cause, u in forces:
        end = start + cause.basis.shape[1]
        Z[:, start:end, start:end] = cause.stiffness(u, s)
        start = end
    T = np.linalg.solve(np.eye(B.shape[1]) + Z @ (B.T @ own), Z)
    return outer - own @ T.transpose(0, 2, 1) @ (B.T @ outer), inner - own @ T @ (B.T @ inner)


def added_stiffness(forces: Sequence[tuple[LineForce, np.ndarray]], s: np.ndarray) -> np.ndarray | float:
    """What forces add to the dynamic stiffness of all coordinates, shape ``(f, n, n)``."""
    return sum(cause.basis @ cause.stiffness(u, s) @ cause.basis.T for cause, u in forces)


def asked_of_modes(forces: Sequence[LineForce]) -> list[Change]:
    """Those that modes tell of; a joint that relaxes about one of several times each, so that all are of one size."""
    out: list[Change] = []
    for f in forces:
        if isinstance(f, RelaxingJoint):
            weight = f.weight / len(TIMES)
            out += [replace(f, weight=weight, about=k * APART, width=APART) for k in TIMES]
        elif isinstance(f, ModalForce):
            out.append(f)
    return out


def losses_at(spring: Change, candidates: Sequence[Change], c: Coordinates) -> list[LineForce]:
    """Losses of a joint, each as others among candidates, at the place of a spring that none was looked for at."""
    assert spring.direction is not None
    b, inside, out = spring.direction, np.flatnonzero(c.frequencies[:-1] < c.frequencies[-2]), []
    for slug in JOINTS:
        alike = [f for f in candidates if isinstance(f, LineForce) and f.slug == slug]
        if alike and all(f.where != spring.where for f in alike):
            like = min(alike, key=lambda f: abs(f.about) if isinstance(f, RelaxingJoint) else 0.0)
            damper = like.middle * _doubling(c, b, inside)
            out.append(
                replace(
                    like, where=spring.where, scale=spring.scale, weight=spring.weight, basis=b[:, None],
                    reference=damper,
                )
            )  # fmt: skip
    return out


def line_forces(
    c: Coordinates, dofs: Sequence[str], outputs: Sequence[str], inputs: Sequence[str],
    springs: Sequence[tuple[tuple[str, ...], np.ndarray, float, float, bool]], low: float, high: float,
) -> list[LineForce]:  # fmt: skip
    """Each such force at each place; ``springs`` are places of joints, ``low`` and ``high`` the band's ends [rad/s]."""
    middle, found = math.sqrt(low * high), []
    inside = np.flatnonzero(c.frequencies[:-1] < 1.5 * high)
    mobile = (c.shapes[:, inside] ** 2).mean(axis=1)
    for slug in JOINTS:
        found += [
            KINDS[slug](
                slug, where, k, weight=w, basis=b[:, None], middle=middle, reference=middle * _doubling(c, b, inside)
            )
            for where, b, k, w, held in springs
            if held
        ]  # fmt: skip
    some = [k for k, name in enumerate(dofs) if mobile[k] > 1e-6 * mobile.max()]
    if len(some) > FEW:
        some = [k for k in some if dofs[k] in {*outputs, *inputs}]
    for j, a in enumerate(some):
        for b in some[:j]:
            size = COUPLED * middle / math.sqrt(mobile[a] * mobile[b])
            pair = c.shapes[[b, a]].T
            found.append(SkewCoupling("gyroscopic", (dofs[b], dofs[a]), size, basis=pair, middle=middle))
    return found + roving_masses(c, outputs, low, high)


def roving_masses(c: Coordinates, outputs: Sequence[str], low: float, high: float) -> list[LineForce]:
    """The mass of a sensor at each output, the only such force that is no matter of the structure's modes."""
    masses = (roving_mass(c, name, k, c.outputs[k], low, high) for k, name in enumerate(outputs))
    return [mass for mass in masses if mass is not None]


def _doubling(c: Coordinates, b: np.ndarray, inside: np.ndarray) -> float:
    """Damper across a place that doubles the damping of one mode [N s/m]."""
    return float((np.diag(c.damping)[inside] / np.maximum(b[inside] ** 2, 1e-300)).min())


def roving_mass(
    c: Coordinates, name: str, number: int, row: np.ndarray, low: float, high: float
) -> RovingMass | None:  # fmt: skip
    """The mass of a sensor at the output of a number and a row of shapes; None where that does not move in the band."""
    seen = float((row[c.frequencies < 1.5 * high] ** 2).mean())
    if not seen:
        return None
    middle = math.sqrt(low * high)
    return RovingMass("sensor_mass", (name,), MASS / seen, basis=row[:, None], middle=middle, row=number)
