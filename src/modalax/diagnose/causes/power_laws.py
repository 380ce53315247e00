"""Joints whose stiffness or damping follows a power of the amplitude, Iwan's among them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import RARE, JointCause
from modalax.diagnose.causes.joints import CoulombFriction
from modalax.diagnose.causes.local import median_omega
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene
from modalax.simulate import joints
from modalax.simulate.joints.friction import jenkins_describing

REFERENCE = 1e-4  # amplitude at which the lost stiffness is reported [m]
EXPONENTS = (0.5, 1.0, 1.5)  # exponents of the amplitude that are screened [-]
IWAN = 0.1  # prior of each form of an Iwan joint: one sharp slip is the simpler thing to say
TERMS = 37  # of a series whose terms fall at least by a half each: what is left out is rounding


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


class IwanMicroSlip(MicroSlip):
    """The micro-slip of an Iwan joint that the simulation has as a spring."""

    slug = "iwan_joint"
    summary = "a spring of the simulation that slips little by little, as Iwan's joint does"
    prior = IWAN


class IwanJoint(JointCause):
    r"""An additional joint of Iwan's kind: sliders whose slip displacements are spread as :math:`\phi^{n-1}`.

    With the stiffness K of small motions, all slips beyond :math:`\phi_m`. A slider of slip displacement
    :math:`\phi = uA` has the share :math:`J(u)` of its stiffness at the amplitude A
    (:func:`~modalax.simulate.joints.friction.jenkins_describing`), so that, with :math:`r = A/\phi_m`,

    .. math:: \frac{N(A)}{K} = \max(0, 1 - r^n) + r^n\int_0^x n u^{n-1} J(u)\,du,\qquad x = \min(1, 1/r),

    which is, by parts,

    .. math:: \Re J(x) + \min(1, r)^n\Big[\frac{4jn}{\pi}\Big(\frac{x}{n+1} - \frac{x^2}{n+2}\Big)
              - \frac8\pi x^{3/2}\int_0^1 v^{n+1/2}\sqrt{1 - xv}\,dv\Big].

    Source: Segalman (2005), J. Appl. Mech. 72:752, eq. 22-30, with :math:`\chi = n - 1` and :math:`\beta = 0`.
    """

    slug = "iwan_joint"
    summary = "an additional joint of Iwan's kind, which slips little by little"
    fidelity = 0.01
    prior = IWAN
    parameters = (
        Parameter("stiffness", "N/m", 0.0),
        Parameter("slip_displacement", "m", 1e-15, log=True),
        Parameter("exponent", "-", 0.1, 1.0),
    )

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Slip of all at fractions and multiples of the amplitude."""
        shapes = [(x, n) for x in scene.amplitudes(place, (0.15, 0.5, 1.5)) for n in EXPONENTS if n <= 1.0]
        return strengths(scene.stiffness_scale(place), shapes, (1e-4, 0.05, 0.4), both=False)

    def law(self, p: Array) -> Any:
        """Force at which all slips, stiffness of small motions, power of the distribution."""
        return joints.Iwan(macro_slip(p), p[0], p[2] - 1)

    def impedance(self, A: Array, omega: Array, p: Array) -> Complex[Array, "..."]:
        """Describing function at amplitude ``A``."""
        n, r = p[2], A / p[1]
        x = 1 / jnp.maximum(r, 1.0)
        loss = 4 / jnp.pi * n * (x / (n + 1) - x**2 / (n + 2))
        slipped = 1j * loss - 8 / jnp.pi * x**1.5 * power_and_root(x, n + 0.5)
        return p[0] * (jenkins_describing(1.0, x, 1.0).real + jnp.minimum(r, 1.0) ** n * slipped)

    def simpler(self, p: np.ndarray) -> tuple[JointCause, np.ndarray]:
        """One of any great stiffness, all of which slips at once, is dry friction."""
        return CoulombFriction(), np.array([float(macro_slip(p))])

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The force of macro-slip rather than the displacement."""
        return {"stiffness": (p[0], "N/m"), "slip_force": (macro_slip(p), "N"), "exponent": (p[2], "-")}


def macro_slip(p: Any) -> Any:
    r"""Force :math:`K\phi_m n/(n+1)` [N] at which all of an Iwan joint slips."""
    return p[0] * p[1] * p[2] / (p[2] + 1)


@jax.jit  # so that it is compiled once, not wherever it is asked for
def power_and_root(x: Array, a: Any) -> Array:
    r""":math:`\int_0^1 v^a\sqrt{1 - xv}\,dv` for :math:`0 \le x \le 1`, an incomplete beta function over a power of x.

    By :math:`\int_0^z u^e(1-u)^q\,du = z^{e+1}\sum_k \frac{(-q)_k}{k!}\frac{z^k}{e+k+1}` (Abramowitz and Stegun, 1964,
    6.6.8) at z = x up to a half; beyond it at z = 1 - x, for the part that is missing from the whole.
    """
    low = x < 0.5
    z, e, q = jnp.where(low, x, 1 - x), jnp.where(low, a, 0.5), jnp.where(low, 0.5, a)

    def add(k: Any, state: tuple[Array, Array]) -> tuple[Array, Array]:
        term, total = state
        term = term * z * (k - 1 - q) / k
        return term, total + term / (e + k + 1)

    series = jax.lax.fori_loop(1, TERMS, add, (jnp.ones_like(e * z), 1 / (e + 1) + 0 * z), unroll=4)[1]
    whole = 0.5 * jnp.sqrt(jnp.pi) * jnp.exp(gammaln(a + 1) - gammaln(a + 2.5))
    return jnp.where(low, series, (whole - z**1.5 * series) / jnp.where(low, 1.0, x) ** (a + 1))


POWER_LAWS: tuple[Any, ...] = (IwanMicroSlip(), IwanJoint(), PowerSpring(), PowerDamper())
