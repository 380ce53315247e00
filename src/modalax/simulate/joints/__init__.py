r"""Laws of non-linear joints, a small class for each.

A joint of your own is a class with its force law; all else (describing function, harmonic balance, gradients) follows.
Parameters are fields made by :func:`parameter`, in SI units. A law without memory gives ``force``::

    class Hardening(Memoryless):
        k: Float[Array, ""] = parameter()
        slug: ClassVar[str] = "hardening"
        units: ClassVar[dict[str, str]] = {"k": "N/m"}
        bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": (0.0, math.inf)}

        def force(self, x, v):
            return self.k * jnp.sinh(x)

A law with memory is a :class:`Hysteretic` with ``initial_state()`` and ``step(state, x_old, x_new) -> (state, force)``,
rate independent; ``average`` (the mean force over a step) may be given where it is known exactly, as for a slider.
Set ``odd`` to False where :math:`f(-x, -v) \ne -f(x, v)`; give ``describing`` where it is known in closed form.
"""

from modalax.simulate.joints.base import Hysteretic, Joint, Memoryless, parameter, quadrature
from modalax.simulate.joints.contact import BilinearSpring, Gap, OneSidedGap, PreloadedGap
from modalax.simulate.joints.friction import CoulombFriction, ElastoSlip
from modalax.simulate.joints.hysteresis import BoucWen, Iwan, ParallelJenkins
from modalax.simulate.joints.smooth import CubicSpring, PolynomialDamping, PolynomialStiffness, QuadraticDamping

CATALOGUE: dict[str, type[Joint]] = {
    joint.slug: joint
    for joint in (
        CubicSpring, Gap, OneSidedGap, PreloadedGap, BilinearSpring, CoulombFriction, ElastoSlip, Iwan,
        ParallelJenkins, BoucWen, QuadraticDamping, PolynomialStiffness, PolynomialDamping,
    )
}  # fmt: skip

__all__ = [
    "CATALOGUE", "BilinearSpring", "BoucWen", "CoulombFriction", "CubicSpring", "ElastoSlip", "Gap", "Hysteretic",
    "Iwan", "Joint", "Memoryless", "OneSidedGap", "ParallelJenkins", "PolynomialDamping", "PolynomialStiffness",
    "PreloadedGap", "QuadraticDamping", "parameter", "quadrature",
]  # fmt: skip
