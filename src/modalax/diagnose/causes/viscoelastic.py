"""Elements at one place whose stiffness and loss follow frequency in other ways than a spring and a damper."""

from typing import Any

import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.base import RARE, LocalCause
from modalax.diagnose.causes.local import median_omega
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene


class FractionalJoint(LocalCause):
    r"""A viscoelastic element, :math:`Z = c\,s^\alpha`, between a spring and a damper."""

    slug = "fractional_joint"
    summary = "a viscoelastic joint"
    named = False
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
    named = False
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
    named = False
    prior = RARE
    parameters = (Parameter("loss_stiffness", "N/m", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        return strengths(scene.stiffness_scale(place), both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`jh`."""
        return 1j * p[0] + 0 * s


VISCOELASTIC: tuple[Any, ...] = (FractionalJoint(), MaxwellElement(), HystereticJoint())
