r"""A quick estimate of the modes in NumPy: poles from a common denominator, then residues with standard deviations.

It serves to judge the measurement, not to replace a fit: it must take seconds only, and residues of any phase must be
allowed, because wrong phases are among the faults looked for.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from modalax.check.basis import MORE_POWERS, SMOOTH_POWERS, Basis, least_squares, lift
from modalax.check.starts import MOST_FRFS, principal_frfs, stable_poles, telling_lines

# A mode stays if it lowers the weighted sum of squares by this many times what as many parameters of noise do.
WORTH = 4.0
# Misfit from which on what is left is searched for more modes, the most of these, and widths tried, in lines.
SEARCHED, MOST_MORE, WIDTHS = 1.25, 12, (1.0, 4.0, 16.0)


class Modes(NamedTuple):
    """Poles common to all FRFs, and residues of the receptance at each channel.

    Attributes
    ----------
    poles
        With Im > 0, shape ``(n,)`` [rad/s].
    residues, std
        Residue of each mode in each FRF and the standard deviation of its real or imaginary part, ``(n, k)``.
    fitted
        The FRFs of the estimate at all lines, shape ``(f, k)``.
    misfit
        Root mean square of what is left of each FRF over its noise, shape ``(k,)`` [-].
    pole_std
        Standard deviation of the real and of the imaginary part of each pole [rad/s], shape ``(n,)``.
    inside
        Whether each pole lies within the band; those outside only explain what reaches into it.
    powers
        Of the smooth terms.
    """

    poles: Complex[np.ndarray, " n"]
    residues: Complex[np.ndarray, "n k"]
    std: Float[np.ndarray, "n k"]
    fitted: Complex[np.ndarray, "f k"]
    misfit: Float[np.ndarray, " k"]
    pole_std: Float[np.ndarray, " n"]
    inside: np.ndarray
    powers: tuple[int, ...] = SMOOTH_POWERS

    @property
    def frequency(self) -> Float[np.ndarray, " n"]:
        """Undamped natural frequency [Hz]."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def width(self) -> Float[np.ndarray, " n"]:
        """Half-power bandwidth [Hz]."""
        return -self.poles.real / np.pi


class Noise(NamedTuple):
    """Weight of each line ``(f,)``, noise of each FRF after weighting ``(k,)``, and of each sample ``(f, k)``."""

    weight: np.ndarray
    level: np.ndarray
    sigma: np.ndarray


def estimate_modes(
    freq: Float[np.ndarray, " f"], H: Complex[np.ndarray, "f k"], sigma: Float[np.ndarray, "f k"], power: int
) -> Modes:
    """Estimate poles and residues of FRFs ``H`` with noise ``sigma`` (root of E|e|^2).

    Parameters
    ----------
    freq
        Lines above 0 Hz [Hz].
    power
        0 for receptance, 1 for mobility, 2 for accelerance.
    """
    omega = 2 * np.pi * freq
    noise = noise_of(H, sigma)
    weight = noise.weight
    principal = principal_frfs(weight[:, None] * H / noise.level)
    keep = telling_lines(principal)
    X = principal[keep]
    start = stable_poles(omega[keep], X / weight[keep, None], weight[keep])
    best: tuple[float, np.ndarray, tuple[int, ...]] | None = None
    for powers in (SMOOTH_POWERS, MORE_POWERS):
        basis = Basis(omega[keep], power, weight[keep], powers)
        poles = _polished(basis, start, X)
        left = misfit_of(basis, poles, X)
        if left > SEARCHED:
            poles = _completed(basis, poles, X)
            left = misfit_of(basis, poles, X)
        if best is None or left < 0.9 * best[0]:
            best = left, poles, powers
        if left < SEARCHED:
            break
        start = poles
    assert best is not None
    return residues_at(omega, H, noise, best[1], power, best[2])


def noise_of(H: np.ndarray, sigma: np.ndarray) -> Noise:
    """The middling noise of a line over all channels weights it: one weighting serves all channels at once."""
    scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=0)) + np.finfo(float).tiny
    sigma = np.maximum(sigma, 1e-12 * scale)
    level = np.exp(np.mean(np.log(sigma), axis=1))
    weight = np.minimum(np.median(level) / level, 30.0)
    return Noise(weight, np.sqrt(np.mean((weight[:, None] * sigma) ** 2, axis=0)) + 1e-7 * scale, sigma)


