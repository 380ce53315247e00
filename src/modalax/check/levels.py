"""Sensors that saturate, found by comparing runs at several force levels."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import Study

# Loss of gain of one output relative to all others that is reported, and its least number of standard deviations.
LOSS, SURE = 0.05, 6.0
# Lines whose response exceeds this share of the output's largest are compared, of those with less relative noise.
LOUD, CLEAR = 0.85, 0.2
OVER = np.geomspace(1.0, 30.0, 400)  # responses at the peak over the sensor's limit that are compared with the loss


def clipped(study: Study) -> Iterator[Finding]:
    """Find single outputs that lose gain where their response is largest, and more so at a higher force."""
    level = study.level
    if not np.isfinite(level).all() or len(level) < 2 or level.max() < 1.2 * level.min() or len(study.outputs) < 2:
        return
    low, high = int(np.argmin(level)), int(np.argmax(level))
    ratio = np.log((np.abs(study.H[high]) + 1e-300) / (np.abs(study.H[low]) + 1e-300))
    noise = np.hypot(
        study.sigma[high] / (np.abs(study.H[high]) + 1e-300), study.sigma[low] / (np.abs(study.H[low]) + 1e-300)
    )
    for o, name in enumerate(study.outputs):
        clear = noise[:, o] < CLEAR
        size = np.where(clear, np.abs(study.H[low, :, o]), 0.0)
        lines, columns = np.nonzero(size > LOUD * max(size.max(), np.finfo(float).tiny))
        count = len(lines)
        # The other outputs at the same lines are the reference, because a non-linear structure changes them all.
        others = np.delete(np.arange(len(study.outputs)), o)
        weight = 1 / (noise[lines][:, others][np.arange(count), :, columns] ** 2 + 1e-4)
        beside = ratio[lines][:, others][np.arange(count), :, columns]
        # Compared with the other output that lost most, because a non-linear structure may change few of them.
        known = np.where(weight > 100, beside, np.inf)
        use = np.isfinite(known).any(axis=1)
        if not use.any():
            continue
        lines, columns, known, weight = lines[use], columns[use], known[use], weight[use]
        least = np.argmin(known, axis=1)
        expected = known[np.arange(len(lines)), least]
        spread = np.sqrt(noise[lines, o, columns] ** 2 + 1 / weight[np.arange(len(lines)), least] + 1e-4)
        loss = expected - ratio[lines, o, columns]
        mean = float(np.sum(loss / spread**2) / np.sum(1 / spread**2))
        std = float(1 / np.sqrt(np.sum(1 / spread**2)))
        quiet = np.median(expected) - np.median(ratio[:, o][clear]) if clear.any() else 0.0
        scatter = float(np.median(np.abs(loss - mean)))
        score = mean / max(LOSS, SURE * std, 0.7 * scatter)
        if score > 1 and abs(quiet) < 0.6 * mean + 0.02:
            share = np.abs(study.H[low, lines, o, columns]) / size.max()
            middle = np.array([np.median(row[np.isfinite(row)]) for row in known])
            told = [
                _at_the_peak(reference - ratio[lines, o, columns], spread, share, level[low] / level[high])
                for reference in (middle, expected)
            ]
            most, ends = told[0][0], (min(a for _, a, _ in told), max(b for _, _, b in told))
            yield Finding(
                "clipped", (name,), sure=sureness(score, 1.0), size=most, unit="of the peak", interval=ends,
                evidence=f"at its peaks this output loses {100 * (1 - np.exp(-mean)):.3g} % from {level[low]:.3g} to "
                f"{level[high]:.3g} N, the other outputs at the same lines do not",
                advice="choose a larger range for this channel, or a lower level",
                picture=Picture(
                    [(f"{level[k]:.3g} N", study.freq, np.abs(study.H[k, :, o]).max(axis=1)) for k in (low, high)],
                    "Frequency [Hz]", "|H|", True,
                ),
            )  # fmt: skip


def _at_the_peak(loss: np.ndarray, spread: np.ndarray, share: np.ndarray, weaker: float) -> tuple[float, float, float]:
    r"""Loss at the peak of the higher level against an unlimited sensor, and its interval of 95 %.

    Of a sine of amplitude :math:`A` a sensor of limit c leaves :math:`g(A/c)` of the fundamental,

    .. math:: g(x) = \tfrac2\pi\big(\arcsin\tfrac1x + \tfrac1x\sqrt{1 - 1/x^2}\big),\quad x > 1

    (Gelb and Vander Velde 1968, Multiple-Input Describing Functions, saturation). One limit explains the loss of all
    lines, those below the peak and those at which the lower level is clipped too.

    Parameters
    ----------
    loss, spread
        Logarithm of the gain that each line loses between the levels, and its standard deviation, shape ``(n,)``.
    share
        Response at each line over that at the peak at the lower level, shape ``(n,)``.
    weaker
        The lower level over the higher one.
    """
    # The lower level's response as it would be without the limit, of each limit that is tried.
    y = np.geomspace(1e-3, 2 * OVER[-1], 2000)
    limited = weaker * OVER * _left(weaker * OVER)
    y = np.interp(limited[:, None] * share, y * _left(y), y)
    chi2 = np.sum(((loss - np.log(_left(y) / _left(y / weaker))) / spread) ** 2, axis=1)
    best = int(np.argmin(chi2))
    inside = np.flatnonzero(chi2 <= chi2[best] + 4 * max(1.0, chi2[best] / max(len(loss) - 1, 1)))
    ends = OVER[[best, inside[0], inside[-1]]] * np.array([1.0, OVER[0] / OVER[1], OVER[1] / OVER[0]])
    size, low, high = (float(1 - _left(np.array(e))) for e in ends)
    return size, low, high


def _left(x: np.ndarray) -> np.ndarray:
    """Part of a sine's fundamental that a limit leaves of it, of amplitudes over that limit."""
    y = 1 / np.maximum(x, 1.0)
    return 2 / np.pi * (np.arcsin(y) + y * np.sqrt(1 - y**2))
