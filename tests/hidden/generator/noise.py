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
    spread of the simulation's frequencies and dampings, ``d^2 = min over t of |delta - m(t)|^2 + |t|^2`` for the
    change ``m(t)`` that modes off by ``t`` claimed standard deviations make: what such errors could imitate counts
    less. For small ones this is ``delta' (I + J J')^-1 delta`` with the sensitivities J. Without a claim d is plainly
    the length of ``delta``.
    """

    weight: np.ndarray  # sqrt(2)/sigma
    modes: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None  # s, gain, omega, zeta, pairs
    claims: tuple[float, float]
    J: np.ndarray  # (sample, parameter), complex, whitened, over all runs, in units of the claimed spread
    core: np.ndarray  # (I + J'J)^-1

    @classmethod
    def of(cls, setup: Setup, sigma: np.ndarray, frequency_std: float, damping_std: float) -> "Yardstick":
        weight = np.sqrt(2) / sigma
        if frequency_std == 0 and damping_std == 0:
            return cls(weight, None, (0.0, 0.0), np.zeros((weight.size, 0), complex), np.zeros((0, 0)))
        omega, zeta, shapes = setup.system.modes()
        s = 1j * setup.omega[:, None]
        pairs = np.einsum("or,ir->oir", shapes[setup.outputs], shapes[setup.inputs])
        gain = s[:, :1] ** DERIVATIVES[setup.form]
        modes, claims = (s, gain, omega, zeta, pairs), (frequency_std, damping_std)
        J = cls._moved(weight, modes, claims, np.zeros(2 * len(omega)))[1]
        return cls(weight, modes, claims, J, np.linalg.inv(np.eye(J.shape[1]) + (J.conj().T @ J).real))

    @staticmethod
    def _moved(weight, modes, claims, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What modes off by ``t`` change, whitened, and its derivatives (over all runs)."""
        s, gain, omega, zeta, pairs = modes
        n = len(omega)
        w, z = omega * np.exp(t[:n] * claims[0]), zeta * np.exp(t[n:] * claims[1])
        D, D0 = w**2 + 2 * z * w * s + s**2, omega**2 + 2 * zeta * omega * s + s**2
        by_frequency = -(2 * w**2 + 2 * z * w * s) / D**2 * claims[0]
        by_damping = -2 * z * w * s / D**2 * claims[1]
        m = np.einsum("fr,oir->foi", gain * (1 / D - 1 / D0), pairs)
        J = np.concatenate([np.einsum("fr,oir->foir", gain * by, pairs) for by in (by_frequency, by_damping)], axis=-1)
        return (weight * m).ravel(), (weight[..., None] * J[None]).reshape(weight.size, -1)

    def plain(self, dH: np.ndarray) -> float:
        return float(np.linalg.norm(self.weight * dH))

    def distance(self, dH: np.ndarray) -> float:
        delta = (self.weight * dH).ravel()
        best = float(np.vdot(delta, delta).real)
        if self.modes is None:
            return best**0.5
        t = np.zeros(2 * len(self.modes[2]))
        moved = lambda t: self._moved(self.weight, self.modes, self.claims, t)
        m, J = moved(t)
        for _ in range(12):
            step = np.linalg.solve(np.eye(len(t)) + (J.conj().T @ J).real, (J.conj().T @ (delta - m)).real - t)
            for shrink in (1.0, 0.3, 0.1, 0.03):
                new = t + shrink * step
                m_new, J_new = moved(new)
                value = float(np.linalg.norm(delta - m_new) ** 2 + new @ new)
                if value < best:
                    break
            else:
                break
            settled = best - value < 1e-6 * best
            t, m, J, best = new, m_new, J_new, value
            if settled:
                break
        return best**0.5
