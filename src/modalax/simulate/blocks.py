r"""A structure as small real blocks :math:`\dot z_m = A_m z_m + B_m u`, two states each, marched exactly in time.

A block is a real mode (also a free-body or an over-damped one), a pair of complex poles or two real poles. Blocks do
not see one another, so a step of a large structure costs no more than its modes.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array, is_traced
from modalax.model.modal import ModalModel
from modalax.model.receptance import AnyStructure, Modified, dof_names
from modalax.model.structure import Structure

MOMENTS = 3
"""Number of Legendre moments of the force in each step, so that a step is exact for quadratic forces."""
PROPORTIONAL = 1e-9
"""Coupling of the modes by damping, relative to the largest damping, that counts as none."""


class Blocks(eqx.Module):
    r"""Displacements :math:`y = Cz + Du` and velocities :math:`CAz + CBu` of a linear structure under forces u.

    Attributes
    ----------
    A
        Shape ``(m, 2, 2)`` [1/s].
    B
        Effect of the forces on the states, shape ``(m, 2, r)``.
    C
        Displacement along the rows due to the states, shape ``(l, m, 2)``.
    D
        Static flexibility of modes left out, shape ``(l, r)`` [m/N].
    """

    A: Float[Array, "m 2 2"]
    B: Float[Array, "m 2 r"]
    C: Float[Array, "l m 2"]
    D: Float[Array, "l r"]

    @property
    def decay(self) -> float:
        """Decay rate of the slowest vibration [1/s], free-body motion aside."""
        poles = np.linalg.eigvals(np.asarray(self.A))
        moves = np.abs(poles) > 1e-9 * np.abs(poles).max()
        return float(np.min(-poles.real[moves], initial=np.inf))


class Propagator(eqx.Module):
    r"""One step of length h: :math:`z_1 = E z_0 + \sum_k W_k c_k` for forces :math:`\sum_k c_k P_k` (Legendre).

    Attributes
    ----------
    E
        Shape ``(m, 2, 2)``.
    W
        Shape ``(m, 2, r, k)``.
    h
        Length of the step [s].
    """

    E: Float[Array, "*f m 2 2"]
    W: Float[Array, "*f m 2 r k"]
    h: Float[Array, "*f"]


def propagator(blocks: Blocks, h: Any) -> Propagator:
    r"""Exact steps of lengths ``h``, shape ``(*f,)`` [s], from the functions :math:`\varphi_k(Ah)`.

    All of them stand in one exponential of an augmented matrix (Van Loan, 1978, IEEE Trans. Automatic Control 23, 395).
    Works on numbers, not inside jit.
    """
    A, h = np.asarray(blocks.A), np.asarray(h, dtype=float)
    chain = np.zeros((*h.shape, len(A), 8, 8))
    chain[..., :2, :2] = A * h[..., None, None, None]
    chain[..., np.arange(6), np.arange(2, 8)] = 1.0
    row = _exponential(chain)[..., :2, :]
    E, first, second, third = (row[..., 2 * k : 2 * k + 2] for k in range(4))
    # integrals of exp(Ah(1 - s)) P_k(s) over the step, P_k the Legendre polynomials on 0 to 1
    weights = np.stack([first, 2 * second - first, 12 * third - 6 * second + first], axis=-1)
    W = h[..., None, None, None, None] * np.einsum("...mabk,mbr->...mark", weights, np.asarray(blocks.B))
    return Propagator(as_array(E), as_array(W), as_array(h))


def _exponential(X: np.ndarray) -> np.ndarray:
    """Exponentials of many small matrices, by Taylor's series of order 16 after halving and squaring."""
    largest = np.abs(X).sum(axis=-1).max(initial=0.0)
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300)))) + 1)
    X = X / 2.0**halvings
    total = np.eye(X.shape[-1])
    for order in range(16, 0, -1):
        total = np.eye(X.shape[-1]) + X @ total / order
    for _ in range(halvings):
        total = total @ total
    return total


def as_blocks(structure: AnyStructure, rows: Any, columns: Any) -> Blocks:
    """Split a structure into blocks, seen along ``rows`` (l, n) and driven along ``columns`` (n, r).

    Works on numbers, not inside jit.

    Raises
    ------
    ValueError
        If the structure has hysteretic damping (which has no law in time), a singular mass matrix, changes known by
        their impedance only, or is being traced.
    """
    if is_traced(*jax.tree.leaves(structure)):
        raise ValueError("time marching splits a structure into modes; that works on numbers, not inside jit or grad")
    rows, columns = np.asarray(rows, dtype=float), np.asarray(columns, dtype=float)
    if isinstance(structure, Modified):
        raise ValueError("time marching needs matrices or a modal model; put the change into them by add_spring, ...")
    if isinstance(structure, ModalModel):
        return _of_modal_model(structure, rows, columns)
    return _of_matrices(structure, rows, columns)


