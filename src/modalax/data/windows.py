r"""Windows on blocks of a time record: tapers for random excitation, force and exponential windows for hammers.

Every window is an array ``(t,)`` of factors [-] that multiplies a block of samples.
"""

from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array, as_double
from modalax._numerics.known import Numbers, by_numpy


def taper(name: str, samples: int) -> Float[np.ndarray, " t"]:
    """Taper by its name in ``scipy.signal.get_window``, such as ``hann``, periodic as spectral averages need it.

    Raises
    ------
    ValueError
        If there is no such window.
    """
    from scipy.signal import get_window  # a second to import, and few need it

    try:
        return np.asarray(get_window(name, samples, fftbins=True))
    except (ValueError, AttributeError) as error:
        raise ValueError(f"no window named {name!r}; use boxcar, hann, flattop or another of scipy.signal") from error


def force_window(samples: int, fs: float, stop: float, start: float = 0.0, ramp: float = 0.0) -> Float[Array, " t"]:
    r"""Window that keeps the force from ``start`` to ``stop`` [s] and makes the noise around it zero.

    Parameters
    ----------
    samples, fs
        Length of the block and sampling rate [Hz].
    start, stop
        First and last time kept in full [s from the start of the block].
    ramp
        Duration of the half cosines that lead from 0 to 1 before ``start`` and back after ``stop`` [s].

    Raises
    ------
    ValueError
        If nothing is kept.
    """
    if not 0 <= start < stop or start * fs > samples - 1:
        raise ValueError(
            f"the force window keeps {start:g} to {stop:g} s of a block of {samples / fs:g} s; it needs "
            "0 <= start < stop, and start within the block"
        )
    time = np.arange(samples) / fs
    outside = np.maximum(np.maximum(start - time, time - stop), 0.0)
    if ramp <= 0:
        return as_array(np.where(outside > 0, 0.0, 1.0))
    return as_array(0.5 * (1 + np.cos(np.pi * np.clip(outside / ramp, 0.0, 1.0))))


def exponential_window(samples: int, fs: float, decay: Any) -> Float[Array, " t"]:
    r"""Window :math:`e^{-\sigma t}` of decay rate :math:`\sigma` [1/s].

    On force and response alike it turns :math:`H(j\omega)` into :math:`H(j\omega + \sigma)`, exactly: every pole
    moves by :math:`-\sigma`, which is what :attr:`modalax.data.FRF.added_decay` keeps. On the response alone it does
    so only if the whole force came at the start of the block.

    Parameters
    ----------
    samples, fs
        Length of the block and sampling rate [Hz].
    decay
        :math:`\sigma` [1/s]; :func:`decay_to` gives it for what is left at the end of the block.
    """
    return _exponential(as_double(decay, "decay"), np.arange(samples) / fs)


@by_numpy
def _exponential(xp: ModuleType, decay: Numbers, time: Numbers) -> Numbers:
    return xp.exp(-decay * time)


def decay_to(remainder: float, duration: float) -> float:
    r"""Decay rate :math:`\sigma = -\ln(\text{remainder})/\text{duration}` [1/s] that leaves a share of the amplitude.

    Parameters
    ----------
    remainder
        What is left after ``duration`` [s], between 0 and 1, for example 0.01.

    Raises
    ------
    ValueError
        If the remainder is no such share or the duration not positive.
    """
    if not 0 < remainder <= 1 or duration <= 0:
        raise ValueError(
            f"remainder {remainder:g} after {duration:g} s; it needs 0 < remainder <= 1 and a time above 0"
        )
    return float(-np.log(remainder) / duration)


def effective_averages(window: Any, step: int, blocks: int) -> float:
    r"""Number of independent blocks that ``blocks`` overlapping ones are worth.

    .. math:: M_e = \frac{M}{1 + 2\sum_{q=1}^{M-1}\left(1-\frac{q}{M}\right)\rho_q}, \quad
              \rho_q = \left(\frac{\sum_t w_t w_{t+qD}}{\sum_t w_t^2}\right)^2

    Parameters
    ----------
    window
        Window of a block, shape ``(t,)``.
    step
        Samples D from the start of a block to that of the next.
    blocks
        Number of blocks M.

    References
    ----------
    P. D. Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Transactions on Audio
    and Electroacoustics 15 (1967) 70-73.
    """
    w = np.asarray(window)
    total = 1.0
    for q in range(1, min(blocks, -(-len(w) // step))):
        shared = np.sum(w[q * step :] * w[: len(w) - q * step]) / np.sum(w**2)
        total += 2 * (1 - q / blocks) * shared**2
    return float(blocks / total)
