"""The noise that weighs the fit: given, smoothed, or estimated from the residual."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax.data.frf import FRF
from modalax.identify.refine import UNIT, Refined

ENOUGH = 32  # repeats from which on a variance needs no smoothing


def smooth_variance(frf: FRF) -> FRF:
    r"""The FRF with a variance fit for weights: smoothed along frequency where few repeats made it noisy.

    A variance from ``M`` repeats has a relative standard deviation of :math:`1/\sqrt{M-1}`; as a weight it would
    let lines dominate that are quiet by chance. Averages over ``2 w + 1`` lines bring it down to that of at least
    ``ENOUGH`` repeats. An all-zero variance is no variance.
    """
    if frf.variance is None or not bool((frf.variance > 0).any()):
        return frf.replace(variance=None)
    if frf.averages is None or frf.averages >= ENOUGH:
        return frf
    half = int(np.ceil(0.5 * ENOUGH / max(frf.averages - 1, 1)))
    return frf.replace(variance=_running_mean(np.asarray(frf.variance), half))


def residual_sigma(frf: FRF, refined: Refined, sigma: Any, share: float = 1.0) -> Float[Array, "f o i"]:
    r"""Standard deviation of each sample from the residual: a size a channel times a course over frequency.

    The course is a running mean square over the lines, shared by the channels of the longer axis. Noise and model
    error are not told apart, and model error is largest at the peaks, which hold the damping: with ``share`` below 1
    the weights go only part of the way (in logarithms) from equal ones to those of the residual. A floor
    at a tenth of the typical deviation keeps lines from dominating that the model passes through by chance.
    """
    if isinstance(sigma, str):
        scale = UNIT * np.sqrt(np.mean(np.abs(np.asarray(frf.H)) ** 2))
        sigma = np.full(frf.H.shape, scale)
    else:
        weight = np.asarray(sigma)
        sigma = weight * UNIT * np.sqrt(np.mean(np.abs(np.asarray(frf.H) / weight) ** 2))
    power = np.abs(np.asarray(refined.residual)) ** 2 * sigma**2
    axis = 2 if frf.shape[2] > frf.shape[1] else 1  # the longer axis, whose channels share a course over frequency
    size = np.maximum(np.median(power, axis=(0, 3 - axis), keepdims=True), 1e-300)
    course = np.mean(power / size, axis=axis, keepdims=True)
    half = max(8, len(power) // 60)
    local = _running_mean(course, half)
    local = np.maximum(local, 1e-2 * np.median(local, axis=0, keepdims=True))
    rounding = (1e-13 * np.abs(np.asarray(frf.H)).max()) ** 2 + 1e-300
    variance = np.maximum(local * size, rounding)
    return jnp.asarray(np.sqrt(variance**share * np.mean(variance) ** (1 - share)))


def _running_mean(values: np.ndarray, half: int) -> np.ndarray:
    """Mean over up to ``half`` neighbours on either side, fewer at the ends."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    n = len(values)
    low = np.maximum(np.arange(n) - half, 0)
    high = np.minimum(np.arange(n) + half + 1, n)
    return (total[high] - total[low]) / (high - low).reshape(-1, *[1] * (values.ndim - 1))
