"""Noise of a measured FRF, and how far an effect stands out of it."""

from dataclasses import dataclass

import numpy as np

from .effect import Setup
from .plant import DERIVATIVES

KINDS = ("absolute", "relative", "coloured")
VARIANCES = ("exact", "6", "8", "16", "30", "missing")


def draw_sigma(setup: Setup, rng, kind: str, level: float) -> np.ndarray:
    """Standard deviation E|e|^2 ** 0.5 of each complex sample (run, f, o, i), from the linear FRF without effect.

    absolute: ``level`` times the channel's (or the whole test's) rms over the lines; relative: times the sample's own
    magnitude, never under a twentieth of that; coloured: absolute, with a slope and a hump over frequency. In half of
    the absolute and coloured draws the sensors set the floor, so it falls as 1/force from run to run.
    """
    size = np.abs(setup.frf(setup.plant))
    rms = np.sqrt((size**2).mean(axis=0, keepdims=True))
    rms = np.sqrt(rms**2 + (0.02**2) * (rms**2).mean())  # no sensor is silent where nothing moves
    by_level, one_floor = rng.random() < 0.5, rng.random() < 0.5
    slope, hump, centre = rng.uniform(-1.5, 1.5), rng.uniform(0, 3), rng.uniform(0.2, 0.8)
    if one_floor and kind != "relative":
        rms = np.broadcast_to(np.sqrt((rms**2).mean()), rms.shape)
    sigma = level * np.broadcast_to(rms, size.shape)
    if kind == "relative":
        sigma = level * np.sqrt(size**2 + (0.05 * rms) ** 2)
    elif kind == "coloured":
        f = setup.freq / np.sqrt(setup.freq[0] * setup.freq[-1])
        u = (setup.freq - setup.freq[0]) / (setup.freq[-1] - setup.freq[0])
        shape = f**slope * (1 + hump * np.exp(-(((u - centre) / 0.1) ** 2)))
        sigma = sigma * (shape / np.sqrt((shape**2).mean()))[:, None, None]
    sigma = np.broadcast_to(sigma, (len(setup.level), *size.shape))
    if by_level and kind != "relative" and np.isfinite(setup.level).all():
        sigma = sigma * (setup.level.max() / setup.level)[:, None, None, None] ** 0.5
    return np.array(sigma)


def add_noise(rng, H: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """``H`` with circular Gaussian errors of variance ``sigma**2``."""
    return H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)


def stated_variance(rng, sigma: np.ndarray, kind: str) -> tuple[np.ndarray | None, int | None]:
    """What the measurement file says of the noise.

    From M repeats the variance of the mean is estimated by the scatter, ``sigma^2`` times a chi-square of 2(M - 1)
    degrees of freedom over that number; by Cochran's theorem it is independent of the mean, so it is drawn as such.
    """
    if kind == "missing":
        return None, None
    if kind == "exact":
        return sigma**2, None
    repeats = int(kind)
    return sigma**2 * rng.gamma(repeats - 1, 1 / (repeats - 1), sigma.shape), repeats


@dataclass(frozen=True)
class Yardstick:
    """Distance of an effect in standard deviations, as a perfect detector sees it.

    White samples ``delta = sqrt(2) dH / sigma`` (real and imaginary parts each of unit variance). With a claimed
    spread of the simulation's frequencies and dampings, ``d^2 = delta' (I + J L J')^-1 delta`` for the
    sensitivities J to each mode's relative frequency and damping error and their variances L: the part of the effect
    that such errors could imitate counts less. Without a claim d is plainly the length of ``delta``.
    """

    weight: np.ndarray  # sqrt(2)/sigma
    J: np.ndarray  # (sample, parameter), complex, whitened, over all runs
    core: np.ndarray  # (L^-1 + J'J)^-1

    @classmethod
    def of(cls, setup: Setup, sigma: np.ndarray, frequency_std: float, damping_std: float) -> "Yardstick":
        weight = np.sqrt(2) / sigma
        if frequency_std == 0 and damping_std == 0:
            return cls(weight, np.zeros((weight.size, 0), complex), np.zeros((0, 0)))
        omega, zeta, shapes = setup.system.modes()
        s = 1j * setup.omega[:, None]
        D = omega**2 + 2 * zeta * omega * s + s**2
        by_frequency = -(2 * omega**2 + 2 * zeta * omega * s) / D**2 * frequency_std
        by_damping = -2 * zeta * omega * s / D**2 * damping_std
        pairs = np.einsum("or,ir->oir", shapes[setup.outputs], shapes[setup.inputs])
        gain = s[:, :1] ** DERIVATIVES[setup.form]
        parts = [np.einsum("fr,oir->foir", gain * by, pairs) for by in (by_frequency, by_damping)]
        J = np.concatenate(parts, axis=-1)
        J = (weight[..., None] * J[None]).reshape(weight.size, -1)  # in units of the claimed spread, so L = I
        return cls(weight, J, np.linalg.inv(np.eye(J.shape[1]) + (J.conj().T @ J).real))

    def plain(self, dH: np.ndarray) -> float:
        return float(np.linalg.norm(self.weight * dH))

    def distance(self, dH: np.ndarray) -> float:
        delta = (self.weight * dH).ravel()
        g = (self.J.conj().T @ delta).real
        return float(np.sqrt(max(np.vdot(delta, delta).real - g @ self.core @ g, 0.0)))
