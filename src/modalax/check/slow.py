"""Channels that drift: their response grows towards 0 Hz in a way that no structure's does."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import CLEAR, Study

# The lowest octaves, which are examined, must end below this share of the first mode and hold so many lines.
BELOW, LINES = 0.7, 4
# Slope of the accelerance in the lowest octaves and in those above, in powers of frequency: a structure has 0 (free)
# or 2 (held).
SLOPE, NEXT = -0.8, -0.4
# How much steeper than the others a single channel must fall where a free structure could have its slope.
STEEPER = 1.2


def drift(study: Study) -> Iterator[Finding]:
    """Find outputs whose low-frequency lines rise towards 0 Hz."""
    freq = study.freq
    # A drift may look like a mode near 0 Hz; a resonance there is seen by most of the sensors.
    clear = (np.abs(study.residues) > CLEAR * study.residue_std).any(axis=2)
    shared = (clear.mean(axis=1) > 0.5) & (study.modes.width < 0.3 * study.modes.frequency)
    resonances = study.modes.frequency[(study.modes.frequency > 8 * freq[0]) | shared]
    first = float(resonances.min()) if len(resonances) else float(freq[-1])
    span = 4.0 if np.sum(freq < 4 * freq[0]) >= 6 else 8.0
    one = np.flatnonzero(freq < 1.01 * span * freq[0])
    two = np.flatnonzero((freq > 0.49 * span * freq[0]) & (freq < 2.01 * span * freq[0]))
    if min(len(one), len(two)) < LINES or freq[two[-1]] > BELOW * first:
        return
    size = np.sqrt(np.mean(np.abs(study.H) ** 2, axis=(0, 3))) + 1e-300
    slopes = np.stack([_slope(freq, size, lines) for lines in (one, two)]) + 2 - study.power
    told = (slopes[0] < SLOPE) & (slopes[1] < NEXT)
    if len(study.outputs) > 2:
        beside = np.array([np.median(np.delete(slopes[0], k)) for k in range(len(study.outputs))])
        lone = (slopes[0] < beside - STEEPER) & (slopes[1] < beside - STEEPER / 2) & (slopes[0] < 0.4)
        told |= lone
    for k in np.flatnonzero(told).tolist():
        energy = np.abs(study.H[:, :, k]) ** 2
        share = float(energy[:, : two[-1] + 1].sum() / energy.sum())
        yield Finding(
            "drift", (study.outputs[k],), sure=sureness(max(slopes[0, k] / SLOPE, 1.0), 1.0), size=share,
            unit="of the energy",
            evidence=f"below {freq[two[-1]]:.3g} Hz the accelerance goes with f^{slopes[0, k]:.2g}, where a structure "
            f"has f^0 (free) or f^2 (held); {100 * share:.3g} % of the channel's energy lies there",
            advice="leave out the lowest lines, let the sensor settle, or use one that measures down to 0 Hz",
            picture=Picture([(study.outputs[k], freq, size[:, k])], "Frequency [Hz]", "|H|", True),
        )  # fmt: skip


def _slope(freq: np.ndarray, size: np.ndarray, lines: np.ndarray) -> np.ndarray:
    x = np.log(freq[lines])
    x = x - x.mean()
    return x @ np.log(size[lines]) / np.sum(x**2)
