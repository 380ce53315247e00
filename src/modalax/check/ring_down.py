r"""Responses to hits that have not died away when the record ends, each resonance by itself.

A mode loses the same share of its amplitude in equal spans of time. Three windows, each half over the next, cover the
time :math:`T` after a hit. Their middles are :math:`T/4` apart, so powers :math:`P_1, P_2, P_3` of a line at resonance
stand in one ratio, and :math:`P_3/P_1 = e^{-\sigma T}` of the amplitude is left at the end. All modes together would
not tell: the high ones make most of an acceleration and die away first.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.leakage import REMAINDER
from modalax.check.records import Records
from modalax.check.resolution import STRONG

# Power of a resonance in the last window over the median of this many lines on either side: noise, whose power is
# exponentially distributed even where there is one hit only, stays below that.
STANDS_OUT, AROUND = 100.0, 10
# Lines of a window from which on its spectrum shows resonances between noise.
FEWEST = 32
# A steady tone keeps all of its amplitude, so of that of a mode at least a tenth must go.
STEADY = 0.9


def cut_short(records: Records) -> Iterator[Finding]:
    """Find outputs at which a resonance still rings when the blocks end."""
    freq, powers = _windows(records)
    if len(freq) < FEWEST:
        return
    left = _left(powers) * _strong(records, freq)
    late = np.flatnonzero(left.max(axis=0) > REMAINDER)
    if not len(late):
        return
    at, k = np.unravel_index(np.argmax(left), left.shape)
    size, duration = float(left[at, k]), records.force.shape[1] / records.fs
    names = [f"{part} window" for part in ("first", "second", "third")]
    yield Finding(
        "record_too_short", tuple(records.outputs[o] for o in late), sure=sureness(size, REMAINDER), size=size,
        unit="of the response",
        evidence=f"of the resonance at {freq[at]:.4g} Hz, {100 * size:.3g} % of the response at {records.outputs[k]} "
        f"is left at the end of the {duration:.4g} s of a block: what is cut off leaks into the lines around it",
        advice="record longer (closer lines), or use an exponential window and take its damping out",
        picture=Picture(
            [(name, freq[1:], np.sqrt(p[1:, k])) for name, p in zip(names, powers, strict=True)], "Frequency [Hz]",
            "Spectrum of part of the block", True,
        ),
    )  # fmt: skip


def _windows(records: Records) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "3 f o"]]:
    """Lines [Hz], and mean power of the responses in three Hann windows from the end of the hits on."""
    size = np.abs(records.force - np.median(records.force, axis=1, keepdims=True))
    ends = [int(np.flatnonzero(s > 0.05 * s.max())[-1]) + 1 for s in size]
    quarter = (size.shape[1] - max(ends)) // 4
    if quarter < FEWEST:
        return np.zeros(0), np.zeros((3, 0, len(records.outputs)))
    window = np.hanning(2 * quarter + 1)[:-1, None]
    powers = []
    for begin in (0, quarter, 2 * quarter):
        part = np.stack([x[a + begin : a + begin + 2 * quarter] for x, a in zip(records.response, ends, strict=True)])
        still = part - np.sum(window * part, axis=1, keepdims=True) / window.sum()
        powers.append(np.mean(np.abs(np.fft.rfft(still * window, axis=1)) ** 2, axis=0))
    return np.fft.rfftfreq(2 * quarter, 1 / records.fs), np.array(powers)


def _left(powers: Float[np.ndarray, "3 f o"]) -> Float[np.ndarray, "f o"]:
    """Share of the amplitude that is left of what decays as a mode does; 0 elsewhere."""
    first, second, third = np.maximum(powers, 1e-300)
    padded = np.pad(third[1:], ((AROUND, AROUND), (0, 0)), mode="reflect")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1, axis=0), axis=-1)
    peak = np.zeros(third.shape, bool)
    peak[2:-1] = (third[2:-1] >= third[1:-2]) & (third[2:-1] >= third[3:]) & (third[2:-1] > STANDS_OUT * around[1:-1])
    left = third / first
    # Noise and tones stay where modes decay: then less goes between the last two windows than between the first two.
    decays = (third / second) ** 2 < second / first
    return np.where(peak & decays & (left < STEADY), left, 0.0)


def _strong(records: Records, freq: np.ndarray) -> np.ndarray:
    """Whether the FRF near each line is not tiny compared with its largest, ``(f, o)``."""
    measured = records.measurement()
    size = np.abs(np.asarray(measured.H)[0, :, :, 0])
    step = freq[1]
    which = np.clip(np.round(np.asarray(measured.freq) / step).astype(int), 0, len(freq) - 1)
    near = np.zeros((len(freq), size.shape[1]))
    np.maximum.at(near, which, size)
    return near > STRONG * size.max(axis=0)
