"""Stepped sine in one record: the stretches of constant frequency are found from the force."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FRAMES = 2**14  # most frames that a record is cut into, half of each within the next
LEAST = 6  # frames of one frequency in a row that make a step
FEWEST = 3  # steps of unlike frequency that make a stepped sine
NARROW, SILENT = 0.7, 0.02  # power that a sine has around its line; share of the largest force that is none
STEADY = 0.02  # lines by which the frequency of a step may seem to move for reasons other than noise
FLAT = 0.15  # drift within a step over the distance to the next one; half of it is the drift of a sweep
TURNED = 0.3  # phase [rad] by which a part of a step may be away from that of the whole
COVERED, PART = 0.5, 0.2  # share of the time with a force that the steps must make up, and those of one frame length
APART = 0.02  # turns over a step within which two frequencies are one


class Step(NamedTuple):
    """A stretch of constant frequency: its first and last sample, and the frequency [cycles/sample]."""

    start: int
    stop: int
    freq: float


def steps_of(force: Float[np.ndarray, " t"]) -> list[Step]:
    """The steps of a stepped sine; none if the force is something else.

    Frames of several lengths are tried, as neither the length of a step nor the distance to the next one is known. Of
    the stretches that they give the longest count; of those of about one length that of the shortest frames, which tell
    best where a step ends.
    """
    still = force - force.mean()
    length = max(64, 2 ** int(np.ceil(np.log2(max(2 * len(force) / FRAMES, 1)))))
    stepped, found = False, []
    while len(force) >= 2 * LEAST * length:
        hop = length // 2
        stretches, jumps = _flat(_tracked(still, length))
        found += [(int(-2 * np.log2((b - a) * hop)), length, (a + 1) * hop, (b + 1) * hop) for a, b in stretches]
        stepped, length = stepped or jumps, 2 * length
    steps: list[Step] = []
    for *_, start, stop in sorted(found) if stepped else []:
        if all(stop <= s.start or start >= s.stop for s in steps):
            freq = _frequency(still[start:stop])
            if _is_sine(still[start:stop], freq):
                steps.append(Step(start, stop, freq))
    loud = np.abs(still) > SILENT * np.abs(still).max()
    return sorted(steps) if sum(loud[s.start : s.stop].sum() for s in steps) > COVERED * loud.sum() else []


def grouped(steps: list[Step]) -> list[tuple[float, list[Step]]]:
    """Steps of one frequency together, the frequencies [cycles/sample] rising; without fragments of a step."""
    groups: list[list[Step]] = []
    for step in sorted(steps, key=lambda s: s.freq):
        if groups and (step.freq - groups[-1][0].freq) * (step.stop - step.start) < APART:
            groups[-1].append(step)
        else:
            groups.append([step])
    longest = [max(s.stop - s.start for s in group) for group in groups]
    whole = [[s for s in group if s.stop - s.start > most / 2] for group, most in zip(groups, longest, strict=True)]
    return [(float(np.mean([s.freq for s in group])), group) for group in whole]


def waves(count: int, freq: float, start: int = 0) -> Float[np.ndarray, "t 3"]:
    """Cosine, sine and one at samples from ``start`` on, for least squares; the frequency in cycles/sample."""
    angle = 2 * np.pi * freq * (start + np.arange(count))
    return np.column_stack([np.cos(angle), np.sin(angle), np.ones(count)])


def _is_sine(force: np.ndarray, freq: float) -> bool:
    """Whether the force is one sine throughout, not two steps taken together: its phase does not move."""
    turned = force * np.exp(-2j * np.pi * freq * np.arange(len(force)))
    length = len(force) // int(np.clip(len(force) * freq / 2, 4, 16))
    pieces = np.lib.stride_tricks.sliding_window_view(turned, length)[:: length // 2] @ np.hanning(length + 1)[:-1]
    return bool(np.all(np.abs(np.angle(pieces * np.conj(pieces.sum()))) < TURNED))


def _tracked(force: np.ndarray, length: int) -> np.ndarray:
    """Frequency of each frame in lines of a frame; NaN where it has no force or none of one frequency."""
    frames = np.lib.stride_tricks.sliding_window_view(force, length)[:: length // 2]
    size = np.abs(np.fft.rfft(frames * np.hanning(length + 1)[:-1], axis=1))
    rows = np.arange(len(size))
    top = np.clip(size.argmax(axis=1), 2, size.shape[1] - 3)
    around = np.array([size[rows, top + k] for k in (-2, -1, 0, 1, 2)])
    narrow = (around**2).sum(axis=0) > NARROW * (size**2).sum(axis=1)
    loud = around[2] > SILENT * around[2].max()
    lines = top + _between(around[1:4])
    return np.where(narrow & loud & (size.argmax(axis=1) == top), lines, np.where(loud, np.nan, np.inf))


def _between(sizes: np.ndarray) -> np.ndarray:
    """How far a sine lies beside the middle one of three lines of a Hann window, by how they share its size."""
    side = np.where(sizes[2] > sizes[0], 1, -1)
    ratio = np.maximum(sizes[2], sizes[0]) / np.maximum(sizes[1], np.finfo(float).tiny)
    return side * (2 * ratio - 1) / (ratio + 1)


def _flat(lines: np.ndarray) -> tuple[list[tuple[int, int]], bool]:
    """First and last frame of stretches of one frequency, and whether it stands still in them but for jumps."""
    heard = ~np.isinf(lines)
    sine = np.isfinite(lines)
    if sine.sum() < LEAST:
        return [], False
    found = _plateaus(np.where(sine, lines, np.nan))
    means = np.array([lines[a : b + 1].mean() for a, b in found])
    jumps = np.abs(np.diff(means))
    unlike = jumps > 2 * STEADY
    covered = sum(b + 1 - a for a, b in found) > PART * heard.sum()
    if not covered or len(np.unique(np.round(means, 1))) < FEWEST or unlike.sum() < FEWEST - 1:
        return found, False
    halves = [(lines[a : (a + b + 1) // 2].mean(), lines[(a + b) // 2 + 1 : b + 1].mean()) for a, b in found]
    drifts = np.array([abs(late - early) for early, late in halves])[:-1]
    return found, float(np.median(drifts[unlike] / jumps[unlike])) < FLAT


def _plateaus(lines: np.ndarray) -> list[tuple[int, int]]:
    """First and last frame of each stretch in which the frequency is one but for noise."""
    moves = np.abs(np.diff(lines))
    noise = 1.05 * float(np.median(moves[np.isfinite(moves)])) if np.isfinite(moves).any() else 0.0
    allowed = max(6 * noise, STEADY)
    if len(lines) < LEAST:
        return []
    first = np.lib.stride_tricks.sliding_window_view(lines, LEAST)
    middle = np.median(first, axis=1)
    found, end = [], 0
    for k in np.flatnonzero((np.abs(first - middle[:, None]) <= allowed).all(axis=1)):
        if k >= end:
            near = np.abs(lines[k:] - middle[k]) <= allowed
            end = int(k) + (len(near) if near.all() else int(np.argmin(near)))
            found.append((int(k), end - 1))
    return found


def _frequency(force: np.ndarray) -> float:
    """Frequency of a sine [cycles/sample], from the phase by which its second half leads the first."""
    half = len(force) // 2
    window, t = np.hanning(half + 1)[:-1], np.arange(half)
    size = np.abs(np.fft.rfft(force[:half] * window))
    top = int(np.clip(size.argmax(), 1, len(size) - 2))
    freq = float(top + _between(size[top - 1 : top + 2])) / half
    for _ in range(3):
        early, late = (np.sum(part * window * np.exp(-2j * np.pi * freq * t)) for part in
                       (force[:half], force[half : 2 * half]))  # fmt: skip
        turned = np.angle(late * np.conj(early) * np.exp(-2j * np.pi * freq * half))
        freq += float(turned) / (2 * np.pi * half)
    return freq
