r"""What FRFs are made of at given lines, and least squares on it."""

import numpy as np

SMOOTH_POWERS, MORE_POWERS = (-2, 0, 2), (-4, -2, 0, 2, 4)
# With these a frequency or a phase of a channel that hardly sees the mode is safe from modes beyond the band; with
# fewer it takes up what the smooth terms leave, by many standard deviations.
ALL_POWERS = (-6, -4, -2, 0, 2, 4, 6)
# Poles may lie beyond the band by this factor: their flanks reach into it.
BEYOND = 1.25


class Basis:
    """What an FRF is made of at given lines: modes and smooth terms for all that lies outside the band."""

    def __init__(self, omega, power, weight, powers=SMOOTH_POWERS):
        self.s: np.ndarray = 1j * np.asarray(omega)
        self.factor = weight * self.s**power
        middle = np.sqrt(omega[0] * omega[-1])
        self.reach = (omega[0] / BEYOND, omega[-1] * BEYOND)
        self.smooth = np.stack([self.factor * (self.s / middle) ** p for p in powers], axis=1)

    def design(self, poles: np.ndarray) -> np.ndarray:
        """Real and imaginary residues, then complex smooth terms, as real columns, shape ``(2 f, 2 n + 2 p)``."""
        u, v = self.factor[:, None] / (self.s[:, None] - poles), self.factor[:, None] / (self.s[:, None] - poles.conj())
        return lift(np.concatenate([u + v, 1j * (u - v), self.smooth, 1j * self.smooth], axis=1))

    def slope(self, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivatives of all FRFs with respect to real and imaginary parts of the poles, ``(2 n, f, k)``."""
        u = self.factor[:, None] / (self.s[:, None] - poles) ** 2
        v = self.factor[:, None] / (self.s[:, None] - poles.conj()) ** 2
        first, second = u.T[:, :, None] * residues[:, None, :], v.T[:, :, None] * residues.conj()[:, None, :]
        return np.concatenate([first + second, 1j * (first - second)])


def lift(z: np.ndarray) -> np.ndarray:
    """Real parts above imaginary parts."""
    return np.concatenate([z.real, z.imag])


def least_squares(Phi: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients, an orthonormal basis of the columns, the covariance for unit noise, and the solving matrix."""
    size = np.linalg.norm(Phi, axis=0) + np.finfo(float).tiny
    U, s, Vt = np.linalg.svd(Phi / size, full_matrices=False)
    good = s > 1e-11 * s[0]
    U, s, Vt = U[:, good], s[good], Vt[good]
    inverse = Vt.T / s
    solve = (inverse @ U.T) / size[:, None]
    return solve @ Y, U, (inverse @ inverse.T) / np.outer(size, size), solve
