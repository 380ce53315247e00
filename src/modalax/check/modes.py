r"""A quick estimate of the modes in NumPy: poles from a common denominator, then residues with standard deviations.

It serves to judge the measurement, not to replace :func:`modalax.fit`: seconds matter, and residues of any phase must
be allowed, because wrong phases are what is looked for.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

# Model orders of the denominator; each in-band mode takes one, noise takes the rest.
LOWEST_ORDER, HIGHEST_ORDER, ORDER_STEP = 8, 44, 2
# Lines and principal FRFs used to find poles: enough for 40 modes, few enough for seconds.
MOST_LINES, MOST_FRFS = 3000, 10
# A root counts as seen again in another order within this share of its half bandwidth in frequency, and of its decay.
SAME_FREQUENCY, SAME_DECAY = 0.35, 0.5
# Share of the orders in which a root has to be seen to be tried as a mode.
STABLE = 0.4
# A mode stays if it lowers the weighted sum of squares by this many times what as many parameters of noise do.
WORTH = 4.0
SMOOTH_POWERS = (-2, 0, 2)


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
    """

    poles: Complex[np.ndarray, " n"]
    residues: Complex[np.ndarray, "n k"]
    std: Float[np.ndarray, "n k"]
    fitted: Complex[np.ndarray, "f k"]
    misfit: Float[np.ndarray, " k"]
    pole_std: Float[np.ndarray, " n"]

    @property
    def frequency(self) -> Float[np.ndarray, " n"]:
        """Undamped natural frequency [Hz]."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def width(self) -> Float[np.ndarray, " n"]:
        """Half-power bandwidth [Hz]."""
        return -self.poles.real / np.pi


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
    # The middling noise of a line over all channels weights it: one weighting serves all channels at once.
    scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=0)) + np.finfo(float).tiny
    level = np.exp(np.mean(np.log(np.maximum(sigma, 1e-12 * scale)), axis=1))
    weight = np.minimum(np.median(level) / level, 30.0)
    noise = np.sqrt(np.mean((weight[:, None] * sigma) ** 2, axis=0)) + 1e-7 * scale
    principal = _principal(weight[:, None] * H / noise)
    keep = _telling_lines(principal)
    poles = _stable_poles(omega[keep], principal[keep] / weight[keep, None], weight[keep])
    basis = Basis(omega[keep], power, weight[keep])
    poles = _select(basis, poles, principal[keep])
    for _ in range(4):
        poles = improve(basis, poles, principal[keep])
    poles = _select(basis, poles, principal[keep])
    return residues_at(omega, H, noise, weight, poles, power)


def residues_at(omega, H, noise, weight, poles, power) -> Modes:
    """Residues of given poles, and all that follows from them."""
    basis = Basis(omega, power, weight)
    Phi = basis.design(poles)
    Y = lift(weight[:, None] * H)
    coefficients, _, covariance = least_squares(Phi, Y)
    left = Y - Phi @ coefficients
    n, freedom = len(poles), max(1, Y.shape[0] - Phi.shape[1])
    # noise is that of a complex sample: half of its square stands in each part.
    spread = np.sqrt(np.sum(left**2, axis=0) / freedom)
    misfit = spread / (noise / np.sqrt(2))
    size = np.maximum(spread, noise / np.sqrt(2))
    std = np.sqrt(np.maximum(np.diag(covariance)[: 2 * n], 0))
    std = np.maximum(std[:n], std[n:])[:, None] * size
    residues = coefficients[:n] + 1j * coefficients[n : 2 * n]
    lifted = Phi @ coefficients
    half = len(lifted) // 2
    fitted = (lifted[:half] + 1j * lifted[half:]) / weight[:, None]
    pole_std = _pole_std(basis, poles, residues / size, Phi)
    return Modes(poles, residues, std, fitted, misfit, pole_std)


class Basis:
    """What an FRF is made of at given lines: modes and three smooth terms for all that lies outside the band."""

    def __init__(self, omega, power, weight):
        self.s: np.ndarray = 1j * np.asarray(omega)
        self.factor = weight * self.s**power
        middle = np.sqrt(omega[0] * omega[-1])
        self.smooth = np.stack([self.factor * (self.s / middle) ** p for p in SMOOTH_POWERS], axis=1)

    def design(self, poles: np.ndarray) -> np.ndarray:
        """Real and imaginary residues, then complex smooth terms, as real columns, shape ``(2 f, 2 n + 6)``."""
        u, v = self.factor[:, None] / (self.s[:, None] - poles), self.factor[:, None] / (self.s[:, None] - poles.conj())
        return lift(np.concatenate([u + v, 1j * (u - v), self.smooth, 1j * self.smooth], axis=1))

    def slope(self, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivatives of all FRFs with respect to real and imaginary parts of the poles, ``(2 n, f, k)``."""
        u = self.factor[:, None] / (self.s[:, None] - poles) ** 2
        v = self.factor[:, None] / (self.s[:, None] - poles.conj()) ** 2
        first, second = u.T[:, :, None] * residues[:, None, :], v.T[:, :, None] * residues.conj()[:, None, :]
        return np.concatenate([first + second, 1j * (first - second)])


