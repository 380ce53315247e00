"""Which lines of the FRFs are fitted, and why others are left out."""

import numpy as np
from jaxtyping import Float

from modalax.data.frf import DERIVATIVES, FRF

# Accelerance (squared) at the first line over that where it stops falling, from which on it counts as drift: a
# suspension whose resonance lies a tenth below the first line makes 30.
FALL = 100.0
LEADING = 0.05  # part of the FRFs' sum of squares that drift must hold before its lines are left out
FROM_ZERO = 5.0  # lines, in steps between them: data that starts above this may start on the flank of a resonance
BINS_AHEAD = 6  # bins of a quarter octave that must not lie lower where the fall is said to end


def usable_lines(frf: FRF, choose: bool) -> tuple[FRF, list[str]]:
    """The FRF without lines that no mode makes, and a sentence on each thing that was left out or should be.

    A line at 0 Hz holds the offsets of amplifiers, and the lower residual term is infinite there. Drift, see
    :func:`drift_ends`, is left out where ``choose`` is true; where the user gave the band it is only told.

    Raises
    ------
    ValueError
        If the line at 0 Hz is the only one.
    """
    told: list[str] = []
    if float(frf.freq[0]) == 0:
        if len(frf.freq) == 1:
            raise ValueError("the FRFs have one line, at 0 Hz; a resonance needs lines around it")
        frf = frf.lines(slice(1, None))
        told.append("The line at 0 Hz was left out: it holds offsets, not vibration.")
    end, part = drift_ends(frf)
    if end and part > LEADING:
        f = float(frf.freq[end])
        what = (
            f"{100 * part:.0f} % of the FRFs' sum of squares lies below {f:.4g} Hz and falls with frequency as drift "
            "does, not as a resonance"
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
    of sensors over next to no force.
    """
    freq = np.asarray(frf.freq)
    step = float(np.median(np.diff(freq))) if len(freq) > 1 else 0.0
    if len(freq) < 4 * BINS_AHEAD or freq[0] > FROM_ZERO * step or freq[0] <= 0:
        return 0, 0.0
    energy = np.sum(np.abs(np.asarray(frf.H)) ** 2, axis=(1, 2))
    size = energy * freq ** (2 * (2 - DERIVATIVES[frf.form]))
    starts, level = _quarter_octaves(freq, size)
    ends = [k for k in range(len(level) - 1) if level[k] <= 1.5 * level[k + 1 : k + 1 + BINS_AHEAD].min()]
    if not ends or int(np.argmax(level[: ends[0] + 1])) > 1 or level[0] < FALL * level[ends[0]]:
        return 0, 0.0
    return int(starts[ends[0]]), float(energy[: starts[ends[0]]].sum() / energy.sum())


def _quarter_octaves(freq: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, Float[np.ndarray, " b"]]:
    """First line of each quarter octave that holds any, and the median there."""
    octave = np.floor(4 * np.log2(freq / freq[0]) + 1e-9)
    starts = np.flatnonzero(np.diff(octave, prepend=-1.0))
    stops = [*starts[1:], len(freq)]
    return starts, np.array([np.median(size[a:b]) for a, b in zip(starts, stops, strict=True)])
