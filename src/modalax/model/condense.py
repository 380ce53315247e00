r"""Finite-element matrices made fit for dynamics: few enough degrees of freedom, and rigid-body modes truly rigid.

Programs write matrices with a limited number of digits, which gives rigid-body modes a little stiffness of either
sign; and they carry degrees of freedom of no mass, or of so little that they only spoil the numerics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Bool, Float

SURE = 5.0  # standard deviations of rounding within which an eigenvalue counts as zero
EXACT = 1e-3  # largest relative change of a frequency of interest that condensation may make
FIRST, FURTHER = 30.0, 1.5  # DoFs that follow statically vibrate so many times above the frequencies of interest
MODES, PART = 30, 3  # elastic modes of interest where no frequency is given: so many, or one in so many
LEAST = 1e-9  # eigenvalue of the mass matrix, scaled to a diagonal of one, below which a direction has no mass


@dataclass(frozen=True)
class Condensed:
    """Matrices on the DoFs that were kept, and what was done to get there.

    Attributes
    ----------
    M, K
        Shape ``(n, n)``, in the units given.
    kept
        Which of the given DoFs are left, ``n`` of ``m``.
    rigid
        Number of rigid-body modes.
    rigid_eigenvalue, rounding
        Largest magnitude of their eigenvalues as given, and the standard deviation that the digits of the entries
        give it [1/s^2].
    eigenvalue, deviation
        Of the modes of the matrices as given up to the frequency of interest, rising, with the standard deviation that
        the digits leave, shape ``(mode,)`` [1/s^2]; rigid-body modes at 0.
    change
        Largest relative change of a frequency among these by the condensation.
    motion
        How all given DoFs follow those kept, shape ``(m, n)``.
    dynamic
        Whether they follow by modes of their own too, not statically alone.
    """

    M: Float[np.ndarray, "n n"]
    K: Float[np.ndarray, "n n"]
    kept: Bool[np.ndarray, " m"]
    rigid: int
    rigid_eigenvalue: float
    rounding: float
    eigenvalue: Float[np.ndarray, " mode"]
    deviation: Float[np.ndarray, " mode"]
    change: float
    motion: Float[np.ndarray, "m n"]
    dynamic: bool = False


def condense(
    M: Float[np.ndarray, "m m"],
    K: Float[np.ndarray, "m m"],
    *,
    up_to_hz: float | None = None,
    digits: int = 15,
    keep: Sequence[int] = (),
) -> Condensed:
    r"""Let DoFs of little mass follow the others statically, and free the stiffness of rounding in rigid-body modes.

    DoFs follow one by one, that of largest :math:`K_{ii}/M_{ii}` first (Henshell and Ong 1975), each by Guyan's
    transformation (1965), :math:`x_c = -K_{cc}^{-1}K_{ca}x_a`, exact where it has no mass. It ends where that ratio
    comes within ``FIRST`` times the highest circular frequency of interest, squared; directions that then still have
    all but no mass (a rotation about a slanting beam) get the mass that puts them there; if a frequency of interest
    then differs by more than ``EXACT``, more DoFs are kept. Rigid-body modes are those whose eigenvalue is zero within
    ``SURE`` standard deviations of the rounding,

    .. math:: \sigma_r^2 = \tfrac1{12}\sum_{i\le j}(m_{ij}\phi_{ir}\phi_{jr}\,u_{ij})^2,

    with :math:`u_{ij}` the last digit of an entry and :math:`m_{ij}` 1 on the diagonal, else 2; the stiffness becomes
    :math:`P^TKP` with :math:`P = I - RR^TM`, :math:`R` these modes.

    Parameters
    ----------
    M, K
        Symmetric mass and stiffness, shape ``(m, m)``, in one system of units.
    up_to_hz
        Highest frequency of interest [Hz]; that of elastic mode ``MODES``, or a third of them all, if None.
    digits
        Significant digits of each entry.
    keep
        Positions of DoFs that stay whatever their mass, for example those that are measured.

    Raises
    ------
    ValueError
        If a matrix is not symmetric or the mass not positive, or a DoF has neither mass nor stiffness.
    """
    _check(M, K)
    square, phi = lowest_modes(M, K)
    deviation = rounding(phi, K, digits)
    rigid = rigid_count(square, phi, K, deviation)
    elastic = square[rigid:]
    if not len(elastic):
        raise ValueError("the matrices have rigid-body modes only; stiffness is missing")
    top = elastic[min(MODES, -(-len(elastic) // PART)) - 1] if up_to_hz is None else (2 * np.pi * up_to_hz) ** 2
    wanted = rigid + max(int((elastic <= top * (1 + 1e-9)).sum()), 1)
    ratio = FIRST**2 * top
    while True:
        kept, m, k = _followed(M, K, ratio, set(keep))
        m, at = _with_mass(m, k, ratio), np.flatnonzero(kept)
        k = freed(m, k, phi[at, :rigid])
        enough = len(at) >= wanted
        found = lowest_modes(m, k)[0][rigid:wanted] if enough else np.array([])
        change = float(np.abs(np.sqrt(np.abs(found) / square[rigid:wanted]) - 1).max(initial=0.0)) if enough else np.inf
        if change < EXACT or ratio > 1e12 * top:
            break
        ratio *= FURTHER**2
    return Condensed(
        m, k, kept, rigid, float(np.abs(square[:rigid]).max(initial=0.0)), float(deviation[:rigid].max(initial=0.0)),
        np.where(np.arange(wanted) < rigid, 0.0, square[:wanted]), deviation[:wanted], change, follow(K, kept),
    )  # fmt: skip


def lowest_modes(
    M: Float[np.ndarray, "n n"], K: Float[np.ndarray, "n n"]
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "n r"]]:
    r"""Modes of a stiffness and a mass matrix that may both be singular, those without mass left out.

    The problem :math:`M\phi = \nu(K + sM)\phi`, :math:`\lambda = 1/\nu - s`, keeps the low modes exact, however stiff
    the highest are.

    Returns
    -------
    tuple
        Eigenvalues, rising, shape ``(r,)`` [1/s^2], and mass-normalised modes, shape ``(n, r)``.

    Raises
    ------
    ValueError
        If some direction has neither mass nor stiffness.
    """
    mass = np.diag(M) > 0
    shift = 1e-6 * float(np.median(np.diag(K)[mass] / np.diag(M)[mass]))
    for _ in range(2):
        try:
            nu, phi = scipy.linalg.eigh(M, K + shift * M)
        except np.linalg.LinAlgError:
            loose = np.flatnonzero((np.diag(K) <= 0) & ~np.any(M, axis=1))
            raise ValueError(
                f"some direction has neither mass nor stiffness (DoFs {loose[:5].tolist()} have neither); leave it out"
            ) from None
        real = nu > 1e-12 * nu[-1]
        nu, phi = nu[real][::-1], phi[:, real][:, ::-1]
        value = 1 / nu - shift
        shift = max(float(np.median(np.abs(value[:20]))), 1e-9 * abs(shift))
    return value, phi / np.sqrt(nu)


def _check(M: np.ndarray, K: np.ndarray) -> None:
    for A, name in ((M, "mass"), (K, "stiffness")):
        skew, size = np.abs(A - A.T).max(initial=0.0), np.abs(A).max(initial=0.0)
        if not skew <= 1e-6 * size:
            raise ValueError(f"the {name} matrix is not symmetric: entries differ by {skew:.3g} of {size:.3g}")
    if np.diag(M).min() < 0 or not np.any(np.diag(M) > 0):
        raise ValueError(f"the mass matrix is not positive: the smallest mass is {np.diag(M).min():.3g}")


def _followed(M: np.ndarray, K: np.ndarray, ratio: float, keep: set[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Guyan's transformation for one DoF after another; which were kept, and their mass and stiffness."""
    m, k = M.copy(), K.copy()
    left = np.ones(len(M), bool)
    free = np.array([i not in keep for i in range(len(M))])
    while True:
        with np.errstate(divide="ignore", invalid="ignore"):
            stiff = np.where(np.diag(m) > 0, np.diag(k) / np.diag(m), np.inf)
        stiff = np.where(left & (free | ~np.isfinite(stiff)) & (np.diag(k) > 0), stiff, -np.inf)
        c = int(np.argmax(stiff))
        if not stiff[c] > ratio:
            break
        left[c] = False
        near = np.flatnonzero(left & ((k[c] != 0) | (m[c] != 0)))  # nothing changes elsewhere
        t, mc, block = -k[c, near] / k[c, c], m[c, near], np.ix_(near, near)
        m[block] += np.outer(t, mc) + np.outer(mc, t) + m[c, c] * np.outer(t, t)
        k[block] += np.outer(t, k[c, near])
        m[c], m[:, c], k[c], k[:, c] = 0.0, 0.0, 0.0, 0.0
    at = np.ix_(left, left)
    return left, 0.5 * (m[at] + m[at].T), 0.5 * (k[at] + k[at].T)


