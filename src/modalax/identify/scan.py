r"""Scan of a residual for missing modes, on the host: score tests at many poles by matrix products.

The statistic is that of :func:`modalax.identify.mode_scores`. Single precision is enough, for what is compared are
sums of squares of standard deviations with a threshold.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from modalax.identify.kernels import kernels
from modalax.identify.projection import orthonormal, stacked

DAMPINGS = (0.001, 0.003, 0.01, 0.03)  # damping ratios at which further modes are looked for
NEW = 0.01  # least part of a further mode's response that the present model cannot represent
NEAR = 0.01  # part of a frequency within which a further mode is the same that was tried before
BATCH = 128  # poles whose scores are computed again at a time
CHUNK = 128  # poles whose scores are taken at once
ROOM = 2**25  # numbers of responses that are kept
MANY, REACH = 2**20, 50.0  # samples from which on lines count only within so many half-bandwidths of a pole


def poles_missing(
    grid: "Grid",
    error: np.ndarray,
    sigma: Sequence[np.ndarray],
    known: np.ndarray,
    *,
    level: float = 1e-4,
    most: int = 4,
    inside: tuple[float, float] | None = None,
    avoid: Sequence[float] = (),
) -> np.ndarray:
    """Poles at which a residual asks for a further mode, strongest first; see :func:`modalax.identify.missing_modes`.

    Parameters
    ----------
    grid
        Where to look.
    error
        What the present model leaves of the FRFs, shape ``(f, o, i)``.
    sigma
        Standard deviations that it may have, each ``(f, o, i)``; a pole must count with each.
    known
        Poles of the present model, shape ``(n,)`` [rad/s].
    level, most, inside, avoid
        As for :func:`modalax.identify.missing_modes`; frequencies [Hz] within those of the grid.
    """
    lower, upper = (-np.inf, np.inf) if inside is None else inside
    poles, lines = grid.poles, len(grid.s)
    allowed = (grid.freq >= lower) & (grid.freq <= upper)
    threshold = chdtri(2 * error[0].size, level / max(int(allowed.sum()), 1))
    for f in avoid:
        allowed &= np.abs(grid.freq - f) > max(NEAR * f, 2 * grid.step)
    scans = [_Scan(grid, deviation.reshape(lines, -1), known) for deviation in sigma]
    whitened = [levelled((error / deviation).reshape(lines, -1)) for deviation in sigma]
    rest = whitened
    found: list[complex] = []
    bound = np.full(len(poles), -np.inf)
    some = np.flatnonzero(allowed)
    bound[some] = scans[0].scores(whitened[0], some)  # with the other deviations scores are no larger
    while len(found) < most and allowed.any():
        best = _best(scans, rest, bound, allowed, threshold)
        if best is None:
            break
        pole = poles[best]
        found.append(pole)
        allowed &= np.abs(poles.imag - pole.imag) > 4 * np.maximum(-poles.real, -pole.real)
        if not (allowed.any() and grid.inside[best]):
            break
        rest = [scan.without(r, np.array(found)) for scan, r in zip(scans, whitened, strict=True)]
    first, last = grid.s.imag[0], grid.s.imag[-1]
    within = [p for p in found if first < p.imag < last]
    return np.array(found[:1] if found and found[0] not in within else within, dtype=complex)


def _best(
    scans: list["_Scan"], rest: list[np.ndarray], bound: np.ndarray, allowed: np.ndarray, threshold: float
) -> int | None:
    """Pole of the largest of the smallest scores, None below the threshold.

    Scores do not rise by more than their scatter when something is taken out of the residual. So the last scores serve
    as bounds, of which only the largest, ``BATCH`` after ``BATCH``, are computed again, until none can be the best.
    """
    current, best, value = np.where(allowed, bound, -np.inf), None, threshold
    while True:
        batch = np.argpartition(-current, min(BATCH, len(current) - 1))[:BATCH]
        batch = batch[current[batch] >= value]
        if not len(batch):
            return best
        scores = np.min([scan.scores(r, batch) for scan, r in zip(scans, rest, strict=True)], axis=0)
        bound[batch], current[batch] = scores, -np.inf
        if scores.max() >= value:
            best, value = int(batch[np.argmax(scores)]), float(scores.max())


def levelled(residual: np.ndarray) -> np.ndarray:
    """Scale scores to the level of a wide neighbourhood, so that a badly fitted part of the band makes no modes."""
    power = np.mean(np.abs(residual) ** 2, axis=tuple(range(1, residual.ndim)))
    local = _running_median(power, max(5, len(power) // 5))
    return residual / np.sqrt(np.maximum(local, 1e-300)).reshape(-1, *[1] * (residual.ndim - 1))


def _running_median(values: np.ndarray, width: int) -> np.ndarray:
    padded = np.pad(values, width // 2, mode="reflect" if len(values) > width // 2 else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.median(windows, axis=1)[: len(values)]


class Grid:
    """Poles to look at, frequencies half a bandwidth apart, and the responses of modes there, of unit size.

    Parameters
    ----------
    s, power
        Where the FRFs were measured, shape ``(f,)`` [1/s], and the number of their time derivatives.
    window
        Frequencies to look at [Hz]; the band and a fifth of it beyond by default.
    """

    def __init__(self, s: np.ndarray, power: int, window: tuple[float, float] | None = None):
        self.s, self.power = s, power
        first, last = float(s.imag[0]) / (2 * np.pi), float(s.imag[-1]) / (2 * np.pi)
        self.step = (last - first) / max(len(s) - 1, 1)
        beyond = 0.2 * (last - first)
        lower, upper = (max(first - beyond, 0.0), last + beyond) if window is None else window
        points = []
        for zeta in DAMPINGS:
            f = max(lower, self.step)
            while f < upper:
                points.append((f, zeta))
                f += max(zeta * f, 0.5 * self.step)
        self.freq, zeta = np.array(points).reshape(-1, 2).T
        self.poles = 2 * np.pi * self.freq * (-zeta + 1j * np.sqrt(1 - zeta**2))
        self.inside = (self.poles.imag >= s.imag.min()) & (self.poles.imag <= s.imag.max())
        self.kept: np.ndarray | None = None
        if 4 * len(self.poles) * len(s) <= ROOM:
            self.kept = np.concatenate([self._made(part, slice(None)) for part in self._chunks()])

    def _chunks(self) -> list[np.ndarray]:
        return np.array_split(np.arange(len(self.poles)), -(-len(self.poles) // CHUNK))

    def _made(self, which: np.ndarray, lines: slice) -> np.ndarray:
        pair = kernels(self.s[lines], self.power, self.poles[which], squares=False).T.reshape(len(which), 2, -1)
        pair = pair / np.sqrt(np.sum(np.abs(pair) ** 2, axis=(1, 2), keepdims=True))
        return np.stack([pair.real, pair.imag], axis=2).astype(np.float32)

    def responses(self, which: np.ndarray, lines: slice) -> np.ndarray:
        """Responses to real and imaginary part of a residue, their own real and imaginary part: ``(g, 2, 2, f)``."""
        return self._made(which, lines) if self.kept is None else self.kept[which][..., lines]


class _Scan:
    """Scores at the poles of a grid for residuals of one deviation; arrays of lines by channels."""

    def __init__(self, grid: Grid, sigma: np.ndarray, known: np.ndarray):
        self.grid = grid
        w2 = 1 / sigma**2
        scale = np.mean(w2, axis=0)
        self.shared = np.sqrt(np.mean(w2 / scale, axis=1))
        self.weight = 1 / (sigma * np.sqrt(scale))  # of order one, for single precision
        self.squares = (self.weight**2).astype(np.float32)
        self.Q = self._known(known)

    def _known(self, known: np.ndarray) -> np.ndarray:
        """Orthonormal basis of what known modes, changes of their poles, and residual terms make of one channel."""
        s, power = self.grid.s, self.grid.power
        safe = np.where(s == 0, 1j * np.max(np.abs(s)), s)
        terms = np.stack([safe**0, 1j * safe**0, safe**-2.0, 1j * safe**-2.0], axis=1) * (s**power)[:, None]
        columns = np.concatenate([kernels(s, power, known), terms], axis=1)
        A = stacked((columns * self.shared[:, None]).T)
        return orthonormal((A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), 1e-300)).T)[0]

    def scores(self, residual: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Statistic of a whitened residual at some poles of the grid."""
        z, Q = stacked(residual.T).astype(np.float32), self.Q.astype(np.float32)
        double = np.tile(self.weight, (2, 1)).astype(np.float32)
        found = np.zeros(len(which))
        inside = self.grid.inside[which]
        for part, within in ((np.flatnonzero(inside), True), (np.flatnonzero(~inside), False)):
            if not len(part):
                continue
            data = (z if within else z - (z @ Q) @ Q.T).T * double
            for start in range(0, len(part), CHUNK):
                some = part[start : start + CHUNK]
                found[some] = self._statistic(which[some], data, within)
        return found

    def _near(self, poles: np.ndarray, samples: int) -> slice:
        """The lines on which modes of some poles act; all but 1 % of a mode's energy is in those of large sets."""
        if samples < MANY:
            return slice(0, len(self.shared))
        reach = REACH * -poles.real
        ends = np.searchsorted(self.grid.s.imag, [np.min(poles.imag - reach), np.max(poles.imag + reach)])
        return slice(int(ends[0]), int(ends[1]))

    def _statistic(self, which: np.ndarray, data: np.ndarray, within: bool) -> np.ndarray:
        near = self._near(self.grid.poles[which], data.size) if within else slice(0, len(self.shared))
        columns = self.grid.responses(which, near)
        lines = columns.shape[3]
        data = data.reshape(2, -1, data.shape[1])[:, near].reshape(2 * lines, -1)
        inner = (columns.reshape(-1, 2 * lines) @ data).reshape(len(columns), 2, -1)
        power = np.sum(columns.reshape(len(columns), 4, lines) ** 2, axis=1)
        size = power @ self.squares[near]
        seen = columns.reshape(len(columns), 2, -1) * np.tile(self.shared[near], 2).astype(np.float32)
        whole = np.sum(seen**2, axis=(1, 2))
        if not within:
            Q = self.Q.astype(np.float32)
            seen = seen - (seen @ Q) @ Q.T
        gram = seen @ np.swapaxes(seen, 1, 2) / whole[:, None, None]
        # The ridge keeps what is all but known from counting much.
        inverse = np.linalg.inv(gram + NEW * np.eye(2, dtype=np.float32))
        squares = np.sum(inner * (inverse @ inner), axis=1)
        return np.sum(2 * squares / np.maximum(size, 1e-30), axis=1)

    def without(self, residual: np.ndarray, poles: np.ndarray) -> np.ndarray:
        """The residual after the best multiples of the poles' responses were taken out of each channel."""
        K = kernels(self.grid.s, self.grid.power, poles, squares=False)
        K = K / np.linalg.norm(K, axis=0)
        weight = self.weight
        products = (K.conj()[:, :, None] * K[:, None, :]).real.reshape(len(K), -1)
        gram = ((weight**2).T @ products).reshape(-1, K.shape[1], K.shape[1])
        left = residual
        for _ in range(2):  # the second time takes out what the normal equations lost
            right = ((weight * left).T @ K.conj()).real
            left = left - weight * (K @ np.linalg.solve(gram, right[..., None])[..., 0].T)
        return left
