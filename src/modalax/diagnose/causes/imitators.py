"""Things that the catalogue has no name for, but that one of its causes may imitate.

They are looked for only to doubt a name: where one of them explains the data better than what was found, the answer is
``unknown`` and its notes say what it looks like. Each is thought rare, so a name stands where they do as well as it.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import Cause, JointCause, LocalCause, Parameter, Place, Scene, strengths
from modalax.diagnose.causes.channels import ChannelCause, one_row, scaled_row
from modalax.diagnose.causes.joints import REFERENCE, MicroSlip
from modalax.diagnose.causes.local import median_omega

RARE = 0.05  # prior of each, relative to a cause of the catalogue


class FractionalJoint(LocalCause):
    r"""A viscoelastic element, :math:`Z = c\,s^\alpha`, between a spring and a damper."""

    slug = "fractional_joint"
    summary = "a viscoelastic joint"
    prior = RARE
    parameters = (Parameter("coefficient", "N s^a/m", 0.0), Parameter("order", "-", 0.1, 0.9))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        k, w = scene.stiffness_scale(place), median_omega(scene)
        return np.array([[x * k / w**a, a] for a in (0.3, 0.5, 0.7) for x in (1e-4, 0.03, 0.2, 1.0)])

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`c\,s^\alpha`."""
        return p[0] * s ** p[1]


class MaxwellElement(LocalCause):
    r"""A spring and a damper in series, :math:`Z = k\,s\tau/(1 + s\tau)`."""

    slug = "maxwell_element"
    summary = "a spring and a damper in series"
    prior = RARE
    parameters = (Parameter("stiffness", "N/m", 0.0), Parameter("time_constant", "s", 1e-9, log=True))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Relaxing about mid-band."""
        shapes = [(x / median_omega(scene),) for x in (0.3, 1.0, 3.0)]
        return strengths(scene.stiffness_scale(place), shapes, both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`k\,s\tau/(1 + s\tau)`."""
        return p[0] * s * p[1] / (1 + s * p[1])


