r"""Receptance of matrices at many lines, by poles and residues where there are many.

With displacements times their frequencies w and velocities as states, :math:`Mx'' + Cx' + Kx = f` has the matrix

.. math:: A = \begin{pmatrix} 0 & \mathrm{diag}(w) \\ -M^{-1}K\,\mathrm{diag}(1/w) & -M^{-1}C \end{pmatrix},

of whose eigenvectors the FRFs are sums. Where two of these are nearly one, as those of a rigid body without damping
are, rounding spoils that sum: some lines are compared with what the matrices themselves give.
"""

import numpy as np

COMPARED = 7  # lines that are solved as well
NEAR = 1e-8  # relative error that is no more than rounding
MANY = 200  # lines from which on poles and residues are faster than a solution of each line
BLOCK = 4e6  # numbers held at once
SLOWEST = 1e-3  # frequency of a coordinate, relative to the quickest line, below which its scale is that of others


def receptance(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, outputs: np.ndarray, inputs: np.ndarray, s: np.ndarray
) -> np.ndarray:
    """Receptance ``(f, o, i)`` of matrices ``(n, n)`` at rows ``outputs`` and ``inputs``.

    Parameters
    ----------
    s
        Laplace variable of the lines [rad/s], shape ``(f,)``.
    """
    H = by_poles(M, C, K, outputs, inputs, s) if len(s) > MANY else None
    if H is not None:
        return H
    size = max(1, int(BLOCK / len(M) ** 2))
    parts = np.split(s, range(size, len(s), size))
    return np.concatenate([_solved(M, C, K, outputs, inputs, part) for part in parts])


def _solved(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, outputs: np.ndarray, inputs: np.ndarray, s: np.ndarray
) -> np.ndarray:
    Z = K + s[:, None, None] * C + s[:, None, None] ** 2 * M
    return outputs @ np.linalg.solve(Z, np.broadcast_to(inputs.T, (len(s), *inputs.T.shape)))


def by_poles(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, outputs: np.ndarray, inputs: np.ndarray, s: np.ndarray
) -> np.ndarray | None:
    """The same by poles and residues; None where rounding spoils it."""
    n = len(M)
    w = np.sqrt(np.maximum(np.abs(np.diag(K) / np.diag(M)), (SLOWEST * np.abs(s).max()) ** 2))
    try:
        right = np.linalg.solve(M, np.concatenate([K / w, C, inputs.T], axis=1))
        A = np.block([[np.zeros((n, n)), np.diag(w)], [-right[:, :n], -right[:, n : 2 * n]]])
        poles, V = np.linalg.eig(A)
        share = np.linalg.solve(V, np.concatenate([np.zeros_like(inputs.T), right[:, 2 * n :]]))
        some = s[np.linspace(0, len(s) - 1, COMPARED).astype(int)]
        direct = _solved(M, C, K, outputs, inputs, some)
    except np.linalg.LinAlgError:
        return None
    residues = (outputs / w @ V[:n]).T[:, :, None] * share[:, None, :]
    flat = residues.reshape(2 * n, -1)
    summed = lambda at: (1 / (at[:, None] - poles) @ flat).reshape(len(at), *residues.shape[1:])
    with np.errstate(over="ignore", invalid="ignore"):  # of a rigid body without damping nothing but rounding is left
        off = np.linalg.norm(summed(some) - direct, axis=(1, 2))
        off /= np.maximum(np.linalg.norm(direct, axis=(1, 2)), 1e-300)
    return summed(s) if (off < NEAR).all() else None
