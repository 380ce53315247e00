r"""A basis of few shapes in which a structure moves rightly even when its elements change.

The lowest modes of a large structure hold its own motion, but not how it bends elsewhere once an element is softer: a
tenth of a per cent is then missing in frequencies that are measured to a millionth. A change of an element of stiffness
:math:`K_e` or mass :math:`M_e` acts on the modes in the band as the forces :math:`K_e\phi_r` and
:math:`\omega_r^2 M_e\phi_r`. The static responses to these forces (modal derivatives; Noor and Whitworth 1987) are
compressed to the few directions that hold most of their energy, and join the modes as a Ritz basis.
"""

from collections.abc import Iterable

import numpy as np
import scipy.linalg

BASE, BESIDE = 10, 6  # modes above the band that are kept as they are, and that forces are taken from
QUICKEST = 300.0  # frequency over that of the band above which a direction follows statically anyway
MASSLESS = 1e-14  # inverse eigenvalue, relative to the largest, below which a direction has no mass
NULL = 1e-10  # energy of a direction, relative to the largest, below which it is a combination of others


Piece = tuple[np.ndarray, np.ndarray]  # DoFs of an element, and its matrix over them


def ritz_basis(
    K: np.ndarray, M: np.ndarray, stiffness: Iterable[Piece], mass: Iterable[Piece], highest: float, count: int,
    acting: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:  # fmt: skip
    """Circular frequencies and shapes of unit mass ``(n, count)`` at most, and how many are inside the band.

    Parameters
    ----------
    stiffness, mass
        Elements of both matrices.
    highest
        End of the band [rad/s].
    acting
        Further forces ``(n, f)`` to which static responses join the basis, beyond ``count``. With forces at all DoFs of
        an element it changes the motion in the band as it changes that of the whole structure.
    """
    A = K + (0.3 * highest) ** 2 * M
    size = np.sqrt(np.diag(A))
    L = np.linalg.cholesky(A / np.outer(size, size))
    values, modes = _modes(M, A, (0.3 * highest) ** 2)
    inside = int(np.count_nonzero(values < highest**2))
    base = modes[:, : min(max(inside + BASE, count // 3), modes.shape[1])]
    further = max(count - base.shape[1], 0)
    some = slice(0, min(inside + BESIDE, modes.shape[1]))
    squares = np.maximum(values[some], (0.03 * highest) ** 2)
    forces = _forces(modes[:, some], squares, stiffness, mass) / np.outer(size, size)
    # responses in coordinates of unit energy, the base taken out: it is orthogonal in energy as well
    half = scipy.linalg.solve_triangular(L, forces, lower=True)
    responses = scipy.linalg.solve_triangular(L, half.T, lower=True)
    known = np.linalg.qr(L.T @ (size[:, None] * base))[0]
    responses -= known @ (known.T @ responses)
    responses -= (responses @ known) @ known.T
    energy, turn = np.linalg.eigh((responses + responses.T) / 2)
    kept = np.flatnonzero(energy > NULL * energy[-1])[::-1][:further]
    more = scipy.linalg.solve_triangular(L, turn[:, kept], lower=True, trans="T") / size[:, None]
    B = np.concatenate([base, more], axis=1)
    if acting is not None and acting.size:
        there = scipy.linalg.solve_triangular(L, acting / size[:, None], lower=True)
        there /= np.maximum(np.linalg.norm(there, axis=0), 1e-300)
        known = np.linalg.qr(L.T @ (size[:, None] * B))[0]
        there -= known @ (known.T @ there)
        u, s, _ = np.linalg.svd(there, full_matrices=False)
        there = u[:, s > np.sqrt(NULL)]
        B = np.hstack([B, scipy.linalg.solve_triangular(L, there, lower=True, trans="T") / size[:, None]])
    values, inner = _modes(B.T @ M @ B, B.T @ A @ B, (0.3 * highest) ** 2, (QUICKEST * highest) ** 2)
    return np.sqrt(np.maximum(values, 0.0)), B @ inner, inside


def _modes(M: np.ndarray, A: np.ndarray, shift: float, quickest: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and modes of unit mass from the mass and the shifted stiffness.

    Directions without mass, or beyond the eigenvalue ``quickest``, get the mass that puts them there; they are left out
    where that is None.
    """
    size = np.sqrt(np.diag(A))
    nu, phi = scipy.linalg.eigh(M / np.outer(size, size), A / np.outer(size, size))
    nu, phi = nu[::-1], phi[:, ::-1] / size[:, None]
    if quickest is None:
        real = nu > MASSLESS * nu[0]
        nu, phi = nu[real], phi[:, real]
    else:
        nu = np.maximum(nu, 1 / quickest)
    return 1 / nu - shift, phi / np.sqrt(nu)


def _forces(modes: np.ndarray, squares: np.ndarray, stiffness: Iterable[Piece], mass: Iterable[Piece]) -> np.ndarray:
    """Sum of squares ``(n, n)`` of the forces of all elements in all modes, each over its mode's frequency."""
    out = np.zeros((len(modes), len(modes)))
    for pieces, scale in ((stiffness, 1 / np.sqrt(squares)), (mass, np.sqrt(squares))):
        for dofs, matrix in pieces:
            force = matrix @ modes[dofs] * scale
            out[np.ix_(dofs, dofs)] += force @ force.T
    return out
