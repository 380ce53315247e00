"""Joints with dry friction: a spring in series with a slider (elasto-slip, Jenkins), and Coulomb friction."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Complex, Float
from typing_extensions import override

from modalax.simulate.joints.base import ANY, POSITIVE, Hysteretic, parameter


@jax.custom_jvp
def _stuck_share(r: Array) -> Array:
    r""":math:`\frac1\pi(\theta - \frac12\sin2\theta)`, :math:`\theta = \arccos(1 - 2r)`: 1 where all sticks (r = 1).

    Its derivative :math:`\frac8\pi\sqrt{r(1-r)}` is finite at both ends, where that of the arc cosine is not.
    """
    r = jnp.clip(r, 0.0, 1.0)
    theta = 2 * jnp.arcsin(jnp.sqrt(r))
    return (theta - 0.5 * jnp.sin(2 * theta)) / jnp.pi


@_stuck_share.defjvp
def _stuck_share_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (r,), (change,) = primals, tangents
    inside = (r > 0) & (r < 1)
    root = jnp.sqrt(jnp.where(inside, r * (1 - r), 1.0))
    return _stuck_share(r), jnp.where(inside, 8 / jnp.pi * root, 0.0) * change


def jenkins_describing(k: Any, slip: Any, A: Any) -> Complex[Array, "..."]:
    r"""Equivalent stiffness of a spring ``k`` [N/m] in series with a slider that slips at ``slip`` [m].

    .. math:: N = \frac{k}{\pi}\left(\theta - \tfrac12\sin 2\theta\right) + j\frac{4 k x_s (A - x_s)}{\pi A^2},
              \quad \theta = \arccos(1 - 2x_s/A),

    for :math:`A > x_s`, else k.
    """
    A = jnp.asarray(A)
    slips = A > slip
    r = jnp.where(slips, slip / jnp.where(slips, A, 1.0), 1.0)
    return k * (_stuck_share(r) + 1j * 4 / jnp.pi * r * (1 - r))


def slide(force: Any, limit: Any, push: Any) -> Float[Array, "..."]:
    """Force of a slider after its spring was pushed on by ``push`` [N]: the exact return map."""
    return jnp.clip(force + push, -limit, limit)


def slide_average(force: Any, limit: Any, k: Any, way: Any, bow: Any) -> Float[Array, "..."]:
    r"""Mean force of a slider over the time of a step, exact also where slip begins on the way.

    The displacement runs as :math:`s\,d + s(1-s)\,c` with the way d and the bow c, without turning back; slip begins
    where the spring has stretched by what it had left.
    """
    length, side = jnp.abs(way), jnp.where(way < 0, -1.0, 1.0)
    curve = jnp.clip(side * bow, -length, length)
    return side * _mean_push(*jnp.broadcast_arrays(side * force, limit, k, length, curve))


def _onset(force: Array, limit: Array, k: Array, length: Array, curve: Array) -> Array:
    """Share of the time of a step before slip begins; 1 where it does not."""
    left = jnp.maximum(limit - force, 0.0) / k
    slips = left < length
    # the smaller root of curve s^2 - (length + curve) s + left = 0, in the form that does not cancel
    slope = length + curve
    inner = jnp.where(slips, slope**2 - 4 * curve * left, 1.0)
    root = jnp.sqrt(jnp.where(inner > 0, inner, 0.0) + jnp.where(inner > 0, 0.0, 1e-300))
    divisor = jnp.where(slips, slope + root, 1.0)
    return jnp.where(slips, jnp.minimum(2 * left / jnp.where(divisor > 0, divisor, 1.0), 1.0), 1.0)


@jax.custom_jvp
def _mean_push(force: Array, limit: Array, k: Array, length: Array, curve: Array) -> Array:
    """Mean force of a slider that is pushed on in the direction of positive forces.

    When slip begins does not matter to first order, because the force does not jump there: so its derivative needs no
    derivative of a root.
    """
    s = _onset(force, limit, k, length, curve)
    return force * s + k * (length * s**2 / 2 + curve * (s**2 / 2 - s**3 / 3)) + (1 - s) * limit


def _mean_push_jvp(primals: tuple[Array, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    force, limit, k, length, curve = primals
    s = _onset(*primals)
    by_length, by_curve = s**2 / 2, s**2 / 2 - s**3 / 3
    value = force * s + k * (length * by_length + curve * by_curve) + (1 - s) * limit
    slopes = (s, 1 - s, length * by_length + curve * by_curve, k * by_length, k * by_curve)
    change = jnp.zeros_like(value)
    for slope, tangent in zip(slopes, tangents, strict=True):
        if not isinstance(tangent, SymbolicZero):
            change = change + slope * tangent
    return value, change


_mean_push.defjvp(_mean_push_jvp, symbolic_zeros=True)


class ElastoSlip(Hysteretic):
    r"""Jenkins element, a spring k in series with a slider of limit :math:`\mu`, and a spring :math:`k_0` beside them.

    Describing function as in :func:`jenkins_describing`, plus :math:`k_0`; small motions feel :math:`k_0 + k`.

    Attributes
    ----------
    k
        Stiffness of the spring in series with the slider [N/m].
    slip_force
        Force at which the slider slips, :math:`\mu f_N` [N].
    k0
        Stiffness of the parallel spring [N/m].
    """

    k: Float[Array, ""] = parameter()
    slip_force: Float[Array, ""] = parameter()
    k0: Float[Array, ""] = parameter(0.0)
    slug: ClassVar[str] = "elasto_slip"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "slip_force": "N", "k0": "N/m"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": POSITIVE, "slip_force": POSITIVE, "k0": ANY}

    @override
    def initial_state(self) -> Float[Array, "..."]:
        return jnp.zeros_like(self.slip_force)

    @override
    def step(self, state: Any, x_old: Any, x_new: Any) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        state = slide(state, self.slip_force, self.k * (x_new - x_old))
        return state, state + self.k0 * x_new

    @override
    def average(self, state: Any, x_old: Any, x_new: Any, bow: Any = 0.0) -> Float[Array, "..."]:
        mean = slide_average(state, self.slip_force, self.k, x_new - x_old, bow)
        return mean + self.k0 * (0.5 * (x_old + x_new) + bow / 6)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return self.k0 + jenkins_describing(self.k, self.slip_force / self.k, A)


class CoulombFriction(Hysteretic):
    r"""Dry friction :math:`f = F\,\mathrm{sign}(v)`, :math:`N = 4jF/(\pi A)`.

    Real contacts creep before they slip: over the distance ``creep`` the force builds up as in a spring
    :math:`F/x_c`, which also decides what the force is at rest. The default is far below any motion that is measured;
    the describing function is that of the elasto-slip law with this stiffness, equal to the formula to order
    :math:`\sqrt{x_c/A}`.

    Attributes
    ----------
    slip_force
        Friction force F [N].
    creep
        Displacement :math:`x_c` before slip [m]. Time marching takes it as none where its steps are too long to follow
        it, as they are for the default.
    """

    slip_force: Float[Array, ""] = parameter()
    creep: Float[Array, ""] = parameter(1e-12)
    slug: ClassVar[str] = "coulomb_friction"
    units: ClassVar[dict[str, str]] = {"slip_force": "N"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"slip_force": POSITIVE}

    @override
    def initial_state(self) -> Float[Array, "..."]:
        return jnp.zeros_like(self.slip_force)

    @override
    def step(self, state: Any, x_old: Any, x_new: Any) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        state = slide(state, self.slip_force, self.slip_force / self.creep * (x_new - x_old))
        return state, state

    @override
    def average(self, state: Any, x_old: Any, x_new: Any, bow: Any = 0.0) -> Float[Array, "..."]:
        return slide_average(state, self.slip_force, self.slip_force / self.creep, x_new - x_old, bow)

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        return jenkins_describing(self.slip_force / self.creep, self.creep, A)
