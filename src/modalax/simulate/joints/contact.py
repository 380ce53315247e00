"""Joints with contact: gaps on two sides, on one side, preloaded, and a spring with two stiffnesses."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float
from typing_extensions import override

from modalax.simulate.joints.base import ANY, POSITIVE, Memoryless, parameter


@jax.custom_jvp
def _share(rho: Array) -> Array:
    r"""Fundamental of :math:`\max(\cos\tau - \rho, 0)`: :math:`\frac12 - \frac1\pi(\arcsin\rho + \rho\sqrt{1-\rho^2})`.

    Its derivative :math:`-\frac2\pi\sqrt{1-\rho^2}` is finite at the ends, where the two terms' own are not.
    """
    rho = jnp.clip(rho, -1.0, 1.0)
    return 0.5 - (jnp.arcsin(rho) + rho * jnp.sqrt(1 - rho**2)) / jnp.pi


@_share.defjvp
def _share_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (rho,), (change,) = primals, tangents
    inside = jnp.abs(rho) < 1
    root = jnp.sqrt(jnp.where(inside, 1 - rho**2, 1.0))
    return _share(rho), jnp.where(inside, -2 / jnp.pi * root, 0.0) * change


def contact_share(gap: Any, A: Any) -> Float[Array, "..."]:
    """Part of a stop's stiffness that a cycle of amplitude ``A`` feels when it closes at ``gap`` (may be negative)."""
    A = jnp.asarray(A)
    moves = A > 0
    rho = jnp.where(moves, gap / jnp.where(moves, A, 1.0), 2 * jnp.sign(gap))
    return _share(jnp.clip(rho, -2.0, 2.0))


class Gap(Memoryless):
    r"""Stops on both sides: :math:`f = k\,(x \mp g)` beyond :math:`\pm g`, 0 between.

    :math:`N = k\left(1 - \frac2\pi(\arcsin\rho + \rho\sqrt{1-\rho^2})\right)`, :math:`\rho = g/A`, for :math:`A > g`.

    Attributes
    ----------
    k
        Stiffness of the stops [N/m].
    gap
        Clearance to each side [m].
    """

    k: Float[Array, ""] = parameter()
    gap: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "gap"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "gap": "m"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": POSITIVE, "gap": POSITIVE}

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self.k * (x - jnp.clip(x, -self.gap, self.gap))

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return 2 * self.k * contact_share(self.gap, A) + 0j


class OneSidedGap(Memoryless):
    r"""A stop on the positive side, :math:`f = k\max(x - g, 0)`; describing function without mean displacement.

    Attributes
    ----------
    k
        Stiffness of the stop [N/m].
    gap
        Clearance to the stop [m].
    """

    k: Float[Array, ""] = parameter()
    gap: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "one_sided_gap"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "gap": "m"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": POSITIVE, "gap": POSITIVE}
    odd: ClassVar[bool] = False

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self.k * jnp.maximum(x - self.gap, 0.0)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return self.k * contact_share(self.gap, A) + 0j


class PreloadedGap(Memoryless):
    r"""A gap of width 2g whose upper stop is pressed with a force P at rest.

    It opens when the joint is pulled by more than P (:math:`x < -P/k`, force :math:`-P`) and meets the other stop
    after the distance 2g: :math:`f = k\max(x + P/k, 0) - k\max(-x - P/k - 2g, 0) - P`.

    Attributes
    ----------
    k
        Stiffness of the stops [N/m].
    gap
        Half the clearance [m].
    preload
        Force that closes the joint at rest [N].
    """

    k: Float[Array, ""] = parameter()
    gap: Float[Array, ""] = parameter()
    preload: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "preloaded_gap"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "gap": "m", "preload": "N"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": POSITIVE, "gap": POSITIVE, "preload": POSITIVE}
    odd: ClassVar[bool] = False

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        opens = self.preload / self.k
        # written as the closed spring less what the opening takes away, so that f(0) is exactly 0
        return self.k * (x + jnp.maximum(-x - opens, 0.0) - jnp.maximum(-x - opens - 2 * self.gap, 0.0))

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        opens = self.preload / self.k
        return self.k * (1 - contact_share(opens, A) + contact_share(opens + 2 * self.gap, A)) + 0j


class BilinearSpring(Memoryless):
    r"""Spring with one stiffness in push and another in pull; :math:`N = (k_+ + k_-)/2` without mean displacement.

    Attributes
    ----------
    k_positive, k_negative
        Stiffness for x > 0 and for x < 0 [N/m].
    """

    k_positive: Float[Array, ""] = parameter()
    k_negative: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "bilinear_stiffness"
    units: ClassVar[dict[str, str]] = {"k_positive": "N/m", "k_negative": "N/m"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k_positive": ANY, "k_negative": ANY}
    odd: ClassVar[bool] = False

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self.k_positive * jnp.maximum(x, 0.0) + self.k_negative * jnp.minimum(x, 0.0)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return 0.5 * (self.k_positive + self.k_negative) * jnp.ones_like(jnp.asarray(A, dtype=float)) + 0j
