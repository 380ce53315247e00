"""Linear couplings of two DoFs that are no elements between them: the FRFs are no longer reciprocal."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.base import RARE, CouplingCause
from modalax.diagnose.causes.local import median_omega
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene


class Gyroscopic(CouplingCause):
    r"""Skew coupling of two DoFs, :math:`Z = s g\,(e_a e_b^T - e_b e_a^T)`: the FRFs are no longer reciprocal."""

    slug = "gyroscopic"
    advice = "measure the FRF with force and response exchanged, at three inputs or more"
    summary = "skew coupling of two DoFs"
    parameters = (Parameter("coupling", "N s/m"),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the mobility."""
        return strengths(scene.stiffness_scale(place) / median_omega(scene))

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs."""
        skew = jnp.array([[0.0, 1.0], [-1.0, 0.0]])
        return s[:, None, None] * p[0] * skew


class OneWayDamper(CouplingCause):
    """A force on one DoF that follows the velocity of another, with no reaction there: no longer reciprocal."""

    slug = "one_way_damper"
    summary = "a velocity feedback from one DoF to another"
    named = False
    prior = RARE
    parameters = (Parameter("coefficient", "N s/m"),)

    def __init__(self, turned: bool):
        self.turned = turned

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the mobility."""
        return strengths(scene.stiffness_scale(place) / median_omega(scene))

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs."""
        one = jnp.array([[0.0, 0.0], [1.0, 0.0]] if self.turned else [[0.0, 1.0], [0.0, 0.0]])
        return s[:, None, None] * p[0] * one


class FollowerStiffness(CouplingCause):
    """Skew stiffness between two DoFs, as a rotor in a seal has: no longer reciprocal."""

    slug = "follower_stiffness"
    summary = "skew stiffness of two DoFs"
    named = False
    prior = RARE
    parameters = (Parameter("stiffness", "N/m"),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        return strengths(scene.stiffness_scale(place))

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs."""
        return p[0] * jnp.array([[0.0, 1.0], [-1.0, 0.0]]) + 0 * s[:, None, None]


COUPLINGS: tuple[Any, ...] = (Gyroscopic(), OneWayDamper(False), OneWayDamper(True), FollowerStiffness())
