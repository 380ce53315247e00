"""Faults that time records of hits or blocks show and FRFs do not."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture
from modalax.check.records import BAND, ROLLOFF, Records, useful_band
from modalax.check.ring_down import cut_short
from modalax.data.hits import CLIPPED, clipped_samples

# A pulse is sampled too coarsely if it has no more than this many samples above this share of its peak.
PULSE_SHARE, SHORT_PULSE = 0.2, 2
# Blocks from which what the force does not explain is looked at, and power of a tone there over the lines around.
FEWEST_BLOCKS, TONE = 4, 30.0
# A channel of so few different values holds the idle steps of its converter.
FEW_VALUES = 8
# Share of different values from which on a channel is not rounded.
UNROUNDED = 0.7
# Power of a resonance over that of the lines around.
STANDS_OUT = 100.0
# Parts of a block that a trend is seen in; the trend as a share of the response's root mean square, and how much of the
# parts' means it makes up.
PARTS, TREND, SMOOTH = 20, 0.25, 0.8
# A second pulse counts from this share of the first, and so many times the noise, this many durations after it.
SECOND, OVER_NOISE, AFTER = 0.05, 8.0, 4.0


def record_findings(records: Records) -> Iterator[Finding]:
    """Findings from single blocks."""
    yield from _clipped(records)
    yield from _dead(records)
    yield from _trend(records)
    if records.hits:
        yield from _double(records)
        yield from _short(records)
        yield from _rolloff(records)
        yield from cut_short(records)
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
    _, top = useful_band(freq, power, records.fs)
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
        counts = np.array([_clipped_samples(b) for b in blocks])
        which = np.flatnonzero(counts)
        if not len(which):
            continue
        worst = int(np.argmax(counts))
        b = blocks[worst]
        yield Finding(
            "clipped", (name,), sure=0.97, size=float(counts[worst]), unit="samples",
            evidence=f"{counts[worst]} samples of block {worst + 1} stand at exactly its largest or smallest value "
            f"({b.max():.4g}, {b.min():.4g}): the channel is overloaded in block {_numbers(which)} of {len(blocks)}",
            advice="choose a larger range, or hit softer, and measure again",
            picture=Picture([(name, np.arange(len(b)) / records.fs, b)], "Time [s]", name),
        )  # fmt: skip


def _clipped_samples(values: np.ndarray) -> int:
    """Samples at a channel's largest or smallest value where it stays more often or longer than rounded values do."""
    # Values that are not rounded meet at the largest of all by overload alone.
    if len(np.unique(values)) > UNROUNDED * len(values):
        meet = [int(np.sum(values == end)) for end in (values.max(), values.min())]
        return sum(n for n in meet if n >= CLIPPED)
    flags = clipped_samples(values[:, None])[:, 0]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    spans = edges.reshape(-1, 2)
    if not len(spans) or np.ptp(values) == 0:
        return 0
    steps = np.abs(np.diff(values))
    rounding = steps[steps > 0].min(initial=np.inf)
    # Rounded values of a smooth top leave it by one step of the converter, clipped ones by more.
    leaps = [max(steps[a - 1] if a > 0 else 0, steps[b - 1] if b < len(values) else 0) for a, b in spans]
    return int(flags.sum()) if max(leaps) > 1.5 * rounding or max(b - a for a, b in spans) >= 6 else 0


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
    low, top = useful_band(np.fft.rfftfreq(samples, 1 / records.fs), power, records.fs)
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
    low, top = useful_band(freq, power, records.fs)
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
