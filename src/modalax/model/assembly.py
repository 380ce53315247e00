"""Building structures: adding springs, dampers and masses, setting the damping, reducing sparse matrices to modes."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from modalax._numerics.known import Numbers, by_numpy
from modalax.model.modal import ModalModel
from modalax.model.receptance import directions
from modalax.model.structure import Structure, real_modes


@by_numpy
def _with(xp: ModuleType, matrix: Any, value: Any, b: Any) -> Float[Numbers, "n n"]:
    """The matrix with an element of this value in a direction."""
    return matrix + value * b.T @ b


def add_spring(structure: Structure, place: Sequence[str], k: Any) -> Structure:
    """The structure with a spring ``k`` [N/m] at ``place``, ``[dof, dof]`` or ``[dof]``; negative takes away."""
    b = directions(structure, [place])
    return structure.replace(K=_with(structure.K, k, b))


def add_damper(structure: Structure, place: Sequence[str], c: Any) -> Structure:
    """The structure with a viscous damper ``c`` [N s/m] at ``place``, ``[dof, dof]`` or ``[dof]``."""
    b = directions(structure, [place])
    return structure.replace(C=_with(structure.C, c, b))


def add_mass(structure: Structure, dof: str, m: Any) -> Structure:
    """The structure with a lumped mass ``m`` [kg] at a DoF."""
    b = directions(structure, [[dof]])
    return structure.replace(M=_with(structure.M, m, b))


def add_tuned_mass(structure: Structure, dof: str, m: Any, k: Any, c: Any = 0.0, name: str = "tuned") -> Structure:
    """The structure with an oscillator of mass ``m`` [kg] on a spring ``k`` [N/m] and damper ``c`` [N s/m] at a DoF.

    The oscillator is one more DoF, called ``name``.
    """
    n = len(structure.dofs)
    grow = lambda A: jnp.pad(A, ((0, 1), (0, 1)))
    larger = structure.replace(
        M=grow(structure.M).at[n, n].set(m), C=grow(structure.C), K=grow(structure.K), D=grow(structure.D),
        dofs=(*structure.dofs, name), frequency_std=0.0, damping_std=0.0,
    )  # fmt: skip
    return add_damper(add_spring(larger, [dof, name], k), [dof, name], c)


def proportional_damping(structure: Structure, alpha: Any, beta: Any) -> Structure:
    r"""The structure with :math:`C = \alpha M + \beta K`, alpha in [1/s], beta in [s], in place of its damping."""
    return structure.replace(C=alpha * structure.M + beta * structure.K, D=None)


def modal_damping(structure: Structure, damping_ratio: Any) -> Structure:
    r"""The structure with a damping ratio for each real mode, :math:`C = M\Phi\,2\zeta\omega\,\Phi^T M`.

    The ratio is one number, or one for each mode. Works on numbers, not inside jit.
    """
    M, K = np.asarray(structure.M), np.asarray(structure.K)
    square, modes, _ = real_modes(M, K)
    zeta = np.broadcast_to(np.asarray(damping_ratio, dtype=float), square.shape)
    across = M @ modes
    return structure.replace(C=across @ ((2 * zeta * np.sqrt(np.maximum(square, 0.0)))[:, None] * across.T), D=None)


def structural_damping(structure: Structure, loss_factor: Any) -> Structure:
    r"""The structure with hysteretic damping :math:`D = \eta K` in place of its damping."""
    return structure.replace(C=jnp.zeros_like(structure.C), D=loss_factor * structure.K)


def reduce_to_modes(
    M: Any,
    K: Any,
    dofs: Sequence[str],
    *,
    modes: int,
    keep: Sequence[str],
    C: Any = None,
    damping_ratio: Any = None,
    shift_hz: float = 1.0,
) -> ModalModel:
    r"""Lowest modes of large sparse matrices at the DoFs of interest, with static correction for those left out.

    The upper residual term is what the modes left out give at ``shift_hz``; free-body modes make the lower term.
    The error left is of order :math:`(\omega/\omega_{m+1})^4` of the correction.

    Parameters
    ----------
    M, K
        Mass [kg] and stiffness [N/m], scipy sparse (or dense) symmetric, shape ``(n, n)``.
    dofs
        Names of all ``n`` DoFs.
    modes
        Number of modes kept, free-body modes included.
    keep
        DoFs at which the model is wanted.
    C
        Viscous damping [N s/m]; projected on the modes, so the modes may be complex. Left-out modes count as undamped:
        a strong local damper is better added afterwards, by :func:`modalax.model.receptance.change`.
    damping_ratio
        Instead of C, a damping ratio for all modes, or one for each mode.
    shift_hz
        Where the factorisation is made (below the first elastic mode, not on it) [Hz].

    Raises
    ------
    ValueError
        If both or neither of C and damping_ratio are given, or there are not enough DoFs for so many modes.
    """
    n = M.shape[0]
    if (C is None) == (damping_ratio is None):
        raise ValueError("give either C or damping_ratio, one of them")
    if not 0 < modes < n:
        raise ValueError(f"{modes} modes asked of {n} DoFs; a reduction keeps from 1 to {n - 1}")
    names = list(dofs)
    missing = [k for k in keep if k not in names]
    if len(names) != n or missing:
        raise ValueError(f"{len(names)} names for {n} DoFs, and none of {missing} among them; keep must be among dofs")
    at = [names.index(k) for k in keep]
    sigma = -((2 * np.pi * shift_hz) ** 2)
    M, K = scipy.sparse.csc_matrix(M), scipy.sparse.csc_matrix(K)
    solve = scipy.sparse.linalg.splu(K - sigma * M).solve
    operator = scipy.sparse.linalg.LinearOperator((n, n), matvec=solve)
    start = np.random.default_rng(0).standard_normal(n)
    square, phi = scipy.sparse.linalg.eigsh(K, modes, M, sigma=sigma, OPinv=operator, v0=start)
    order = np.argsort(square)
    square, phi = square[order], phi[:, order]
    columns = np.zeros((n, len(at)))
    columns[at, np.arange(len(at))] = 1.0
    local = phi[at]
    # static answer at the shift less that of the modes kept: the modes left out
    upper = solve(columns)[at] - local @ (local / (square - sigma)).T
    free = np.abs(square) < 1e-6 * np.abs(sigma)
    phi, local_free, local, square = phi[:, ~free], local[:, free], local[:, ~free], square[~free]
    if C is None:
        frequency = np.sqrt(square) / (2 * np.pi)
        model = ModalModel.from_real_modes(
            frequency, np.broadcast_to(damping_ratio, frequency.shape), local.T, np.ones(len(square)), keep
        )
    else:
        small = Structure(np.eye(len(square)), phi.T @ (C @ phi), np.diag(square)).modal()
        model = ModalModel(
            small.poles, small.shapes @ local.T, small.participation @ local.T, outputs=keep, inputs=keep
        )
    return model.replace(upper=0.5 * (upper + upper.T), lower=local_free @ local_free.T)
