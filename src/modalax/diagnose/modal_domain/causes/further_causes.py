"""Causes that are more than one change of one matrix: an attached oscillator, a mode too many, hysteretic damping."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.special

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates

ABSORBER = 0.1  # usual mass of an attached oscillator, relative to the modal mass seen from its place
ZETA, FACTOR = 0.02, 1.0  # its usual damping ratio, and the standard deviation of that one's logarithm
LARGEST = 50.0  # of logarithms
LIGHT = 0.01, 1.2  # the same of any mode, from light to welded structures
SIZES = 2.0  # standard deviation of the logarithm of a residue's size about those of the other modes
REAL = 0.1  # standard deviation of the imaginary parts of a normalised shape; most modes are nearly real


@dataclass(frozen=True)
class TunedMass(Change):
    r"""An oscillator attached at a DoF, the coordinate that the simulation keeps spare.

    With ``z`` its displacement times the root of its mass ``m``, and ``b`` the direction of the DoF, its spring adds
    :math:`\tfrac12\omega_0^2 (z - \sqrt m\, b^T q)^2` to the energy, and its damper the same with
    :math:`2\zeta_0\omega_0`. Sizes: :math:`\sqrt m` over its usual value, logarithms of frequency and damping.

    Attributes
    ----------
    middle, width
        Usual circular frequency [rad/s], and the standard deviation of its logarithm.
    spare
        Circular frequency of the spare coordinate while nothing is attached to it [rad/s].
    """

    middle: float = 1.0
    width: float = 1.0
    spare: float = 1.0

    @property
    def local(self) -> bool:
        """It changes stiffness and damping."""
        return True

    @property
    def adds_mode(self) -> bool:
        """Its own."""
        return True

    @property
    def count(self) -> int:
        """Mass, frequency, damping ratio."""
        return 3

    @property
    def linear(self) -> bool:
        """Its mass alone moves nothing in proportion."""
        return False

    def values(self, u: np.ndarray) -> np.ndarray:
        """Mass [kg], circular frequency [rad/s] and damping ratio."""
        grown = np.exp(np.clip([self.width * u[1], FACTOR * u[2]], -LARGEST, LARGEST))  # a search may go anywhere
        return np.array([self.scale * u[0] ** 2, self.middle * grown[0], ZETA * grown[1]])

    def _vectors(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Direction of the spring, and its derivative by the first size."""
        assert self.direction is not None
        own = np.zeros(len(self.direction))
        own[-1] = 1.0
        slope = -math.sqrt(self.scale) * self.direction
        return own + u[0] * slope, slope

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Of stiffness and damping."""
        _, w, zeta = self.values(u)
        d, _ = self._vectors(u)
        stiffness = w**2 * np.outer(d, d)
        stiffness[-1, -1] -= self.spare**2
        return {"K": stiffness, "C": 2 * zeta * w * np.outer(d, d)}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """By the root of the mass, the logarithm of the frequency and that of the damping ratio."""
        _, w, zeta = self.values(u)
        d, slope = self._vectors(u)
        both, whole, c = np.outer(d, slope) + np.outer(slope, d), np.outer(d, d), 2 * zeta * w
        return [
            {"K": w**2 * both, "C": c * both},
            {"K": 2 * self.width * w**2 * whole, "C": self.width * c * whole},
            {"C": FACTOR * c * whole},
        ]

    def size(self, u: np.ndarray) -> float:
        """Its mass."""
        return float(self.values(u)[0])

    def possible(self, u: np.ndarray) -> bool:
        """What is damped beyond the critical damping oscillates no more: a damper holds it there as a mass."""
        return super().possible(u) and bool(self.values(u)[2] < 1)

    def alike(self, u: np.ndarray) -> tuple[str, float | None]:
        """What its spring holds to its place is a mass there."""
        return "added_mass", self.size(u)

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Mass, frequency, damping ratio."""
        m, w, zeta = (float(v) for v in self.values(u))
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return {
            "mass": {"value": m, "std": float(2 * self.scale * abs(u[0]) * std[0]), "unit": "kg"},
            "frequency": {"value": w / 2 / np.pi, "std": float(w / 2 / np.pi * self.width * std[1]), "unit": "Hz"},
            "damping_ratio": {"value": zeta, "std": float(zeta * FACTOR * std[2]), "unit": "-"},
        }

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Mass, frequency, damping ratio."""
        told = self.told(u, covariance).values()
        return [v["value"] for v in told], [v["std"] for v in told], None


@dataclass(frozen=True)
class MissingMode(Change):
    """A measured mode that the simulation has not: it explains nothing of the others and is explained by none.

    Attributes
    ----------
    number
        Of the mode, among the measured ones.
    pole, residue
        As measured, in rad/s and of the receptance, shape ``(o, i)``.
    order
        Derivatives of the displacement that were measured.
    log_density
        Of its features before the data, where they were measured.
    std
        Standard deviations of the logarithms of its size, frequency and damping ratio.
    """

    number: int = 0
    pole: complex = field(default=0j, compare=False)
    residue: np.ndarray | None = field(default=None, compare=False)
    order: int = field(default=0, compare=False)
    log_density: float = field(default=0.0, compare=False)
    std: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), compare=False)

    @property
    def sized(self) -> bool:
        """All its parameters are those of the measured mode."""
        return False

    @property
    def adds_mode(self) -> bool:
        """Its own."""
        return True

    @property
    def freed(self) -> int | None:
        """The mode itself."""
        return self.number

    @property
    def shape(self) -> np.ndarray:
        """Real product of shape and participation by outputs and inputs, for modal equations of unit mass."""
        assert self.residue is not None
        return (2j * self.pole.imag * self.residue).real

    def added(self, s: np.ndarray) -> np.ndarray:
        """Its own FRF."""
        assert self.residue is not None
        at = s[:, None, None]
        both = self.residue / (at - self.pole) + self.residue.conj() / (at - np.conj(self.pole))
        return both * at**self.order

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Size, frequency and damping ratio."""
        w, size = abs(self.pole), float(np.linalg.norm(self.shape))
        values = {"participation": (size, "-"), "frequency": (w / 2 / np.pi, "Hz"),
                  "damping_ratio": (-self.pole.real / w, "-")}  # fmt: skip
        return {
            name: {"value": float(value), "std": float(value * error), "unit": unit}
            for (name, (value, unit)), error in zip(values.items(), self.std, strict=True)
        }

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Size, frequency, damping ratio, and the shape."""
        told = self.told(u, covariance).values()
        return [v["value"] for v in told], [v["std"] for v in told], (self.shape / np.linalg.norm(self.shape))[None]


ROUNDS = 6  # of two equations for two unknowns, each nearer by the square of the damping ratio


def hysteretic_poles(poles: np.ndarray, share: float) -> np.ndarray:
    r"""Poles of modes with a share of hysteretic damping, by those with as much viscous damping.

    They solve :math:`\lambda^2 + 2\zeta\omega(1-u)\lambda + \omega^2(1 + 2ju\zeta) = 0` with :math:`\omega = |\lambda|`
    and :math:`\zeta\omega = -\mathrm{Re}\lambda` of the viscous ones.
    """
    decay, square = -(1 - share) * poles.real, np.abs(poles) ** 2 - 2j * share * poles.real * np.abs(poles)
    return -decay + 1j * np.sqrt(square - decay**2)


def viscous_terms(poles: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    r""":math:`\zeta\omega` and :math:`\omega^2` of the viscous modes whose :func:`hysteretic_poles` are given.

    Imaginary and real part of the equation that these solve are taken one after the other.
    """
    a, b, square = -poles.real, poles.imag, np.abs(poles) ** 2
    for _ in range(ROUNDS):
        decay = a * b / ((1 - share) * b + share * np.sqrt(square))
        square = b**2 - a**2 + 2 * (1 - share) * decay * a
    return decay, square  # pyrefly: ignore[unbound-name]


@dataclass(frozen=True)
class StructuralDamping(Change):
    r"""Hysteretic instead of viscous damping, a share ``u`` of it.

    A hysteretic mode of the same pole :math:`\lambda` has the residue :math:`\phi\phi^T/(2\lambda)`, a viscous one
    :math:`\phi\phi^T/(2j\,\mathrm{Im}\lambda)`, so that phases of residues tell them apart. In between it is one
    over :math:`2\lambda + 2\zeta\omega(1-u)`, the derivative of what the pole solves (:func:`hysteretic_poles`).
    """

    def alike(self, u: np.ndarray) -> tuple[str, float | None]:
        """A window may decay likewise."""
        return "exponential_window", None

    @property
    def signed(self) -> bool:
        """No damping is less hysteretic than viscous."""
        return False

    def hysteretic(self, u: np.ndarray) -> float:
        """The share."""
        return float(u[0])

    def at_modes(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues turned by a share of the damping ratio, from those of modes with as much viscous damping."""
        decay, square = viscous_terms(poles, float(u[0]))
        return residues * (1j * np.sqrt(square - decay**2) / (poles + (1 - u[0]) * decay))[:, None, None]

    def slope_at_modes(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        r"""Derivative of :meth:`at_modes` by the share, to first order in the damping ratio.

        There the residue is one over :math:`2j\,\mathrm{Im}\lambda + 2u\,\mathrm{Re}\lambda`, and the pole stays.
        """
        turned = 1j * poles.imag + u[0] * poles.real
        return residues * (-1j * poles.imag * poles.real / turned**2)[:, None, None]

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The share."""
        return {"share": {"value": float(u[0]), "std": float(np.sqrt(max(covariance[0, 0], 0.0))), "unit": "-"}}


def tuned_masses(dofs: tuple[str, ...], c: Coordinates, inside: np.ndarray, low: float, high: float) -> list[Change]:
    """An oscillator at each DoF that moves in the modes ``inside`` the band from ``low`` to ``high`` [rad/s]."""
    mobile = (c.shapes[:, inside] ** 2).mean(axis=1)
    middle, width = math.sqrt(low * high), max(math.log(high / low), 0.1) / math.sqrt(12)
    return [
        TunedMass(
            "tuned_mass", (name,), ABSORBER / float(mobile[k]), c.shapes[k], middle=middle, width=width,
            spare=float(c.frequencies[-1]),
        )
        for k, name in enumerate(dofs) if mobile[k] > 1e-6 * mobile.max()
    ]  # fmt: skip


def missing_modes(f: Features, order: int, low: float, high: float) -> list[Change]:
    """Each measured mode as one that the simulation lacks; the band is from ``low`` to ``high`` [rad/s]."""
    std = np.sqrt(np.maximum(np.diag(f.covariance), 0.0)).reshape(f.values.shape)
    raw, found = f.residues * f.units, []
    for k in np.flatnonzero(~f.grouped).tolist():  # of those of one frequency none is told by itself
        found.append(
            MissingMode(
                "missing_mode", (), number=k, pole=complex(f.poles[k]), residue=raw[k], order=order,
                log_density=_log_density(f, k, low, high), std=(float(std[k, 2]), float(std[k, 0]), float(std[k, 1])),
            )
        )  # fmt: skip
    return found


def _log_density(f: Features, k: int, low: float, high: float) -> float:
    """Of any mode of the band, where mode ``k`` was measured; directions of a nearly real shape are all alike."""
    normal = lambda x, std: -0.5 * (x / std) ** 2 - math.log(std * math.sqrt(2 * math.pi))
    others = np.delete(f.values[:, 2], k)
    size = float(f.values[k, 2] - others.mean()) if len(others) else 0.0
    zeta = float(f.values[k, 1]) - math.log(LIGHT[0])
    total = -math.log(max(math.log(high / low), 0.1)) + normal(zeta, LIGHT[1]) + normal(size, SIZES)
    total -= math.log(2 * math.pi)  # the phase
    for count in f.residues.shape[1:]:  # half a sphere of real directions, and imaginary parts
        half = 0.5 * count
        total -= math.log(math.pi**half) - scipy.special.gammaln(half) + (count - 1) * math.log(
            REAL * math.sqrt(2 * math.pi)
        )  # fmt: skip
    return float(total)
