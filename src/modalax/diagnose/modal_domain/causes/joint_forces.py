"""Joints that lose energy as no damper does, as modes feel them: alike at all frequencies, relaxing, by a power."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.causes import Cause
from modalax.diagnose.causes.viscoelastic import FractionalJoint, HystereticJoint, MaxwellJoint
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.line_forces import ModalForce
from modalax.diagnose.modal_domain.structure.loads import Load
from modalax.diagnose.thresholds import THRESHOLDS

DECADE = math.log(10)  # standard deviation of the logarithm of a relaxation time about mid-band
STEP, TERMS = 0.6, 14  # of the logarithms of rates by which a power is made, and how many on either side of mid-band


class Loss(ModalForce):
    """A joint that loses energy as no damper does."""

    @property
    def dissipates(self) -> bool:
        """It loses energy."""
        return True


class Between(Loss):
    """One between a spring and a damper: slow or of order 0 it is the one, at once or of order 1 the other."""

    @property
    def limits(self) -> tuple[tuple[str, ...], float]:
        """Spring and damper."""
        return ("joint_stiffness", "local_damper"), 0.5 * THRESHOLDS.stands_out**2

    @property
    def count(self) -> int:
        """Its strength, and where between them it is."""
        return 2

    def as_limit(self, u: np.ndarray, simple: Change) -> float:
        """Size of a spring or damper that has the same force as this in the middle of the band, but for its phase."""
        Z = complex(self.scale * u[0] * self.unit(u, np.array([1j * self.middle]))[0, 0, 0])
        return (Z.imag / self.middle if simple.slug == "local_damper" else Z.real) / simple.scale


class LossyJoint(Loss):
    """A joint that loses energy alike at all frequencies."""

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
class RelaxingJoint(Between):
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
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return MaxwellJoint()

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
        return Load(self.basis, np.full((1, 1), k), np.zeros((1, 1)), (k,), (1 / self._time(u),))

    def slopes_at(self, u: np.ndarray, s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """By strength and by the logarithm of the time."""
        time = self._time(u)
        x, by_time = s[:, None, None] * time, self.slopes_of_stiffness(u, s)[1]
        grown = self.scale * u[0] * self.width * time * (1 - x) / (1 + x) ** 3
        return [*super().slopes_at(u, s), (by_time, grown)]

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """With its time."""
        values, errors, extra = super().as_catalogue(u, covariance)
        spread = math.sqrt(max(float(covariance[1, 1]), 0.0))
        return [*values, self._time(u)], [*errors, self._time(u) * self.width * spread], extra


@dataclass(frozen=True)
class PowerLawJoint(Between):
    r"""A joint whose stiffness and loss grow with one power of frequency, :math:`Z = k(s/\omega_0)^\alpha`.

    With :math:`\omega_0` mid-band it is, to one part in ten thousand there, a sum of joints that relax,

    .. math:: z^\alpha = \frac{\sin\pi\alpha}{\pi}\int_0^\infty \frac{x^{\alpha-1}z}{z+x}\,dx

    by the trapezoidal rule in :math:`\ln x` (Trefethen and Weideman 2014), far below which they are a spring
    and far above a damper. Sizes: strength at mid-band, and :math:`\ln(\alpha/(1-\alpha))`.
    """

    @property
    def rarity(self) -> float:
        """As line by line, beside its limits."""
        return self.in_catalogue.prior

    @property
    def screened(self) -> bool:
        """Where a spring, a damper or another loss leads it is fitted; it lies between these."""
        return False

    @property
    def linear(self) -> bool:
        """It has two sizes."""
        return False

    @property
    def in_catalogue(self) -> Cause:
        """The same line by line."""
        return FractionalJoint()

    @staticmethod
    def order(u: np.ndarray) -> float:
        """Between 0 and 1."""
        return 1 / (1 + math.exp(-float(np.clip(u[1], -4.0, 4.0))))

    def unit(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The power itself."""
        return (s[:, None, None] / self.middle) ** self.order(u)

    def _by_order(self, u: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative by the second size, and that by s."""
        a, z = self.order(u), s[:, None, None] / self.middle
        size = self.scale * u[0] * a * (1 - a)
        return size * z**a * np.log(z), size * z ** (a - 1) * (a * np.log(z) + 1) / self.middle

    def slopes_of_stiffness(self, u: np.ndarray, s: np.ndarray) -> list[np.ndarray]:
        """By strength and by the order."""
        return [self.scale * self.unit(u, s), self._by_order(u, s)[0]]

    def load(self, u: np.ndarray) -> Load:
        """Joints that relax, a spring and a damper."""
        a, k = self.order(u), self.scale * float(u[0])
        x = np.exp(STEP * np.arange(-TERMS, TERMS + 1))
        each = k * math.sin(math.pi * a) / math.pi * STEP * x**a
        low, high = each[0] / math.expm1(a * STEP), each[-1] / x[-1] / math.expm1((1 - a) * STEP)
        return Load(
            self.basis, np.full((1, 1), each.sum() + low), np.full((1, 1), high / self.middle),
            tuple(each.tolist()), tuple((self.middle * x).tolist()),
        )  # fmt: skip

    def slopes_at(self, u: np.ndarray, s: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """By strength and by the order."""
        return [*super().slopes_at(u, s), self._by_order(u, s)]

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Coefficient and order."""
        a, unit = self.order(u), self.scale / self.middle ** self.order(u)
        slope = np.array([[unit, -unit * u[0] * math.log(self.middle) * a * (1 - a)], [0.0, a * (1 - a)]])
        std = np.sqrt(np.maximum(np.diag(slope @ covariance @ slope.T), 0.0))
        return [float(unit * u[0]), a], std.tolist(), None
