r"""Modes of a structure on which forces act at one place each that no symmetric change of its matrices stands for.

A skew coupling, a joint that loses energy alike at all frequencies and one that relaxes have, between the directions B
at which they act, the dynamic stiffness

.. math:: Z(s) = K_0 + sC_0 - \sum_q\kappa_q\,r_q/(s + r_q),

so that poles and both kinds of vectors, right :math:`T(\lambda)\phi=0` and left :math:`\psi^TT(\lambda)=0` of the whole
dynamic stiffness :math:`T`, follow from one linear problem with a further state for all that relaxes (Tisseur and
Meerbergen 2001, SIAM Review 43:235, for what does not). Near a pole
:math:`T^{-1}(s) = \phi\psi^T/(s-\lambda) + G + \dots` with :math:`\psi^TT'\phi=1`; the powers of
:math:`s-\lambda` in :math:`TT^{-1}=I` give
:math:`TG = I - T'\phi\,\psi^T` and :math:`\psi^TT'G = -(\psi^T\tfrac12T''\phi)\,\psi^T`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

REAL = 1e-7  # imaginary part of a pole, over the highest frequency, below which it is no oscillation but rounding


@dataclass(frozen=True)
class Load:
    r"""One such force.

    Attributes
    ----------
    basis
        Directions B, shape ``(n, k)``.
    stiffness, damping
        :math:`K_0` and :math:`C_0`, shapes ``(k, k)``.
    relaxing, rates
        :math:`\kappa_q` of each direction, and :math:`r_q` [1/s].
    """

    basis: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    relaxing: tuple[float, ...] = ()
    rates: tuple[float, ...] = ()

    def expanded(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Z, its derivative and half its second derivative by s, shapes ``(f, k, k)``."""
        eye, at = np.eye(self.basis.shape[1]), s[:, None, None]
        k, r = np.array(self.relaxing), np.array(self.rates)
        falls = [(k * r / (s[:, None] + r) ** (1 + p)).sum(axis=1)[:, None, None] * eye for p in range(3)]
        return self.stiffness + at * self.damping - falls[0], self.damping + falls[1], -falls[2]


def loaded_modes(
    squares: np.ndarray, damping: np.ndarray, loads: Sequence[Load]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poles by rising frequency, right and left vectors, shapes ``(m,)`` and ``(m, n)``.

    Parameters
    ----------
    squares, damping
        Squared circular frequencies and damping matrix of coordinates of unit mass, in which the directions of the
        ``loads`` are.
    """
    n, w = len(squares), np.sqrt(np.abs(squares))
    inner = [(k, r, b) for load in loads for k, r in zip(load.relaxing, load.rates, strict=True) for b in load.basis.T]
    K, C = (sum(load.basis @ getattr(load, part) @ load.basis.T for load in loads) for part in ("stiffness", "damping"))
    state, each = np.zeros((2 * n + len(inner),) * 2, np.result_type(K, float)), np.arange(n)
    # of displacements times their frequencies and of velocities, so that all parts are of one size
    unit = np.maximum(w, REAL * w.max())
    state[each, n + each] = unit
    state[n : 2 * n, :n] = -(np.diag(squares) + K) / unit
    state[n : 2 * n, n : 2 * n] = -(damping + C)
    for k, (relaxing, rate, b) in enumerate(inner):
        state[n : 2 * n, 2 * n + k] = relaxing * b
        state[2 * n + k, :n] = rate * b / unit
        state[2 * n + k, 2 * n + k] = -rate
    both: Any = scipy.linalg.eig(state, left=True, right=True)
    poles, left, right = both
    up = poles.imag > REAL * w.max()
    order = np.flatnonzero(up)[np.argsort(np.abs(poles[up]))]
    poles, right, left = poles[order], right[n : 2 * n, order].T, left[n : 2 * n, order].conj().T
    norm = np.einsum("kn,kn->k", left, _slope_times(poles, damping, loads, right))
    if not len(poles) or (np.abs(norm) < 1e-12 * np.abs(poles)).any():
        raise np.linalg.LinAlgError("modes of which the force makes one")
    root = np.sqrt(norm)[:, None]
    return poles, right / root, left / root


def _slope_times(poles: np.ndarray, damping: np.ndarray, loads: Sequence[Load], v: np.ndarray) -> np.ndarray:
    """T' at each pole times a vector of its own, shape ``(k, n)``."""
    out = 2 * poles[:, None] * v + v @ damping.T
    for load in loads:
        _, slope, _ = load.expanded(poles)
        out = out + np.einsum("kab,kb->ka", slope, v @ load.basis) @ load.basis.T
    return out


def responses(
    poles: np.ndarray, right: np.ndarray, left: np.ndarray, squares: np.ndarray, damping: np.ndarray,
    loads: Sequence[Load], rows: np.ndarray, backwards: bool = False,
) -> np.ndarray:  # fmt: skip
    """G at each of some poles, from the left to ``rows`` (or from the right, backwards), shape ``(pole, rows, n)``."""
    n, count = len(squares), len(poles)
    T = poles[:, None, None] * damping.astype(complex)
    T[:, range(n), range(n)] += squares + poles[:, None] ** 2
    slope = 2 * poles[:, None, None] * np.eye(n) + damping
    bend = np.einsum("kn,kn->k", left, right)
    for load in loads:
        B = load.basis
        Z, dZ, ddZ = load.expanded(poles)
        T, slope = T + B @ Z @ B.T, slope + B @ dZ @ B.T
        bend = bend + np.einsum("ka,kab,kb->k", left @ B, ddZ, right @ B)
    if backwards:
        T, slope, right, left = T.transpose(0, 2, 1), slope.transpose(0, 2, 1), left, right
    # y' T = r' - (r' phi) psi' T' and y' T' phi = -(r' phi) bend
    ahead, behind = (slope @ right[:, :, None])[:, :, 0], (slope.transpose(0, 2, 1) @ left[:, :, None])[:, :, 0]
    scale = (np.abs(poles) ** 1.5)[:, None]  # so that all parts of the system are of one size
    A = np.zeros((count, n + 1, n + 1), complex)
    A[:, :n, :n] = T.transpose(0, 2, 1)
    A[:, n, :n], A[:, :n, n] = scale * ahead, scale * behind
    part = right @ rows.T  # (k, rows)
    above = rows.T - behind[:, :, None] * part[:, None]
    below = -scale[:, :, None] * bend[:, None, None] * part[:, None]
    return np.linalg.solve(A, np.concatenate([above, below], axis=1))[:, :n].transpose(0, 2, 1)
