"""Faults that time records of hits or blocks show and FRFs do not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from modalax.check.finding import Finding, Picture
from modalax.data.hits import CONTACT, clipped_samples, contacts
from modalax.data.measurement import Measurement

# A pulse is sampled too coarsely if it has no more than this many samples above this share of its peak.
PULSE_SHARE, SHORT_PULSE = 0.2, 2
# Decay of the force spectrum within the band [dB], and the band of usual analysers as a share of the sampling rate.
ROLLOFF, BAND = 26.0, 1 / 2.56
# Share of the response left at the end of the record from which on it is reported, and parts of a record compared.
LEFT, PARTS = 0.08, 20
# Trend over the record, as a share of the response's root mean square, from which on it is reported.
TREND = 0.5
# A force is a hit if its energy lies within this share of the record.
HIT_SHARE = 0.15


@dataclass(frozen=True)
class Records:
    """Blocks of time: hits of a hammer, or blocks of another excitation, at one input.

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
        Form of response over force: receptance (m), mobility (m/s) or accelerance (m/s^2, g).
    """

    force: Float[np.ndarray, "m t"]
    response: Float[np.ndarray, "m t o"]
    fs: float
    outputs: tuple[str, ...]
    input: str = "force"
    form: str = "accelerance"

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
        energy = np.sort((self.force - np.median(self.force, axis=1, keepdims=True)) ** 2, axis=1)[:, ::-1]
        few = max(3, int(HIT_SHARE * energy.shape[1]))
        return bool(np.all(energy[:, :few].sum(axis=1) > 0.9 * energy.sum(axis=1)) and np.any(self.force))

    def measurement(self, each: bool = False) -> Measurement:
        """FRFs by H1, with their variance where there are repeats; with ``each``, every block is a run."""
        F = np.fft.rfft(self.force - np.median(self.force, axis=1, keepdims=True), axis=1)
        X = np.fft.rfft(self.response - np.median(self.response, axis=1, keepdims=True), axis=1)
        freq = np.fft.rfftfreq(self.force.shape[1], 1 / self.fs)
        power = np.mean(np.abs(F) ** 2, axis=0)
        top = _useful(freq, power, self.fs)
        keep = (freq > 0) & (freq <= top)
        names = dict(outputs=self.outputs, inputs=(self.input,), form=self.form)
        if each:
            H = X[:, keep] / F[:, keep, None]
            return Measurement(freq[keep], H[..., None], **names)
        H = np.mean(X * F.conj()[:, :, None], axis=0) / power[:, None]
        extra = {}
        m = len(F)
        if m > 1:
            left = np.mean(np.abs(X - H * F[:, :, None]) ** 2, axis=0) * m / (m - 1)
            variance = left / (m * power[:, None])
            extra = {"variance": variance[None, keep, :, None], "averages": m}
        return Measurement(freq[keep], H[None, keep, :, None], **names, **extra)


def _useful(freq: np.ndarray, power: np.ndarray, fs: float) -> float:
    """Frequency to which the force has energy [Hz], at most the band of usual analysers."""
    smooth = _smooth(power)
    reference = np.max(smooth[: max(2, len(smooth) // 5)])
    weak = np.flatnonzero(smooth < reference * 10 ** (-ROLLOFF / 10))
    weak = weak[weak > np.argmax(smooth)]
    end = BAND * fs
    return float(min(end, freq[weak[0]] if len(weak) else end))


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


def _numbers(which: np.ndarray) -> str:
    shown = ", ".join(str(k + 1) for k in which[:8])
    return shown + (", ..." if len(which) > 8 else "")


def _double(records: Records) -> Iterator[Finding]:
    level = np.abs(records.force - np.median(records.force, axis=1, keepdims=True))
    noise = np.median(level, axis=1) * 6
    double = np.array(
        [contacts(np.where(f > n, f, 0.0)) > 1 for f, n in zip(level, noise, strict=True)]
    )  # fmt: skip
    which = np.flatnonzero(double)
    if not len(which):
        return
    f = level[which[0]]
    gap, ratio = _second(f)
    yield Finding(
        "double_hit", (records.input,), sure=0.98, size=gap / records.fs, unit="s",
        evidence=f"the hammer touches twice in block {_numbers(which)} of {len(level)}: the second pulse comes "
        f"{gap / records.fs:.4g} s after the first with {100 * ratio:.3g} % of the larger",
        advice="leave these hits out and repeat them",
        picture=_force_picture(records, int(which[0])),
    )  # fmt: skip


def _second(size: np.ndarray) -> tuple[int, float]:
    """Samples between the two largest pulses, and their ratio."""
    over = size > CONTACT * size.max()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], over.astype(int), [0]])))
    peaks = [(size[a:b].max(), a + int(np.argmax(size[a:b]))) for a, b in edges.reshape(-1, 2)]
    first = max(peaks)
    far = [p for p in peaks if abs(p[1] - first[1]) > 2]
    if not far:
        return 0, 0.0
    second = max(far)
    return int(abs(second[1] - first[1])), float(second[0] / first[0])


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
    top = _useful(freq, power, records.fs)
    if top > 0.95 * end:
        return
    yield Finding(
        "force_rolloff", (records.input,), sure=0.95, size=top, unit="Hz",
        evidence=f"the force spectrum falls by {ROLLOFF:.0f} dB at {top:.4g} Hz, inside the band to {end:.4g} Hz",
        advice=f"use the FRFs to {top:.3g} Hz only, or a harder tip or a lighter hammer",
        picture=Picture([("force spectrum", freq[1:], np.sqrt(power[1:]))], "Frequency [Hz]", "|F|", True),
    )  # fmt: skip


def _clipped(records: Records) -> Iterator[Finding]:
    channels = [(records.input, records.force)]
    channels += [(name, records.response[:, :, k]) for k, name in enumerate(records.outputs)]
    for name, blocks in channels:
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
    spread = records.response.std(axis=1).max(axis=0)
    for k in np.flatnonzero(spread == 0).tolist():
        yield Finding(
            "dead", (records.outputs[k],), sure=0.99, size=0.0, unit="rms",
            evidence="the channel holds one value in all blocks", advice="check cable, sensor and range",
        )  # fmt: skip


def _trend(records: Records) -> Iterator[Finding]:
    time = np.linspace(-1, 1, records.response.shape[1])
    low = np.stack([time, 1.5 * time**2 - 0.5], axis=1)
    low /= np.linalg.norm(low, axis=0)
    still = records.response - records.response.mean(axis=1, keepdims=True)
    trend = np.einsum("tp,mto->mpo", low, still)
    share = np.sqrt(np.sum(trend**2, axis=1) / np.maximum(np.sum(still**2, axis=1), 1e-300))
    for k in np.flatnonzero(np.median(share, axis=0) > TREND).tolist():
        size = float(np.median(share[:, k]))
        yield Finding(
            "drift", (records.outputs[k],), sure=0.95, size=size, unit="of the rms",
            evidence=f"a slow trend holds {100 * size:.3g} % of the channel's root mean square within a block",
            advice="let the sensor settle (temperature, cable, amplifier), or filter below the first mode",
            picture=Picture(
                [(records.outputs[k], np.arange(len(time)) / records.fs, records.response[0, :, k])], "Time [s]", "x"
            ),
        )  # fmt: skip


def _cut_short(records: Records) -> Iterator[Finding]:
    late = []
    for k in range(len(records.outputs)):
        x = records.response[:, :, k]
        x = x - np.linspace(0, 1, x.shape[1]) * 0 - np.median(x, axis=1, keepdims=True)
        count = x.shape[1] // PARTS
        parts = x[:, : count * PARTS].reshape(len(x), PARTS, count)
        level = np.sqrt(np.mean((parts - parts.mean(axis=2, keepdims=True)) ** 2, axis=(0, 2)))
        first = int(np.argmax(level))
        end, before = level[-1], np.sqrt(np.mean(level[-6:-3] ** 2))
        # Noise stays constant, a response decays further.
        falling = end < 0.97 * before or end > 0.5 * level[first]
        if end > LEFT * level[first] and falling and first < PARTS // 2:
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
        picture=Picture(
            [("rms of a part", (np.arange(PARTS) + 0.5) * duration / PARTS, level)], "Time [s]", "rms", True
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
    for k, name in enumerate(records.outputs):
        for mains in (50.0, 60.0):
            at = int(round(mains * duration))
            if at < 12 or at + 40 >= len(freq):
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
                    evidence=f"a tone at {mains:g} Hz keeps its level while the response decays",
                    advice="look for ground loops, use insulated mounts and shielded cables",
                    picture=Picture(
                        [(name, freq[1:], np.sqrt(spectrum[1:, k]))], "Frequency [Hz]", "Last half", True
                    ),
                )  # fmt: skip
                break