def follow(K: Float[np.ndarray, "m m"], kept: Bool[np.ndarray, " m"]) -> Float[np.ndarray, "m n"]:
    """How all DoFs follow those kept, statically: 1 for these, :math:`-K_{cc}^{-1}K_{ca}` for the others."""
    T = np.zeros((len(K), int(kept.sum())))
    T[kept] = np.eye(T.shape[1])
    if not kept.all():
        size = np.sqrt(np.diag(K)[~kept])
        inner = K[np.ix_(~kept, ~kept)] / np.outer(size, size)
        T[~kept] = -scipy.linalg.solve(inner, K[np.ix_(~kept, kept)] / size[:, None], assume_a="pos") / size[:, None]
    return T


def _with_mass(M: np.ndarray, K: np.ndarray, ratio: float) -> np.ndarray:
    """The mass, with what puts directions that have all but none at the eigenvalue ``ratio``."""
    scale = np.sqrt(np.maximum(np.diag(M), 1e-300))
    value, vectors = np.linalg.eigh(M / np.outer(scale, scale))
    null = value < LEAST
    if not null.any():
        return M
    N = vectors[:, null] / scale[:, None]
    stiffness, turn = np.linalg.eigh(N.T @ K @ N)
    directions = (vectors[:, null] @ turn) * scale[:, None]
    return M + (directions * (stiffness / ratio)) @ directions.T


