"""Facts about simulation and test from which causes choose their places and starting values."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.data.dofs import parse_dof

NEIGHBOURS, GROUND = 0.6, 0.2  # shares of joints between coupled DoFs, and to ground
UNLIKE = 0.02  # weight of a pair of DoFs of unlike directions


@dataclass(frozen=True)
class Place:
    """Where a cause sits: names for the answer, and integers (DoFs, channel, mode or variant) for the map."""

    where: tuple[Any, ...]
    index: tuple[int, int, int] = (0, -1, 0)


def across(x: np.ndarray, place: Place) -> np.ndarray:
    """What shapes or participation, ``(..., dof)``, are across a place."""
    a, b = place.index[:2]
    return x[..., a] - (x[..., b] if b >= 0 else 0.0)


@dataclass
class Scene:
    """Facts from which causes choose places and starting values, as NumPy arrays without padding.

    Attributes
    ----------
    freq, omega
        Lines [Hz], [rad/s], shape ``(f,)``.
    dofs, outputs, inputs
        Names.
    frequency_hz, damping_ratio
        Of the modes of the simulation.
    receptance
        Between all DoFs and themselves or pairs: ``drive(a, b)`` gives :math:`b^T H b`, shape ``(f,)`` [m/N].
    levels
        Force amplitudes [N].
    coupled
        Which DoFs a spring or damper of the simulation couples, shape ``(dof, dof)``; None where it does not say.
    """

    freq: np.ndarray
    dofs: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    levels: np.ndarray
    modal_form: Any
    scaled: bool = True
    form: str = "receptance"
    coupled: np.ndarray | None = None
    cache: dict[Any, Any] = field(default_factory=dict)

    @property
    def omega(self) -> np.ndarray:
        """Circular frequencies [rad/s]."""
        return 2 * np.pi * self.freq

    def gains(self) -> tuple[np.ndarray, np.ndarray]:
        """Gains of the modes and of their conjugates, shape ``(f, m)`` each [s]."""
        if "gains" not in self.cache:
            s, poles = 1j * self.omega[:, None], np.asarray(self.modal_form.poles)
            self.cache["gains"] = 1 / (s - poles), 1 / (s - poles.conj())
        return self.cache["gains"]

    def direction(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        """Modal displacement across a place, and modal participation of a force there, shape ``(m,)`` each."""
        psi, part = np.asarray(self.modal_form.shapes), np.asarray(self.modal_form.participation)
        return across(psi, place), across(part, place)

    def drive(self, place: Place) -> np.ndarray:
        """Receptance across a place, shape ``(f,)`` [m/N]."""
        u, v = self.gains()
        psi, part = self.direction(place)
        return u @ (psi * part) + v @ (psi * part).conj()

    def motion(self, place: Place) -> np.ndarray:
        """Relative displacement across a place for each input, shape ``(f, i)`` [m/N]."""
        u, v = self.gains()
        psi, _ = self.direction(place)
        part = np.asarray(self.modal_form.participation)[:, [self.dofs.index(name) for name in self.inputs]]
        return u @ (psi[:, None] * part) + v @ (psi[:, None] * part).conj()

    def stiffness_scale(self, place: Place) -> float:
        """A stiffness [N/m] that would matter at a place: one over the median receptance across it."""
        key = ("stiffness", place.index)
        if key not in self.cache:
            self.cache[key] = float(1 / max(np.median(np.abs(self.drive(place))), 1e-300))
        return self.cache[key]

    def amplitudes(self, place: Place, fractions: Sequence[float]) -> np.ndarray:
        """Amplitudes [m] across a place, as fractions of the largest undisturbed one of the largest level."""
        key = ("amplitude", place.index)
        if key not in self.cache:
            self.cache[key] = float(np.abs(self.motion(place)).max()) * float(self.levels.max())
        return self.cache[key] * np.asarray(fractions)

    def pairs(self, ground: bool = True, both: bool = True) -> list[Place]:
        """Every DoF to ground and every pair."""
        key = ("pairs", ground, both)
        if key not in self.cache:
            names = self.dofs if self.scaled else ()
            single = [Place((name,), (k, -1, 0)) for k, name in enumerate(names)] if ground else []
            pairs = [Place((names[a], names[b]), (a, b, 0)) for a, b in itertools.combinations(range(len(names)), 2)]
            self.cache[key] = single + (pairs if both else [])
        return self.cache[key]

    def weights(self, places: Sequence[Place]) -> np.ndarray:
        """How likely each place is before the data, summing to 1.

        Between DoFs that the simulation couples ``NEIGHBOURS``, to ground ``GROUND``, the rest anywhere else; a
        displacement less a rotation, or one along another axis, is hardly a joint's motion.
        """
        a, b = np.array([p.index[:2] for p in places]).reshape(-1, 2).T
        if (b < 0).all() or not len(places):
            return np.full(len(places), 1 / max(len(places), 1))
        _, direction = np.unique([str(parse_dof(name).direction) for name in self.dofs], return_inverse=True)
        other = np.maximum(b, 0)
        alike = (b < 0) | (direction[a] == direction[other])
        near = np.zeros(len(a), bool) if self.coupled is None else (b >= 0) & self.coupled[a, other]
        kinds = ((near & alike, NEIGHBOURS), (b < 0, GROUND), (np.ones(len(a), bool), 1 - NEIGHBOURS - GROUND))
        out = np.zeros(len(a))
        for mask, share in kinds:
            part = mask * np.where(alike, 1.0, UNLIKE)
            out += share * part / part.sum() if part.any() else 0.0
        return out / out.sum()

    def channels(self) -> list[Place]:
        """Every measured output."""
        return [Place((name,), (k, -1, 0)) for k, name in enumerate(self.outputs)]
