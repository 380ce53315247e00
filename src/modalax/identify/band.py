"""Choice of the frequency lines to fit: a line at 0 Hz and drift of the sensors are left out."""

import numpy as np
from jaxtyping import Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.neighbourhood import line_noise

# Accelerance (squared) at the first line over that where it stops falling, from which on it counts as drift: a
# suspension whose resonance lies a tenth below the first line makes 30.
FALL = 100.0
LEADING = 0.05  # share of the FRFs' sum of squares from which on lines with drift are left out
FROM_ZERO = 5.0  # lines, in steps between the first: data that starts above this may start on a resonance's flank
STILL = 1.5  # fall over half an octave below which drift has ended; its power falls at least with the frequency
BINS = 24  # lines, at least, among which drift is looked for
MOST = 0.25  # part of the lines, at most, that drift may take
LITTLE = 0.01  # share of the sum of squares above them that lines of noise may hold to stay
SCATTERED = 0.5  # part of the power that changes from line to line from which on lines hold noise, not a response


def usable_lines(frf: FRF, choose: bool) -> tuple[FRF, list[str]]:
    """The FRF without lines that hold no vibration, and a sentence on each thing that was or should be left out.

    A line at 0 Hz holds the offsets of amplifiers, and the lower residual term is infinite there. Drift, see
    :func:`drift_ends`, is left out where ``choose`` is true; where the user gave the band a sentence only advises it.

    Raises
    ------
    ValueError
        If the line at 0 Hz is the only one.
    """
    told: list[str] = []
    if frf.ends[0] == 0:
        if len(frf.freq) == 1:
            raise ValueError("the FRFs have one line, at 0 Hz; a resonance needs lines around it")
        frf = frf.lines(slice(1, None))
        told.append("The line at 0 Hz was left out: it holds offsets, not vibration.")
    end, part = drift_ends(frf)
    if end and part > LEADING:
        f = float(np.asarray(frf.freq)[end])
        what = (
            f"{100 * part:.0f} % of the FRFs' sum of squares lies below {f:.4g} Hz and falls with frequency as drift "
            "or integrated noise does, not as a resonance"
        )
        if choose:
            frf = frf.lines(slice(end, None))
            told.append(f"{what}: these lines were left out; --band fits others.")
        else:
            told.append(f"{what}: a band from {f:.4g} Hz on would leave it out.")
    return frf, told


def drift_ends(frf: FRF) -> tuple[int, float]:
    r"""Index of the first line above drift, 0 where there is none, and the part of the sum of squares below it.

    As frequency falls to 0 Hz the accelerance of any structure becomes constant (free) or falls (supported): below its
    first resonance it never rises. So where the sum over the channels of :math:`|\omega^{2-p}H|^2`, in medians of
    quarter octaves, falls by ``FALL`` or more from the first line on, the lines up to the end of the fall are drift
    of sensors over next to no force. Each median stands for the largest of itself and the next two, so that a line that
    is low by chance does not end it. So are lines whose own power falls by ``FALL`` and changes at random from line to
    line (:data:`SCATTERED`), as the noise of accelerometers does that was integrated to a receptance.
    """
    freq = np.asarray(frf.freq)
    # A stepped sine has lines close to its first resonance and far apart elsewhere.
    step = float(np.median(np.diff(freq[:BINS]))) if len(freq) > 1 else 0.0
    if len(freq) < BINS or freq[0] > FROM_ZERO * step or freq[0] <= 0:
        return 0, 0.0
    energy = np.sum(np.abs(np.asarray(frf.H)) ** 2, axis=(1, 2))
    acceleration = np.asarray(frf.H).reshape(len(freq), -1) * freq[:, None] ** (2 - DERIVATIVES[frf.form])
    end = max(
        _end_of_fall(freq, np.sum(np.abs(acceleration) ** 2, axis=1)), _end_of_scatter(freq, acceleration, energy)
    )
    return end, float(energy[:end].sum() / energy.sum())


def _end_of_fall(freq: np.ndarray, size: np.ndarray) -> int:
    """First line after a fall from the first one on; 0 where there is none."""
    starts, level = _quarter_octaves(freq, size)
    top = np.max(np.lib.stride_tricks.sliding_window_view(level, 3), axis=1)
    ends = np.flatnonzero(top[:-2] < STILL * top[2:])
    end = int(ends[0]) if len(ends) else len(top) - 1
    if top[0] < FALL * top[end] or starts[end] > MOST * len(freq):
        return 0
    return int(starts[end])


def _end_of_scatter(freq: np.ndarray, acceleration: np.ndarray, energy: np.ndarray) -> int:
    """First line after those whose accelerance is random from line to line, if their own power falls; else 0."""
    starts, level = _quarter_octaves(freq, energy)
    random = np.add.reduceat(np.sum(line_noise(acceleration), axis=1), starts)
    whole = np.add.reduceat(np.sum(np.abs(acceleration) ** 2, axis=1), starts)
    three = lambda a: np.convolve(np.pad(a, 1, "edge"), np.ones(3), "valid")
    part = np.lib.stride_tricks.sliding_window_view(three(random) / np.maximum(three(whole), 1e-300), 3)
    response = np.flatnonzero(np.max(part, axis=1) < SCATTERED)
    end = int(response[0]) if len(response) else 0
    if not end or level[0] < FALL * level[end] or starts[end] > MOST * len(freq):
        return 0
    # Of these lines those stay that hold next to nothing of what is left.
    stop = int(starts[end])
    held = np.cumsum(energy[:stop][::-1])[::-1]
    return int(np.sum(held > LITTLE * energy[stop:].sum()))


def _quarter_octaves(freq: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, Float[np.ndarray, " b"]]:
    """First line of each quarter octave that holds any, and the median there."""
    octave = np.floor(4 * np.log2(freq / freq[0]) + 1e-9)
    starts = np.flatnonzero(np.diff(octave, prepend=-1.0))
    stops = [*starts[1:], len(freq)]
    return starts, np.array([np.median(size[a:b]) for a, b in zip(starts, stops, strict=True)])