def freed(M: np.ndarray, K: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Stiffness that gives no force for motions R."""
    if not R.shape[1]:
        return K
    R = R @ np.linalg.inv(np.linalg.cholesky(R.T @ M @ R)).T
    P = np.eye(len(M)) - R @ (R.T @ M)
    K = P.T @ K @ P
    return 0.5 * (K + K.T)


def rigid_count(square: np.ndarray, phi: np.ndarray, K: Any, deviation: np.ndarray) -> int:
    """How many of the lowest eigenvalues are zero within the digits of the stiffness and of double precision."""
    size = np.abs(phi)
    zero = np.abs(square) < SURE * deviation + 1e-13 * np.sum(size * (abs(K) @ size), axis=0)
    return int(np.argmin(zero)) if not zero.all() else len(zero)


def rounding(phi: np.ndarray, K: Any, digits: int) -> np.ndarray:
    """Standard deviation of each eigenvalue from rounding of the stiffness, dense or sparse, shape ``(r,)``."""
    K = scipy.sparse.csr_array(K)
    unit = K.copy()
    unit.data = np.where(K.data == 0, 0.0, 10.0 ** (np.floor(np.log10(np.abs(K.data) + (K.data == 0))) - (digits - 1)))
    # over all i, j: half of (2 u)^2, and u^2 on the diagonal
    weight = 2.0 * unit.power(2) - scipy.sparse.diags_array(unit.diagonal() ** 2)
    squares = phi**2
    return np.sqrt(np.sum(squares * (weight @ squares), axis=0) / 12)


def node_pairs(
    K: Any, nodes: Sequence[str], directions: Sequence[str], kept: Bool[np.ndarray, " m"]
) -> list[tuple[int, int]]:
    """Pairs of kept DoFs of one direction whose nodes an element joins: where a spring or joint may sit.

    Parameters
    ----------
    K
        Stiffness before the condensation, dense or scipy sparse, shape ``(m, m)``.
    nodes, directions
        Of each DoF.
    kept
        Which DoFs are left.
    """
    at = np.unique(np.asarray(nodes), return_inverse=True)[1]
    there = np.isin(at, at[kept])
    i, j = K.nonzero()
    near = there[i] & there[j] & (at[i] < at[j])
    joined = np.unique(np.stack([at[i[near]], at[j[near]]], axis=1), axis=0)
    place = {(int(at[d]), directions[d]): d for d in np.flatnonzero(kept).tolist()}
    return [
        (place[a, way], place[b, way])
        for a, b in joined.tolist() for way in dict.fromkeys(directions) if (a, way) in place and (b, way) in place
    ]  # fmt: skip


def rigid_motions(
    xyz: Float[np.ndarray, "m 3"], axes: Float[np.ndarray, "m 3"], rotation: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "m 6"]:
    r"""The six rigid-body motions at DoFs: translations along, rotations about x, y and z through the origin.

    Parameters
    ----------
    xyz, axes
        Position of each DoF and the unit vector of its direction.
    rotation
        Whether it is a rotation about that vector.
    """
    out = np.zeros((len(xyz), 6))
    out[~rotation, :3] = axes[~rotation]
    out[:, 3:] = np.where(rotation[:, None], axes, np.cross(xyz, axes))
    return out
