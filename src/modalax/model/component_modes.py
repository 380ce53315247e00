r"""Large finite-element matrices on the few degrees of freedom of interest.

Component modes with residual flexibility (Rubin 1975): the motion is that of the modes in the band and somewhat beyond,
and what static forces at the DoFs of interest add to it. The amplitudes are then told by the motions of the DoFs of
interest and of as many others, so that springs, masses and dampers can be put at any of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from modalax.model.condense import MODES, Condensed, freed, lowest_modes, rigid_count, rounding

BEYOND = 2.0  # modes are kept up to so many times the highest frequency of interest
DEPENDENT = 1e-9  # part of a static motion below which modes and other forces tell it
BELOW = 1e-3  # shift of the factorisation, of the eigenvalue at the highest frequency of interest
FIRST = 20  # modes by which the shift is chosen
SMALL = 300  # DoFs up to which all modes are found, without iteration


@dataclass(frozen=True)
class _Shifted:
    """Stiffness and mass, ``K + shift M`` factorised."""

    M: Any
    K: Any
    shift: float

    @property
    def size(self) -> int:
        return self.K.shape[0]

    def solver(self) -> Any:
        try:
            A = scipy.sparse.csc_matrix(self.K + self.shift * self.M)  # positive, so that it needs no pivots
            order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
            return scipy.sparse.linalg.splu(A, **order).solve
        except RuntimeError:
            raise ValueError("some direction has neither mass nor stiffness; leave it out") from None

    def modes(self, count: int, solve: Any) -> tuple[np.ndarray, np.ndarray]:
        """The lowest ``count`` modes, rising; all where they are few."""
        if self.size <= SMALL or 2 * count >= self.size:
            value, phi = lowest_modes(self.M.toarray(), self.K.toarray())
            return value[:count], phi[:, :count]
        inverse = scipy.sparse.linalg.LinearOperator(self.K.shape, matvec=solve)
        start = np.random.default_rng(0).standard_normal(self.size)
        value, phi = scipy.sparse.linalg.eigsh(self.K, count, self.M, sigma=-self.shift, OPinv=inverse, v0=start)
        order = np.argsort(value)
        return value[order], phi[:, order]

    def modes_up_to(self, top: float, solve: Any, least: int = FIRST) -> tuple[np.ndarray, np.ndarray]:
        """At least all modes up to the eigenvalue ``top``."""
        while True:
            value, phi = self.modes(least, solve)
            if len(value) < least or value[-1] > top:
                return value, phi
            least *= 2


def reduce_to_points(
    M: Any, K: Any, keep: Sequence[int], *, up_to_hz: float | None = None, digits: int = 15
) -> Condensed:
    r"""Mass and stiffness on DoFs of interest and on as many others as their dynamics up to a frequency need.

    The motion is :math:`x = \Phi q + (K+sM)^{-1}E_b\,g`, :math:`\Phi` the modes up to ``BEYOND`` times the highest
    frequency of interest, which stay exact, :math:`E_b` a unit force at each DoF of interest, and ``s`` a small shift,
    which lets the structure float freely. In place of ``q`` and ``g`` stand the motions of the DoFs of interest and of
    those others that tell the rest best (pivoted QR, weighted by :math:`M_{ii}^{1/2}`).

    Parameters
    ----------
    M, K
        Mass and stiffness, scipy sparse (or dense) symmetric, shape ``(m, m)``, in one system of units.
    keep
        Positions of the DoFs of interest: measured, driven, or with a joint.
    up_to_hz
        Highest frequency of interest [Hz]; that of elastic mode ``MODES`` if None.
    digits
        Significant digits of each entry of the stiffness.

    Raises
    ------
    ValueError
        If ``keep`` is empty or holds all DoFs, a direction has neither mass nor stiffness, or the matrices have
        rigid-body modes only.

    References
    ----------
    S. Rubin: Improved component-mode representation for structural dynamic analysis. AIAA Journal 13 (1975) 995-1006.
    """
    M, K = scipy.sparse.csc_matrix(M), scipy.sparse.csc_matrix(K)
    held = np.zeros(K.shape[0], bool)
    held[list(keep)] = True
    if not 0 < held.sum() < len(held):
        raise ValueError(f"{int(held.sum())} of {len(held)} DoFs are to be kept; a reduction keeps some, not all")
    square, phi = _of_interest(M, K, up_to_hz)
    deviation = rounding(phi, K, digits)
    rigid = rigid_count(square, phi, K, deviation)
    elastic = square[rigid:]
    if not len(elastic):
        raise ValueError("the matrices have rigid-body modes only; stiffness is missing")
    top = elastic[min(MODES, len(elastic)) - 1] if up_to_hz is None else (2 * np.pi * up_to_hz) ** 2
    wanted = rigid + max(int((elastic <= top * (1 + 1e-9)).sum()), 1)
    kept, T = _told_by_motions(M, _basis(M, K, np.flatnonzero(held), max(top, elastic[0])), held)
    m, k = (0.5 * (A + A.T) for A in (T.T @ (M @ T), T.T @ (K @ T)))
    k = freed(m, k, phi[kept, :rigid])
    found = scipy.linalg.eigh(k, m, eigvals_only=True)[rigid:wanted]
    change = float(np.abs(np.sqrt(np.abs(found / square[rigid : rigid + len(found)])) - 1).max(initial=0.0))
    return Condensed(
        m, k, kept, rigid, float(np.abs(square[:rigid]).max(initial=0.0)), float(deviation[:rigid].max(initial=0.0)),
        np.where(np.arange(wanted) < rigid, 0.0, square[:wanted]), deviation[:wanted], change, T, True,
    )  # fmt: skip


def _of_interest(M: Any, K: Any, up_to_hz: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Modes up to a frequency, or enough of them where none is given; six more than that for rigid-body modes."""
    mass, stiffness = M.diagonal(), K.diagonal()
    if not (mass > 0).any():
        raise ValueError(f"the mass matrix is not positive: its largest diagonal entry is {mass.max(initial=0.0):.3g}")
    rough = _Shifted(M, K, 1e-6 * float(np.median(stiffness[mass > 0] / mass[mass > 0])))
    value, _ = rough.modes(min(FIRST, K.shape[0] - 1), rough.solver())
    fine = _Shifted(M, K, max(float(np.median(np.abs(value))), 1e-9 * rough.shift))
    if up_to_hz is None:
        return fine.modes(min(MODES + 6, K.shape[0] - 1), fine.solver())
    return fine.modes_up_to((2 * np.pi * up_to_hz) ** 2, fine.solver())