def _polished(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    poles = select(basis, poles, X)
    for _ in range(4):
        poles = improve(basis, poles, X)
    return select(basis, poles, X)


def misfit_of(basis: Basis, poles: np.ndarray, X: np.ndarray) -> float:
    """Root mean square of what is left over the noise, which is 1 in each sample."""
    Y = lift(X)
    U = least_squares(basis.design(poles), Y)[1]
    return float(np.sqrt(2 * np.sum((Y - U @ (U.T @ Y)) ** 2) / max(1, Y.size - U.shape[1] * Y.shape[1])))


def _completed(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    """With more modes, each where it explains most of what is left, as long as that is worth it."""
    omega = basis.s.imag
    lines = np.unique(np.linspace(1, len(omega) - 2, min(300, len(omega) - 2)).round().astype(int))
    gap = np.maximum(np.gradient(omega)[lines], 1e-5 * omega[lines])
    tried = [1j * omega[lines] - w * gap for w in WIDTHS]
    for edge, reach in zip(omega[[0, -1]], basis.reach, strict=True):
        tried += [1j * np.linspace(edge, reach, 12)[1:-1] - share * edge for share in (0.003, 0.02)]
    tried = np.concatenate(tried)
    level = misfit_of(basis, poles, X)
    columns = basis.design(tried)[:, : 2 * len(tried)]
    columns /= np.linalg.norm(columns, axis=0) + 1e-300
    Y = lift(X)
    for _ in range(MOST_MORE):
        U = least_squares(basis.design(poles), Y)[1]
        left = Y - U @ (U.T @ Y)
        # What is left is orthogonal to U: of a column only the size is needed of what U does not hold of it.
        beyond = np.maximum(1.0 - np.sum((U.T @ columns) ** 2, axis=0), np.finfo(float).eps)
        gain = np.sum((columns.T @ left) ** 2, axis=1) / beyond
        gain = gain[: len(tried)] + gain[len(tried) :]
        # What lies within a mode that is there already is an error of its form, not another mode.
        if len(poles):
            apart = np.abs(tried[:, None].imag - poles[None, :].imag) + (tried[:, None].real - poles.real)
            gain = np.where((apart < -2 * poles.real).any(axis=1), 0.25 * gain, gain)
        more = _polished(basis, np.append(poles, tried[np.argmax(gain)]), X)
        now = misfit_of(basis, more, X)
        if now > 0.97 * level:
            break
        poles, level = more, now
        if level < SEARCHED / 1.1:
            break
    return poles


def residues_at(
    omega: np.ndarray, H: np.ndarray, noise: Noise, poles: np.ndarray, power: int, powers: Sequence[int] = SMOOTH_POWERS
) -> Modes:
    """Residues at given poles, with standard deviations, fitted FRFs and misfit."""
    basis = Basis(omega, power, noise.weight, powers)
    Phi = basis.design(poles)
    Y = lift(noise.weight[:, None] * H)
    coefficients, _, _, solve = least_squares(Phi, Y)
    left = Y - Phi @ coefficients
    n, freedom = len(poles), max(1, Y.shape[0] - Phi.shape[1])
    # Noise is that of a complex sample: half of its square stands in each part.
    spread = np.sqrt(np.sum(left**2, axis=0) / freedom)
    misfit = spread / (noise.level / np.sqrt(2))
    power_of = 0.5 * (noise.weight[:, None] * noise.sigma) ** 2
    variance = solve[: 2 * n] ** 2 @ np.concatenate([power_of, power_of]) * np.maximum(misfit, 1.0) ** 2
    std = np.sqrt(np.maximum(variance[:n], variance[n:]))
    residues = coefficients[:n] + 1j * coefficients[n : 2 * n]
    lifted = Phi @ coefficients
    half = len(lifted) // 2
    fitted = (lifted[:half] + 1j * lifted[half:]) / noise.weight[:, None]
    pole_std = _pole_std(basis, poles, residues, noise, misfit, left)
    inside = (poles.imag > omega[0]) & (poles.imag < omega[-1])
    return Modes(poles, residues, std, fitted, misfit, pole_std, inside, tuple(powers))


def worth(frfs: int) -> float:
    """Squares of standard deviations by which a mode must lower those of so many FRFs to be one."""
    return WORTH * (2 * frfs + 2) + 10


def select(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Modes that lower the sum of squares by more than noise would, dropped one at a time from the weakest."""
    Y = lift(X)
    k = X.shape[1]
    while len(poles):
        Phi = basis.design(poles)
        coefficients, U, covariance, _ = least_squares(Phi, Y)
        left = Y - U @ (U.T @ Y)
        freedom = max(1, Y.shape[0] - Phi.shape[1])
        level = np.maximum(np.sum(left**2, axis=0) / freedom, 1e-30)
        n = len(poles)
        gain = np.empty(n)
        for r in range(n):
            which = [r, n + r]
            x = coefficients[which]
            inverse = np.linalg.pinv(covariance[np.ix_(which, which)], hermitian=True)
            gain[r] = np.sum(np.einsum("ak,ab,bk->k", x, inverse, x) / level)
        weakest = int(np.argmin(gain))
        if gain[weakest] > worth(k):
            break
        poles = np.delete(poles, weakest)
    return poles


def improve(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step of the poles, residues eliminated (variable projection, Kaufman 1975)."""
    if not len(poles):
        return poles
    n, Y = len(poles), lift(X)
    coefficients, U, _, _ = least_squares(basis.design(poles), Y)
    left = Y - U @ (U.T @ Y)
    residues = coefficients[:n] + 1j * coefficients[n : 2 * n]
    columns = _pole_columns(basis, poles, residues, U)
    normal, right = columns @ columns.T, columns @ left.reshape(-1)
    normal[np.diag_indices(2 * n)] *= 1 + 1e-6
    step = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    step = step[:n] + 1j * step[n:]
    # No further than half a bandwidth at a time, and never across the axis.
    limit = 0.5 * -poles.real
    step = step * np.minimum(1.0, limit / np.maximum(np.abs(step), 1e-300))
    moved = poles + step
    return moved[(moved.real < 0) & (moved.imag > basis.reach[0]) & (moved.imag < basis.reach[1])]


def _pole_columns(basis: Basis, poles: np.ndarray, residues: np.ndarray, U: np.ndarray) -> np.ndarray:
    """What real and imaginary parts of the poles change and residues cannot, ``(2 n, 2 f k)``."""
    slopes = basis.slope(poles, residues)
    lifted = np.concatenate([slopes.real, slopes.imag], axis=1)
    columns = lifted - np.einsum("tq,pqk->ptk", U, np.einsum("tq,ptk->pqk", U, lifted, optimize=True), optimize=True)
    return columns.reshape(len(columns), -1)


def _pole_std(basis: Basis, poles, residues, noise: Noise, misfit: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Standard deviations of the poles, from the strongest FRFs.

    The larger of two: by the noise of each sample, and by what is left at each line with all FRFs together, which also
    knows noise that they share, as that of a force (a sandwich estimate clustered by line, Liang and Zeger 1986).
    """
    n = len(poles)
    if not n:
        return np.zeros(0)
    strong = np.argsort(-np.sum(np.abs(residues / noise.level) ** 2, axis=0))[:MOST_FRFS]
    U = least_squares(basis.design(poles), np.zeros((2 * len(basis.s), 1)))[1]
    columns = _pole_columns(basis, poles, residues[:, strong] / noise.level[strong], U)
    solve = np.linalg.pinv(columns @ columns.T, hermitian=True) @ columns
    one = 0.5 * (noise.weight[:, None] * noise.sigma[:, strong] / noise.level[strong]) ** 2
    one = one * np.maximum(misfit[strong], 1.0) ** 2
    alone = solve**2 @ np.concatenate([one, one]).reshape(-1)
    scores = np.sum(solve.reshape(2 * n, *left[:, strong].shape) * left[:, strong] / noise.level[strong], axis=2)
    shared = np.sum((scores[:, : len(basis.s)] + scores[:, len(basis.s) :]) ** 2, axis=1)
    return np.sqrt(np.maximum(alone, shared)).reshape(2, n).max(axis=0)
