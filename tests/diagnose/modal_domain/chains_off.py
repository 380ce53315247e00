"""A chain of five masses whose elements can be off, all of its modes in the band, and its FRFs, by plain NumPy."""

import numpy as np
import scipy.linalg

from modalax.data import Measurement
from modalax.model import Structure

DOFS = tuple(f"{k}:+Z" for k in range(1, 6))
MASSES = np.array([1.0, 1.4, 0.9, 1.7, 1.2])  # kg
SPRINGS = np.array([5e4, 9e4, 1.2e5, 7e4, 1.1e5, 6e4])  # N/m, the first and the last to ground
ZETA = np.array([0.012, 0.008, 0.015, 0.01, 0.018])


def matrices(masses: np.ndarray, springs: np.ndarray, zeta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, modal damping and stiffness."""
    B = np.eye(6, 5) - np.eye(6, 5, -1)
    M, K = np.diag(masses), B.T @ np.diag(springs) @ B
    w2, P = scipy.linalg.eigh(K, M)
    return M, M @ P @ np.diag(2 * zeta * np.sqrt(w2)) @ P.T @ M, K


def simulation() -> Structure:
    """The chain as its author has it."""
    return Structure(*matrices(MASSES, SPRINGS, ZETA), DOFS)


def response(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, freq: np.ndarray, Z: np.ndarray | float = 0.0
) -> np.ndarray:  # fmt: skip
    """Accelerances at the five DoFs by unit forces there, shape ``(f, 5, 5)``; ``Z`` is added to the stiffness."""
    s = 2j * np.pi * freq[:, None, None]
    return np.linalg.inv(s**2 * M + s * C + K + Z)[:, :5, :5] * s**2


def chain_off(seed: int, off: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of a chain whose springs are off by ``off``, masses by a third of it and dampings by ten times that."""
    rng = np.random.default_rng(seed)
    springs, masses, zeta = (
        a * (1 + size * rng.standard_normal(len(a)))
        for a, size in ((SPRINGS, off), (MASSES, off / 3), (ZETA, 10 * off))
    )
    return matrices(masses, springs, zeta)


def summed(seed: int, freq: np.ndarray, t: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Accelerances of a chain 2 % off, each mode summed over the times ``t`` [s] by the weights ``seen`` ``(f, t)``."""
    M, C, K = chain_off(seed, 0.02)
    w2, P = scipy.linalg.eigh(K, M)
    w, step = np.sqrt(w2), t[1] - t[0]
    zeta = np.diag(P.T @ C @ P) / 2 / w
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    residues = np.einsum("or,ir->roi", P, P) / (2j * poles.imag)[:, None, None] * (poles**2)[:, None, None]
    direct = 2 * (residues / poles[:, None, None]).sum(axis=0).real
    turned = np.exp(-2j * np.pi * freq[:, None] * t) * seen * step
    both = [turned @ np.exp(t[:, None] * p) for p in (poles, poles.conj())]
    return np.einsum("fr,roi->foi", both[0], residues) + np.einsum("fr,roi->foi", both[1], residues.conj()) + direct


def as_measured(
    H: np.ndarray, freq: np.ndarray, seed: int, outputs: tuple[int, ...] = (0, 1, 3, 4),
    inputs: tuple[int, ...] = (0, 3), noise: float = 0.01,
) -> Measurement:  # fmt: skip
    """Some channels with noise of known variance."""
    rng = np.random.default_rng([seed, 1])
    H = H[:, outputs][:, :, inputs]
    sigma = noise * np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    variance = np.broadcast_to(sigma**2, H.shape)[None].copy()
    rows, columns = (tuple(DOFS[k] for k in some) for some in (outputs, inputs))
    return Measurement(freq, H[None], form="accelerance", outputs=rows, inputs=columns, variance=variance)


FREQ = np.linspace(12.0, 110.0, 300)