class HystereticJoint(LocalCause):
    r"""Loss that does not depend on frequency at one joint, :math:`Z = jh`."""

    slug = "hysteretic_joint"
    summary = "structural damping of one joint"
    prior = RARE
    parameters = (Parameter("loss_stiffness", "N/m", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        return strengths(scene.stiffness_scale(place), both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`jh`."""
        return 1j * p[0] + 0 * s


class OneWayDamper(LocalCause):
    """A force on one DoF that follows the velocity of another, with no reaction there: no longer reciprocal."""

    slug = "one_way_damper"
    summary = "a velocity feedback from one DoF to another"
    prior = RARE
    parameters = (Parameter("coefficient", "N s/m"),)

    def __init__(self, turned: bool):
        self.turned = turned

    def places(self, scene: Scene) -> list[Place]:
        """Every pair."""
        return scene.pairs(ground=False)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the mobility."""
        return strengths(scene.stiffness_scale(place) / median_omega(scene))

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs."""
        one = jnp.array([[0.0, 0.0], [1.0, 0.0]] if self.turned else [[0.0, 1.0], [0.0, 0.0]])
        return s[:, None, None] * p[0] * one


class FollowerStiffness(LocalCause):
    """Skew stiffness between two DoFs, as a rotor in a seal has: no longer reciprocal."""

    slug = "follower_stiffness"
    summary = "skew stiffness of two DoFs"
    prior = RARE
    parameters = (Parameter("stiffness", "N/m"),)

    def places(self, scene: Scene) -> list[Place]:
        """Every pair."""
        return scene.pairs(ground=False)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        return strengths(scene.stiffness_scale(place))

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs."""
        return p[0] * jnp.array([[0.0, 1.0], [-1.0, 0.0]]) + 0 * s[:, None, None]


class PowerSpring(JointCause):
    r"""A spring whose force grows as another power than the third, :math:`N(A) = k_0 (A/A_0)^m`."""

    slug = "power_spring"
    summary = "a spring with a power law"
    fidelity = 0.01
    prior = RARE
    parameters = (Parameter("stiffness", "N/m"), Parameter("exponent", "-", 0.2, 6.0))
    exponents, both = (1.0, 4.0), True

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the stiffness that matters at the largest amplitude."""
        largest = float(scene.amplitudes(place, (1.0,))[0])
        scale = scene.stiffness_scale(place) / (1.0 if self.both else median_omega(scene))
        parts = [
            strengths(scale * (REFERENCE / largest) ** m, [(m,)], (1e-4, 0.05, 0.4, 2.0), self.both)
            for m in self.exponents
        ]
        return np.concatenate(parts)

    def impedance(self, A: Array, omega: Array, p: Array) -> Complex[Array, "..."]:
        """Stiffness at amplitude ``A``."""
        return p[0] * (A / REFERENCE) ** p[1] + 0j * omega


class PowerDamper(PowerSpring):
    r"""A damper whose force grows as another power than the first and second, :math:`N(A) = j\omega c_0(A/A_0)^m`."""

    slug = "power_damper"
    summary = "a damper with a power law"
    parameters = (Parameter("damping", "N s/m", 0.0), Parameter("exponent", "-", -0.95, 4.0))
    exponents, both = (-0.5, 2.0), False

    def impedance(self, A: Array, omega: Array, p: Array) -> Complex[Array, "..."]:
        """Damping at amplitude ``A``."""
        return 1j * omega * p[0] * (A / REFERENCE) ** p[1]


class RareMicroSlip(MicroSlip):
    """The microslip law as something that a name of the catalogue may stand for."""

    prior = RARE


class AllStiffness(Cause):
    """All natural frequencies off by one share: Young's modulus, or the clock of the analyser."""

    slug = "all_stiffness"
    stage = "modes"
    summary = "all natural frequencies off by one share"
    prior = RARE
    parameters = (Parameter("relative_stiffness", "-", -0.9),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Small changes both ways."""
        return strengths(1.0, ((),), (1e-6, 1e-3, 1e-2, 5e-2))

    def modes(self, modes: Any, where: Array, p: Array, runs: int) -> Any:
        """Scale the stiffness."""
        return type(modes)(modes.k * (1 + p[0]), modes.c, modes.h)


class ForceGain(ChannelCause):
    r"""Calibration of the force of one input or of all, columns times :math:`1 + g`."""

    slug = "force_gain"
    summary = "calibration of the force"
    prior = RARE
    parameters = (Parameter("gain", "-", -0.999),)

    def places(self, scene: Scene) -> list[Place]:
        """All inputs together, then every one."""
        each = [Place((name,), (k, -1, 0)) for k, name in enumerate(scene.inputs)]
        return [Place((), (-1, -1, 0))] + (each if len(each) > 1 else [])

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the gain, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale columns."""
        which = jnp.where(where[0] < 0, 1.0, (jnp.arange(H.shape[3]) == where[0]).astype(float))
        return H * (1 + p[0] * which)


class AcCoupling(ChannelCause):
    r"""One sensor through a high-pass filter of first order, :math:`s/(s + \omega_c)`."""

    slug = "ac_coupling"
    summary = "high-pass filter of one sensor"
    prior = RARE
    rows = 1
    parameters = (Parameter("corner_frequency", "Hz", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Every output."""
        return scene.channels()

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the start of the band."""
        return strengths(float(scene.freq[0]), ((),), (1e-4, 0.1, 0.5, 1.5), both=False)

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Filter one row."""
        gain = 1 / (1 - 2j * jnp.pi * p[0] / at.s.imag)
        return scaled_row(H, where[0], gain[:, None, None])


class SensorLowpass(ChannelCause):
    r"""One sensor through a low-pass filter of first order, :math:`1/(1 + s\tau)`: nearly a delay."""

    slug = "sensor_lowpass"
    summary = "low-pass filter of one sensor"
    prior = RARE / 2
    rows = 1
    parameters = (Parameter("time_constant", "s", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Every output."""
        return scene.channels()

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the end of the band."""
        return strengths(float(1 / scene.omega[-1]), ((),), (1e-4, 0.1, 0.5, 1.5), both=False)

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Filter one row."""
        gain = 1 / (1 + 1j * at.s.imag * p[0])
        return scaled_row(H, where[0], gain[:, None, None])


class Crosstalk(ChannelCause):
    """A share of one channel leaks into another."""

    slug = "crosstalk"
    summary = "one channel leaks into another"
    prior = RARE
    parameters = (Parameter("share", "-"),)
    most = 24  # outputs beyond which there are too many pairs

    def places(self, scene: Scene) -> list[Place]:
        """Every ordered pair of outputs; the first hears the second."""
        names, count = scene.outputs, len(scene.outputs)
        if count > self.most:
            return []
        return [Place((names[a], names[b]), (a, b, 0)) for a in range(count) for b in range(count) if a != b]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the share, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Add to one row."""
        return H + p[0] * jnp.take(H, where[1], axis=2)[:, :, None] * one_row(H, where[0])


class SensorResonance(ChannelCause):
    r"""One sensor on a mount or cable that resonates.

    Row times :math:`1 - g s^2/(s^2 + 2\zeta\omega_c s + \omega_c^2)`.
    """

    slug = "sensor_resonance"
    summary = "a resonance of the mount of one sensor"
    prior = RARE
    rows = 1
    parameters = (
        Parameter("share", "-"),
        Parameter("frequency", "Hz", 1e-3, log=True),
        Parameter("damping_ratio", "-", 1e-4, 0.5, log=True),
    )

    def places(self, scene: Scene) -> list[Place]:
        """Every output."""
        return scene.channels()

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Frequencies dense enough that no resonance falls between two; linear in the share, so one size does."""
        low, high = scene.freq[0], scene.freq[-1]
        count = int(np.clip(np.log(high / low) / 0.05, 8, 40))
        return strengths(1.0, [(f, 0.025) for f in np.geomspace(low, high, count)], (1e-4,))

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale one row."""
        s, w = 1j * at.s.imag, 2 * jnp.pi * p[1]
        gain = 1 - p[0] * s**2 / (s**2 + 2 * p[2] * w * s + w**2)
        return scaled_row(H, where[0], gain[:, None, None])


class StrayForce(ChannelCause):
    r"""A share of the force of one input also acts on another DoF, as in an oblique hit: :math:`H_{oi} + g H_{oj}`."""

    slug = "stray_force"
    summary = "a share of the force acts elsewhere"
    prior = RARE
    parameters = (Parameter("share", "-"),)
    most = 60  # DoFs beyond which there are too many places

    def places(self, scene: Scene) -> list[Place]:
        """Every input with every other DoF."""
        names = scene.dofs if scene.scaled and len(scene.dofs) <= self.most else ()
        return [
            Place((name, dof), (i, k, 0)) for i, name in enumerate(scene.inputs) for k, dof in enumerate(names)
            if dof != name
        ]  # fmt: skip

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Linear in the share, so one size does."""
        return np.array([[1e-3]])

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Add to one column."""
        which = (jnp.arange(H.shape[3]) == where[0]).astype(float)
        return H + p[0] * at.column(where[1])[None, :, :, None] * which


class ClippedSensor(ChannelCause):
    r"""One sensor that clips: the fundamental of a clipped sine, by the amplitude of its own quantity."""

    slug = "clipped_sensor"
    summary = "one sensor saturates"
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

    def channels(self, H: Array, at: Any, where: Array, extra: Any, p: Array) -> Complex[Array, "run f o i"]:
        """Scale one row by how much is cut off."""
        row = jnp.take(H, where[0], axis=2)
        size = jnp.abs(row) * at.level[:, :, None] * jnp.abs(at.s)[:, None] ** where[1]
        rho = jnp.minimum(1 / jnp.maximum(p[0] * size, 1e-30), 1 - 1e-12)
        gain = 2 / jnp.pi * (jnp.arcsin(rho) + rho * jnp.sqrt(1 - rho**2))
        return scaled_row(H, where[0], gain[:, :, None])


IMITATORS: tuple[Cause, ...] = (
    FractionalJoint(), MaxwellElement(), HystereticJoint(), OneWayDamper(False), OneWayDamper(True),
    FollowerStiffness(), PowerSpring(), PowerDamper(), RareMicroSlip(), AllStiffness(), ForceGain(), AcCoupling(),
    SensorLowpass(), SensorResonance(), Crosstalk(), StrayForce(), ClippedSensor(),
)  # fmt: skip
