r"""A virtual test bench: structure, joints, sensors and recorder, from an excitation to time records and to FRFs.

What is recorded goes through the signal processing of real records (:mod:`modalax.data.records`), so leakage, noise on
the force, filters, delays and the best linear view of a joint come out as they do in a laboratory.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax.data.frf import check_form
from modalax.data.measurement import Measurement
from modalax.data.multisine import cut_periods, excited_lines, multisine
from modalax.data.records import frf_from_blocks, frf_from_hits, frf_from_records
from modalax.model.receptance import AnyStructure, dof_names
from modalax.simulate.excitation import hammer, random, swept_sine
from modalax.simulate.joints import Joint
from modalax.simulate.march import respond

UNITS = {"receptance": "m", "mobility": "m/s", "accelerance": "m/s^2"}


def butterworth(s: Complex[Array, " f"], corner: Any, order: int, high: bool = False) -> Complex[Array, " f"]:
    """Transfer function of an analogue Butterworth filter at ``s`` [rad/s], low pass or high pass, ``corner`` in Hz."""
    p = s / (2 * jnp.pi * corner)
    if high:
        p = jnp.where(s == 0, jnp.inf, 1 / jnp.where(s == 0, 1.0, p))
    roots = np.exp(1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order))
    return 1 / jnp.prod(p[:, None] - roots, axis=1) * np.real(np.prod(-roots))


class Sensor(eqx.Module):
    r"""A channel: gain, delay, coupling and low-pass filter, then white noise.

    Attributes
    ----------
    gain
        What it shows over what is there [-].
    delay
        Delay [s].
    noise
        Root mean square of the noise it adds over the whole band of the recorder [unit of the channel].
    lowpass, highpass
        Corners of its filters [Hz], or None.
    order
        Order of the low-pass filter; the high-pass filter is of first order, as an AC coupling is.
    """

    gain: Any = 1.0
    delay: Any = 0.0
    noise: Any = 0.0
    lowpass: Any = None
    highpass: Any = None
    order: int = eqx.field(static=True, default=4)

    def transfer(self, freq: Float[Array, " f"]) -> Complex[Array, " f"]:
        """Frequency response of the channel [-]."""
        s = 2j * jnp.pi * freq
        T = self.gain * jnp.exp(-s * self.delay)
        if self.lowpass is not None:
            T = T * butterworth(s, self.lowpass, self.order)
        if self.highpass is not None:
            T = T * butterworth(s, self.highpass, 1, high=True)
        return T


class Records(eqx.Module):
    """What the recorder kept.

    Attributes
    ----------
    force, response
        Shapes ``(run, t, i)`` [N] and ``(run, t, o)`` [``unit``].
    fs
        Sampling rate [Hz].
    unit
        ``m``, ``m/s`` or ``m/s^2``.
    outputs, inputs
        DoF names.
    """

    force: Float[Array, "run t i"]
    response: Float[Array, "run t o"]
    fs: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)


class Bench(eqx.Module):
    """Structure, joints and channels of a test.

    Attributes
    ----------
    structure, joints, places
        What is tested: matrices or a modal model, and its joints with where they sit.
    force_sensor, response_sensor
        The channels: one for all, or one each.
    fs
        Sampling rate of the recorder [Hz].
    oversample
        Steps of the time marching a sample.
    antialias
        Corner of the recorder's 8th-order low pass on all channels, over the sampling rate.
    form
        What the response channels see: displacement (``receptance``), velocity or acceleration.
    inputs, outputs
        DoFs driven and seen.
    """

    structure: AnyStructure
    joints: tuple[Joint, ...]
    force_sensor: Sensor | tuple[Sensor, ...]
    response_sensor: Sensor | tuple[Sensor, ...]
    places: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    fs: float = eqx.field(static=True)
    oversample: int = eqx.field(static=True)
    antialias: float = eqx.field(static=True)
    form: str = eqx.field(static=True)

    def __init__(
        self,
        structure: AnyStructure,
        joints: Sequence[Joint] = (),
        places: Sequence[Sequence[str]] = (),
        *,
        fs: float,
        inputs: Sequence[str],
        outputs: Sequence[str] | None = None,
        force_sensor: Sensor | Sequence[Sensor] | None = None,
        response_sensor: Sensor | Sequence[Sensor] | None = None,
        oversample: int = 8,
        antialias: float = 0.4,
        form: str = "accelerance",
    ):
        self.structure, self.joints, self.places = structure, tuple(joints), tuple(tuple(p) for p in places)
        self.inputs = tuple(inputs)
        self.outputs = dof_names(structure) if outputs is None else tuple(outputs)
        self.force_sensor = _channels(force_sensor, len(self.inputs), "force_sensor")
        self.response_sensor = _channels(response_sensor, len(self.outputs), "response_sensor")
        self.fs, self.oversample, self.antialias, self.form = float(fs), oversample, antialias, check_form(form)

    @property
    def rate(self) -> float:
        """Rate at which the excitation is given and the structure marched [Hz]."""
        return self.fs * self.oversample

    def record(self, key: jax.Array, force: Any) -> Records:
        """Excite the structure from rest by forces at :attr:`rate`, shape ``(run, t, i)`` [N], and record.

        Raises
        ------
        ValueError
            If the shape does not fit, or a joint is too stiff for the steps: raise ``oversample``.
        """
        force = as_double(force, "force")
        if force.ndim != 3 or force.shape[2] != len(self.inputs):
            raise ValueError(
                f"force has shape {force.shape}; it needs (run, t, i), here with {len(self.inputs)} inputs"
            )
        motion = respond(
            self.structure, self.joints, self.places, force, self.rate,
            inputs=self.inputs, outputs=self.outputs, form=self.form,
        )  # fmt: skip
        keys = jax.random.split(key, 2)
        kept = [
            _through(k, signal, sensors, self.fs, self.oversample, self.antialias)
            for k, signal, sensors in zip(
                keys, (force, motion.response), (self.force_sensor, self.response_sensor), strict=True
            )
        ]
        return Records(kept[0], kept[1], self.fs, UNITS[self.form], self.outputs, self.inputs)


def _channels(sensor: Sensor | Sequence[Sensor] | None, count: int, what: str) -> tuple[Sensor, ...]:
    sensors = (sensor or Sensor(),) * count if sensor is None or isinstance(sensor, Sensor) else tuple(sensor)
    if len(sensors) != count:
        raise ValueError(f"{len(sensors)} sensors for {count} channels in {what}; give one, or one a channel")
    return sensors


@eqx.filter_jit
def _through(
    key: jax.Array, signal: Float[Array, "run t c"], sensors: Any, fs: float, oversample: int, antialias: float
) -> Float[Array, "run t2 c"]:
    """Signals as the recorder keeps them: filtered, sampled, with noise."""
    runs, samples, channels = signal.shape
    rate = fs * oversample
    # silence after the record, so that what the filters remember of its end does not come back at its start
    padded = 2 * samples
    lines = jnp.fft.rfftfreq(padded, 1 / rate)
    T = jnp.stack([s.transfer(lines) for s in sensors], axis=1)
    T = T * butterworth(2j * jnp.pi * lines, antialias * fs, 8)[:, None]
    shown = jnp.fft.irfft(jnp.fft.rfft(signal, padded, axis=1) * T, padded, axis=1)[:, :samples:oversample]
    noise = jax.random.normal(key, shown.shape, jnp.float64) * jnp.array([s.noise for s in sensors])
    return shown + noise


def random_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    band: tuple[float, float],
    duration: float,
    block: float,
    estimator: Any = "H1",
    **processing: Any,
) -> Measurement:
    """Random excitation at several levels (root mean square [N]), FRFs by averaged blocks.

    Parameters
    ----------
    band
        Band of the force, and of the lines kept [Hz].
    duration, block
        Length of the record and of a block [s]; one block more is run first and left out.
    processing
        Further arguments of :func:`modalax.data.records.frf_from_records`.
    """
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    chance, noise = jax.random.split(key)
    samples, skip = round((duration + block) * bench.rate), round(block * bench.fs)
    draw = jax.vmap(lambda k: random(k, samples, bench.rate, *band))
    unit = draw(jax.random.split(chance, len(levels) * len(bench.inputs)))
    force = jnp.swapaxes(unit.reshape(len(levels), len(bench.inputs), samples), 1, 2) * levels[:, None, None]
    kept = bench.record(noise, force)
    return Measurement.from_frfs(
        [
            frf_from_records(
                f[skip:], x[skip:], bench.fs, unit=kept.unit, block=block, estimator=estimator, band=band, level=level,
                outputs=bench.outputs, inputs=bench.inputs, **processing,
            )
            for f, x, level in zip(kept.force, kept.response, levels, strict=True)
        ]
    )  # fmt: skip


def multisine_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    band: tuple[float, float],
    period: float,
    periods: int = 8,
    skip: int = 2,
) -> Measurement:
    """One random-phase multisine at several levels (root mean square [N]), FRFs from whole periods: no leakage.

    Parameters
    ----------
    band
        Band excited [Hz], on every line of the period.
    period
        Period [s].
    periods, skip
        Periods averaged, and run before them until the transient is gone.

    Raises
    ------
    ValueError
        If there are several inputs, for which records of several experiments are needed, or the period holds no
        whole number of samples.
    """
    if len(bench.inputs) != 1:
        raise ValueError(f"{len(bench.inputs)} inputs; this test drives one")
    count = period * bench.fs
    if abs(count - round(count)) > 1e-6:
        raise ValueError(
            f"a period of {period:g} s holds {count:g} samples at {bench.fs:g} Hz; it needs a whole number"
        )
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    chance, noise = jax.random.split(key)
    samples = round(count) * bench.oversample
    lines = excited_lines("full", *band, bench.rate, samples)
    one = jnp.tile(multisine(chance, lines, samples)[0], (periods + skip, 1))
    kept = bench.record(noise, one * levels[:, None, None])
    cut = lambda a: cut_periods(a, round(count), skip)  # noqa: E731
    return Measurement.from_frfs(
        [
            frf_from_blocks(
                cut(f), cut(x), bench.fs, unit=kept.unit, band=band, level=level, outputs=bench.outputs,
                inputs=bench.inputs,
            )
            for f, x, level in zip(kept.force, kept.response, levels, strict=True)
        ]
    )  # fmt: skip


def sweep_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    start: float,
    stop: float,
    rate: float,
    tail: float,
    repeats: int = 1,
    band: tuple[float, float] | None = None,
) -> Measurement:
    """Swept sine, up or down, at several amplitudes [N]; each sweep with its decay is one block.

    Parameters
    ----------
    start, stop, rate
        First and last frequency [Hz] and speed [Hz/s].
    tail
        Time recorded after the sweep, in which the motion dies away [s].
    repeats
        Sweeps averaged; noise differs, so the variance is known from 2 up.
    band
        Lines kept [Hz]; those swept by default.
    """
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    one = swept_sine(start, stop, rate, bench.rate)
    one = jnp.concatenate([one, jnp.zeros(round(tail * bench.rate))])
    one = one[: len(one) // bench.oversample * bench.oversample]
    force = jnp.repeat(levels, repeats)[:, None, None] * one[None, :, None]
    kept = bench.record(key, force)
    blocks = lambda a: a.reshape(len(levels), repeats, *a.shape[1:])  # noqa: E731
    return Measurement.from_frfs(
        [
            frf_from_blocks(
                f, x, bench.fs, unit=kept.unit, band=band or (min(start, stop), max(start, stop)), level=level,
                outputs=bench.outputs, inputs=bench.inputs,
            )
            for f, x, level in zip(blocks(kept.force), blocks(kept.response), levels, strict=True)
        ]
    )  # fmt: skip


def hammer_test(
    bench: Bench,
    key: jax.Array,
    peaks: Any,
    *,
    contact: float,
    block: float,
    hits: int = 5,
    scatter: float = 0.1,
    band: tuple[float, float] | None = None,
    **processing: Any,
) -> Measurement:
    """Hammer hits at several peak forces [N], ``hits`` at each, FRFs by :func:`modalax.data.records.frf_from_hits`.

    Parameters
    ----------
    contact
        Contact time [s].
    block
        Time from hit to hit [s]; blocks of 95 % of it are cut.
    scatter
        Relative standard deviation of the peaks of one level.
    processing
        Further arguments of :func:`modalax.data.records.frf_from_hits`.
    """
    peaks = np.atleast_1d(np.asarray(peaks, dtype=float))
    chance, noise = jax.random.split(key)
    factors = jnp.exp(scatter * jax.random.normal(chance, (len(peaks), hits), jnp.float64))
    samples = round(hits * block * bench.rate)
    times = (jnp.arange(hits) + 0.04) * block
    one = jax.vmap(lambda p: hammer(samples, bench.rate, peak=p, contact=contact, times=times))
    kept = bench.record(noise, one(jnp.asarray(peaks)[:, None] * factors)[:, :, None])
    given: dict[str, Any] = {"pretrigger": 0.02 * block} | processing
    return Measurement.from_frfs(
        [
            frf_from_hits(
                f, x, bench.fs, unit=kept.unit, block=0.95 * block, band=band, outputs=bench.outputs,
                input=bench.inputs[0], **given,
            ).replace(level=peak)
            for f, x, peak in zip(kept.force, kept.response, peaks, strict=True)
        ]
    )  # fmt: skip
