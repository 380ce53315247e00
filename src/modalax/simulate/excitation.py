"""Forces of a test: sines swept or stepped, band-limited noise and bursts of it, hammer pulses. Multisines are in data.

All are records of shape ``(t,)`` [N]; those with chance in them take a JAX key.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_double, require_double


def swept_sine(
    start: float, stop: float, rate: float, fs: float, *, amplitude: Any = 1.0, logarithmic: bool = False
) -> Float[Array, " t"]:
    r"""A sine whose frequency runs from ``start`` to ``stop``, up or down.

    .. math:: F\sin 2\pi\left(f_0 t \pm \tfrac12 r t^2\right) \quad\text{or}\quad
              F\sin\frac{2\pi f_0 (2^{\pm rt} - 1)}{\pm r\ln 2}

    Parameters
    ----------
    start, stop
        First and last frequency [Hz]; a sweep down starts at the higher one.
    rate
        Speed r [Hz/s], or [octave/s] if ``logarithmic``; ISO 7626-2 advises at most :math:`54 f_r^2/Q^2` Hz/min at a
        resonance :math:`f_r` of quality Q.
    fs
        Sampling rate [Hz].
    amplitude
        Amplitude F [N].

    Raises
    ------
    ValueError
        If a frequency or the rate is not positive, or the sampling is too slow for the highest frequency.
    """
    if not (start > 0 and stop > 0 and rate > 0) or start == stop:
        raise ValueError(
            f"a sweep from {start:g} to {stop:g} Hz at rate {rate:g}; both frequencies and the rate must be above 0, "
            "and the frequencies different"
        )
    _check_rate(max(start, stop), fs)
    sign = np.sign(stop - start)
    duration = abs(np.log2(stop / start)) / rate if logarithmic else abs(stop - start) / rate
    t = jnp.arange(round(duration * fs)) / fs
    if logarithmic:
        slope = sign * rate * jnp.log(2.0)
        phase = start * jnp.expm1(slope * t) / slope
    else:
        phase = start * t + 0.5 * sign * rate * t**2
    return amplitude * jnp.sin(2 * jnp.pi * phase)


def stepped(freq: Any, dwell: float, fs: float, *, amplitude: Any = 1.0) -> Float[Array, " t"]:
    """Sines one after the other in the order of ``freq`` [Hz], each for ``dwell`` [s], the phase running on.

    Raises
    ------
    ValueError
        If a frequency is not positive, or the sampling is too slow for the highest.
    """
    freq = np.asarray(freq, dtype=float)
    if not freq.min() > 0:
        raise ValueError(f"a line at {freq.min():g} Hz; a sine needs a frequency above 0")
    _check_rate(freq.max(), fs)
    samples = round(dwell * fs)
    # The phase at the start of a line is reduced by whole turns, so that a long test loses no digits.
    begin = np.concatenate([[0.0], np.cumsum(freq * samples / fs)[:-1]]) % 1.0
    phase = begin[:, None] + freq[:, None] * np.arange(samples) / fs
    return amplitude * jnp.sin((2 * np.pi * phase).ravel())


def random(
    key: jax.Array, samples: int, fs: float, lower: float, upper: float, *, rms: Any = 1.0
) -> Float[Array, " t"]:
    """Gaussian noise whose power lies within a band, of a given root mean square on average.

    Parameters
    ----------
    key
        Random key.
    samples, fs
        Length of the record and sampling rate [Hz].
    lower, upper
        Band [Hz].
    rms
        Root mean square [N].

    Raises
    ------
    ValueError
        If the band holds no line of the record, or the sampling is too slow.
    """
    require_double("random excitation")
    _check_rate(upper, fs)
    # Twice as long as needed, so that the end of the record is independent of its start.
    lines = np.fft.rfftfreq(2 * samples, 1 / fs)
    inside = (lines >= lower) & (lines <= upper) & (lines > 0)
    if not inside.any():
        raise ValueError(f"the band {lower:g} to {upper:g} Hz holds no line of a record of {samples / fs:g} s")
    real, imag = jax.random.normal(key, (2, lines.size), jnp.float64)
    # each line is a cosine and a sine of mean square (rms^2 / lines) / 2 each
    scale = rms * samples / np.sqrt(inside.sum())
    return jnp.fft.irfft(jnp.where(inside, scale * (real + 1j * imag), 0.0), 2 * samples)[:samples]


def burst(force: Float[Array, " t"], share: float, *, ramp: float = 0.02) -> Float[Array, " t"]:
    """Burst: the first ``share`` of a record, faded in and out by half cosines of length ``ramp`` of it, then zeros.

    Raises
    ------
    ValueError
        If the share is not between 0 and 1, or the ramps do not fit.
    """
    if not 0 < share <= 1 or not 0 <= 2 * ramp <= share:
        raise ValueError(f"share {share:g} with ramps of {ramp:g}; it needs 0 < share <= 1 and ramps within it")
    s = jnp.arange(force.shape[0]) / force.shape[0]
    edge = jnp.minimum(s, share - s)
    window = jnp.where(edge < 0, 0.0, 1.0)
    if ramp > 0:
        window = 0.5 * (1 - jnp.cos(jnp.pi * jnp.clip(edge / ramp, 0.0, 1.0)))
    return force * window


def hammer(
    samples: int, fs: float, *, peak: Any = 1.0, contact: Any, start: Any = 0.0, times: Any = None
) -> Float[Array, " t"]:
    r"""A hammer pulse, half a sine :math:`F\sin(\pi (t - t_0)/T)` over the contact time T; or several of them.

    Its spectrum has its first zero at :math:`1.5/T`.

    Parameters
    ----------
    samples, fs
        Length of the record and sampling rate [Hz].
    peak, contact
        Peak force [N] and contact time [s], one number, or one for each pulse.
    start
        When the pulse begins [s].
    times
        When each of several pulses begins, shape ``(p,)`` [s]; in place of ``start``.

    Raises
    ------
    ValueError
        If the contact is shorter than ten samples, so that the record does not hold its shape.
    """
    if float(np.min(contact)) * fs < 10:
        raise ValueError(
            f"a contact of {float(np.min(contact)):g} s at {fs:g} Hz is {float(np.min(contact)) * fs:.3g} samples "
            "long; at least 10 are needed"
        )
    begin = jnp.atleast_1d(as_double(start if times is None else times, "times"))
    phase = (jnp.arange(samples)[:, None] / fs - begin) / as_double(contact, "contact")
    pulse = jnp.where((phase > 0) & (phase < 1), jnp.sin(jnp.pi * jnp.clip(phase, 0.0, 1.0)), 0.0)
    return jnp.sum(as_double(peak, "peak") * pulse, axis=1)


def _check_rate(highest: float, fs: float) -> None:
    if not 2 * highest < fs:
        raise ValueError(f"{highest:g} Hz at a sampling rate of {fs:g} Hz; the rate must be above {2 * highest:g} Hz")