def _of_matrices(structure: Structure, rows: np.ndarray, columns: np.ndarray) -> Blocks:
    if np.any(structure.D):
        raise ValueError("hysteretic damping D has no law in time; give viscous or modal damping instead")
    M, C, K = (np.asarray(A) for A in (structure.M, structure.C, structure.K))
    rank = np.linalg.matrix_rank(M)
    if rank < len(M):
        raise ValueError(f"M is singular: rank {rank} of {len(M)}; condense the massless DoFs first")
    square, phi = scipy.linalg.eigh(K, M)
    damping = phi.T @ C @ phi
    coupling = damping - np.diag(np.diag(damping))
    if np.abs(coupling).max() <= PROPORTIONAL * np.abs(damping).max(initial=1e-300):
        return _stack([_real_modes(square, np.diag(damping), rows @ phi, phi.T @ columns)])
    still = np.abs(square) < 1e-11 * np.abs(square).max()
    free = phi[:, still & (np.abs(damping).max(axis=0) < 1e-9 * np.abs(damping).max())]
    keep = scipy.linalg.null_space(free.T @ M) if free.shape[1] else np.eye(len(M))
    rigid = _real_modes(np.zeros(free.shape[1]), np.zeros(free.shape[1]), rows @ free, free.T @ columns)
    m, c, k = (keep.T @ A @ keep for A in (M, C, K))
    return _stack([rigid, *_first_order(m, c, k, rows @ keep, keep.T @ columns)])


Part = tuple[np.ndarray, np.ndarray, np.ndarray]


def _real_modes(square: np.ndarray, damping: np.ndarray, left: np.ndarray, right: np.ndarray) -> Part:
    """Modes q'' + c q' + w^2 q = right u as blocks; states w q and q', so that both are of one size."""
    scale = np.sqrt(np.where(square > 0, square, 1.0))
    zero = np.zeros_like(scale)
    A = np.stack([np.stack([zero, scale], -1), np.stack([-square / scale, -damping], -1)], 1)
    return A, np.stack([np.zeros_like(right), right], 1), np.stack([left / scale, np.zeros_like(left)], -1)


def _pole_pairs(poles: np.ndarray, left: np.ndarray, right: np.ndarray) -> Part:
    """Pairs p' = pole p + right u, y = 2 Re(left p), as blocks of real and imaginary part."""
    real, imag = np.real(poles), np.imag(poles)
    A = np.stack([np.stack([real, -imag], -1), np.stack([imag, real], -1)], 1)
    return A, np.stack([np.real(right), np.imag(right)], 1), 2 * np.stack([np.real(left), -np.imag(left)], -1)


def _first_order(m: np.ndarray, c: np.ndarray, k: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> list[Part]:
    n = len(m)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    poles, V = np.linalg.eig(state)
    inverse = np.linalg.inv(V)
    lost = np.abs((V * poles) @ inverse - state).max() / np.abs(state).max()
    if not lost < 1e-8:
        raise ValueError(
            f"the damped modes do not span the motion ({lost:.1g}): a mode is critically damped; change C slightly"
        )
    left, right = rows @ V[:n], inverse[:, n:] @ np.linalg.solve(m, columns)
    rounding = 1e-12 * np.abs(poles).max()
    up, flat = np.imag(poles) > rounding, np.abs(np.imag(poles)) <= rounding
    parts = [_pole_pairs(poles[up], left[:, up], right[up])]
    if flat.any():
        # poles without vibration come in even number; two make a block
        rates = np.real(poles[flat]).reshape(-1, 2)
        A = np.stack([np.diag(pair) for pair in rates])
        B, C = np.real(right[flat]), np.real(left[:, flat])
        parts.append((A, B.reshape(-1, 2, columns.shape[1]), C.reshape(len(rows), -1, 2)))
    return parts


def _of_modal_model(model: ModalModel, rows: np.ndarray, columns: np.ndarray) -> Blocks:
    names = dof_names(model)
    seen = tuple(n for n, used in zip(names, np.any(rows != 0, axis=0).tolist(), strict=True) if used)
    driven = tuple(n for n, used in zip(names, np.any(columns != 0, axis=1).tolist(), strict=True) if used)
    left, right = rows[:, [names.index(n) for n in seen]], columns[[names.index(n) for n in driven]]
    psi, part = np.asarray(model.shapes_at(seen)), np.asarray(model.participation_at(driven))
    parts = [_pole_pairs(np.asarray(model.poles), left @ psi.T, part @ right)]
    lower = np.real(left @ np.asarray(model._residual(model.lower, seen, driven)) @ right)
    if np.any(lower):
        # free-body motion: double integrators, as many as the residual has rank
        u, s, vt = np.linalg.svd(lower, full_matrices=False)
        kept = s > 1e-12 * s[0]
        parts.append(_real_modes(np.zeros(kept.sum()), np.zeros(kept.sum()), u[:, kept], s[kept, None] * vt[kept]))
    upper = np.real(left @ np.asarray(model._residual(model.upper, seen, driven)) @ right)
    return _stack(parts, upper)


def _stack(parts: list[Part], flexibility: np.ndarray | None = None) -> Blocks:
    A, B, C = (np.concatenate([p[k] for p in parts], axis=axis) for k, axis in ((0, 0), (1, 0), (2, 1)))
    D = np.zeros((C.shape[0], B.shape[2])) if flexibility is None else flexibility
    return Blocks(as_array(A), as_array(B), as_array(C), as_array(D))
