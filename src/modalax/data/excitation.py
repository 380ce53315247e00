"""The kind of excitation of a recorded force: hits, periodic, a stepped sine, a sweep, bursts or random."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from modalax.data.steps import steps_of

KINDS = ("hits", "multisine", "stepped", "sweep", "blocks", "random")
QUIET, BRIEF = 0.05, 0.08  # share of its peak below which a force is quiet; most of the time that hits may take up
REPEATS = 0.98  # correlation of a periodic force with itself a period later
ORDERED = 0.98  # rank correlation of a sweep's frequency with time


class Excitation(NamedTuple):
    """Kind of excitation, why it is taken to be that, and the period in samples of a periodic one (else 0)."""

    kind: str
    why: str
    period: int


def excitation_of(force: Float[np.ndarray, "segment t"]) -> Excitation:
    """Find the kind of excitation from the force alone.

    Parameters
    ----------
    force
        One force, in segments.

    Raises
    ------
    ValueError
        If the force does not change.
    """
    whole = force - np.median(force, axis=1, keepdims=True)
    size = np.abs(whole)
    if not size.any():
        raise ValueError(f"the force does not change: it is {force.flat[0]:.6g} throughout; is it another channel?")
    loud = float(np.mean(size > QUIET * size.max()))
    if loud < BRIEF:
        return Excitation("hits", f"the force stands out in {100 * loud:.2g} % of the time only", 0)
    if steps_of(whole[0]):
        return Excitation("stepped", "its frequency stands still and then jumps to the next", 0)
    period = period_of(whole[0])
    if period:
        return Excitation("multisine", f"the force repeats every {period} samples", period)
    if sweeps(whole[0]):
        return Excitation("sweep", "its frequency goes one way", 0)
    edge = max(1, force.shape[1] // 50)
    ends = np.concatenate([size[:, :edge], size[:, -edge:]], axis=1)
    if len(force) > 1 and float(ends.max()) < QUIET * size.max():
        return Excitation("blocks", "each record begins and ends at rest", 0)
    return Excitation("random", "it neither stands still, nor repeats, nor sweeps", 0)


def period_of(force: Float[np.ndarray, " t"]) -> int:
    """Shortest period in samples of a force that repeats at least once in its second half; 0 if none."""
    # the beginning may be another realisation, or not have settled
    x = force[len(force) // 4 :] - force[len(force) // 4 :].mean()
    n = len(x)
    if n < 64 or not x.any():
        return 0
    spectrum = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    product = np.fft.irfft(spectrum)[: n // 2 + 1]
    energy = np.concatenate([[0.0], np.cumsum(x**2)])
    lags = np.arange(n // 2 + 1)
    ahead, behind = energy[n - lags], energy[n] - energy[lags]
    likeness = product / np.sqrt(np.maximum(ahead * behind, 1e-300))
    valley = int(np.argmax(likeness < 0.5))
    if valley == 0:
        return 0
    beyond = likeness[valley:]
    if beyond.max() < REPEATS:
        return 0
    first = int(np.argmax(beyond > min(REPEATS, 1 - 2 * (1 - beyond.max())))) + valley
    peak = first + int(np.argmax(likeness[first : first + valley + 1]))
    # one sine repeats at every cycle: that is no multisine
    lines = np.sort(np.abs(np.fft.rfft(x[: (n // peak) * peak])) ** 2)
    return 0 if lines[-1] > 0.9 * lines.sum() else peak


def sweeps(force: Float[np.ndarray, " t"], pieces: int = 24) -> bool:
    """Whether the frequency of the loudest line rises or falls steadily over the record."""
    length = len(force) // pieces
    if length < 16:
        return False
    parts = force[: pieces * length].reshape(pieces, length) * np.hanning(length)
    power = np.abs(np.fft.rfft(parts, 4 * length, axis=1)) ** 2
    loud = power.sum(axis=1) > 1e-3 * power.sum(axis=1).max()
    lines = power.argmax(axis=1)[loud].astype(float)
    if len(lines) < pieces // 2 or lines.max() - lines.min() < 4:
        return False
    rank = lambda a: np.argsort(np.argsort(a, kind="stable"), kind="stable").astype(float)
    order = float(np.corrcoef(rank(lines), np.arange(len(lines)))[0, 1])
    backward = float(np.corrcoef(rank(lines[::-1]), np.arange(len(lines)))[0, 1])
    # random noise has its loudest line anywhere
    return max(order, backward) > ORDERED


def excited(force: Float[np.ndarray, "t i"], share: float = 0.03) -> Int[np.ndarray, " k"]:
    """Lines of one period at which every force exceeds a share of its largest line.

    A line between that falls short, as where a shaker loses its force at a resonance, counts if its neighbours of the
    same parity do not.
    """
    F = np.abs(np.fft.rfft(force, axis=0))[1 : (len(force) + 1) // 2]
    loud = (share * F.max(axis=0) < F).all(axis=1)
    lines = np.flatnonzero(loud) + 1
    inside = np.arange(lines[0], lines[-1] + 1)
    if np.isin(inside, lines).mean() > 0.9:
        return inside
    odd = inside[inside % 2 == lines[0] % 2]
    return odd if np.isin(odd, lines).mean() > 0.9 and (lines % 2 == lines[0] % 2).all() else lines