def _basis(M: Any, K: Any, at: np.ndarray, top: float) -> np.ndarray:
    """Modes up to beyond ``top`` and what static forces at some DoFs add to them, shape ``(m, n)``."""
    shifted = _Shifted(M, K, BELOW * top)
    solve = shifted.solver()
    value, phi = shifted.modes_up_to(BEYOND**2 * top, solve)
    phi = phi[:, value <= BEYOND**2 * top]
    phi = phi / np.sqrt(np.sum(phi * (M @ phi), axis=0))
    forces = np.zeros((len(phi), len(at)))
    forces[at, np.arange(len(at))] = 1.0
    answer = solve(forces)
    size = np.sqrt(np.diag(answer[at]))
    answer = answer - phi @ (phi.T @ (M @ answer))
    # orthogonal in energy: how much more each force moves its DoF than the modes tell, of how much it moves it in all
    scaled = answer / size
    energy, turn = np.linalg.eigh(scaled[at] / size[:, None])
    real = energy > DEPENDENT
    return np.concatenate([phi, scaled @ turn[:, real] / np.sqrt(energy[real])], axis=1)


def _told_by_motions(M: Any, basis: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which DoFs' motions tell all amplitudes of a basis, those held among them, and how all follow, ``(m, n)``."""
    size = np.linalg.norm(basis[held], axis=1, keepdims=True)
    within = scipy.linalg.null_space(basis[held] / size)
    if within.shape[1] != basis.shape[1] - held.sum():
        order = _pivots((basis[held] / size).T)
        raise ValueError(
            f"DoF {np.flatnonzero(held)[order[-1]]} (counted from 0) moves only as others that are kept let it; "
            "leave it out of those to keep"
        )
    weight = np.sqrt(np.maximum(M.diagonal(), 0.0)) * ~held
    order = _pivots(weight * (basis @ within).T)
    kept = held.copy()
    kept[order[: within.shape[1]]] = True
    return kept, basis @ np.linalg.inv(basis[kept])


def _pivots(A: np.ndarray) -> np.ndarray:
    """Columns by how much each adds to those before."""
    return scipy.linalg.lapack.dgeqp3(A)[1] - 1
