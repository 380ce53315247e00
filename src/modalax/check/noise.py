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


def local_noise(H: Complex[np.ndarray, "f k"], lines: int | None = None) -> Float[np.ndarray, "f k"]:
    """Root of E|e|^2 near each line: the median over a window, so that peaks and single lines do not count."""
    count = H.shape[0]
    lines = lines or max(11, count // 12)
    off = np.abs(off_neighbours(H)) ** 2
    centres = np.unique(np.linspace(0, count - 1, max(2, 3 * count // lines)).round().astype(int))
    half = lines // 2
    medians = np.array([np.median(off[max(0, c - half) : c + half + 1], axis=0) for c in centres]) / MEDIAN
    logs = np.log(np.maximum(medians, 1e-300))
    smooth = np.stack([np.interp(np.arange(count), centres, logs[:, k]) for k in range(H.shape[1])], axis=1)
    return np.exp(smooth / 2)
