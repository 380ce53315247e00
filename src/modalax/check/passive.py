r"""How far a drive point's FRF is from that of any passive structure.

There every residue of the receptance is :math:`-j` times a positive number for real modes, and what modes beyond the
band add has the same sign. So between its resonances too such an FRF cannot be just anything.
"""

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import nnls

from modalax.check.phases import SCATTER

# Residues of complex modes may turn by this angle at a drive point [rad].
CONE = 0.35


def passive_misfit(
    freq: Float[np.ndarray, " f"], H: Complex[np.ndarray, " f"], sigma: Float[np.ndarray, " f"],
    poles: Complex[np.ndarray, " n"], power: int,
) -> float:  # fmt: skip
    """Residual of a drive point's FRF after fitting passive terms, in squares of noise and of a share of the FRF."""
    s = 2j * np.pi * freq
    weight = 1 / np.sqrt(sigma**2 + (0.02 * np.abs(H)) ** 2)
    u, v = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    modes = []
    for turn in (-CONE, 0.0, CONE):
        a = -1j * np.exp(1j * turn)
        modes.append((a * u + np.conj(a) * v) * np.abs(poles))
    omega, low, high = s.imag, s.imag[0], s.imag[-1]
    out = np.concatenate([low / np.array([3.0, 1.5, 1.15]), high * np.array([1.1, 1.4, 2.5])])
    beyond = out**2 / (out**2 - omega[:, None] ** 2)
    rest = np.stack([-((low / omega) ** 2), np.ones_like(omega)], axis=1)
    columns = np.concatenate([*modes, beyond, rest], axis=1) * (s**power * weight)[:, None]
    scale = np.linalg.norm(columns, axis=0)
    lifted = np.concatenate([columns.real, columns.imag]) / scale
    target = np.concatenate([(H * weight).real, (H * weight).imag])
    # In coordinates of the columns the search has few rows.
    Q, R = np.linalg.qr(lifted)
    seen = Q.T @ target
    outside = max(float(target @ target - seen @ seen), 0.0)
    return (float(nnls(R, seen, maxiter=50 * len(R))[1] ** 2) + outside) / (2 * len(omega)) + SCATTER**2
