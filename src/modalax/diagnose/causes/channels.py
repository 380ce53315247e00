"""Faults of the measurement: gains, signs, swaps, delays, units, sensors' mass, noise on the force."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import ChannelCause
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import Channels


def one_row(H: Array, k: Array) -> Array:
    """1 at output ``k`` of FRFs ``(..., o, i)``, 0 elsewhere, shape ``(o, 1)``."""
    return (jnp.arange(H.shape[-2]) == k).astype(float)[:, None]


def scaled_row(H: Array, k: Array, gain: Array) -> Array:
    """FRFs ``(run, f, o, i)`` with the row of output ``k`` times a gain that broadcasts over them."""
    return H * (1 + (gain - 1) * one_row(H, k))


class SensorCause(ChannelCause):
    """A fault that any one sensor may have."""

    rows = 1

    def places(self, scene: Scene) -> list[Place]:
        """Every output."""
        return scene.channels()


class ChannelGain(SensorCause):
    r"""Calibration of one sensor, row times :math:`1 + g`."""

    slug = "channel_gain"
    advice = "exchange the two sensors, or calibrate them"
    summary = "calibration of one sensor"
    parameters = (Parameter("gain", "-", -0.999),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the gain, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale one row."""
        return scaled_row(H, where[0], 1 + p[0])


class ChannelSign(SensorCause):
    """One sensor with the wrong sign."""

    slug = "channel_sign"
    advice = "turn one sensor and repeat"
    summary = "sign of one sensor"

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Turn one row."""
        return scaled_row(H, where[0], jnp.array(-1.0))


class ChannelSwap(ChannelCause):
    """Two sensors exchanged."""

    slug = "channel_swap"
    shortlist_by = "exchange"
    advice = "tap at each sensor and check which channel responds"
    summary = "two sensors exchanged"
    rows = 2

    def places(self, scene: Scene) -> list[Place]:
        """Every pair of outputs."""
        names = scene.outputs
        return [Place((names[a], names[b]), (a, b, 0)) for a in range(len(names)) for b in range(a + 1, len(names))]

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Exchange two rows."""
        first, second = jnp.take(H, where[0], axis=2), jnp.take(H, where[1], axis=2)
        a, b = one_row(H, where[0]), one_row(H, where[1])
        return H * (1 - a - b) + second[:, :, None] * a + first[:, :, None] * b


class TimeDelay(ChannelCause):
    r"""A delay of one channel, :math:`e^{-j\omega\tau}`."""

    slug = "time_delay"
    advice = "calibrate the channels against each other on one sensor position"
    summary = "delay of one sensor"
    parameters = (Parameter("delay", "s"),)
    prior = 0.5
    rows = 1

    def places(self, scene: Scene) -> list[Place]:
        """Every output, if there are several."""
        return scene.channels() if len(scene.outputs) > 1 else []

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Up to a full turn of the phase at the end of the band."""
        return strengths(1 / (2 * np.pi * scene.freq[-1]), ((),), (1e-3, 0.2, 0.7, 1.5, 3.0))

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Turn the phase of one row."""
        return H * jnp.exp(-1j * at.s.imag[:, None, None] * p[0] * one_row(H, where[0]))


class CommonDelay(TimeDelay):
    r"""A delay of all responses relative to the force, :math:`e^{-j\omega\tau}`."""

    summary = "delay of all sensors"
    rows = 0

    def places(self, scene: Scene) -> list[Place]:
        """All outputs together."""
        return [Place(())]

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Turn the phase of all."""
        return H * jnp.exp(-1j * at.s.imag[:, None, None] * p[0])


class Units(ChannelCause):
    r"""One integration or differentiation too many, :math:`(j\omega)^{\pm1}`."""

    slug = "units"
    advice = "check the unit of one channel against a known motion"
    summary = "one integration or differentiation"

    def places(self, scene: Scene) -> list[Place]:
        """Down and up."""
        return [Place((), (k, -1, 0)) for k in (-1, 1)]

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Differentiate or integrate."""
        s = (1j * at.s.imag)[:, None, None]
        return H * jnp.where(where[0] > 0, s, 1 / s)


class SensorMass(ChannelCause):
    r"""A roving sensor loads only its own FRFs: row times :math:`1/(1 + s^2 m H_{ss})`."""

    slug = "sensor_mass"
    advice = "repeat with a dummy mass at the sensor, or with all sensors left in place"
    summary = "mass of a roving sensor"
    rows = 1
    parameters = (Parameter("mass", "kg", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Every output."""
        return scene.channels() if scene.scaled else []

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the accelerance."""
        at = Place(place.where, (scene.dofs.index(scene.outputs[place.index[0]]), -1, 0))
        return strengths(scene.stiffness_scale(at) / float(np.median(scene.omega)) ** 2, both=False)

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Load one row."""
        own = jnp.take(at.own, where[0], axis=1)
        loaded = 1 / (1 + at.s**2 * p[0] * own)
        return scaled_row(H, where[0], loaded[:, None, None])


class ForceDropout(ChannelCause):
    r"""Noise on a force that falls where the drive point moves easily biases H1 low.

    :math:`H/(1 + \kappa\,|1 + \mu\,Y/\max|Y||^2)` with Y the mobility of the drive point: a shaker of mechanical
    impedance :math:`\mu/\max|Y|`. Variants take the accelerance or the receptance instead (a shaker whose mass or
    spring matters), and :math:`1 + \mu^2|Y|^2/\max|Y|^2` where the force falls by more than its own path.
    """

    slug = "force_dropout"
    visible_when_free = True
    advice = "estimate the FRF as Hv, or from the generator's signal as reference"
    summary = "force lost at resonances"
    fidelity = 0.02
    parameters = (
        Parameter("noise_to_force", "-", 0.0),
        Parameter("relative_impedance", "-", 0.1, 1e3, log=True),
    )

    def places(self, scene: Scene) -> list[Place]:
        """Six kinds of shaker."""
        return [Place((), (0, -1, k)) for k in range(6)] if scene.scaled else []

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Sharp to flat."""
        return np.array([[size / mu**2, mu] for mu in (1.0, 3.0, 10.0, 100.0) for size in (1e-4, 0.1)])

    def channels(self, H: Array, at: Channels, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Divide by one and the noise-to-force ratio."""
        s = (1j * at.s.imag)[:, None]
        moves = at.drive * s ** jnp.array([1, 2, 0])[where[2] % 3]
        moves = moves / jnp.maximum(jnp.max(jnp.abs(moves), axis=0, keepdims=True), 1e-300)
        ratio = jnp.where(where[2] < 3, jnp.abs(1 + p[1] * moves) ** 2, 1 + p[1] ** 2 * jnp.abs(moves) ** 2)
        return H / (1 + p[0] * ratio[:, None, :])


CHANNELS: tuple[Any, ...] = (
    ChannelGain(), ChannelSign(), ChannelSwap(), TimeDelay(), CommonDelay(), Units(), SensorMass(), ForceDropout(),
)  # fmt: skip
