"""Channels that drift: their response grows towards 0 Hz in a way that no structure's does."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import CLEAR, Study

# Octaves from the first line up that are looked at, as many as end below this share of the first mode; lines needed.
OCTAVES, BELOW, LINES = (3, 4, 5), 0.5, 7
# Slope of the accelerance there in powers of frequency (a structure has 0, free, or 2, held), how many standard
# deviations it must be below none, and how much louder the lowest octave is than the highest.
SLOPE, SURE, LOUDER = -0.8, 4.0, 3.0
# How much louder a resonance is than the quietest of the lines below it, in the middle of the outputs.
RISE = 2.0
# How much steeper than the other channels a channel alone must fall, for a slope that a free structure could have.
STEEPER = 1.2


def drift(study: Study) -> Iterator[Finding]:
    """Find outputs whose low-frequency lines rise towards 0 Hz."""
    freq = study.freq
    # What drifts may look like a mode near 0 Hz; a resonance there is seen by most of the sensors, and is narrow.
    clear = (np.abs(study.residues) > CLEAR * study.residue_std).any(axis=2)
    shared = (clear.mean(axis=1) > 0.5) & (study.modes.width < 0.3 * study.modes.frequency) & study.modes.inside
    size = np.sqrt(np.mean(np.abs(study.H) ** 2, axis=(0, 3))) + 1e-300
    size = size * freq[:, None] ** (2 - study.power)
    shared &= _rises_to(study.modes.frequency, freq, size)
    first = float(study.modes.frequency[shared].min(initial=freq[-1]))
    best: dict[int, tuple[float, float, int]] = {}
    for octaves in OCTAVES:
        lines = np.flatnonzero(freq < 1.001 * 2**octaves * freq[0])
        if len(lines) < LINES or freq[lines[-1]] > BELOW * first:
            continue
        slope, std = _slope(freq, size, lines)
        top = freq[lines] > 2 ** (octaves - 1) * freq[0]
        louder = np.median(size[lines[freq[lines] < 2.001 * freq[0]]], axis=0) / np.median(size[lines[top]], axis=0)
        beside = np.array([np.median(np.delete(slope, k)) if len(slope) > 1 else 0.0 for k in range(len(slope))])
        lone = (slope < beside - STEEPER) & (slope < SLOPE / 2) & (len(slope) > 2)
        told = ((slope < SLOPE) | lone) & (slope < -SURE * std) & (louder > LOUDER)
        for k in np.flatnonzero(told).tolist():
            score = float(min(slope[k] / SLOPE, -slope[k] / (SURE * std[k])))
            if k not in best or score > best[k][0]:
                best[k] = score, float(slope[k]), int(lines[-1])
    for k, (score, slope, last) in best.items():
        energy = np.abs(study.H[:, :, k]) ** 2
        share = float(energy[:, : last + 1].sum() / energy.sum())
        yield Finding(
            "drift", (study.outputs[k],), sure=sureness(max(score, 1.0), 1.0), size=share, unit="of the energy",
            evidence=f"below {freq[last]:.3g} Hz the accelerance goes with f^{slope:.2g}, where a structure "
            f"has f^0 (free) or f^2 (held); {100 * share:.3g} % of the channel's energy lies there",
            advice="leave out the lowest lines, let the sensor settle, or use one that measures down to 0 Hz",
            picture=Picture([(study.outputs[k], freq, size[:, k])], "Frequency [Hz]", "Accelerance", True),
            bands=((0.0, float(freq[last])),),
        )  # fmt: skip


def _rises_to(frequency: np.ndarray, freq: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Whether the response rises to each mode from lines below it; what drifts falls all the way."""
    middle = np.median(np.log(size), axis=1)
    lowest = np.minimum.accumulate(middle)
    near = np.searchsorted(freq, frequency).clip(1, len(freq) - 1)
    return np.maximum(middle[near], middle[near - 1]) > np.log(RISE) + lowest[near - 1]


def _slope(freq: np.ndarray, size: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power of frequency that each channel follows, and its standard deviation from the scatter about it."""
    x, y = np.log(freq[lines]), np.log(size[lines])
    x = x - x.mean()
    slope = x @ y / np.sum(x**2)
    left = y - y.mean(axis=0) - x[:, None] * slope
    return slope, np.sqrt(np.sum(left**2, axis=0) / (len(x) - 2) / np.sum(x**2))
