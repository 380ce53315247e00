"""The linear structure as it really is: matrices, dynamic stiffnesses and added modes, at any complex s."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

DERIVATIVES = {"receptance": 0, "mobility": 1, "accelerance": 2}


@dataclass(frozen=True)
class Plant:
    """``(K + s C + s^2 M + sum Z_k(s) p_k q_k') x = f``, then added modes ``phi phi' / (w^2 + 2 zeta w s + s^2)``."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    dynamic: tuple[tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]], ...] = ()
    modes: tuple[tuple[np.ndarray, float, float], ...] = ()

    def add(self, M=0.0, C=0.0, K=0.0) -> "Plant":
        n = len(self.M)
        fit = lambda A: np.pad(A, (0, n - len(A))) if np.ndim(A) else A
        return replace(self, M=self.M + fit(M), C=self.C + fit(C), K=self.K + fit(K))

    def add_dynamic(self, row: np.ndarray, column: np.ndarray, Z) -> "Plant":
        return replace(self, dynamic=(*self.dynamic, (row, column, Z)))

    def add_mode(self, shape: np.ndarray, omega: float, zeta: float) -> "Plant":
        return replace(self, modes=(*self.modes, (shape, omega, zeta)))

    def grow(self, mass: float, at: np.ndarray, k: float, c: float) -> "Plant":
        """One more DoF: a mass on a spring and damper that hang on ``at``."""
        b = np.append(at, -1.0)
        M, C, K = (np.pad(A, ((0, 1), (0, 1))) for A in (self.M, self.C, self.K))
        M[-1, -1] = mass
        bb = np.outer(b, b)
        dynamic = tuple((np.append(p, 0.0), np.append(q, 0.0), Z) for p, q, Z in self.dynamic)
        modes = tuple((np.append(phi, 0.0), w, z) for phi, w, z in self.modes)
        return Plant(M, C + c * bb, K + k * bb, dynamic, modes)

    def receptance(self, s: np.ndarray, outputs: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Shape (s, outputs, inputs); ``outputs`` (o, n) and ``inputs`` (i, n) hold direction vectors in rows."""
        n = len(self.M)
        outputs, inputs = (np.pad(A, ((0, 0), (0, n - A.shape[1]))) for A in (outputs, inputs))
        sr = s[:, None, None]
        Z = self.K + sr * self.C + sr**2 * self.M
        for p, q, law in self.dynamic:
            Z = Z + law(s)[:, None, None] * np.outer(p, q)
        H = outputs @ np.linalg.solve(Z, np.broadcast_to(inputs.T, (len(s), n, len(inputs))))
        for phi, w, zeta in self.modes:
            pad = np.pad(phi, (0, n - len(phi)))
            H = H + np.outer(outputs @ pad, inputs @ pad) / (w**2 + 2 * zeta * w * sr + sr**2)
        return H

    def residues(self, outputs: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All poles (m,) and receptance residues (m, o, i): H = sum R/(s - p). Real matrices, no dynamic stiffness."""
        if self.dynamic or np.iscomplexobj(self.K):
            raise ValueError("a dynamic or complex stiffness has no poles here")
        n = len(self.M)
        outputs, inputs = (np.pad(A, ((0, 0), (0, n - A.shape[1]))) for A in (outputs, inputs))
        poles, V, W = state_modes(self.M, self.C, self.K)
        R = np.einsum("om,mi->moi", outputs @ V[:n], W @ np.linalg.solve(self.M, inputs.T))
        for phi, w, zeta in self.modes:
            pad = np.pad(phi, (0, n - len(phi)))
            p = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
            r = np.outer(outputs @ pad, inputs @ pad) / (p - p.conj())
            poles, R = np.append(poles, [p, p.conj()]), np.concatenate([R, r[None], r.conj()[None]])
        return poles, R


def state_modes(M, C, K):
    """Poles, right vectors (2n, m) and the lower half of the left ones (m, n): x = V p, p' = poles p + W M^-1 f."""
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    poles, V = np.linalg.eig(A)
    return poles, V, np.linalg.inv(V)[:, n:]


# transforms of the impulse response: what finite records and fast sweeps do ---------------------------------------


def _ramp(s: np.ndarray, T: float) -> np.ndarray:
    """Integral of exp(s t) (1 - t/T) over 0..T."""
    z = s * T
    return (np.exp(z) - 1 - z) / (s * z)


def _box(s: np.ndarray, T: float) -> np.ndarray:
    """Integral of exp(s t) over 0..T."""
    return (np.exp(s * T) - 1) / s


def truncated_kernel(s: np.ndarray, T: float) -> np.ndarray:
    """The whole impulse response cut off at T: an impact with a record that ends too early."""
    return _box(s, T)


def boxcar_kernel(s: np.ndarray, T: float) -> np.ndarray:
    """Mean of H1 from records of length T of stationary white force, no window: h(t) times (1 - t/T)."""
    return _ramp(s, T)


def hann_kernel(s: np.ndarray, T: float) -> np.ndarray:
    """Mean of H1 with a Hann window: h(t) times the window's autocorrelation.

    That is (1 - t/T)(2/3 + cos(2 pi t/T)/3) + sin(2 pi t/T)/(2 pi).
    """
    nu = 2j * np.pi / T
    ramps = 2 / 3 * _ramp(s, T) + (_ramp(s + nu, T) + _ramp(s - nu, T)) / 6
    return ramps + (_box(s + nu, T) - _box(s - nu, T)) / (4j * np.pi)


def sweep_kernel(s: np.ndarray, rate: float) -> np.ndarray:
    """Integral of exp(s t + j rate t^2/2) over all t > 0: response at the instant frequency of a linear sweep.

    ``rate`` in rad/s^2. Closed form (sqrt(pi/b)/2) erfcx(-s/(2 sqrt b)), b = -j rate/2.
    """
    b = -0.5j * rate
    root = np.sqrt(b)
    return 0.5 * np.sqrt(np.pi) / root * scipy.special.wofz(1j * (-s / (2 * root)))


def through_kernel(poles, R, omega, derivative: int, kernel) -> np.ndarray:
    """FRF whose impulse response is weighted: every 1/(s - p) becomes ``kernel(p - j omega)``.

    An accelerance has a direct part (the instant answer of the masses), which the weight leaves alone.
    """
    terms = R * poles[:, None, None] ** derivative
    gain = kernel(poles[None] - 1j * omega[:, None])
    H = np.tensordot(gain, terms, axes=1)
    return H + (np.tensordot(poles, R, axes=1) if derivative == 2 else 0.0)
