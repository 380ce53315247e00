r"""A virtual test bench: structure, joints, sensors and recorder, from an excitation to time records."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax.data.dofs import as_names
from modalax.data.frf import check_form
from modalax.model.receptance import AnyStructure, dof_names
from modalax.simulate.joints import Joint
from modalax.simulate.march import respond
from modalax.simulate.overview import of_bench, of_records

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
        Recorded value over true value [-].
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
    """Time records of a virtual test.

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

    def __str__(self) -> str:
        """Runs, duration, rate and channels."""
        return of_records(self)


class Bench(eqx.Module):
    """Structure, joints and channels of a test.

    Attributes
    ----------
    structure, joints, places
        The structure under test, as matrices or modal model, its joints, and the place of each.
    force_sensor, response_sensor
        Sensors: one for all channels of that kind, or one for each.
    fs
        Sampling rate of the recorder [Hz].
    oversample
        Steps of the time marching in each sample of the recorder.
    antialias
        Corner frequency of the recorder's 8th-order low-pass filter on all channels, relative to the sampling rate.
    form
        Motion that the response channels measure: displacement (``receptance``), velocity or acceleration.
    inputs, outputs
        DoFs measured, and DoFs driven.
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
        self.inputs = as_names(inputs)
        self.outputs = dof_names(structure) if outputs is None else as_names(outputs)
        self.force_sensor = _channels(force_sensor, len(self.inputs), "force_sensor")
        self.response_sensor = _channels(response_sensor, len(self.outputs), "response_sensor")
        self.fs, self.oversample, self.antialias, self.form = float(fs), oversample, antialias, check_form(form)

    def __str__(self) -> str:
        """Structure, joints, channels and sampling."""
        return of_bench(self)

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
        raise ValueError(f"{len(sensors)} sensors for {count} channels in {what}; give one, or one for each channel")
    return sensors


@eqx.filter_jit
def _through(
    key: jax.Array, signal: Float[Array, "run t c"], sensors: Any, fs: float, oversample: int, antialias: float
) -> Float[Array, "run t2 c"]:
    """Signals as the recorder keeps them: filtered, sampled, with noise."""
    runs, samples, channels = signal.shape
    rate = fs * oversample
    # Zeros after the record, so that the filters' response to its end does not wrap around to its start.
    padded = 2 * samples
    lines = jnp.fft.rfftfreq(padded, 1 / rate)
    T = jnp.stack([s.transfer(lines) for s in sensors], axis=1)
    T = T * butterworth(2j * jnp.pi * lines, antialias * fs, 8)[:, None]
    shown = jnp.fft.irfft(jnp.fft.rfft(signal, padded, axis=1) * T, padded, axis=1)[:, :samples:oversample]
    noise = jax.random.normal(key, shown.shape, jnp.float64) * jnp.array([s.noise for s in sensors])
    return shown + noise
