r"""Poles moved by a linear problem, which knows no local minima: vector fitting (Gustavsen and Semlyen 1999).

All channels share a factor :math:`\sigma(s) = 1 + \sum_k c_k/(s-\lambda_k)` by which the measured FRF becomes a sum
over the same poles; its zeros are better poles. Noise bends them a little, so that a refinement follows.
"""

import numpy as np
import scipy.linalg

from modalax.diagnose.modal_domain.free_residues import Channels

ROUNDS = 3  # relocations, each from the poles of the last
RIDGE = 1e-12  # of the information, relative to its diagonal


def relocated(poles: np.ndarray, channels: Channels, rounds: int = ROUNDS) -> np.ndarray:
    """As many stable poles, moved; those that end without oscillation are left out."""
    for _ in range(rounds):
        if not len(poles):
            break
        poles = _zeros(poles, _factor(poles, channels))
    return poles


def _factor(poles: np.ndarray, channels: Channels) -> np.ndarray:
    """Sizes of the kernels of each pole in the common factor, shape ``(2 n,)``."""
    own = np.concatenate([channels.kernels(poles), channels.background()], axis=1)
    common = channels.kernels(poles) / channels.s[:, None] ** channels.order
    own, common = (a / np.maximum(np.linalg.norm(a, axis=0), 1e-300) for a in (own, common))
    size = np.maximum(np.linalg.norm(channels.kernels(poles) / channels.s[:, None] ** channels.order, axis=0), 1e-300)
    count = common.shape[1]
    gram, right = np.zeros((count, count)), np.zeros(count)
    for weight, H in zip(channels.weight.T, channels.data.T, strict=True):
        root = np.sqrt(weight)
        A, B, y = root[:, None] * own, -(root * H)[:, None] * common, root * H
        A, B, y = (np.concatenate([a.real, a.imag]) for a in (A, B, y))
        inner, across = A.T @ A, A.T @ np.column_stack([B, y])
        inner += RIDGE * np.diag(np.maximum(np.diag(inner), 1e-300))
        beside = scipy.linalg.solve(inner, across, assume_a="pos")
        left = B.T @ np.column_stack([B, y]) - across[:, :-1].T @ beside
        gram += left[:, :-1]
        right += left[:, -1]
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
