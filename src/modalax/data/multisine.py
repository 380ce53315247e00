"""Random-phase multisines: signals whose spectrum tells noise, even and odd distortion apart."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from modalax._numerics.checks import as_double, require_double

GRIDS = ("full", "odd", "random-odd")


def excited_lines(
    grid: str, lower: float, upper: float, fs: float, samples: int, *, key: jax.Array | None = None, group: int = 4
) -> Int[np.ndarray, " k"]:
    """Harmonics of ``fs/samples`` that a multisine excites.

    Parameters
    ----------
    grid
        ``full``: all lines; ``odd``: odd ones, even lines show even distortion; ``random-odd``: odd ones of which
        one in each ``group`` is left out at random, to show odd distortion.
    lower, upper
        Band [Hz].
    fs, samples
        Sampling rate [Hz] and samples of one period.
    key
        Random key, for ``random-odd``.

    Raises
    ------
    ValueError
        If the grid is unknown, ``random-odd`` has no key, or the band holds no line below half the sampling rate.

    References
    ----------
    R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley-IEEE, 2012, sec. 4.3.
    """
    if grid not in GRIDS:
        raise ValueError(f"grid is {grid!r}; it must be one of {', '.join(GRIDS)}")
    spacing = fs / samples
    lines = np.arange(max(1, int(np.ceil(lower / spacing * (1 - 1e-12)))), int(upper / spacing * (1 + 1e-12)) + 1)
    lines = lines[2 * lines < samples]
    if grid != "full":
        lines = lines[lines % 2 == 1]
    if lines.size == 0:
        raise ValueError(
            f"the band {lower:g} to {upper:g} Hz holds no line to excite; lines are {spacing:g} Hz apart and end below "
            f"{fs / 2:g} Hz"
        )
    if grid == "random-odd":
        if key is None:
            raise ValueError("a random-odd grid draws the lines left out; give it a key, jax.random.key(number)")
        whole = lines.size // group
        out = np.asarray(jax.random.randint(key, (whole,), 0, group)) + group * np.arange(whole)
        lines = np.delete(lines, out)
    return lines


def multisine(
    key: jax.Array, lines: Any, samples: int, *, inputs: int = 1, rms: Any = 1.0, spectrum: Any = None
) -> Float[Array, "e t i"]:
    r"""One period of random-phase multisines, :math:`\sum_k A_k\cos(2\pi k t/N + \varphi_k)` with uniform phases.

    For several inputs there are as many experiments, in which the inputs' phases turn against each other by the
    columns of a Fourier matrix: the forces of all experiments together are orthogonal at every line, so each
    realisation gives every FRF with no more noise than one input alone would.

    Parameters
    ----------
    key
        Random key; ``jax.vmap`` over keys makes realisations.
    lines
        Excited harmonics, shape ``(k,)``, as :func:`excited_lines` gives them.
    samples
        Samples N of one period.
    inputs
        Number of inputs, and of experiments.
    rms
        Root mean square of each signal [N].
    spectrum
        Amplitudes relative to each other, shape ``(k,)``; all the same by default.

    Returns
    -------
    Array
        Shape ``(e, t, i)``: experiment, sample, input.

    Raises
    ------
    ValueError
        If a line lies at 0 or beyond half the sampling rate.

    References
    ----------
    T. P. Dobrowiecki, J. Schoukens, Measuring a linear approximation to weakly nonlinear MIMO systems, Automatica 43
    (2007) 1737-1751.
    """
    require_double("a multisine")
    which = check_lines(lines, samples)
    shape = np.ones(which.size) if spectrum is None else as_double(spectrum, "spectrum")
    return _signals(key, which, shape, rms, samples, inputs)


@partial(jax.jit, static_argnames=("samples", "inputs"))
def _signals(
    key: jax.Array, lines: Int[ArrayLike, " k"], shape: Any, rms: Any, samples: int, inputs: int
) -> Float[Array, "e t i"]:
    amplitude = rms * shape * jnp.sqrt(2 / jnp.sum(shape**2))
    phase = jax.random.uniform(key, (lines.size, inputs), jnp.float64, 0.0, 2 * jnp.pi)
    turn = 2 * np.pi * np.outer(np.arange(inputs), np.arange(inputs)) / inputs
    lines_of = samples / 2 * amplitude[:, None] * jnp.exp(1j * (phase + turn[:, None, :]))
    whole = jnp.zeros((inputs, samples // 2 + 1, inputs), jnp.complex128).at[:, lines].set(lines_of)
    return jnp.fft.irfft(whole, samples, axis=1)


def cut_periods(record: Any, samples: int, skip: int = 1) -> Float[Array, "p t c"]:
    """Whole periods of a record, without the first ``skip`` in which the transient dies away.

    Parameters
    ----------
    record
        Shape ``(t, c)``, from the start of a period on.
    samples
        Samples of one period.
    skip
        Periods left out at the start.

    Raises
    ------
    ValueError
        If no whole period is left.
    """
    record = as_double(record, "record")
    if record.ndim != 2:
        raise ValueError(f"record has shape {record.shape}; it needs (t, channel)")
    count = record.shape[0] // samples - skip
    if count < 1:
        raise ValueError(
            f"{record.shape[0]} samples hold {record.shape[0] // samples} periods of {samples}; with {skip} left out "
            f"at least {skip + 1} are needed"
        )
    return record[skip * samples : (skip + count) * samples].reshape(count, samples, record.shape[1])


def check_lines(lines: Any, samples: int) -> Int[np.ndarray, " k"]:
    """Return ``lines`` as increasing harmonics between 0 and half the sampling rate, both excluded.

    Raises
    ------
    ValueError
        If they are not.
    """
    which = np.asarray(lines)
    if which.ndim != 1 or which.size == 0 or which.dtype.kind not in "iu" or (np.diff(which) <= 0).any():
        raise ValueError(f"lines must be increasing whole numbers in a shape (k,); seen {which.dtype} of {which.shape}")
    if which[0] < 1 or 2 * which[-1] >= samples:
        raise ValueError(
            f"lines {which[0]} to {which[-1]} of a period of {samples} samples; they must lie from 1 to "
            f"{(samples - 1) // 2}"
        )
    return which.astype(np.int64)
