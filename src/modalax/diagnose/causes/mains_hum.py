r"""Mains hum: lines at 50 or 60 Hz and its multiples where the residual is larger than the noise allows.

Each sample there has its own hum, or all have that of one source (:mod:`.hum_pickup`), whichever explains more.
"""

from typing import Any

import numpy as np

from modalax.diagnose.causes.base import LinesCause
from modalax.diagnose.causes.hum_pickup import pickup
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import HumLines

MAINS = (50.0, 60.0)  # Hz
DRAWS = 1000  # draws of noise alone, with which hum is compared
FEW_LINES = 16  # lines away from hum, of which fewer say nothing about how uneven the noise is
REACHES = (0.5, 1.5, 2.5)  # distances, in line spacings, into which hum may leak


class MainsHum(LinesCause):
    r"""Narrow lines at 50 or 60 Hz and multiples: there the error has variance :math:`\sigma^2(1 + \tau^2)`."""

    slug = "mains_hum"
    advice = "record a run without force"
    summary = "narrow lines at the mains frequency and its multiples"
    parameters = (Parameter("relative_amplitude", "-", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Nowhere in particular, if there are lines that such hum reaches."""
        return [Place((), (int(f), -1, 0)) for f in MAINS if self.lines(scene.freq, f, REACHES[0])]

    def lines(self, freq: np.ndarray, fundamental: float, reach: float) -> list[np.ndarray]:
        """Lines within ``reach`` line spacings of each multiple."""
        step = np.gradient(freq) if len(freq) > 1 else np.ones(1)
        top = int(freq[-1] * 1.002 // fundamental)
        sets = []
        for k in range(1, top + 1):
            # mains frequency strays by a few parts in ten thousand
            near = np.flatnonzero(np.abs(freq - k * fundamental) <= reach * step + 5e-4 * k * fundamental)
            if len(near):
                sets.append(near)
        return sets

    def explain(
        self, freq: np.ndarray, fundamental: float, residual: np.ndarray, live: np.ndarray, known: float = np.inf
    ) -> HumLines:
        """Best reach and sizes for whitened residuals.

        Parameters
        ----------
        residual
            Whitened, complex, shape ``(column, o, f)``, a column an input of a run; both parts have unit variance
            under noise alone.
        live
            Which samples count, same shape.
        known
            Degrees of freedom to which the variance of each channel is known.
        """
        if not self.lines(freq, fundamental, REACHES[0]):
            return HumLines(np.zeros(len(freq), bool), 0.0, 1.0, 0.0, fundamental, 1.0)
        shaped, residual, live = (residual, live), _flat(residual), _flat(live)
        power = (np.abs(residual) ** 2 * live).sum(axis=0)[None]
        count = 2 * live.sum(axis=0)
        tried = [(near, _raised(power, count, near)) for near in (self.lines(freq, fundamental, r) for r in REACHES)]
        worth = [_worth(*t)[0] for t in tried]
        sets, gains = tried[int(np.argmax(worth))]
        chosen = [near for near, gain in zip(sets, gains, strict=True) if gain[0] > 0]
        gain, p_value = float(sum(g[0] for g in gains)), 1.0
        uneven = _unevenness(power[0], count, np.concatenate([np.concatenate(near) for near, _ in tried]))
        if chosen:
            noise = _null(count, uneven)
            p_value = _tail(
                max(worth), np.max([_worth(near, _raised(noise, count, near)) for near, _ in tried], axis=0)
            )
        source = pickup(freq, fundamental, *shaped, uneven, known, _tail)
        if sum(source.gains) > gain:
            chosen, gain = source.sets, sum(source.gains)
        mask = np.zeros(len(freq), bool)
        if not chosen:
            return HumLines(mask, 0.0, 1.0, 0.0, fundamental, 1.0)
        mask[np.concatenate(chosen)] = True
        top = max(float((power[0, mask] / np.maximum(count[mask], 1)).max() - 1), 0.0)
        p_value = min(1.0, 2 * min(p_value, source.p_value))
        return HumLines(mask, -gain, float(mask.sum()), float(np.sqrt(top)), fundamental, p_value)

    def told(self, lines: HumLines) -> dict[str, tuple[Any, str]]:
        """The fundamental."""
        return {"frequency": (lines.frequency, "Hz")}


def hums(frequency: float, damping_ratio: float, freq: np.ndarray) -> bool:
    """Whether a mode is narrower than the lines [Hz] can show, and peaks where a multiple of a mains frequency does."""
    near = int(np.abs(freq - frequency).argmin())
    if len(freq) < 3 or 2 * damping_ratio * frequency > 0.5 * np.gradient(freq)[near]:
        return False
    reached = [k for mains in MAINS for k in MainsHum().lines(freq, mains, REACHES[0])]
    return any(near in lines for lines in reached)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(-1, x.shape[-1])


def _unevenness(power: np.ndarray, count: np.ndarray, near: np.ndarray) -> float:
    """Variance of how well the noise of a line is known, from the lines away from hum.

    Known variances leave a scatter of 2/n there; what lies beyond that, and beyond what chance makes of it, is this.
    """
    n = np.maximum(count, 1)
    away = np.setdiff1d(np.flatnonzero(count > 0), near)
    if len(away) < FEW_LINES:
        return 0.0
    more = float(np.var(power[away] / n[away]) - np.mean(2 / n[away]))
    return max(more - float(np.mean(2 / n[away])) * float(np.sqrt(2 / len(away))), 0.0)


def _null(count: np.ndarray, uneven: float) -> np.ndarray:
    """Draws of the sums of squares under noise alone, as uneven from line to line as away from the lines of hum."""
    rng = np.random.default_rng(0)
    draws = rng.chisquare(np.maximum(count, 1), (DRAWS, len(count))) * (count > 0)
    return draws * rng.gamma(1 / uneven, uneven, draws.shape) if uneven > 0 else draws


def _raised(power: np.ndarray, count: np.ndarray, sets: list[np.ndarray]) -> list[np.ndarray]:
    r"""What hum of its own size at each line explains, :math:`n(\tau^2 - \ln(1 + \tau^2))`, for each set of lines.

    0 where that is too little to count, or where the lines beside are raised as well: a resonance is, hum through a
    window is not. ``power`` holds the sums of squares over the ``count`` samples of each line, shape ``(draw, f)``.
    """
    lines = len(count)
    more = power / np.maximum(count, 1) - 1
    tau2 = np.maximum(more, 0.0)
    each = count * (tau2 - np.log1p(tau2))
    out = []
    for near in sets:
        gain = each[:, near].sum(axis=1)
        beside = [k for k in (*range(near[0] - 6, near[0] - 1), *range(near[-1] + 2, near[-1] + 7)) if 0 <= k < lines]
        around = int(count[beside].sum())
        if around:
            excess = power[:, beside].sum(axis=1) / around - 1
            wide = excess > 0.1 * tau2[:, near].max(axis=1) + 3 / np.sqrt(around / 2)
            gain = np.where(wide, 0.0, gain)
        out.append(np.where(gain > 4.0 * len(near), gain, 0.0))
    return out


def _worth(sets: list[np.ndarray], gains: list[np.ndarray]) -> np.ndarray:
    """Gain of all sets less two for each line."""
    return np.sum([g - 2.0 * len(near) * (g > 0) for near, g in zip(sets, gains, strict=True)], axis=0)


def _tail(value: float, null: np.ndarray) -> float:
    """Chance that a draw of the null exceeds a value; beyond the draws, its tail falls as that of a chi-square."""
    high = float(np.quantile(null, 0.95))
    beyond = null[null > high] - high
    if value <= high or not len(beyond):
        rare = 1 / len(null) if not len(beyond) else 1.0
        return float(max((null >= value).mean(), rare * np.exp(-0.5 * max(value - high, 0.0))))
    return float(len(beyond) / len(null) * np.exp(-(value - high) / max(float(beyond.mean()), 2.0)))
