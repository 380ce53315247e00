"""Elements at one place whose stiffness and loss follow frequency in other ways than a spring and a damper."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.base import LocalCause
from modalax.diagnose.causes.local import median_omega
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene


class FractionalJoint(LocalCause):
    r"""A viscoelastic element, :math:`Z = c\,s^\alpha`, between a spring and a damper."""

    slug = "fractional_joint"
    summary = "a viscoelastic joint"
    advice = "widen the band: its stiffness and its loss grow with the same power of frequency"
    prior = 0.2  # a spring and a damper are its limits
    parameters = (Parameter("coefficient", "N s^a/m", 0.0), Parameter("order", "-", 0.1, 0.9))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        k, w = scene.stiffness_scale(place), median_omega(scene)
        return np.array([[x * k / w**a, a] for a in (0.3, 0.5, 0.7) for x in (1e-4, 0.03, 0.2, 1.0)])

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`c\,s^\alpha`."""
        return p[0] * s ** p[1]


class MaxwellJoint(LocalCause):
    r"""A joint that relaxes: a spring in series with a damper, :math:`Z = k\,s\tau/(1 + s\tau)`.

    It is at rest no spring and far above :math:`1/\tau` one of stiffness k (Maxwell 1867, Phil. Trans. R. Soc. 157:49).
    """

    slug = "maxwell_joint"
    summary = "a joint that relaxes: a spring and a damper in series"
    advice = "widen the band on both sides of the frequency at which the joint relaxes"
    prior = 0.2  # a spring and a damper are its limits
    parameters = (
        Parameter("relaxing_stiffness", "N/m", 0.0),
        Parameter("relaxation_time", "s", 1e-9, log=True),
    )
    lasting: ClassVar[tuple[tuple[float, ...], ...]] = ((),)  # shares that last, tried with each time

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Relaxing about mid-band."""
        shapes = [(x / median_omega(scene), *share) for x in (0.3, 1.0, 3.0) for share in self.lasting]
        return strengths(scene.stiffness_scale(place), shapes, both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`k\,s\tau/(1 + s\tau)`."""
        return p[0] * (s * p[1] / (1 + s * p[1]))


class ZenerJoint(MaxwellJoint):
    r"""The same with a spring in parallel, of which the share r lasts.

    :math:`Z = k\left(r + \frac{s\tau}{1 + s\tau}\right)`, from :math:`kr` at rest to :math:`k(1 + r)` far above
    :math:`1/\tau` (the standard linear solid; Zener 1948, Elasticity and Anelasticity of Metals).
    """

    summary = "a joint that relaxes: a spring in parallel with a spring and a damper in series"
    prior = 0.1  # half as likely as that of which nothing lasts
    parameters = (*MaxwellJoint.parameters, Parameter("lasting_share", "-", 0.0, 100.0))
    lasting = ((0.0,), (1.0,))

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`k(r + s\tau/(1 + s\tau))`."""
        return p[0] * (p[2] + s * p[1] / (1 + s * p[1]))

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """Both stiffnesses rather than a share."""
        return {
            "relaxing_stiffness": (p[0], "N/m"),
            "relaxation_time": (p[1], "s"),
            "lasting_stiffness": (p[0] * p[2], "N/m"),
        }


class HystereticJoint(LocalCause):
    r"""Loss that does not depend on frequency at one joint, :math:`Z = jh`."""

    slug = "hysteretic_joint"
    summary = "structural damping of one joint"
    advice = "widen the band: a viscous joint's loss grows with frequency, this one's does not"
    prior = 0.5  # beside a viscous damper, by which most simulations have it
    parameters = (Parameter("loss_stiffness", "N/m", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around one over the receptance."""
        return strengths(scene.stiffness_scale(place), both=False)

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        r""":math:`jh`."""
        return 1j * p[0] + 0 * s


VISCOELASTIC: tuple[Any, ...] = (FractionalJoint(), MaxwellJoint(), ZenerJoint(), HystereticJoint())
