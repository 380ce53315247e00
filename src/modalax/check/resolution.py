r"""Spacing of the lines and length of the records, compared with the decay of the modes.

A mode of half-power bandwidth :math:`2\zeta f` decays as :math:`e^{-\sigma t}`, and :math:`n` lines a bandwidth, with
the record :math:`T = 1/\Delta f`, mean :math:`\sigma T = \pi n`: with one line a bandwidth 4 % of the response are
still there when the record ends.
"""

from collections.abc import Iterator

import numpy as np

from modalax.check.basis import MORE_POWERS
from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import CLEAR, Study, line_step

# Lines per half-power bandwidth: reported below the first for most of the modes, below the second for any strong one.
FEW, FEWEST = 1.5, 0.8
# Lines that tell one mode, its pole and residue beside the terms for what lies beyond the band, from noise: as many
# again as there are unknowns.
FEWEST_LINES = 2 * (2 + len(MORE_POWERS))
STRONG = 0.1  # peak of a mode, relative to the strongest, from which on it counts


def resolution(study: Study) -> Iterator[Finding]:
    """Find modes with too few lines within their half-power bandwidth."""
    lines = lines_a_width(study)
    if not len(lines):
        yield from _too_few_to_tell(study)
        return
    middle, least = float(np.median(lines)), float(lines.min())
    if middle >= FEW and least >= FEWEST:
        return
    size = least
    score = max(FEW / max(middle, 1e-6), FEWEST / max(least, 1e-6))
    modes = study.modes
    yield Finding(
        "too_few_lines", (), sure=sureness(score, 1.0), size=size, unit="lines per half-power bandwidth",
        evidence=f"the narrowest mode has {least:.2g} lines within its half-power bandwidth, the middle of all "
        f"{middle:.2g}; the peaks fall between the lines",
        advice="measure with closer lines (a longer record or a zoom): four lines per half-power bandwidth show a peak",
        picture=Picture(
            [("modes", modes.frequency, modes.width / line_step(study.freq, modes.frequency))], "Frequency [Hz]",
            "Lines a half-power bandwidth [-]", True, dots=True,
        ),
    )  # fmt: skip


def _too_few_to_tell(study: Study) -> Iterator[Finding]:
    """A band of so few lines that none of its modes can be told."""
    count = len(study.freq)
    if count >= FEWEST_LINES:
        return
    yield Finding(
        "too_few_lines", (), sure=0.95, size=float(count), unit="lines",
        evidence=f"no mode can be told from {count} lines, and little else: a mode and what lies beyond the band are "
        f"{FEWEST_LINES // 2} complex unknowns of each FRF",
        advice=f"measure at {FEWEST_LINES} lines or more, in a band that holds a resonance",
    )  # fmt: skip


def strong_modes(study: Study) -> np.ndarray:
    """Modes that count: well above the noise, and not tiny compared with the strongest."""
    ratio = np.max(np.abs(study.modes.residues) / study.modes.std, axis=1, initial=0.0)
    peak = np.max(
        np.abs(study.modes.residues) / np.maximum(-study.modes.poles.real, 1e-300)[:, None], axis=1, initial=0
    )
    peak = peak * np.abs(study.modes.poles) ** study.power
    # A pole beyond the band, or one that nobody knows, is the strongest by its residue alone.
    sure = study.modes.inside & (study.modes.pole_std < 0.3 * -study.modes.poles.real)
    return np.flatnonzero(sure & (ratio > 2 * CLEAR) & (peak > STRONG * peak[sure].max(initial=0.0)))


def lines_a_width(study: Study) -> np.ndarray:
    """Lines within the half-power bandwidth of each strong mode."""
    which = strong_modes(study)
    return study.modes.width[which] / line_step(study.freq, study.modes.frequency[which])
