"""Sensors that saturate, found by comparing runs at several force levels."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import Study

# Loss of gain of one output relative to all others that is reported, and its least number of standard deviations.
LOSS, SURE = 0.05, 6.0
# Lines whose response exceeds this share of the output's largest are compared, of those with less relative noise.
LOUD, CLEAR = 0.85, 0.2


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
            # The loss is largest at the very peak, and on the mean of all loud lines less.
            most = float(max(mean, np.median(np.sort(loss)[-3:])))
            yield Finding(
                "clipped", (name,), sure=sureness(score, 1.0), size=float(1 - np.exp(-most)), unit="of the peak",
                interval=(float(1 - np.exp(-mean + 2 * std)), float(1 - np.exp(-most - 2 * spread.max()))),
                evidence=f"at its peaks this output loses {100 * (1 - np.exp(-mean)):.3g} % from {level[low]:.3g} to "
                f"{level[high]:.3g} N, the other outputs at the same lines do not",
                advice="choose a larger range for this channel, or a lower level",
                picture=Picture(
                    [(f"{level[k]:.3g} N", study.freq, np.abs(study.H[k, :, o]).max(axis=1)) for k in (low, high)],
                    "Frequency [Hz]", "|H|", True,
                ),
            )  # fmt: skip
