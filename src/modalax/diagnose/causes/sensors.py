"""Sensors that filter, resonate or saturate."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import RARE, ChannelCause
from modalax.diagnose.causes.channels import SensorCause, scaled_row
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import Channels


class AcCoupling(SensorCause):
    r"""One sensor through a high-pass filter of first order, :math:`s/(s + \omega_c)`."""

    slug = "sensor_filter"
    summary = "high-pass filter of one sensor"
    advice = "compare the sensor with another at the same place, below and above the band"
    prior = RARE
    parameters = (Parameter("high_pass_corner", "Hz", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the start of the band."""
        return strengths(float(scene.freq[0]), ((),), (1e-4, 0.1, 0.5, 1.5), both=False)

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Filter one row."""
        gain = 1 / (1 - 2j * jnp.pi * p[0] / at.s.imag)
        return scaled_row(H, where[0], gain[:, None, None])


class SensorLowpass(SensorCause):
    r"""One sensor through a low-pass filter, where weak nearly a delay.

    :math:`1/(1 + s\tau)` of first order, :math:`1/(1 + s\tau + s^2\tau^2/2)` (Butterworth's) of second.
    """

    slug = "sensor_filter"
    advice = AcCoupling.advice
    prior = RARE / 2  # each order
    parameters = (Parameter("time_constant", "s", 0.0),)

    def __init__(self, order: int):
        self.order = order
        self.summary = f"low-pass filter of one sensor, of order {order}"

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the end of the band."""
        return strengths(float(1 / scene.omega[-1]), ((),), (1e-4, 0.1, 0.5, 1.5), both=False)

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Filter one row."""
        x = 1j * at.s.imag * p[0]
        return scaled_row(H, where[0], (1 / (1 + x + (self.order - 1) * x**2 / 2))[:, None, None])

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The frequency at which the gain is down by 3 dB rather than the time constant."""
        corner = np.sqrt(self.order) / (2 * np.pi * p[0]) if p[0] else np.inf
        return {"low_pass_corner": (corner, "Hz"), "order": (float(self.order), "-")}


class SensorResonance(SensorCause):
    r"""One sensor on a mount or cable that resonates.

    Row times :math:`1 - g s^2/(s^2 + 2\zeta\omega_c s + \omega_c^2)`.
    """

    slug = "sensor_resonance"
    summary = "a resonance of the mount of one sensor"
    named = False
    prior = RARE
    parameters = (
        Parameter("share", "-"),
        Parameter("frequency", "Hz", 1e-3, log=True),
        Parameter("damping_ratio", "-", 1e-4, 0.5, log=True, ends=True),
    )

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Frequencies dense enough that no resonance falls between two; linear in the share, so one size does."""
        low, high = scene.freq[0], scene.freq[-1]
        count = int(np.clip(np.log(high / low) / 0.05, 8, 40))
        return strengths(1.0, [(f, 0.025) for f in np.geomspace(low, high, count)], (1e-4,))

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale one row."""
        s, w = 1j * at.s.imag, 2 * jnp.pi * p[1]
        gain = 1 - p[0] * s**2 / (s**2 + 2 * p[2] * w * s + w**2)
        return scaled_row(H, where[0], gain[:, None, None])


class ClippedSensor(ChannelCause):
    r"""One sensor that clips: the fundamental of a clipped sine, by the amplitude of its own quantity."""

    slug = "sensor_clipping"
    summary = "one sensor saturates"
    advice = "repeat at a lower force, or with a longer measuring range"
    per_run = True
    prior = RARE
    rows = 1
    fidelity = 0.01
    parameters = (Parameter("inverse_ceiling", "1/unit", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Every output; the second number says what it measures."""
        order = DERIVATIVES[scene.form]
        return [Place((name,), (k, order, 0)) for k, name in enumerate(scene.outputs)]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Ceilings a little or far below the largest response."""
        at = Place(place.where, (scene.dofs.index(scene.outputs[place.index[0]]), -1, 0))
        size = np.abs(scene.motion(at)) * scene.omega[:, None] ** place.index[1]
        return np.array([[x / (float(size.max()) * float(scene.levels.max()))] for x in (1.05, 1.3, 2.0, 4.0)])

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The amplitude beyond which it clips, in the sensor's own unit."""
        return {"ceiling": (1 / p[0] if p[0] else np.inf, ("m", "m/s", "m/s^2")[place.index[1]])}

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale one row by how much is cut off."""
        row = jnp.take(H, where[0], axis=2)
        size = jnp.abs(row) * at.level[:, :, None] * jnp.abs(at.s)[:, None] ** where[1]
        rho = jnp.minimum(1 / jnp.maximum(p[0] * size, 1e-30), 1 - 1e-12)
        gain = 2 / jnp.pi * (jnp.arcsin(rho) + rho * jnp.sqrt(1 - rho**2))
        return scaled_row(H, where[0], gain[:, :, None])


class SensorPlace(ChannelCause):
    """A sensor at another point than its name.

    It is found among modes (:mod:`modalax.diagnose.modal_domain.odd_channels.misplaced`).
    """

    slug = "sensor_place"
    summary = "the point that a sensor is really at"
    advice = "look where the sensor is, and follow its cable to the channel"
    prior = RARE
    rows = 1

    def places(self, scene: Scene) -> list[Place]:
        """Never looked for line by line."""
        return []

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """The names of the channels are changed, not the FRFs."""
        return H


SENSORS: tuple[Any, ...] = (
    SensorPlace(), AcCoupling(), SensorLowpass(1), SensorLowpass(2), SensorResonance(), ClippedSensor()
)  # fmt: skip
