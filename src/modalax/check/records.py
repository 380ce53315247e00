"""Faults that time records of hits or blocks show and FRFs do not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from modalax.check.finding import Finding, Picture
from modalax.data.excitation import excitation_of
from modalax.data.hits import CLIPPED, clipped_samples
from modalax.data.measurement import Measurement

# A pulse is sampled too coarsely if it has no more than this many samples above this share of its peak.
PULSE_SHARE, SHORT_PULSE = 0.2, 2
# Decay of the force spectrum within the band [dB], and the band of usual analysers as a share of the sampling rate.
ROLLOFF, BAND = 26.0, 1 / 2.56
# Blocks from which what the force does not explain is looked at, and power of a tone there over the lines around.
FEWEST_BLOCKS, TONE = 4, 30.0
# A channel of so few different values holds the idle steps of its converter.
FEW_VALUES = 8
# Share of different values from which on a channel is not rounded.
UNROUNDED = 0.7
# Power of a resonance over that of the lines around.
STANDS_OUT = 100.0
# Part of the response that is left at the end of the record, parts of the record that are compared, and how much
# more than before the hit it must be.
LEFT, PARTS, QUIET = 0.06, 20, 3.0
# Trend over the record, as a share of the response's root mean square, and how much of the parts' means it makes up.
TREND, SMOOTH = 0.25, 0.8
# A second pulse counts from this share of the first, and so many times the noise, this many durations after it.
SECOND, OVER_NOISE, AFTER = 0.05, 8.0, 4.0
# Lines where the force has less than this share of its middling power are not excited.
EXCITED = 1e-4


@dataclass(frozen=True)
class Records:
    """Blocks of time: hits of a hammer, periods, or blocks of another excitation, at one input.

    Attributes
    ----------
    force
        Shape ``(block, t)`` [N].
    response
        Shape ``(block, t, o)`` [``unit`` of the response].
    fs
        Sampling rate [Hz].
    outputs, input
        Names of the channels.
    form
        What the responses over the force are: receptance (m), mobility (m/s) or accelerance (m/s^2, g).
    kind
        ``hits``, ``periods`` (of a force that repeats), ``random`` (blocks that overlap by half), or ``blocks``.
    """

    force: Float[np.ndarray, "m t"]
    response: Float[np.ndarray, "m t o"]
    fs: float
    outputs: tuple[str, ...]
    input: str = "force"
    form: str = "accelerance"
    kind: str = ""

    def __post_init__(self):
        if self.force.ndim != 2 or self.response.ndim != 3 or self.force.shape != self.response.shape[:2]:
            raise ValueError(
                f"force has shape {self.force.shape} and response {self.response.shape}; needed are (block, t) and "
                "(block, t, output) of the same blocks and samples"
            )
        if not np.isfinite(self.force).all() or not np.isfinite(self.response).all():
            raise ValueError("the records hold values that are not finite")

    @property
    def hits(self) -> bool:
        """Whether the force is a pulse in every block."""
        return (self.kind or excitation_of(self.force).kind) == "hits"

    def spectra(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lines [Hz], and the spectra of force ``(block, f)`` and responses ``(block, f, o)``."""
        samples = self.force.shape[1]
        window = np.hanning(samples + 1)[:-1] if self.kind == "random" else np.ones(samples)
        F = np.fft.rfft((self.force - np.median(self.force, axis=1, keepdims=True)) * window, axis=1)
        still = self.response - np.median(self.response, axis=1, keepdims=True)
        return np.fft.rfftfreq(samples, 1 / self.fs), F, np.fft.rfft(still * window[:, None], axis=1)

    def measurement(self, each: bool = False) -> Measurement:
        """FRFs by H1, with their variance where there are repeats; with ``each``, every block is a run."""
        freq, F, X = self.spectra()
        power = np.mean(np.abs(F) ** 2, axis=0)
        low, top = _useful(freq, power, self.fs)
        keep = (freq >= low) & (freq <= top)
        keep &= power > EXCITED * np.median(power[keep])
        names = dict(outputs=self.outputs, inputs=(self.input,), form=self.form)
        if each:
            H = X[:, keep] / F[:, keep, None]
            return Measurement(freq[keep], H[..., None], **names)
        H = np.mean(X * F.conj()[:, :, None], axis=0) / power[:, None]
        extra = {}
        # Blocks that overlap by half under a Hann window hold hardly less than as many of their own.
        m = len(F)
        if m > 1:
            left = np.mean(np.abs(X - H * F[:, :, None]) ** 2, axis=0) * m / (m - 1)
            variance = left / (m * power[:, None])
            extra = {"variance": variance[None, keep, :, None], "averages": m}
        return Measurement(freq[keep], H[None, keep, :, None], **names, **extra)


