r"""Records that ended before the response had decayed, told by the FRFs alone, and taken out of them.

Through a record of length T each mode keeps its pole and its residue; only its kernel is another
(:mod:`modalax.diagnose.modal_domain.modes.windows`). Where lines lie closer than :math:`1/T`, the inverse transform of
the FRFs over the band ends at T. The modes are identified through each window of that length; one that leaves no more
than noise is what happened. Lines :math:`1/T` apart do not show an end, and nothing is said of them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize

from modalax.data import Measurement
from modalax.diagnose.causes.records import Leakage
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, project, refine
from modalax.diagnose.modal_domain.modes.measured import prepared
from modalax.diagnose.modal_domain.modes.mode_count import blind_modes, misfit
from modalax.diagnose.modal_domain.modes.windows import KINDS, Window
from modalax.diagnose.modal_domain.records.forced import Forced
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.thresholds import THRESHOLDS

NEAR, FAR = 2, 6  # samples of the inverse transform beside an end that are compared: beyond its blur, and up to
ENDS = 10.0  # ratio of these from which a record may end there; decays and noise of sound FRFs give less than half
EVEN = 0.01  # relative scatter of the spacing of lines that are even
WANDER = 2.0  # samples of the inverse transform about an end within which its length is sought
FINE, TURNS = 0.1, 3  # step of the lengths tried, in samples, and turns of refining poles and length
BEYOND = 0.1  # standard deviation of a length, in samples, by modes beyond the band that were cut off as well
STRONG = 3  # channels that lengths are tried by
FEW = 6  # steps of a refinement within these
DECAYS = 4.0  # of an exponential window within a record, so that its end does not show
ROUGH = 0.02  # error of FRFs, relative to their root mean square, up to which poles are identified to begin with
LIGHT = 1e-3  # least damping ratio of a pole to begin with
ROUNDING = 0.5  # chi-square per sample below which modes that hardly differ in a record that short fit by rounding
STEP = 0.05  # of such a sample, in which the slope of chi-square is taken


@dataclass(frozen=True)
class ShortRecord(Change):
    """A record of a length [s], seen through a window."""

    window: Window = Window("cut", math.inf)
    std: float = 0.0

    @property
    def sized(self) -> bool:
        """Its length was found before."""
        return False

    @property
    def variant(self) -> int:
        """Number of the window in the catalogue."""
        return KINDS.index(self.window.kind)

    @property
    def in_catalogue(self) -> Leakage:
        """The same line by line."""
        return Leakage()

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The length."""
        return {"record_length": {"value": self.window.length, "std": self.std, "unit": "s"}}

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], None]:
        """One over the length."""
        return [1 / self.window.length], [self.std / self.window.length**2], None


def end_of_record(freq: np.ndarray, H: np.ndarray) -> float | None:
    """Time [s] at which FRFs ``(f, channel)`` end in the time domain; None where they last as long as lines tell."""
    apart, n = np.diff(freq), len(freq)
    if n < 8 * FAR or np.ptp(apart) > EVEN * np.median(apart):
        return None
    h = np.fft.ifft(H * np.hanning(n + 2)[1:-1, None], axis=0)  # a window over the band blurs an end little
    power = (np.abs(h) ** 2 / np.maximum((np.abs(H) ** 2).mean(axis=0), 1e-300)).sum(axis=1)
    total = np.concatenate([[0.0], np.cumsum(power)])
    k = np.arange(2 * FAR, n - FAR)
    ratio = (total[k - NEAR] - total[k - FAR]) / np.maximum(total[k + FAR] - total[k + NEAR], 1e-300)
    best = int(np.argmax(ratio))
    return float(k[best] / (n * np.median(apart))) if ratio[best] > ENDS else None


def short_record(
    measurement: Measurement, c: Coordinates, tell: Callable[[str], None]
) -> Forced | None:  # fmt: skip
    """What a record that ended too early adds to the FRFs; None where they do not end, or no window explains it."""
    freq, H = np.asarray(measurement.freq), np.asarray(measurement.H)
    end = end_of_record(freq, H.mean(axis=0).reshape(len(freq), -1))
    if end is None:
        return None
    tell(f"the FRFs end after {end:.3g} s: identifying modes through a record as long")
    channels, _, runs, _ = prepared(measurement, c)
    return record_that_ends(channels, end, H.shape[1:]) if len(runs) == len(H) else None


