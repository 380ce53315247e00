"""Joints with distributed slip: Jenkins elements side by side, the four-parameter Iwan model, and Bouc-Wen."""

import abc
import math
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float
from typing_extensions import override

from modalax._numerics.checks import as_double
from modalax.simulate.joints.base import POSITIVE, Hysteretic, parameter
from modalax.simulate.joints.friction import jenkins_describing, slide, slide_average

CLOSING = 3
"""Newton steps that close a Bouc-Wen loop."""


class _Sliders(Hysteretic):
    """Base class of laws made of sliders in parallel, each in series with a spring."""

    @abc.abstractmethod
    def sliders(self) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
        """Stiffness [N/m] and slip displacement [m] of each slider."""

    @override
    def initial_state(self) -> Float[Array, " s"]:
        return jnp.zeros_like(self.sliders()[0])

    @override
    def step(self, state: Any, x_old: Any, x_new: Any) -> tuple[Float[Array, " s"], Float[Array, ""]]:
        k, slip = self.sliders()
        state = slide(state, k * slip, k * (x_new - x_old))
        return state, jnp.sum(state)

    @override
    def average(self, state: Any, x_old: Any, x_new: Any, bow: Any = 0.0) -> Float[Array, ""]:
        k, slip = self.sliders()
        return jnp.sum(slide_average(state, k * slip, k, x_new - x_old, bow))

    @override
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        k, slip = self.sliders()
        return jnp.sum(jenkins_describing(k, slip, jnp.asarray(A)[..., None]), axis=-1)


class ParallelJenkins(_Sliders):
    """Jenkins elements side by side, each with its own stiffness and limit (the discrete Iwan model).

    Attributes
    ----------
    k
        Stiffness of each spring, shape ``(s,)`` [N/m].
    slip_force
        Limit of each slider, shape ``(s,)`` [N].
    """

    k: Float[Array, " s"]
    slip_force: Float[Array, " s"]
    slug: ClassVar[str] = "parallel_jenkins"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "slip_force": "N"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {"k": POSITIVE, "slip_force": POSITIVE}

    def __init__(self, k: Any, slip_force: Any):
        self.k, self.slip_force = as_double(k, "k"), as_double(slip_force, "slip_force")
        if self.k.ndim != 1 or self.k.shape != self.slip_force.shape:
            raise ValueError(
                f"k has shape {self.k.shape} and slip_force {self.slip_force.shape}; each needs one number per slider"
            )

    @override
    def sliders(self) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
        return self.k, self.slip_force / self.k


class Iwan(_Sliders):
    r"""Four-parameter Iwan model: slip displacements spread as :math:`\rho = R\phi^\chi` up to a largest one.

    At the largest displacement :math:`\phi_m` a share of the stiffness slips at once, so that

    .. math:: \phi_m = \frac{F_s (1+\beta)}{K_t\left(\beta + \frac{\chi+1}{\chi+2}\right)};

    the loss a cycle at small amplitude goes as :math:`A^{\chi+3}`. ``chi = 0, beta = 0`` is the uniform distribution.
    Source: Segalman (2005), A four-parameter Iwan model for lap-type joints, J. Appl. Mech. 72, eq. 22-30.

    Attributes
    ----------
    slip_force
        Force of macro-slip :math:`F_s` [N].
    k
        Stiffness of small motions :math:`K_t` [N/m].
    chi
        Power of the distribution, between -1 and 0 [-].
    beta
        Stiffness that slips last over that of the power law, from 0 up [-].
    count
        Number of sliders that stand for the power law, spaced geometrically.
    """

    slip_force: Float[Array, ""] = parameter()
    k: Float[Array, ""] = parameter()
    chi: Float[Array, ""] = parameter(0.0)
    beta: Float[Array, ""] = parameter(0.0)
    count: int = eqx.field(static=True, default=40)
    slug: ClassVar[str] = "iwan"
    units: ClassVar[dict[str, str]] = {"slip_force": "N", "k": "N/m", "chi": "-", "beta": "-"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {
        "slip_force": POSITIVE, "k": POSITIVE, "chi": (-1.0, 0.0), "beta": (0.0, math.inf)
    }  # fmt: skip

    def largest(self) -> Float[Array, ""]:
        r"""Displacement of macro-slip :math:`\phi_m` [m]."""
        power = self.chi + 1
        return self.slip_force * (1 + self.beta) / (self.k * (self.beta + power / (power + 1)))

    @override
    def sliders(self) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
        power, top = self.chi + 1, self.largest()
        spread, last = self.k / (1 + self.beta), self.k * self.beta / (1 + self.beta)
        edges = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-3, 1.0, self.count)])
        # each slider stands for one bin: its stiffness is the bin's, its limit is the force the bin holds when it slips
        low, high = edges[:-1], edges[1:]
        safe = jnp.where(low > 0, low, 1.0)
        share = high**power - jnp.where(low > 0, safe**power, 0.0)
        moment = power / (power + 1) * (high ** (power + 1) - jnp.where(low > 0, safe ** (power + 1), 0.0))
        k = jnp.concatenate([spread * share, last[None]])
        return k, top * jnp.concatenate([moment / share, jnp.ones(1)])


