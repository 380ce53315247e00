"""A measurement as its own modes: noise, runs brought together where they are alike, modes and features."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage
import scipy.stats

from modalax.data import Measurement
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.modal_domain.modes.bent_peaks import bent, one_each, widened
from modalax.diagnose.modal_domain.modes.beside_band import with_modes_beside
from modalax.diagnose.modal_domain.modes.features import Features, chosen, features_of, shapes_shown, sure
from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, refine
from modalax.diagnose.modal_domain.modes.mode_count import MOST, blind_modes, cost_of_mode, heavy, misfit, mode_gains
from modalax.diagnose.modal_domain.modes.repeated import close_pairs, of_rank, reach, twofold
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, modes_of
from modalax.diagnose.setup.noise import Noise, noise_of, third_difference
from modalax.identify.shared_noise import shared_noise

BELOW, ABOVE = 2, 3  # modes of the simulation on either side of the band that stand for all beyond it
ASIDE = 0.1  # distance of these from the band, relative to its ends
EDGE = 0.003  # part of the band's ends by which a mode that is compared may lie outside
ALIKE = 5.0  # standard deviations of chi-square by which runs may differ and still count as alike
OFF = 1.3  # factor by which variances that were estimated may be too small at some lines
DOUBLED = 0.02  # part of a pole's energy from which on what is no shape times a participation is a second mode
UNDERSTATED = 1.5  # chi-square per sample about a line from which stated variances may be too small there
INDEPENDENT = 0.9, 1.15  # scatter between lines over what modes leave where that is noise: 1 if white, 0 if smooth
AROUND_LINE = 15  # lines that tell of the noise about one, and twice as many are needed
EXPLAINED = 1.1  # chi-square per sample up to which modes explain the data
DISTORTED = 2.0  # chi-square per sample that modes leave of the lowest level from which on the highest is tried,
CLEARLY = 1.5  # which is taken where they leave so many times less of it
TIMES, MORE = 2, 12  # most modes in the band: so many times those of the simulation, and more
UNLIKE = 1e-6  # chance under noise below which runs differ at three neighbouring lines, as where a peak is bent


@dataclass(frozen=True)
class Measured:
    """What was measured, identified without the simulation.

    Attributes
    ----------
    freq
        Lines that were used [Hz], shape ``(f,)``.
    noise
        Standard deviations of every sample.
    channels
        The FRFs that were identified, runs averaged.
    modes
        Modes found.
    misfit
        Chi-square per sample that the modes leave; at least 1.
    features
        Of the modes that are known well enough.
    runs
        Which runs went into it; fewer than all where they differ by more than their noise.
    unlike
        Chi-square per sample of the runs about their mean; 1 under noise.
    shared
        By how much noise that the outputs share counts more than as much of each output's own; 1 where none is shared.
        Modes know of it, single lines do not.
    apart
        Whether close modes that are known one by one are told so.
    most
        How many modes there may be.
    """

    freq: np.ndarray
    noise: Noise
    channels: Channels
    modes: Projected
    misfit: float
    features: Features
    runs: np.ndarray
    unlike: float
    shared: float = 1.0
    apart: bool = False
    most: int = MOST


def identify(measurement: Measurement, c: Coordinates | None) -> Measured:
    """Identify a measurement (no line at 0 Hz) blind; the simulation only stands for the modes beyond the band.

    Of force levels that differ it is the lowest, at which stops are open and springs do not slip; or the highest, where
    runs differ less there and modes leave less: friction holds at low levels and slips freely at high ones.

    Raises ``ValueError`` where no mode stands out of the noise.
    """
    lowest = _identified(measurement, c)
    if lowest.misfit < DISTORTED or not settles(np.asarray(measurement.H), np.asarray(measurement.level)):
        return lowest
    highest = _identified(measurement, c, highest=True)
    return highest if CLEARLY * highest.misfit < lowest.misfit else lowest


def settles(H: np.ndarray, level: np.ndarray) -> bool:
    """Whether runs ``(run, f, o, i)`` differ less from level to level the higher the level [N] is, of three or more.

    As where friction slips freely in the end; what stiffens or drags changes ever more.
    """
    force = np.unique(level[np.isfinite(level)])
    if len(force) < 3 or not np.isfinite(level).all() or force[0] <= 0:
        return False
    mean = [H[level == f].mean(axis=0) for f in force]
    steps = [np.linalg.norm(mean[k + 1] - mean[k]) / np.log(force[k + 1] / force[k]) for k in range(len(force) - 1)]
    return bool(steps[-1] < steps[0])


def _most(c: Coordinates | None, channels: Channels) -> int:
    """How many modes a measurement may have: of a joint that bends peaks ever more poles describe a little more."""
    if c is None:
        return MOST
    low, high = np.abs(channels.s[[0, -1]])
    inside = int(np.count_nonzero((c.frequencies > low) & (c.frequencies < high)))
    return min(MOST, TIMES * inside + MORE)


def _identified(measurement: Measurement, c: Coordinates | None, highest: bool = False) -> Measured:
    H, order = np.asarray(measurement.H), DERIVATIVES[measurement.form]
    channels, noise, runs, unlike = prepared(measurement, c, highest)
    most = _most(c, channels)
    modes = blind_modes(channels, at_most=most)
    beside = with_modes_beside(modes, channels)
    if beside is not channels:
        channels, modes = beside, blind_modes(beside, modes.poles, most)
    s, outside = channels.s, channels.outside
    made = modes.made(channels).reshape(H.shape[1:])
    scattered = too_small(modes, channels)
    if scattered is not None:
        noise = _by_scatter(measurement, made, scattered)
        channels = channels_of(s, H[runs], noise.sigma[runs], order, outside)
        modes = blind_modes(channels, at_most=most)
        made = modes.made(channels).reshape(H.shape[1:])
    if np.isfinite(noise.freedom):  # noise that was estimated is known better beside what is no noise
        noise = noise_of(measurement, made) if scattered is None else _by_scatter(measurement, made, scattered)
        channels = channels_of(s, H[runs], noise.sigma[runs], order, outside)
        modes = blind_modes(channels, modes.poles, most)
    shared = _shared(modes, channels, H.shape[2:])
    if shared > 1.0:  # each output tells less of a mode than it seems to
        channels = channels_of(s, H[runs], noise.sigma[runs] * np.sqrt(shared), order, outside)
        modes = blind_modes(channels, modes.poles, most)
    modes = one_each(modes, channels)
    if not len(modes.poles):
        raise ValueError("no mode stands out of the noise in the band")
    left, features = _features(modes, channels, H.shape[2:])
    freq = np.asarray(measurement.freq)
    return Measured(freq, noise, channels, modes, left, features, runs, unlike, shared, most=most)


def too_small(modes: Projected, channels: Channels) -> float | None:
    r"""How many times larger than stated the noise is on the lines where it surely is larger; None if on none.

    What modes leave is noise only as far as neighbouring lines are off independently of each other: then third
    differences, which smooth curves have none of, are as large as it, on all samples and on the smaller ones alone.
    The traces of a joint or of a record are curves, sharp peaks with too few lines a few large samples, and hum is on
    single lines, of which differences reach the neighbours too. With the residual r of modes over the stated deviation
    and its third differences, scaled to the variance of white noise, it is the ratio
    :math:`\sum|\Delta^3r|^2/\sum|r|^2` that tells, and the answer is the mean of :math:`|r|^2` there.
    """
    residual = np.sqrt(channels.weight / 2) * (channels.data - modes.made(channels))
    rough, whole = third_difference(residual[None])[0], np.abs(residual) ** 2
    line = scipy.ndimage.uniform_filter1d(whole.mean(axis=1), AROUND_LINE, mode="nearest")
    some = line > UNDERSTATED
    if np.count_nonzero(some) < 2 * AROUND_LINE:
        return None
    rough, whole = rough[some], whole[some]
    most = np.quantile(whole, 0.99)
    scatter = [float(np.minimum(rough, m).mean() / np.minimum(whole, m).mean()) for m in (np.inf, most)]
    white = INDEPENDENT[0] < min(scatter) and max(scatter) < INDEPENDENT[1]
    return float(whole.mean()) if white else None


def _by_scatter(measurement: Measurement, made: np.ndarray, times: float) -> Noise:
    """Noise read off the lines, where the variances that are stated are too small."""
    noise = noise_of(measurement.replace(variance=None, coherence=None), made)
    source = (
        f"the variances as given are too small, where they are by a factor of {times:.2g}: what modes leave scatters "
        "by as much from line to line; the noise is taken from that scatter instead"
    )
    return replace(noise, source=source)


def _shared(modes: Projected, channels: Channels, shape: tuple[int, ...]) -> float:
    """By how much noise that the outputs share counts more than as much of each output's own."""
    made, root = modes.made(channels), np.sqrt(channels.weight / 2)
    response, residual = (a.reshape(-1, *shape) for a in (root * made, root * (channels.data - made)))
    return shared_noise(response, residual)


