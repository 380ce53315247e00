"""The nominal simulation and the structure as it really is: every element off a little by itself."""

from dataclasses import dataclass

import numpy as np
from generator.systems import log_uniform, modal_matrix

from .structures import Build, modes


@dataclass(frozen=True)
class Spread:
    """Relative standard deviations of every element's stiffness and mass, and of every mode's damping ratio."""

    stiffness: float
    mass: float
    damping: float

    def scaled(self, factor: float) -> "Spread":
        return Spread(factor * self.stiffness, factor * self.mass, factor * self.damping)


@dataclass(frozen=True)
class World:
    """Matrices of one structure with the modal damping ratios that made ``C``."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    zeta: np.ndarray

    @property
    def shapes(self) -> np.ndarray:
        return modes(self.M, self.K)[1]

    @property
    def frequencies(self) -> np.ndarray:
        """Undamped natural frequencies [Hz], rigid-body ones included."""
        return modes(self.M, self.K)[0] / (2 * np.pi)

    def changed(self, M=0.0, C=0.0, K=0.0) -> "World":
        return World(self.M + M, self.C + C, self.K + K, self.zeta)

    def at_equal_ratios(self, M=0.0, K=0.0) -> "World":
        """With other mass and stiffness, and modes that are damped as they were."""
        return damped(self.M + M, self.K + K, self.zeta)


def damped(M: np.ndarray, K: np.ndarray, zeta: np.ndarray) -> World:
    """A structure with the damping ratios ``zeta`` of its own modes."""
    omega, shapes = modes(M, K)
    C = modal_matrix(M, shapes, 2 * zeta * omega)
    return World(M, (C + C.T) / 2, K, zeta)


def nominal(build: Build, rng: np.random.Generator) -> World:
    """The structure as designed, modes damped by 0.3 to 3 %."""
    zeta = np.clip(log_uniform(rng, 0.004, 0.02) * log_uniform(rng, 0.6, 1.6, build.n), 0.003, 0.03)
    return damped(*build.assemble(), zeta)


@dataclass(frozen=True)
class Off:
    """Relative errors drawn: stiffness and mass of every element, damping of every mode, as logarithms."""

    stiffness: np.ndarray
    mass: np.ndarray
    damping: np.ndarray


def draw_off(build: Build, rng: np.random.Generator, spread: Spread) -> Off:
    count = len(build.elements)
    return Off(
        rng.normal(size=count) * spread.stiffness,
        rng.normal(size=count) * spread.mass,
        rng.normal(size=build.n) * spread.damping,
    )


def realised(build: Build, design: World, off: Off) -> World:
    """The structure with every element off; shapes and frequencies follow."""
    M, K = build.assemble(np.exp(off.stiffness), np.exp(off.mass))
    return damped(M, K, design.zeta * np.exp(off.damping))


def modal_inaccuracy(build: Build, design: World, true: World, spread: Spread, inside: np.ndarray) -> dict[str, dict]:
    """What all this amounts to in the modes ``inside`` the band, as relative rms.

    ``drawn``: of phi' dK phi / omega^2, phi' dM phi and the damping ratios; ``expected``: its standard deviation over
    many draws, by the share of every element in a mode's energy; ``element``: the spread of the elements themselves.
    """
    omega, shapes = modes(design.M, design.K)
    phi, square = shapes[:, inside], omega[inside] ** 2
    share_k = np.stack([np.einsum("ar,ab,br->r", phi[e.at], e.k, phi[e.at]) for e in build.elements]) / square
    share_m = np.stack([np.einsum("ar,ab,br->r", phi[e.at], e.m, phi[e.at]) for e in build.elements])
    rms = lambda x: float(np.sqrt(np.mean(np.square(x))))
    return {
        "stiffness": {
            "element": spread.stiffness,
            "drawn": rms(np.einsum("ar,ab,br->r", phi, true.K - design.K, phi) / square),
            "expected": rms(np.linalg.norm(share_k, axis=0)) * spread.stiffness,
        },
        "mass": {
            "element": spread.mass,
            "drawn": rms(np.einsum("ar,ab,br->r", phi, true.M - design.M, phi)),
            "expected": rms(np.linalg.norm(share_m, axis=0)) * spread.mass,
        },
        "damping": {
            "element": spread.damping,
            "drawn": rms(np.log(true.zeta / design.zeta)[inside]),
            "expected": spread.damping,
        },
    }
