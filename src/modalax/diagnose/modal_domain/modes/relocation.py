r"""Poles moved by a linear problem, which knows no local minima: vector fitting (Gustavsen and Semlyen 1999).

All channels share a factor :math:`\sigma(s) = 1 + \sum_k c_k/(s-\lambda_k)` by which the measured FRF becomes a sum
over the same poles; its zeros are better poles. Noise bends them a little, so that a refinement follows.
"""

import numpy as np

from modalax._numerics.grams import weighted_grams
from modalax._numerics.triangles import forward
from modalax.diagnose.modal_domain.modes.free_residues import BLOCK, Channels

ROUNDS = 3  # relocations, each from the poles of the last
RIDGE = 1e-12  # of the information, relative to its diagonal


def relocated(poles: np.ndarray, channels: Channels) -> np.ndarray:
    """As many stable poles, moved; those that end without oscillation are left out."""
    for _ in range(ROUNDS):
        if not len(poles):
            break
        poles = _zeros(poles, _factor(poles, channels))
    return poles


def _factor(poles: np.ndarray, channels: Channels) -> np.ndarray:
    """Sizes of the kernels of each pole in the common factor, shape ``(2 n,)``."""
    kernels = channels.kernels(poles)
    own, common = (
        np.concatenate([kernels, channels.background()], axis=1),
        kernels / channels.s[:, None] ** channels.order,
    )
    size = np.maximum(np.linalg.norm(common, axis=0), 1e-300)
    own, common = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300), common / size
    weighted, energy = channels.weight * channels.data, channels.weight * np.abs(channels.data) ** 2
    inner = weighted_grams(own.real, own.imag, channels.weight.T, BLOCK)
    inner[:, *np.diag_indices(own.shape[1])] *= 1 + RIDGE
    turned, own = own.conj().T, (own.conj().T @ weighted).real
    gram = weighted_grams(common.real, common.imag, energy.sum(axis=1)[None], BLOCK)[0]
    right = -(common.real.T @ energy).sum(axis=1)
    for A, a, wH in zip(inner, own.T, weighted.T, strict=True):
        across = np.column_stack([-(turned @ (wH[:, None] * common)).real, a])
        half = forward(np.linalg.cholesky(A), across)
        gram -= half[:, :-1].T @ half[:, :-1]
        right -= half[:, :-1].T @ half[:, -1]
    gram += RIDGE * np.diag(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.lstsq(gram, right, rcond=None)[0] / size


def _zeros(poles: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Zeros above the real axis of one plus the kernels of poles, made stable."""
    A = np.zeros((2 * len(poles), 2 * len(poles)))
    for k, x in enumerate(poles):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[x.real, x.imag], [-x.imag, x.real]]
    b = np.tile([2.0, 0.0], len(poles))
    found = np.linalg.eigvals(A - np.outer(b, sizes))
    found = found[found.imag > 0]
    return np.sort_complex(-np.abs(found.real) + 1j * found.imag)