def prepared(
    measurement: Measurement, c: Coordinates | None, highest: bool = False
) -> tuple[Channels, Noise, np.ndarray, float]:  # fmt: skip
    """FRFs to identify, their noise before any mode is known, the runs in them, and how unlike all runs are."""
    freq, H = np.asarray(measurement.freq), np.asarray(measurement.H)
    order = DERIVATIVES[measurement.form]
    s = 2j * np.pi * freq
    outside = np.zeros(0, complex) if c is None else _outside(c, abs(s[0]), abs(s[-1]))
    noise = noise_of(measurement, _first_guess(measurement, H))
    runs, unlike = alike_runs(H, noise.sigma, np.asarray(measurement.level), highest)
    channels = channels_of(s, H[runs], noise.sigma[runs], order, outside)
    return channels, noise, runs, unlike


def reidentified(measured: Measured, H: np.ndarray, error: np.ndarray) -> Measured:
    """The same runs identified again, from FRFs ``(run, f, o, i)`` with something taken out.

    ``error`` is the standard deviation of what was taken out of these runs.
    """
    c, sigma = measured.channels, measured.noise.sigma[measured.runs] * np.sqrt(measured.shared)
    sigma = np.where(sigma > 0, np.hypot(sigma, error), 0.0)
    channels = channels_of(c.s, H[measured.runs], sigma, c.order, c.outside)
    modes = one_each(blind_modes(channels, measured.modes.poles, measured.most), channels)
    left, features = _features(modes, channels, H.shape[2:], measured.apart)
    return replace(measured, channels=channels, modes=modes, misfit=left, features=features)


