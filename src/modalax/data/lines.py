"""Frequency lines in equal steps."""

import numpy as np

MOST_LINES = 1_000_000  # lines of a prediction; more are surely a mistake


def lines_of_band(lower: float, upper: float, step: float, name: str) -> np.ndarray:
    """Frequency lines from the lower end of a band in equal steps [Hz]; the upper end counts if a step meets it.

    Parameters
    ----------
    lower, upper
        Ends of the band [Hz].
    step
        Distance of the lines [Hz].
    name
        What errors call the step, as ``--step``.

    Raises
    ------
    ValueError
        If the step is not positive, wider than the band or makes more than ``MOST_LINES`` lines.
    """
    if not 0 < step < np.inf:
        raise ValueError(f"{name} {step:g}: the distance of the lines must be above 0 Hz and finite")
    steps = np.floor((upper - lower) / step * (1 + 1e-12))
    if steps < 1:
        raise ValueError(f"{name} {step:g}: wider than the band {lower:g} to {upper:g} Hz, which would leave one line")
    if steps >= MOST_LINES:
        raise ValueError(
            f"{name} {step:g}: makes {steps + 1:.3g} lines of the band {lower:g} to {upper:g} Hz; at most "
            f"{MOST_LINES} are computed, which a step of {(upper - lower) / (MOST_LINES - 1):.2g} Hz makes"
        )
    return lower + step * np.arange(int(steps) + 1)
