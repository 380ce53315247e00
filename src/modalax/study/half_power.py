"""An example of a function that a study can run: a mode by its half-power bandwidth."""

import numpy as np


def half_power(seed: int, noise: float = 0.02) -> dict[str, float]:
    r"""Frequency and damping ratio of one mode by its peak and half-power bandwidth, from an FRF with noise.

    The mode has 50 Hz and 1 %; the noise is a fraction of the peak, and the lines are 0.02 Hz apart.

    Raises
    ------
    ValueError
        If the band holds no half-power point on a side.
    """
    freq = np.arange(45, 55, 0.02)
    rng = np.random.default_rng(seed)
    H = 1 / (1 - (freq / 50) ** 2 + 2j * 0.01 * freq / 50)
    H = H + noise * np.abs(H).max() * (rng.normal(size=freq.size) + 1j * rng.normal(size=freq.size)) / np.sqrt(2)
    size = np.abs(H)
    top = int(size.argmax())
    below = size < size[top] / np.sqrt(2)
    if not below[:top].any() or not below[top:].any():
        raise ValueError("no half-power point on a side of the peak")
    low, high = freq[np.flatnonzero(below[:top])[-1]], freq[top + np.flatnonzero(below[top:])[0]]
    return {"frequency_hz": float(freq[top]), "damping_ratio": float((high - low) / (2 * freq[top]))}
