r"""Mains hum: lines at 50 or 60 Hz and its multiples where the residual is larger than the noise allows."""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.causes.base import Cause, Parameter, Place, Scene


@dataclass(frozen=True)
class HumLines:
    """Lines that hum reaches and what it explains.

    Attributes
    ----------
    lines
        Mask over the lines, shape ``(f,)``.
    chi2
        Minus twice the log likelihood of these lines with hum of unknown size and phase, less the constant of the
        noise alone.
    freedom
        Unknown sizes, one a harmonic.
    amplitude
        Spread of the hum over that of the noise at the strongest harmonic.
    frequency
        Fundamental [Hz].
    """

    lines: np.ndarray
    chi2: float
    freedom: float
    amplitude: float
    frequency: float


class MainsHum(Cause):
    r"""Narrow lines at 50 or 60 Hz and multiples: there the error has variance :math:`\sigma^2(1 + \tau^2)`."""

    slug = "mains_hum"
    stage = "lines"
    summary = "narrow lines at the mains frequency and its multiples"
    parameters = (Parameter("relative_amplitude", "-", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Nowhere in particular, if the band holds such a line."""
        low, high = scene.freq[0], scene.freq[-1]
        inside = [f for f in (50.0, 60.0) if np.floor(high * 1.002 / f) * f >= low * 0.998 and high * 1.002 >= f]
        return [Place((), (int(f), -1, 0)) for f in inside]

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

    def explain(self, freq: np.ndarray, fundamental: float, residual: np.ndarray, live: np.ndarray) -> HumLines:
        """Best reach and sizes for whitened residuals.

        Parameters
        ----------
        residual
            Whitened, complex, shape ``(channel, f)``; both parts have unit variance under noise alone.
        live
            Which samples count, same shape.
        """
        best = HumLines(np.zeros(len(freq), bool), 0.0, 1.0, 0.0, fundamental)
        for reach in (0.5, 1.5, 2.5):
            mask, gain, top, count = np.zeros(len(freq), bool), 0.0, 0.0, 0.0
            for near in self.lines(freq, fundamental, reach):
                if _wide(near, residual, live):
                    continue
                # the size falls away from the multiple: each distance has its own
                x2 = np.abs(residual[:, near]) ** 2
                n = 2 * live[:, near].sum(axis=0)
                mean = x2.sum(axis=0) / np.maximum(n, 1)
                tau2 = np.maximum(mean - 1, 0.0)
                more = float((n * (tau2 - np.log1p(tau2))).sum())
                if more > 4.0 * len(near):
                    mask[near] = True
                    gain, top, count = gain + more, max(top, float(tau2.max())), count + len(near)
            if gain - 2 * count > -best.chi2 - 2 * best.freedom:
                best = HumLines(mask, -gain, max(count, 1.0), float(np.sqrt(top)), fundamental)
        return best


def _wide(near: np.ndarray, residual: np.ndarray, live: np.ndarray) -> bool:
    """Whether the lines beside those at a multiple are raised as well: a resonance is, hum through a window is not."""
    lines = residual.shape[1]
    beside = [k for k in (*range(near[0] - 6, near[0] - 1), *range(near[-1] + 2, near[-1] + 7)) if 0 <= k < lines]
    count = int(live[:, beside].sum())
    if count == 0:
        return False
    excess = float((np.abs(residual[:, beside]) ** 2).sum() / (2 * count) - 1)
    inside = (np.abs(residual[:, near]) ** 2).sum(axis=0) / np.maximum(2 * live[:, near].sum(axis=0), 1) - 1
    return bool(excess > 0.1 * max(float(inside.max()), 0.0) + 3 / np.sqrt(count))