def features_beside(measured: Measured, H: np.ndarray) -> np.ndarray:
    """Features of the same modes, shape ``(k, width)``, in FRFs ``(run, f, o, i)`` that differ a little."""
    c, f = measured.channels, measured.features
    sigma = measured.noise.sigma[measured.runs] * np.sqrt(measured.shared)
    channels = channels_of(c.s, H[measured.runs], sigma, c.order, c.outside)
    assert f.origin is not None
    modes, _ = twofold(refine(measured.modes.poles, channels), channels, f.origin.twice)
    residues = modes.residues.reshape(len(modes.poles), *f.units.shape[1:])
    poles, residues = f.origin.together.seen(f.along, modes.poles, residues)
    return f.predicted(poles, residues / f.units)


def _features(
    modes: Projected, channels: Channels, shape: tuple[int, ...], apart: bool = False
) -> tuple[float, Features]:
    """Misfit of modes, and the features of those that are known well enough and inside the band."""
    left, s = misfit(modes, channels), channels.s
    features, several = features_at(modes, channels, shape, left, apart)
    size = np.abs(features.poles)
    known = sure(features) & ~heavy(features.poles) & (size > abs(s[0]) * (1 - EDGE)) & (size < abs(s[-1]) * (1 + EDGE))
    return left, chosen(widened(features, modes, channels), known & ~several)


def told_one_by_one(measured: Measured) -> Measured | None:
    """The same with the features of each mode that is known by itself, however close others are.

    None where no mode is told together with another that it could be told from.
    """
    features = measured.features
    left, apart = _features(measured.modes, measured.channels, features.units.shape[1:], apart=True)
    more = int(np.count_nonzero(~apart.grouped)) > int(np.count_nonzero(~features.grouped))
    return replace(measured, misfit=left, features=apart, apart=True) if more else None


def features_at(
    modes: Projected, channels: Channels, shape: tuple[int, ...], left: float, apart: bool = False
) -> tuple[Features, np.ndarray]:
    """Features of all modes, and which of them are more of one frequency than can be told.

    ``apart``: whether close modes that are known one by one are told so.
    """
    plain = np.flatnonzero(~heavy(modes.poles) & ~bent(modes, channels))
    close = [tuple(plain[list(two)].tolist()) for two in close_pairs(modes.poles[plain])]
    rank, alone = together(modes, channels, shape), np.ones(len(modes.poles), bool)
    unsure = ~sure(features_of(modes, shape[0], shape[1], left, directions=1)) if close else alone
    alone[[k for two in close for k in two]] = False
    for k in plain[(alone & (unsure | (rank > 1)))[plain]]:  # what is left beside two is part of what they make
        near = [abs(modes.poles[list(some)].mean() - modes.poles[k]) for some in close]
        if near and min(near) < reach(modes.poles[k]):
            close[int(np.argmin(near))] += (int(k),)
            alone[k] = False
    twice = alone & (rank == 2)
    split, touching = twofold(modes, channels, twice)
    number = np.arange(len(twice)) + np.cumsum(twice) - twice  # of each pole once others are two
    # fewer are told of them together only where one by one they are not known, and as close as one mode is wide
    shown, poles = shapes_shown(modes, shape[0], shape[1], close), (modes.poles[list(k)] for k in close)
    lost = [unsure[list(k)].any() and np.ptp(np.abs(p)) < reach(p).min() for k, p in zip(close, poles, strict=True)]
    some = [k for k, n, one in zip(close, shown, lost, strict=True) if n >= len(k) or one]
    some = [k for k in some if not apart or unsure[list(k)].any()]
    f = features_of(split, shape[0], shape[1], left, touching + [tuple(number[list(k)].tolist()) for k in some])
    assert f.origin is not None
    several = np.repeat(alone & (rank > 2), 1 + twice)[f.origin.together.pairs]
    return replace(f, origin=replace(f.origin, twice=twice)), several


