r"""Noise of each sample: variances from few repeats are smoothed, missing ones are estimated from the data.

A variance from M repeats is :math:`\sigma^2\chi^2_\nu/\nu` with :math:`\nu = 2(M-1)`; used line by line, M = 3 puts
13 % of the whitened residuals beyond 3.5 instead of 0.05 %. The variance of a channel is therefore taken as a constant
and parts that follow the magnitude of the response, measured and expected, times a slow function of frequency, fitted
to all lines together. The constant has a course over frequency, that of all channels first and, where variances are
given, that of each output then: what rises towards a narrow peak would else be taken for a part that follows the
response, and be many times too large at the peak itself.
"""

from dataclasses import dataclass

import numpy as np
import scipy.special
from scipy.ndimage import correlate1d, median_filter, uniform_filter1d

from modalax.data import Measurement

ENOUGH = 300.0  # degrees of freedom at which a variance is as good as known
FLOOR = 1e-7  # least standard deviation, over the root mean square of the channel
ROUNDING = 1e-10  # the same, over the largest of all channels: what rounding leaves in a channel that shows nothing
AROUND = 15  # lines over which the scatter with and without the simulation is compared
SHARED, GIVEN = 9, 15  # lines over which the course of the noise is taken, read off the lines or given
SMOOTHED = 160.0  # degrees of freedom that the lines of one smoothing window have together
TRUSTED = 3.0  # degrees of freedom of each variance below which it was read from neighbouring lines
TIED = 4.0  # lines that the noise floor of all channels counts for, where variances are read off the lines
ROUNDS = (
    12  # rounds in which parts and course are fitted in turn; given variances get a course per output in the last half
)
RARE, SMALL = 1e-6, 1e-4  # chances below which a line's own variance, large or small, counts against its neighbours'
READ_LINES = 1.12  # widening of a line's sum where variances were read off the lines; 166 clean sets: 1.2 % below 0.01
THIRD = np.array([1.0, -3.0, 3.0, -1.0]) / np.sqrt(20.0)
# Lines of third differences that tell as much as one: the sum of their squared correlations. A variance known to one
# part in n, and so are the parts it is made of, makes the mean of 1/variance too large by as much; 60 clean sets have
# chi-squares of 1.065 per sample without this correction.
DEPENDENT = float(np.sum(np.correlate(THIRD, THIRD, "full") ** 2))


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the complex errors and how they were found.

    Attributes
    ----------
    sigma
        Shape ``(run, f, o, i)``, in the unit of the measurement.
    source
        One sentence for the answer.
    freedom
        Degrees of freedom a line had before smoothing; infinite where the variance was taken as known.
    """

    sigma: np.ndarray
    source: str
    freedom: float

    @property
    def spread(self) -> float:
        """Factor by which estimated variances widen the scores; for variances from the lines, as in 109 clean sets."""
        if not np.isfinite(self.freedom):
            return 1.0
        return 1.1 if self.freedom < TRUSTED else 1.0 + 0.3 / self.freedom

    @property
    def known(self) -> float:
        """Degrees of freedom to which the variance of a channel about a line is known."""
        return SMOOTHED if np.isfinite(self.freedom) else float("inf")

    @property
    def line_spread(self) -> float:
        """Degrees of freedom of sums over the channels of a line; the unevenness of lines is counted separately."""
        return READ_LINES if self.freedom < TRUSTED else self.spread


def noise_of(measurement: Measurement, predicted: np.ndarray) -> Noise:
    """Standard deviation of every sample.

    Parameters
    ----------
    predicted
        What the simulation expects, shape ``(f, o, i)`` or ``(run, f, o, i)``, in the form of the measurement.
    """
    H = np.asarray(measurement.H)
    predicted = np.broadcast_to(predicted, H.shape)
    size = np.sqrt(np.mean(np.abs(H) ** 2, axis=1, keepdims=True))
    if measurement.variance is not None and float(np.max(np.asarray(measurement.variance))) > 0:
        noise = _given(measurement, H, predicted)
    elif measurement.coherence is not None and measurement.averages is not None:
        noise = _from_coherence(measurement, H, predicted)
    else:
        noise = _from_data(measurement, H, predicted)
    least = np.maximum(FLOOR * size, ROUNDING * size.max() + 1e-300)
    return Noise(np.maximum(noise.sigma, least), noise.source, noise.freedom)


def _given(measurement: Measurement, H: np.ndarray, predicted: np.ndarray) -> Noise:
    variance = np.asarray(measurement.variance)
    freedom = scatter_freedom(variance) if measurement.averages is None else 2.0 * (measurement.averages - 1)
    if freedom >= ENOUGH:
        return Noise(np.sqrt(variance), "variances as given", np.inf)
    told = (
        f"they scatter from line to line as from {freedom / 2 + 1:.0f} repeats"
        if measurement.averages is None
        else f"from {measurement.averages} repeats"
    )
    smooth = smoothed(variance, H, predicted, max(freedom, 1.0))
    return Noise(np.sqrt(smooth), f"variances as given ({told}), smoothed over frequency", freedom)


def _from_coherence(measurement: Measurement, H: np.ndarray, predicted: np.ndarray) -> Noise:
    gamma = np.clip(np.asarray(measurement.coherence), 1e-6, 1 - 1e-9)
    averages = int(measurement.averages or 1)
    variance = np.abs(H) ** 2 * (1 - gamma) / (gamma * averages)
    smooth = smoothed(variance, H, predicted, max(2.0 * (averages - 1), 1.0))
    return Noise(
        np.sqrt(smooth), "no variances given; taken from the coherence, which mixes noise, leakage and non-linearity",
        2.0 * (averages - 1),
    )  # fmt: skip


def _from_data(measurement: Measurement, H: np.ndarray, predicted: np.ndarray) -> Noise:
    """From repeats at one level, else from what third differences along frequency leave."""
    level = np.asarray(measurement.level)
    groups = [np.flatnonzero(level == value) for value in np.unique(level[np.isfinite(level)])]
    groups += [np.flatnonzero(np.isnan(level))]
    groups = [g for g in groups if len(g) > 1]
    if groups and sum(map(len, groups)) == len(level):
        variance = np.empty(H.shape)
        for g in groups:
            variance[g] = H[g].var(axis=0, ddof=1)
        freedom = 2.0 * (min(map(len, groups)) - 1)
        return Noise(
            np.sqrt(smoothed(variance, H, predicted, freedom)),
            "no variances given; estimated from the repeated runs",
            freedom,
        )
    if H.shape[1] < 8:
        raise ValueError(
            f"no variances given, and {H.shape[1]} lines are too few to estimate them; at least 8 are needed"
        )
    # whichever varies less around a line; chosen line by line, the smaller of two would be too small
    plain, beside = third_difference(H), third_difference(H - predicted)
    around = [uniform_filter1d(e, AROUND, axis=1, mode="nearest") for e in (plain, beside)]
    rough = np.where(around[0] <= around[1], plain, beside)
    variance = smoothed(rough, H, predicted, 2.0, clip=5.0)
    return Noise(np.sqrt(variance), "no variances given; estimated from the scatter between neighbouring lines", 2.0)


def third_difference(H: np.ndarray) -> np.ndarray:
    """Squared third differences, centred, scaled to the variance of white noise."""
    lines = H.shape[1]
    e = sum(c * H[:, k : lines - 3 + k] for k, c in enumerate(THIRD))
    square = np.abs(e) ** 2
    return np.concatenate([square[:, :1], square, square[:, -1:], square[:, -1:]], axis=1)


def scatter_freedom(variance: np.ndarray) -> float:
    """Degrees of freedom that the scatter of log variances between neighbouring lines stands for."""
    if variance.shape[1] < 8:
        return np.inf
    log_v = np.log(np.maximum(variance, 1e-300))
    e = sum(c * log_v[:, k : log_v.shape[1] - 3 + k] for k, c in enumerate(THIRD))
    spread = float((np.median(np.abs(e)) / 0.6745) ** 2)
    grid = np.geomspace(1.0, 2 * ENOUGH, 400)
    return float(np.interp(-spread, -scipy.special.polygamma(1, grid / 2), grid)) if spread > 2 / ENOUGH else np.inf


def smoothed(
    variance: np.ndarray, H: np.ndarray, predicted: np.ndarray, freedom: float, clip: float | None = None
) -> np.ndarray:  # fmt: skip
    """Variances fitted over all lines of each channel.

    Parameters
    ----------
    variance
        Line by line, shape ``(run, f, o, i)``, each with ``freedom`` degrees of freedom.
    predicted
        What the simulation expects, of the same shape.
    clip
        Ratio to the fit beyond which a line counts no further (what is no noise must not raise the estimate).
    """
    lines, level = variance.shape[1], np.mean(np.abs(H) ** 2, axis=1, keepdims=True)
    # no variance is nothing at all: data may be free of noise, or a channel dead
    variance = np.maximum(variance, FLOOR**2 * np.maximum(level, 1e-12 * level.max()) + 1e-280)
    size = uniform_filter1d(np.abs(H) ** 2, 3, axis=1, mode="nearest")
    shapes = [size, np.broadcast_to(np.abs(predicted) ** 2, H.shape)]
    if len(H) > 1:  # the other runs show narrow peaks as they are, and do not share a run's own errors
        square = np.abs(H) ** 2
        shapes.append((square.sum(axis=0, keepdims=True) - square) / (len(H) - 1))
    basis = [np.ones_like(size), *(x / np.maximum(x.mean(axis=1, keepdims=True), 1e-300) for x in shapes)]
    width = int(np.clip(round(SMOOTHED / freedom), 7, max(7, lines // 3))) | 1
    value, fit, course, given = variance, variance, np.ones((1, lines, 1, 1)), clip is None
    for k in range(ROUNDS):
        beside = [course * basis[0], *basis[1:]]
        told = beside if given else [correlate1d(g, THIRD**2, axis=1, mode="nearest", origin=-1) for g in beside]
        parts, model = _parts(value, told, 0.0 if given else TIED)
        slow = uniform_filter1d(value / model, width, axis=1, mode="nearest")
        fit = slow * sum(a * g for a, g in zip(parts, beside, strict=True))
        if clip is not None:
            value = np.minimum(variance, clip * slow * model)
        over = (0, 3) if given and k >= ROUNDS // 2 else (0, 2, 3)
        course = _course(value / model, parts[0] * told[0] / model, course, over, GIVEN if given else SHARED)
    if clip is not None:
        fit = fit * (1 + DEPENDENT * (1 / width + 2 / lines))
    else:
        # of a mean of n chi-squares of this many degrees of freedom each, 1/variance is n f / (n f - 2) times too large
        fit = fit * (1 + 2 / freedom * (1 / width + 2 / lines))
        # a line whose own estimate is far above the smooth one knows something that the smooth one does not; far below,
        # it bounds the variance, and is not believed itself, which would be the smallest of thousands
        high = scipy.special.gammainccinv(freedom / 2, RARE) * 2 / freedom
        low = scipy.special.gammaincinv(freedom / 2, SMALL) * 2 / freedom
        fit = np.minimum(np.where(variance > high * fit, variance, fit), variance / low)
    return fit


def _course(ratio: np.ndarray, share: np.ndarray, course: np.ndarray, over: tuple[int, ...], about: int) -> np.ndarray:
    """Course over frequency of the noise that does not follow the response, the same along the axes ``over``.

    The multiplicative update for chi-square scatter (Fevotte, Bertin and Durrieu 2009, Neural Computation 21:793),
    single lines of ``about`` left out. ``ratio`` is that of the variances to the model, ``share`` the part of this
    noise in it.
    """
    told = (share * ratio).sum(axis=over, keepdims=True) / np.maximum(share.sum(axis=over, keepdims=True), 1e-300)
    line = median_filter(np.log(np.maximum(course * told, 1e-300)), (1, about, 1, 1), mode="nearest")
    smooth = uniform_filter1d(line, about // 2, axis=1, mode="nearest")
    return np.exp(smooth - smooth.mean(axis=1, keepdims=True))


def _parts(
    value: np.ndarray, basis: list[np.ndarray], tied: float, rounds: int = 60
) -> tuple[list[np.ndarray], np.ndarray]:
    """Non-negative parts of a variance by maximum likelihood for chi-square scatter, and their sum (same source).

    The share of the first part, in the mean over runs and channels, counts as ``tied`` lines on which there is nothing
    else: few lines, those at an antiresonance, tell how small it is, and one channel's may be nothing by chance.
    """
    mean = np.maximum(value.mean(axis=1, keepdims=True), 1e-290)
    along = lambda x: np.ascontiguousarray(np.moveaxis(x, 1, -1))
    told = along(value / mean)  # squares of the smallest variances would be nothing
    each = np.stack([along(np.broadcast_to(g, value.shape)) for g in basis])
    parts = np.full((len(basis), *told.shape[:-1]), 1 / len(basis))
    model = np.einsum("p...,p...f->...f", parts, each)
    for _ in range(rounds):
        inverse = 1 / model
        up = np.einsum("p...f,...f->p...", each, told * inverse**2)
        down = np.einsum("p...f,...f->p...", each, inverse)
        if tied:
            first = np.maximum(parts[0], 1e-12)
            up[0] += tied * first.mean() / first**2
            down[0] += tied / first
        parts = parts * np.sqrt(up / np.maximum(down, 1e-300))
        model = np.maximum(np.einsum("p...,p...f->...f", parts, each), 1e-12)
    return [a[:, None] * mean for a in parts], np.moveaxis(model, -1, 1) * mean
