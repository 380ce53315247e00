"""What measured data may not hold: samples that are no numbers, frequencies out of order, impossible variances."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

from modalax._numerics.checks import as_double, is_traced, require_finite, require_range


def check_axis(freq: Any) -> None:
    """Refuse a frequency axis that does not increase or is negative; traced values cannot be checked.

    Raises
    ------
    ValueError
        If the axis is of that kind; the message names the first such line.
    """
    if is_traced(freq):
        return
    require_finite(freq, "freq")
    values = np.asarray(freq)
    if values.ndim != 1:
        raise ValueError(f"freq has shape {values.shape}; it needs (f,), a frequency for each line: [f] for one")
    if values.size == 0:
        raise ValueError("freq holds 0 lines; at least 1 is needed")
    if values[0] < 0:
        raise ValueError(f"freq starts at {values[0]:g} Hz; frequencies are counted from 0 Hz up")
    back = np.flatnonzero(np.diff(values) <= 0)
    if back.size:
        k = int(back[0])
        raise ValueError(
            f"freq must increase: line {k + 1} is {values[k + 1]:g} Hz after {values[k]:g} Hz; sort the lines first"
        )


def check_variance(variance: Any) -> None:
    """Refuse a variance that is negative or not finite.

    The variance is checked as it was given, because under ``jit`` whatever is computed from it is traced.

    Raises
    ------
    ValueError
        With the smallest value, or the place of the first that is not finite.
    """
    if is_traced(variance):
        return
    require_finite(variance, "variance")
    smallest = float(np.min(np.asarray(variance), initial=np.inf))
    if smallest < 0:
        raise ValueError(f"variance holds negative values (smallest {smallest:g})")


def check_beside(shape: tuple[int, ...], coherence: Any, level: Any, added_decay: Any, averages: Any) -> None:
    """Refuse FRFs without runs, outputs or inputs, and coherences, levels, decays or averages that are impossible.

    Raises
    ------
    ValueError
        With the number seen and what is needed.
    """
    if 0 in shape:
        raise ValueError(f"H has shape {shape}; at least one run, line, output and input are needed")
    if coherence is not None:
        # A thousandth above one is rounding of files in single precision, or of averages taken apart.
        require_range(coherence, "coherence", -1e-3, 1 + 1e-3, "a coherence lies between 0 and 1")
    positive = "a force amplitude is above 0 N and finite; NaN where it is not known"
    require_range(level, "level", np.finfo(float).tiny, np.inf, positive, unknown=True)
    require_range(added_decay, "added_decay", 0.0, np.inf, "the decay that a window adds is 0 1/s or more")
    if averages is not None and (isinstance(averages, bool) or averages != int(averages) or averages < 1):
        raise ValueError(f"averages is {averages}; it needs a whole number of repeats, at least 1")


def require_samples(
    data: Real[np.ndarray, "segment t channel"], fs: float, channels: Sequence[str], first: int = 0
) -> None:
    """Refuse samples that are not finite; ``first`` is the place in the record of the first sample given.

    Raises
    ------
    ValueError
        With the channel and the time of the first such sample [s from the beginning of the record].
    """
    if np.isfinite(data.sum()):  # quicker than to look at each sample
        return
    bad = np.argwhere(~np.isfinite(data))
    if len(bad):
        segment, sample, channel = bad[0]
        of_record = f" of record {segment + 1}" if len(data) > 1 else ""
        more = f"; {len(bad)} samples in all are not finite" if len(bad) > 1 else ""
        raise ValueError(
            f"channel {channels[channel]} is {data[segment, sample, channel]:g} at {(first + sample) / fs:g} s"
            f"{of_record}{more}; every sample must be finite"
        )


def over_samples(value: Any, what: str, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """A statistic of each sample: ``value`` in double precision, repeated along axes that it lacks.

    Raises
    ------
    ValueError
        If its shape does not fit that of the FRFs.
    """
    found = as_double(value, what)
    if found.ndim > len(shape) or any(n not in (1, m) for n, m in zip(found.shape[::-1], shape[::-1], strict=False)):
        raise ValueError(f"{what} has shape {found.shape}; it needs that of H, {shape}, or one number")
    return jnp.broadcast_to(found, shape)
