r"""Search for the poles that leave the least of the lines around some modes.

The residues are eliminated: with an orthonormal basis :math:`Q` of the kernels and of all that has no pole to be found,
what is left is :math:`r = (1-QQ^H)D`, and a change of pole :math:`p_j` changes it by :math:`-(1-QQ^H)K'(p_j)a_j`, the
residues :math:`a_j` as they are (Kaufman 1975). All kernels are analytic in their pole, so one derivative each is
enough.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from modalax.identify.neighbourhood import Neighbourhood

STEPS = 60  # most steps of a search, those that were rejected among them
DONE = 1e-10  # part of the sum of squares by which a step must lower it for another one to follow
CHANGE = 1e-4  # change of a pole by which its kernel is differentiated, in half-bandwidths
LIGHT, HEAVY = 1e-7, 0.5  # damping ratios that bound a search
BOLD, CAUTIOUS, LOST = 1e-3, 1e-12, 1e8  # Levenberg's parameter: at the start, at least, and where a search gives up


class _State(NamedTuple):
    """Where a search stands: its unknowns, what is left, and the normal equations of the next step."""

    x: Float[np.ndarray, " 2n"]
    rest: float
    gradient: Float[np.ndarray, " 2n"]
    matrix: Float[np.ndarray, "2n 2n"]


def best_poles(
    hood: Neighbourhood,
    start: Sequence[complex] | np.ndarray,
    leading: Complex[np.ndarray, "m k"] | None = None,
) -> tuple[Complex[np.ndarray, " n"], float]:
    """Poles that leave the least of the data, searched from a start, and the sum of squares that they leave.

    Levenberg and Marquardt's method in the logarithms of frequency and damping ratio, inside the lines, unless it
    starts beyond them, and between ``LIGHT`` and ``HEAVY``. The search looks at ``leading``, what
    :meth:`Neighbourhood.leading` gives if None; the sum is that of all channels.
    """
    start = np.asarray(start)
    n = len(start)
    search = _Search(hood, hood.leading() if leading is None else leading)
    x = np.log(np.concatenate([np.abs(start), np.clip(-start.real / np.abs(start), LIGHT, HEAVY)]))
    low = np.minimum(np.repeat(np.log([hood.s[0].imag, LIGHT]), n), x)
    high = np.maximum(np.repeat(np.log([hood.s[-1].imag, HEAVY]), n), x)
    now, damping = search.at(x), BOLD
    for _ in range(STEPS):
        held = ((now.x <= low) & (now.gradient > 0)) | ((now.x >= high) & (now.gradient < 0))
        size = np.diag(now.matrix)
        matrix = np.where(held[:, None] | held, 0.0, now.matrix)
        matrix[np.diag_indices(2 * n)] = np.where(held | (size <= 0), 1.0, (1 + damping) * size)
        step = -np.linalg.solve(matrix, np.where(held, 0.0, now.gradient))
        new = search.at(np.clip(now.x + step, low, high))
        gained = now.rest - new.rest
        if gained > 0:
            now, damping = new, max(damping / 10, CAUTIOUS)
        else:
            damping *= 10
        if 0 <= gained <= DONE * now.rest or damping > LOST:
            break
    poles = _poles(now.x)
    return poles, hood.squares_left(poles)


def _poles(x: np.ndarray) -> Complex[np.ndarray, " n"]:
    omega, zeta = np.exp(x[: len(x) // 2]), np.exp(x[len(x) // 2 :])
    return omega * (-zeta + 1j * np.sqrt(1 - zeta**2))


class _Search:
    """Normal equations at trial poles, of data without the fixed columns."""

    def __init__(self, hood: Neighbourhood, data: np.ndarray):
        self.hood, self.data = hood, data
        self.known = np.linalg.qr(hood.columns(()))[0]

    def at(self, x: np.ndarray) -> _State:
        poles, n = _poles(x), len(x) // 2
        small = CHANGE * np.maximum(-poles.real, 1e-12 * np.abs(poles))
        own = self.hood.seen(np.concatenate([poles, poles + small, poles - small]))
        own[:, n : 2 * n] = (own[:, n : 2 * n] - own[:, 2 * n :]) / (2 * small)
        own = own[:, : 2 * n] - self.known @ (self.known.conj().T @ own[:, : 2 * n])
        scale = np.maximum(np.linalg.norm(own[:, :n], axis=0), 1e-300)
        Q, triangle = np.linalg.qr(own[:, :n] / scale)
        seen = Q.conj().T @ self.data
        left = self.data - Q @ seen
        change = own[:, n:] - Q @ (Q.conj().T @ own[:, n:])
        residues = (np.linalg.pinv(triangle, rcond=1e-12) @ seen) / scale[:, None]
        zeta = np.exp(x[n:])
        turn = np.abs(poles) * (-zeta - 1j * zeta**2 / np.sqrt(1 - zeta**2))
        by = np.concatenate([poles, turn])
        pairs = np.tile((change.conj().T @ change) * (residues.conj() @ residues.T), (2, 2))
        asked = np.tile(np.sum(residues.conj() * (change.conj().T @ left), axis=1), 2)
        return _State(
            x, float(np.vdot(left, left).real), -np.real(by.conj() * asked), np.real(by.conj()[:, None] * pairs * by)
        )


class Trial(NamedTuple):
    """One way to explain the lines around some modes: twice the negative log-likelihood, unknowns, and poles."""

    chi2: float
    unknowns: int
    poles: Complex[np.ndarray, " n"]


def trial(
    hood: Neighbourhood, start: Sequence[complex] | np.ndarray, leading: Complex[np.ndarray, "m k"] | None = None
) -> Trial:
    """The best poles from a start, with residues of every channel's own."""
    poles, rest = best_poles(hood, start, leading)
    return Trial(2 * rest, 2 * len(poles) * (1 + hood.data.shape[1]), poles)
