"""Mains hum on lines of a measurement whose modes are explained: seen without a simulation, as by a check."""

from typing import Any

import numpy as np

from modalax.check.finding import Finding
from modalax.check.hum import MAINS, SPREAD, WANDER, hum
from modalax.check.study import study_of
from modalax.data import Measurement

SEEN = 9.0  # power at a line near a multiple of the mains, over the usual one, from which hum is looked for


def mains_hum(
    measurement: Measurement, freq: np.ndarray, residual: np.ndarray, joint: bool = False
) -> Finding | None:  # fmt: skip
    """What a check finds of hum, where a diagnosis leaves more near multiples of the mains than elsewhere.

    Hum is least disguised at the lowest level. A joint may jump at a line, but not there: beside one that level is
    looked at alone.

    Parameters
    ----------
    measurement
        As it was diagnosed.
    freq, residual
        Its lines [Hz], and what is left of it over the noise, shape ``(run, f, o, i)``.
    joint
        Whether a joint tells the levels apart.
    """
    if joint:
        level = np.asarray(measurement.level)
        runs = np.flatnonzero(level == level.min()).tolist()
        measurement, residual = Measurement.from_frfs([measurement.run(k) for k in runs]), residual[runs]
    power = (np.abs(residual) ** 2).mean(axis=(0, 2, 3))
    if len(freq) < 2 or not near_mains(freq, power > SEEN * np.median(power)).any():
        return None
    return next(iter(hum(study_of(measurement))), None)


def lines_without_hum(freq: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Numbers of the lines that tell of the structure: all but those near multiples of the mains that stand out."""
    power = (np.abs(residual) ** 2).mean(axis=(0, 2, 3))
    return np.flatnonzero(~near_mains(freq, power > SEEN * np.median(power)))


def near_mains(freq: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Which of some lines are near a multiple of the mains."""
    multiples = np.stack([m * np.maximum(np.round(freq / m), 1) for m in MAINS])
    near = np.abs(freq - multiples) < SPREAD * np.median(np.diff(freq)) + WANDER * freq
    return which & near.any(axis=0)


def hum_told(found: Finding) -> dict[str, Any]:
    """The cause as in the answer."""
    size = {"value": found.size, "std": None, "unit": "-"}
    return {"name": "mains_hum", "where": [], "probability": found.sure, "parameters": {"relative_amplitude": size}}
