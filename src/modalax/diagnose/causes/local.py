"""Linear elements that the simulation lacks at one place: springs, dampers, masses, oscillators."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.base import LocalCause
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene


def median_omega(scene: Scene) -> float:
    """Median circular frequency of the band [rad/s]."""
    return float(np.median(scene.omega))


class JointStiffness(LocalCause):
    r"""A spring, :math:`Z = k`."""

    slug = "joint_stiffness"
    summary = "the right stiffness of a joint"
    parameters = (Parameter("stiffness", "N/m"),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Softer and stiffer, around one over the receptance."""
        return strengths(scene.stiffness_scale(place))

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        """:math:`k`."""
        return p[0] + 0j * s


class LocalDamper(LocalCause):
    r"""A viscous damper, :math:`Z = s c`."""

    slug = "local_damper"
    summary = "a viscous damper at a joint"
    parameters = (Parameter("damping", "N s/m", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the mobility."""
        return strengths(scene.stiffness_scale(place) / median_omega(scene), both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`s c`."""
        return s * p[0]


class AddedMass(LocalCause):
    r"""A lumped mass, :math:`Z = s^2 m`."""

    slug = "added_mass"
    advice = "repeat with a known mass added at the same place"
    summary = "a lumped mass"
    parameters = (Parameter("mass", "kg", 0.0),)

    def places(self, scene: Scene) -> list[Place]:
        """Every DoF."""
        return scene.pairs(both=False)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the accelerance."""
        return strengths(scene.stiffness_scale(place) / median_omega(scene) ** 2, both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`s^2 m`."""
        return s**2 * p[0]


class TunedMass(LocalCause):
    r"""An attached oscillator, :math:`Z = s^2 m\,k_s/(s^2 + k_s)`, :math:`k_s = \omega_t^2 + 2\zeta\omega_t s`."""

    slug = "tuned_mass"
    advice = "zoom into the split peak with a finer line spacing"
    summary = "an attached oscillator"
    parameters = (
        Parameter("mass", "kg", 0.0),
        Parameter("frequency", "Hz", 1e-3, log=True),
        Parameter("damping_ratio", "-", 1e-4, 0.5, log=True, ends=True),
    )

    def places(self, scene: Scene) -> list[Place]:
        """Every DoF."""
        return scene.pairs(both=False)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Frequencies dense enough that no oscillator falls between two."""
        low, high = scene.freq[0], scene.freq[-1]
        count = int(np.clip(np.log(high / low) / 0.025, 12, 80))
        shapes = [(f, z) for f in np.geomspace(low, high, count) for z in (0.01, 0.05)]
        return strengths(scene.stiffness_scale(place) / median_omega(scene) ** 2, shapes, (1e-4, 3e-3), both=False)

    def fits(self, p: np.ndarray, scene: Scene) -> bool:
        """Only where it splits or draws a peak; far below the band it is a damper to ground, far above it a mass."""
        return bool(0.7 * scene.freq[0] <= p[1] <= 1.4 * scene.freq[-1])

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r"""Dynamic stiffness of a mass on a spring and damper."""
        w = 2 * jnp.pi * p[1]
        spring = w**2 + 2 * p[2] * w * s
        return s**2 * p[0] * spring / (s**2 + spring)


LOCAL: tuple[Any, ...] = (JointStiffness(), LocalDamper(), AddedMass(), TunedMass())
