"""Noise of FRFs, from the stated variance or from how far each line lies off its neighbours."""

import numpy as np
from jaxtyping import Complex, Float

# Weights of a cubic through the two neighbours on either side, and what they make of white noise.
CUBIC = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6
SPREAD = 1 + np.sum(CUBIC**2)
# Median of |e|^2 of complex Gaussian noise over its mean.
MEDIAN = np.log(2)


def off_neighbours(H: Complex[np.ndarray, "... f k"]) -> Complex[np.ndarray, "... f k"]:
    """Each line less the cubic through its four neighbours, scaled to the standard deviation of white noise."""
    if H.shape[-2] < 5:
        return np.zeros_like(H)
    padded = np.concatenate([H[..., 2:0:-1, :], H, H[..., -2:-4:-1, :]], axis=-2)
    count = H.shape[-2]
    predicted = sum(c * padded[..., k : k + count, :] for k, c in enumerate(CUBIC) if c)
    return (H - predicted) / np.sqrt(SPREAD)


def local_noise(freq: Float[np.ndarray, " f"], H: Complex[np.ndarray, "f k"], power: int) -> Float[np.ndarray, "f k"]:
    """Root of E|e|^2 near each line: the median over a window, so that peaks and single lines do not count.

    Noise that is even in an accelerance falls by the square of frequency in its receptance, over few lines near 0 Hz.
    So the form is taken in which the medians are most alike.

    Parameters
    ----------
    freq
        Lines [Hz].
    power
        0 for receptance, 1 for mobility, 2 for accelerance.
    """
    tried = []
    for form in range(3):
        turn = (freq / freq[-1])[:, None] ** (form - power)
        logs = _log_medians(H * turn)
        tried.append((float(np.var(logs, axis=0).sum()), logs / 2 - np.log(turn)))
    return np.exp(min(tried, key=lambda one: one[0])[1])


def _log_medians(H: Complex[np.ndarray, "f k"]) -> Float[np.ndarray, "f k"]:
    """Logarithm of the power of noise near each line."""
    count = H.shape[0]
    lines = max(11, count // 12)
    off = np.abs(off_neighbours(H)) ** 2
    centres = np.unique(np.linspace(0, count - 1, max(2, 3 * count // lines)).round().astype(int))
    half = lines // 2
    medians = np.array([np.median(off[max(0, c - half) : c + half + 1], axis=0) for c in centres]) / MEDIAN
    logs = np.log(np.maximum(medians, 1e-300))
    return np.stack([np.interp(np.arange(count), centres, logs[:, k]) for k in range(H.shape[1])], axis=1)