def together(modes: Projected, channels: Channels, shape: tuple[int, ...]) -> np.ndarray:
    """How many modes of one frequency each pole stands for: its residues are a sum of so many of a single mode; to 3.

    The sum that is nearest by their uncertainties: residues of channels where other modes are large say little.
    More than one only where modes explain the data: a peak that a joint bends by the force that moves it has residues
    of its own for each input.
    """
    left, rank = misfit(modes, channels), np.ones(len(modes.poles), int)
    raw, variance = (a.reshape(-1, *shape) for a in (modes.residues, modes.variance))
    least = np.maximum(cost_of_mode(channels) * left, DOUBLED * mode_gains(modes))
    for few in range(1, min(3, *shape) if left < EXPLAINED else 1):
        plain = modes.residues - of_rank(raw, variance, few).reshape(modes.residues.shape)
        rank += (rank == few) & (mode_gains(replace(modes, residues=plain)) > least)
    return rank


def _first_guess(measurement: Measurement, H: np.ndarray) -> np.ndarray:
    """What noise is estimated beside at first: the mean of the runs where variances are known, else nothing."""
    if measurement.variance is None and measurement.coherence is None:
        return np.zeros(H.shape[1:], complex)
    return H.mean(axis=0)


def _outside(c: Coordinates, low: float, high: float) -> np.ndarray:
    poles = modes_of(c).poles
    poles = poles[np.abs(poles) < c.end]
    size = np.abs(poles)
    below, above = poles[size < low * (1 - ASIDE)], poles[size > high * (1 + ASIDE)]
    return np.concatenate([below[-BELOW:], above[:ABOVE]])


def channels_of(s: np.ndarray, H: np.ndarray, sigma: np.ndarray, order: int, outside: np.ndarray) -> Channels:
    """Runs averaged by their variances; samples of a standard deviation of 0 are left out."""
    weight = np.where(sigma > 0, 1 / np.maximum(sigma, 1e-150) ** 2, 0.0)
    total = weight.sum(axis=0)
    mean = (weight * H).sum(axis=0) / np.maximum(total, 1e-300)
    flat = (len(s), -1)
    return Channels(s, mean.reshape(flat), 2 * total.reshape(flat), order, outside)


def alike_runs(
    H: np.ndarray, sigma: np.ndarray, level: np.ndarray, highest: bool = False
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Runs that may be averaged, and how far all disagree: all where they agree, else those of the lowest level.

    Or of the highest. The first alone where those disagree as well.
    """
    runs = len(H)
    every = np.arange(runs)
    if runs == 1:
        return every, 1.0
    weight = 1 / np.maximum(sigma, 1e-300) ** 2
    mean = (weight * H).sum(axis=0) / weight.sum(axis=0)
    lines = 2 * (weight * np.abs(H - mean) ** 2).sum(axis=(0, 2, 3))
    chi2, own = float(lines.sum()), 2 * (runs - 1) * mean[0].size
    freedom = own * len(lines)
    excess = (chi2 - freedom) / np.sqrt(2 * freedom)
    somewhere = scipy.ndimage.median_filter(lines, 3) > OFF * scipy.stats.chi2.isf(UNLIKE / len(lines), own)
    if not somewhere.any() and (excess < ALIKE or chi2 < 1.05 * freedom):
        return every, chi2 / freedom
    end = np.nan if not np.isfinite(level).any() else np.nanmax(level) if highest else np.nanmin(level)
    some = every[level == end] if np.isfinite(end) else every[:1]
    if len(some) > 1:
        some = some[alike_runs(H[some], sigma[some], np.full(len(some), np.nan))[0]]
    return some, chi2 / freedom
