"""Joints whose stiffness or damping follows a power of the amplitude."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import RARE, JointCause
from modalax.diagnose.causes.local import median_omega
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene

REFERENCE = 1e-4  # amplitude at which the lost stiffness is reported [m]
EXPONENTS = (0.5, 1.0, 1.5)  # exponents of the amplitude that are screened [-]


class MicroSlip(JointCause):
    r"""Sliders whose strengths follow a power law: stiffness falls and damping rises as a power of the amplitude.

    The force on first loading is :math:`Kx - \kappa x|x|^n`, later loops by Masing's rule. With K in the simulation,

    .. math:: N(A) = \kappa_0 \Big(\frac{A}{A_0}\Big)^n\Big(-c_n + \frac{4jn}{\pi(n+2)}\Big),\qquad
              c_n = \frac{4\,\Gamma(n+\frac32)\,(n+1)}{\sqrt\pi\,\Gamma(n+2)\,(n+2)},

    at :math:`A_0` = 0.1 mm; n = 1 is Iwan's model with evenly distributed strengths. It is the microslip limit of
    Segalman's four-parameter model (2005, J. Appl. Mech. 72:752), whose dissipation grows as :math:`A^{n+2}`.
    """

    slug = "micro_slip"
    summary = "micro-slip of an interface"
    fidelity = 0.01
    parameters = (Parameter("lost_stiffness", "N/m", 0.0), Parameter("exponent", "-", 0.2, 2.0))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the stiffness that matters, lost at the largest amplitude."""
        largest = float(scene.amplitudes(place, (1.0,))[0])
        scale = scene.stiffness_scale(place)
        parts = [
            strengths(scale * (REFERENCE / largest) ** n, [(n,)], (1e-4, 0.03, 0.2), both=False) for n in EXPONENTS
        ]
        return np.concatenate(parts)

    def impedance(self, A: Array, omega: Array, p: Array) -> Complex[Array, "..."]:
        """Stiffness lost and damping gained at amplitude ``A``."""
        n = p[1]
        c = 4 / jnp.sqrt(jnp.pi) * jnp.exp(gammaln(n + 1.5) - gammaln(n + 2)) * (n + 1) / (n + 2)
        return p[0] * (A / REFERENCE) ** n * (-c + 4j * n / (jnp.pi * (n + 2)))


class PowerSpring(JointCause):
    r"""A spring whose force grows as another power than the third, :math:`N(A) = k_0 (A/A_0)^m`."""

    slug = "power_spring"
    summary = "a spring with a power law"
    fidelity = 0.01
    named = False
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

    named = False
    prior = RARE


POWER_LAWS: tuple[Any, ...] = (PowerSpring(), PowerDamper(), RareMicroSlip())