class BoucWen(Hysteretic):
    r"""Smooth hysteresis :math:`f = k(\alpha x + (1-\alpha) z)`.

    :math:`\frac{dz}{dx} = 1 - \left|\frac{z}{x_y}\right|^n\left(1 - \beta + \beta\,\mathrm{sign}(z\,dx)\right)`.
    Source: Wen (1976), Method for random vibration of hysteretic systems, J. Eng. Mech. Div. 102, eq. 3.

    Attributes
    ----------
    k
        Stiffness of small motions [N/m].
    x_y
        Yield displacement, the largest z [m].
    alpha
        Stiffness after yield over k [-].
    n
        Sharpness of the yield [-].
    beta
        Shape of the loop: 0.5 unloads with the stiffness k [-].
    substeps
        Runge-Kutta steps that integrate one step of displacement.
    """

    k: Float[Array, ""] = parameter()
    x_y: Float[Array, ""] = parameter()
    alpha: Float[Array, ""] = parameter(0.0)
    n: Float[Array, ""] = parameter(2.0)
    beta: Float[Array, ""] = parameter(0.5)
    substeps: int = eqx.field(static=True, default=2)
    slug: ClassVar[str] = "bouc_wen"
    units: ClassVar[dict[str, str]] = {"k": "N/m", "x_y": "m", "alpha": "-", "n": "-", "beta": "-"}
    bounds: ClassVar[dict[str, tuple[float, float]]] = {
        "k": POSITIVE, "x_y": POSITIVE, "alpha": (0.0, 1.0), "n": (1.0, math.inf), "beta": (0.0, 1.0)
    }  # fmt: skip

    @override
    def initial_state(self) -> Float[Array, "..."]:
        return jnp.zeros_like(self.x_y)

    @override
    def close(self, lap: Callable[[Any], Any], state: Any) -> Float[Array, "..."]:
        """By Newton's iteration: where little is lost a cycle, the start would be remembered over many of them."""

        def newton(state: Array, _: None) -> tuple[Array, None]:
            after, slope = jax.jvp(lap, (state,), (jnp.ones_like(state),))
            forgets = 1 - slope > 1e-12  # not at all where the motion is so small that the law is a spring
            state = state + jnp.where(forgets, (after - state) / jnp.where(forgets, 1 - slope, 1.0), 0.0)
            return jnp.clip(state, -self.x_y, self.x_y), None

        return jax.lax.scan(newton, state, None, length=CLOSING)[0]

    def _rate(self, z: Any, way: Any) -> Float[Array, "..."]:
        size = jnp.abs(z) / self.x_y
        still = size == 0
        power = jnp.where(still, 0.0, jnp.where(still, 1.0, size) ** self.n)
        return way * (1 - power * (1 - self.beta + self.beta * jnp.sign(z * way)))

    @override
    def step(self, state: Any, x_old: Any, x_new: Any) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        # a step far longer than the yield displacement only has to saturate; limited, Runge-Kutta stays stable there
        limit = 2 * self.x_y / self.n
        z, way = state, jnp.clip((x_new - x_old) / self.substeps, -limit, limit)

        def runge_kutta(z: Array, _: None) -> tuple[Array, None]:
            first = self._rate(z, way)
            second = self._rate(z + 0.5 * first, way)
            third = self._rate(z + 0.5 * second, way)
            return z + (first + 2 * second + 2 * third + self._rate(z + third, way)) / 6, None

        z = jax.lax.scan(runge_kutta, z, None, length=self.substeps)[0]
        return z, self._force(z, x_new)

    @override
    def average(self, state: Any, x_old: Any, x_new: Any, bow: Any = 0.0) -> Float[Array, "..."]:
        # Simpson's rule; the second half of the way goes on from the first
        middle = 0.5 * (x_old + x_new) + 0.25 * bow
        half, force = self.step(state, x_old, middle)
        return (self._force(state, x_old) + 4 * force + self.step(half, middle, x_new)[1]) / 6

    def _force(self, z: Any, x: Any) -> Float[Array, "..."]:
        return self.k * (self.alpha * x + (1 - self.alpha) * z)