def _useful(freq: np.ndarray, power: np.ndarray, fs: float) -> tuple[float, float]:
    """Frequencies between which the force has energy [Hz], at most the band of usual analysers."""
    smooth = _smooth(power)
    loudest = int(np.argmax(smooth[1:])) + 1
    weak = np.flatnonzero(smooth < smooth[loudest] * 10 ** (-ROLLOFF / 10))
    below, above = weak[weak < loudest], weak[weak > loudest]
    end = BAND * fs
    return float(freq[below[-1] + 1] if len(below) else freq[1]), float(min(end, freq[above[0]] if len(above) else end))


def _smooth(power: np.ndarray) -> np.ndarray:
    width = max(1, len(power) // 100)
    kernel = np.ones(2 * width + 1) / (2 * width + 1)
    return np.convolve(np.pad(power, width, mode="edge"), kernel, "valid")


def record_findings(records: Records) -> Iterator[Finding]:
    """Findings from single blocks."""
    yield from _clipped(records)
    yield from _dead(records)
    yield from _trend(records)
    if records.hits:
        yield from _double(records)
        yield from _short(records)
        yield from _rolloff(records)
        yield from _cut_short(records)
        yield from _mains(records)
    elif len(records.force) >= FEWEST_BLOCKS:
        yield from _tones(records)


def _numbers(which: np.ndarray) -> str:
    shown = ", ".join(str(k + 1) for k in which[:8])
    return shown + (", ..." if len(which) > 8 else "")


def _double(records: Records) -> Iterator[Finding]:
    level = np.abs(records.force - np.median(records.force, axis=1, keepdims=True))
    seconds = [_second(f) for f in level]
    which = np.flatnonzero([gap > 0 for gap, _ in seconds])
    if not len(which):
        return
    gap, ratio = max((seconds[k] for k in which), key=lambda pair: pair[1])
    yield Finding(
        "double_hit", (records.input,), sure=0.98, size=gap / records.fs, unit="s",
        interval=((gap - 1) / records.fs, (gap + 1) / records.fs),
        evidence=f"the hammer touches twice in block {_numbers(which)} of {len(level)}: the second pulse comes "
        f"{gap / records.fs:.4g} s after the first with {100 * ratio:.3g} % of the larger",
        advice="leave these hits out and repeat them",
        picture=_force_picture(records, int(which[0])),
    )  # fmt: skip


def _second(size: np.ndarray) -> tuple[int, float]:
    """Samples between the largest pulse and the next largest, and their ratio; 0 where there is no other.

    What filters and cables ring right after a pulse is none, and neither is what stands out of the noise by little.
    """
    peak = int(np.argmax(size))
    over = np.flatnonzero(size > 0.1 * size[peak])
    close = over[np.abs(over - peak) < 3 + 2 * np.sum(size > 0.5 * size[peak])]
    width = int(close[-1] - close[0] + 1)
    far = np.abs(np.arange(len(size)) - peak) > AFTER * width
    noise = 1.4826 * np.median(size)
    found = np.flatnonzero(far & (size > max(SECOND * size[peak], OVER_NOISE * noise)))
    if len(found) < max(1, width // 4):
        return 0, 0.0
    second = int(found[np.argmax(size[found])])
    return abs(second - peak), float(size[second] / size[peak])


def _short(records: Records) -> Iterator[Finding]:
    size = np.abs(records.force - np.median(records.force, axis=1, keepdims=True))
    samples = np.sum(size > PULSE_SHARE * size.max(axis=1, keepdims=True), axis=1)
    which = np.flatnonzero(samples <= SHORT_PULSE)
    if len(which) < 0.5 * len(samples):
        return
    count = float(np.median(samples[which]))
    yield Finding(
        "short_pulse", (records.input,), sure=0.97, size=count, unit="samples",
        evidence=f"the force pulse has {count:g} samples above {100 * PULSE_SHARE:.0f} % of its peak: its height, and "
        "with it the scale of all FRFs, is not resolved",
        advice="sample faster, or use a softer tip",
        picture=_force_picture(records, int(which[0])),
    )  # fmt: skip


def _force_picture(records: Records, block: int) -> Picture:
    force = records.force[block]
    peak = int(np.argmax(np.abs(force)))
    over = np.flatnonzero(np.abs(force) > 0.1 * np.abs(force).max())
    a, b = max(0, over[0] - 20), min(len(force), max(over[-1], peak) + 40)
    return Picture([("force", np.arange(a, b) / records.fs, force[a:b])], "Time [s]", "Force [N]")


def _rolloff(records: Records) -> Iterator[Finding]:
    freq = np.fft.rfftfreq(records.force.shape[1], 1 / records.fs)
    power = np.mean(np.abs(np.fft.rfft(records.force, axis=1)) ** 2, axis=0)
    end = BAND * records.fs
    _, top = _useful(freq, power, records.fs)
    if top > 0.8 * end or not _rings_above(records, freq, top, end):
        return
    yield Finding(
        "force_rolloff", (records.input,), sure=0.95, size=top, unit="Hz",
        evidence=f"the force spectrum falls by {ROLLOFF:.0f} dB at {top:.4g} Hz, with resonances above",
        advice=f"use the FRFs to {top:.3g} Hz only, or a harder tip or a lighter hammer",
        picture=Picture([("force spectrum", freq[1:], np.sqrt(power[1:]))], "Frequency [Hz]", "|F|", True),
    )  # fmt: skip


def _rings_above(records: Records, freq: np.ndarray, top: float, end: float) -> bool:
    """Whether the responses have resonances between two frequencies."""
    still = records.response - records.response.mean(axis=1, keepdims=True)
    spectrum = np.mean(np.abs(np.fft.rfft(still, axis=1)) ** 2, axis=0)[(freq > 1.05 * top) & (freq < end)]
    if len(spectrum) < 30:
        return False
    return bool(np.any(spectrum.max(axis=0) > STANDS_OUT * np.median(spectrum, axis=0)))


def _clipped(records: Records) -> Iterator[Finding]:
    channels = [(records.input, records.force)]
    channels += [(name, records.response[:, :, k]) for k, name in enumerate(records.outputs)]
    for name, blocks in channels:
        if len(np.unique(blocks)) <= FEW_VALUES:
            continue
        flat = [int(clipped_samples(b[:, None]).sum()) for b in blocks]
        which = np.flatnonzero([_plateau(b) for b in blocks])
        if not len(which):
            continue
        b = blocks[which[0]]
        yield Finding(
            "clipped", (name,), sure=0.97, size=float(np.abs(b).max()), unit="of the channel",
            evidence=f"{max(flat)} samples stand at exactly the same largest value in block {_numbers(which)} of "
            f"{len(blocks)}: the channel is overloaded",
            advice="choose a larger range, or hit softer, and measure again",
            picture=Picture([(name, np.arange(len(b)) / records.fs, b)], "Time [s]", name),
        )  # fmt: skip


def _plateau(values: np.ndarray) -> bool:
    """Whether a channel stays at its largest or smallest value, more often or longer than rounded values do."""
    # Values that are not rounded meet at the largest of all by overload alone.
    if len(np.unique(values)) > UNROUNDED * len(values):
        return bool(max(np.sum(values == values.max()), np.sum(values == values.min())) >= CLIPPED)
    flags = clipped_samples(values[:, None])[:, 0]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    spans = edges.reshape(-1, 2)
    if not len(spans) or np.ptp(values) == 0:
        return False
    steps = np.abs(np.diff(values))
    rounding = steps[steps > 0].min(initial=np.inf)
    # Rounded values of a smooth top leave it by one step of the converter, clipped ones by more.
    leaps = [max(steps[a - 1] if a > 0 else 0, steps[b - 1] if b < len(values) else 0) for a, b in spans]
    return bool(max(leaps) > 1.5 * rounding or max(b - a for a, b in spans) >= 6)


def _dead(records: Records) -> Iterator[Finding]:
    for k, name in enumerate(records.outputs):
        count = len(np.unique(records.response[:, :, k]))
        if count > FEW_VALUES:
            continue
        yield Finding(
            "dead", (name,), sure=0.99, size=float(count), unit="values",
            evidence=f"the channel holds {count} different values in all blocks, steps of its converter",
            advice="check cable, sensor and range",
        )  # fmt: skip


def _trend(records: Records) -> Iterator[Finding]:
    """A slow trend: means of parts that follow a straight or bent line through the block."""
    still = records.response - records.response.mean(axis=1, keepdims=True)
    blocks, samples, outs = still.shape
    count = samples // PARTS
    if count < 2:
        return
    means = still[:, : count * PARTS].reshape(blocks, PARTS, count, outs).mean(axis=2)
    time = np.linspace(-1, 1, PARTS)
    low = np.stack([np.ones(PARTS), time, 1.5 * time**2 - 0.5], axis=1)
    fitted = np.einsum("pq,bqo->bpo", low @ np.linalg.pinv(low), means)
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = np.var(fitted, axis=1) / np.var(means, axis=1)
        share = np.std(fitted, axis=1) / still.std(axis=1)
    for k in np.flatnonzero((np.median(share, axis=0) > TREND) & (np.median(smooth, axis=0) > SMOOTH)).tolist():
        size = float(np.median(share[:, k]))
        yield Finding(
            "drift", (records.outputs[k],), sure=0.95, size=size, unit="of the rms",
            evidence=f"a slow trend holds {100 * size:.3g} % of the channel's root mean square within a block",
            advice="let the sensor settle (temperature, cable, amplifier), or filter below the first mode",
            picture=Picture(
                [(records.outputs[k], np.arange(samples) / records.fs, records.response[0, :, k])], "Time [s]", "x"
            ),
        )  # fmt: skip


def _cut_short(records: Records) -> Iterator[Finding]:
    late = []
    for k in range(len(records.outputs)):
        x = records.response[:, :, k]
        x = x - np.median(x, axis=1, keepdims=True)
        count = x.shape[1] // PARTS
        parts = x[:, : count * PARTS].reshape(len(x), PARTS, count)
        level = np.sqrt(np.mean((parts - parts.mean(axis=2, keepdims=True)) ** 2, axis=(0, 2)))
        first = int(np.argmax(level))
        end, before = level[-1], np.sqrt(np.mean(level[-6:-3] ** 2))
        # Noise stays constant, a response decays further.
        falling = end < 0.97 * before or end > 0.5 * level[first]
        if end > LEFT * level[first] and end > QUIET * _before(records, k) and falling and first < PARTS // 2:
            late.append((end / level[first], k, level))
    if not late:
        return
    share, k, level = max(late, key=lambda entry: entry[0])
    duration = records.force.shape[1] / records.fs
    yield Finding(
        "record_too_short", tuple(records.outputs[k] for _, k, _ in sorted(late, key=lambda e: e[1])), sure=0.96,
        size=float(share), unit="of the response",
        evidence=f"{100 * share:.3g} % of the response at {records.outputs[k]} is left at the end of the block of "
        f"{duration:.4g} s: the part cut off leaks into the lines around the resonances",
        advice="record longer (closer lines), or use an exponential window and take its damping out",
        picture=Picture([("level", (np.arange(PARTS) + 0.5) * duration / PARTS, level)], "Time [s]", "rms", True),
    )  # fmt: skip


def _before(records: Records, k: int) -> float:
    """Root mean square of a channel before the hits; 0 where nothing was recorded before."""
    size = np.abs(records.force - np.median(records.force, axis=1, keepdims=True))
    quiet = int(np.min(np.argmax(size > 0.05 * size.max(axis=1, keepdims=True), axis=1))) - 4
    if quiet < 16:
        return 0.0
    x = records.response[:, :quiet, k]
    return float(np.sqrt(np.mean((x - x.mean(axis=1, keepdims=True)) ** 2)))


def _mains(records: Records) -> Iterator[Finding]:
    """A steady tone at the mains frequency in the last part of the records."""
    samples = records.response.shape[1]
    last = records.response[:, samples // 2 :]
    duration = last.shape[1] / records.fs
    if duration < 0.2:
        return
    window = np.hanning(last.shape[1])[None, :, None]
    spectrum = np.mean(np.abs(np.fft.rfft((last - last.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    freq = np.fft.rfftfreq(last.shape[1], 1 / records.fs)
    early = records.response[:, samples // 4 : samples // 4 + last.shape[1]]
    steady = np.mean(np.abs(np.fft.rfft((early - early.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2, axis=0)
    power = np.mean(np.abs(np.fft.rfft(records.force, axis=1)) ** 2, axis=0)
    low, top = _useful(np.fft.rfftfreq(samples, 1 / records.fs), power, records.fs)
    for k, name in enumerate(records.outputs):
        for mains in (50.0, 60.0):
            at = int(round(mains * duration))
            if at < 12 or at + 40 >= len(freq) or not low <= mains <= top:
                continue
            near = slice(at - 1, at + 2)
            around = np.r_[spectrum[max(1, at - 30) : at - 4, k], spectrum[at + 5 : at + 31, k]]
            height = spectrum[near, k].max()
            flank = max(spectrum[at - 4, k], spectrum[at + 4, k])
            same = 0.6 < height / max(steady[near, k].max(), 1e-300) < 1.6
            if height > 100 * np.median(around) and flank < 0.02 * height and same and height > 4 * around.max():
                yield Finding(
                    "hum", (name,), sure=0.95, size=float(np.sqrt(height / max(spectrum[1:, k].max(), 1e-300))),
                    unit="of the largest line",
                    evidence=f"a tone at {mains:g} Hz stays as it is through the record",
                    advice="look for ground loops, use insulated mounts and shielded cables",
                    picture=Picture([(name, freq[1:], np.sqrt(spectrum[1:, k]))], "Frequency [Hz]", "Last half", True),
                )  # fmt: skip
                break


def _tones(records: Records) -> Iterator[Finding]:
    """A tone at the mains frequency in what the force does not explain of the responses."""
    freq, F, X = records.spectra()
    power = np.mean(np.abs(F) ** 2, axis=0)
    H = np.mean(X * F.conj()[:, :, None], axis=0) / np.maximum(power, 1e-300)[:, None]
    left = np.mean(np.abs(X - H * F[:, :, None]) ** 2, axis=0)
    low, top = _useful(freq, power, records.fs)
    for k, name in enumerate(records.outputs):
        for mains in (50.0, 60.0):
            at = int(round(mains / freq[1]))
            if at < 40 or at + 40 >= len(freq) or not low <= mains <= top:
                continue
            around = np.r_[left[at - 30 : at - 4, k], left[at + 5 : at + 31, k]]
            height = left[at - 1 : at + 2, k].max()
            flank = max(left[at - 4, k], left[at + 4, k])
            if height < TONE * np.median(around) or height < 4 * around.max() or flank > 0.1 * height:
                continue
            size = float(np.sqrt(height / max(np.mean(np.abs(X[:, at, k]) ** 2), 1e-300)))
            yield Finding(
                "hum", (name,), sure=0.95, size=size, unit="of the response there",
                evidence=f"at {mains:g} Hz a tone stands in what the force does not explain of the response",
                advice="look for ground loops, use insulated mounts and shielded cables, or leave the line out",
                picture=Picture([(name, freq[1:], np.sqrt(left[1:, k]))], "Frequency [Hz]", "Not explained", True),
            )  # fmt: skip
            break
