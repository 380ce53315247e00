"""Joints with a smooth law: springs and dampers that are polynomials, and quadratic damping."""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float
from typing_extensions import override

from modalax._numerics.checks import as_double
from modalax.simulate.joints.base import ANY, POSITIVE, Memoryless, parameter


class CubicSpring(Memoryless):
    r"""Duffing spring :math:`f = k_3 x^3`, :math:`N = \frac34 k_3 A^2`.

    Attributes
    ----------
    k3
        Cubic stiffness, positive where it hardens [N/m^3].
    """

    k3: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "cubic_stiffness"
    units: ClassVar[dict[str, str]] = {"k3": "N/m^3"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k3": ANY}

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self.k3 * jnp.asarray(x) ** 3

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return 0.75 * self.k3 * jnp.asarray(A) ** 2 + 0j


class QuadraticDamping(Memoryless):
    r"""Drag :math:`f = c\,v|v|`, :math:`N = j\frac{8}{3\pi} c\,\omega^2 A`.

    Attributes
    ----------
    c
        Drag coefficient [N s^2/m^2].
    """

    c: Float[Array, ""] = parameter()
    slug: ClassVar[str] = "quadratic_damping"
    units: ClassVar[dict[str, str]] = {"c": "N s^2/m^2"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"c": POSITIVE}

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self.c * v * jnp.abs(v)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return 1j * 8 / (3 * jnp.pi) * self.c * jnp.asarray(omega) ** 2 * A


def cosine_power(power: int) -> float:
    r"""Fundamental of :math:`\cos^p\tau`: :math:`\binom{p}{(p+1)/2}/2^{p-1}` for odd p, else 0."""
    return math.comb(power, (power + 1) // 2) / 2 ** (power - 1) if power % 2 else 0.0


class _Polynomial(Memoryless):
    """Coefficients and powers, one each."""

    coefficients: Float[Array, " term"]
    powers: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, coefficients: Any, powers: tuple[int, ...]):
        self.coefficients = as_double(coefficients, "coefficients")
        if self.coefficients.shape != (len(powers),) or min(powers, default=0) < 1:
            raise ValueError(
                f"{self.coefficients.size} coefficients for powers {powers}; it needs one for each power, from 1 up"
            )
        self.powers = tuple(powers)

    @property
    def odd(self) -> bool:
        """Whether there are odd powers only."""
        return all(p % 2 for p in self.powers)

    def _sum(self, z: Any) -> Float[Array, "..."]:
        z = jnp.asarray(z)
        return sum((c * z**p for c, p in zip(self.coefficients, self.powers, strict=True)), jnp.zeros_like(z))

    def _fundamental(self, amplitude: Any) -> Float[Array, "..."]:
        amplitude = jnp.asarray(amplitude)
        terms = zip(self.coefficients, self.powers, strict=True)
        return sum((c * cosine_power(p) * amplitude ** (p - 1) for c, p in terms), jnp.zeros_like(amplitude))


class PolynomialStiffness(_Polynomial):
    r"""Spring :math:`f = \sum_p k_p x^p`, :math:`N = \sum_{p\,\mathrm{odd}} k_p\binom{p}{(p+1)/2}(A/2)^{p-1}`.

    Attributes
    ----------
    coefficients
        :math:`k_p`, one a power [N/m^p].
    powers
        The powers p, whole numbers from 1 up.
    """

    slug: ClassVar[str] = "polynomial_stiffness"
    units: ClassVar[dict[str, str]] = {"coefficients": "N/m^p"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"coefficients": ANY}

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self._sum(x)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return self._fundamental(A) + 0j


class PolynomialDamping(_Polynomial):
    r"""Damper :math:`f = \sum_p c_p v^p`.

    :math:`N = j\omega\sum_{p\,\mathrm{odd}} c_p\binom{p}{(p+1)/2}(\omega A/2)^{p-1}`.

    Attributes
    ----------
    coefficients
        :math:`c_p`, one a power [N (s/m)^p].
    powers
        The powers p, whole numbers from 1 up.
    """

    slug: ClassVar[str] = "polynomial_damping"
    units: ClassVar[dict[str, str]] = {"coefficients": "N (s/m)^p"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"coefficients": ANY}

    @override
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        return self._sum(v)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return 1j * jnp.asarray(omega) * self._fundamental(jnp.asarray(omega) * A)