def lift(z: np.ndarray) -> np.ndarray:
    """Real parts above imaginary parts."""
    return np.concatenate([z.real, z.imag])


def least_squares(Phi: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients, an orthonormal basis of the columns, and the covariance for unit noise."""
    size = np.linalg.norm(Phi, axis=0) + np.finfo(float).tiny
    U, s, Vt = np.linalg.svd(Phi / size, full_matrices=False)
    good = s > 1e-11 * s[0]
    U, s, Vt = U[:, good], s[good], Vt[good]
    inverse = Vt.T / s
    coefficients = (inverse @ (U.T @ Y)) / size[:, None]
    return coefficients, U, (inverse @ inverse.T) / np.outer(size, size)


def _principal(X: np.ndarray) -> np.ndarray:
    """The strongest principal FRFs: combinations of all channels that hold nearly all that is above the noise."""
    if X.shape[1] <= MOST_FRFS:
        return X
    # Tall and thin: the eigenvectors of the small Gram matrix suffice.
    _, vectors = np.linalg.eigh(X.conj().T @ X)
    return X @ vectors[:, ::-1][:, :MOST_FRFS]


def _telling_lines(X: np.ndarray) -> np.ndarray:
    """All lines, or of very many an even choice together with the lines that stand out from their surroundings."""
    count = len(X)
    if count <= MOST_LINES:
        return np.arange(count)
    size = np.log(np.sum(np.abs(X) ** 2, axis=1) + np.finfo(float).tiny)
    span = max(3, count // 50)
    mean = np.convolve(np.pad(size, span, mode="edge"), np.ones(2 * span + 1) / (2 * span + 1), "valid")
    even = np.linspace(0, count - 1, MOST_LINES // 2).round().astype(int)
    above = np.argsort(mean - size)[: MOST_LINES // 2]
    return np.unique(np.concatenate([even, above]))


def _stable_poles(omega: np.ndarray, X: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Poles that come back in many orders of a common denominator (least squares complex frequency, Guillaume 1998)."""
    top = int(min(HIGHEST_ORDER, len(omega) // 4))
    orders = [n for n in range(min(LOWEST_ORDER, top), top + 1, ORDER_STEP)]
    if not orders or top < 2:
        return np.zeros(0, complex)
    period = 0.8 * 2 * np.pi / (omega[-1] - omega[0])
    z = np.exp(1j * period * (omega - omega[0]))
    powers = z[:, None] ** np.arange(top + 1)
    weighted = weight[:, None] * powers
    Q, _ = np.linalg.qr(weighted)
    normal = np.zeros((top + 1, top + 1), complex)
    for k in range(X.shape[1]):
        columns = X[:, k, None] * weighted
        columns = columns / (np.linalg.norm(columns[:, 0]) + np.finfo(float).tiny) * np.linalg.norm(X[:, k])
        columns = columns - Q @ (Q.conj().T @ columns)
        normal += columns.conj().T @ columns
    found = []
    for n in orders:
        # The lowest coefficient is 1, so that the roots of noise come out unstable.
        a = np.linalg.lstsq(normal[1 : n + 1, 1 : n + 1], -normal[1 : n + 1, 0], rcond=1e-13)[0]
        roots = np.roots(np.concatenate([[1.0], a])[::-1])
        roots = roots[np.abs(roots) > 0]
        poles = np.log(roots) / period + 1j * omega[0]
        # The logarithm takes angles from -pi to pi; those of the band are 0 to 0.8 * 2 pi.
        poles += 1j * 2 * np.pi / period * (poles.imag < omega[0] - 0.1 * 2 * np.pi / period)
        inside = (poles.real < 0) & (poles.imag > omega[0]) & (poles.imag < omega[-1])
        narrow = -poles.real < 0.25 * np.minimum(poles.imag, omega[-1] - omega[0])
        found.append(poles[inside & narrow])
    return _clusters(found)


def _clusters(found: list[np.ndarray]) -> np.ndarray:
    """The middle of each cloud of poles that holds a share ``STABLE`` of the orders."""
    everything = np.concatenate(found) if found else np.zeros(0, complex)
    middles = []
    taken = np.zeros(len(everything), bool)
    near = _near(everything[:, None], everything[None, :])
    counts = near.sum(axis=1)
    while True:
        free = np.where(taken, 0, (near & ~taken[None, :]).sum(axis=1))
        if not len(free) or free.max() < max(2, STABLE * len(found)):
            break
        best = int(np.argmax(free * (1 + 1e-6 * counts)))
        members = near[best] & ~taken
        cloud = everything[members]
        middles.append(np.median(cloud.real) + 1j * np.median(cloud.imag))
        taken |= members
    return np.array(sorted(middles, key=lambda p: p.imag), complex)


def _near(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    decay = np.maximum(-a.real, -b.real)
    return (np.abs(a.imag - b.imag) < SAME_FREQUENCY * decay) & (np.abs(a.real - b.real) < SAME_DECAY * decay)


def _select(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Modes that lower the sum of squares by more than noise would, dropped one at a time from the weakest."""
    Y = lift(X)
    k = X.shape[1]
    while len(poles):
        Phi = basis.design(poles)
        coefficients, U, covariance = least_squares(Phi, Y)
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
        if gain[weakest] > WORTH * (2 * k + 2) + 10:
            break
        poles = np.delete(poles, weakest)
    return poles


def improve(basis: Basis, poles: np.ndarray, X: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step of the poles, residues eliminated (variable projection, Kaufman 1975)."""
    if not len(poles):
        return poles
    n, Y = len(poles), lift(X)
    coefficients, U, _ = least_squares(basis.design(poles), Y)
    left = Y - U @ (U.T @ Y)
    residues = coefficients[:n] + 1j * coefficients[n : 2 * n]
    normal, right = _pole_normal(basis, poles, residues, U, left)
    normal[np.diag_indices(2 * n)] *= 1 + 1e-6
    step = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    step = step[:n] + 1j * step[n:]
    # No further than half a bandwidth at a time, and never across the axis.
    limit = 0.5 * -poles.real
    step = step * np.minimum(1.0, limit / np.maximum(np.abs(step), 1e-300))
    moved = poles + step
    omega = basis.s.imag
    return moved[(moved.real < 0) & (moved.imag > omega[0]) & (moved.imag < omega[-1])]


def _pole_normal(basis, poles, residues, U, left):
    slopes = basis.slope(poles, residues)
    lifted = np.concatenate([slopes.real, slopes.imag], axis=1)
    columns = lifted - np.einsum("tq,pqk->ptk", U, np.einsum("tq,ptk->pqk", U, lifted, optimize=True), optimize=True)
    flat = columns.reshape(len(columns), -1)
    return flat @ flat.T, flat @ left.reshape(-1)


def _pole_std(basis: Basis, poles: np.ndarray, residues: np.ndarray, Phi: np.ndarray) -> np.ndarray:
    """Standard deviations for noise of 1 in each part of each channel."""
    n = len(poles)
    if not n:
        return np.zeros(0)
    strong = np.argsort(-np.sum(np.abs(residues) ** 2, axis=0))[:MOST_FRFS]
    U = least_squares(Phi, np.zeros((len(Phi), 1)))[1]
    normal, _ = _pole_normal(basis, poles, residues[:, strong], U, np.zeros((len(Phi), len(strong))))
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal, hermitian=True)), 0)).reshape(2, n).max(axis=0)