def record_that_ends(channels: Channels, end: float, shape: tuple[int, ...]) -> Forced | None:
    """What a record that ends there adds to FRFs ``(f, o, i)`` of closer lines; None where no window explains them."""
    found = _at(channels, end)
    if found is None:
        return None
    _, modes, through = found
    if modes.chi2 < ROUNDING * through.data.size:
        return None
    gained = 0.5 * (refine(modes.poles, channels, FEW).chi2 - modes.chi2)
    if misfit(modes, through) > THRESHOLDS.as_noise or gained < THRESHOLDS.further_cause:
        return None
    band = float(np.ptp(np.abs(channels.s))) / 2 / np.pi
    std = math.hypot(_error(modes, through, band), BEYOND / band)
    return _told(found, gained, std, shape)


Found = tuple[Window, Projected, Channels]


def _told(found: Found, gained: float, std: float, shape: tuple[int, ...]) -> Forced:
    window, modes, through = found
    whole = replace(through, window=Window(window.kind, math.inf))
    effect = modes.made(through) - modes.made(whole)
    cause = ShortRecord("leakage", (), window=window, std=std)
    return Forced(cause, np.zeros(1), np.zeros((1, 1)), 1.0, gained, (), effect.reshape(shape))


def _at(channels: Channels, end: float) -> Found | None:
    """Windows of a record that ends where the FRFs do in the time domain."""
    freq = np.abs(channels.s) / 2 / np.pi
    sample = 1 / (len(freq) * float(np.median(np.diff(freq))))
    poles = _decayed(channels, end)
    if not len(poles):
        return None
    lengths = end + sample * np.arange(-FAR - WANDER, WANDER, FINE)  # the whole of its blur is left out after an end
    few, found = strongest(channels), []
    for kind in KINDS:
        windows = [Window(kind, length) for length in lengths]
        left = [project(poles, replace(few, window=window))[0].chi2 for window in windows]
        found.append(_settled_length(windows[int(np.argmin(left))], poles, channels, sample))
    window, modes, through = min(found, key=lambda trial: trial[1].chi2)
    return _settled_length(window, blind_modes(through, modes.poles).poles, channels, sample)


def strongest(channels: Channels) -> Channels:
    """The channels of the largest response over its noise."""
    size = (channels.weight * np.abs(channels.data) ** 2).sum(axis=0)
    most = np.argsort(-size)[:STRONG]
    return replace(channels, data=channels.data[:, most], weight=channels.weight[:, most])


def _decayed(channels: Channels, end: float) -> np.ndarray:
    r"""Poles of FRFs that an exponential window makes decay before the record ends, its decay taken out of them."""
    freq, decay = np.abs(channels.s) / 2 / np.pi, DECAYS / end
    t = np.arange(len(freq)) / (len(freq) * float(np.median(np.diff(freq))))
    data = np.fft.fft(np.fft.ifft(channels.data, axis=0) * np.exp(-decay * t)[:, None], axis=0)
    weight = np.broadcast_to(1 / np.maximum((np.abs(data) ** 2).mean(axis=0) * ROUGH**2, 1e-300), data.shape)
    poles = blind_modes(replace(channels, data=data, weight=weight)).poles
    return np.minimum(poles.real + decay, -LIGHT * np.abs(poles)) + 1j * poles.imag


def _settled_length(window: Window, poles: np.ndarray, channels: Channels, sample: float) -> Found:
    """The length of least chi-square near the best of a grid, with the poles moved to it in turns."""
    for _ in range(TURNS):
        poles = refine(poles, replace(channels, window=window), FEW).poles
        far, now = FINE * sample, window
        best = scipy.optimize.minimize_scalar(
            lambda length, now=now, poles=poles: project(
                poles, replace(channels, window=replace(now, length=length))
            )[0].chi2,
            bounds=(window.length - far, window.length + far), method="bounded", options={"xatol": 1e-4 * sample},
        )  # fmt: skip
        window = replace(window, length=float(best.x))
    through = replace(channels, window=window)
    return window, refine(poles, through), through


def _error(modes: Projected, through: Channels, band: float) -> float:
    """Standard deviation of the length, everything else fitted beside it; ``band`` is that of the lines [Hz]."""
    assert through.window is not None
    window, step = through.window, STEP / band

    def left(x: float) -> float:
        moved = replace(through, window=Window(window.kind, window.length + x))
        return refine(modes.poles, moved).chi2

    curvature = (left(step) - 2 * modes.chi2 + left(-step)) / step**2
    return math.sqrt(2 / curvature) if curvature > 0 else math.inf
