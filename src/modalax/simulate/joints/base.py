"""Base classes of joints: a force law between two points of a structure, with parameters, units and bounds."""

import abc
import math
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax.simulate.overview import of_joint

POSITIVE = (0.0, math.inf)
ANY = (-math.inf, math.inf)
QUADRATURE_POINTS = 2048  # samples of a cycle for describing functions without a closed form


def _scalar(value: Any) -> Float[Array, ""]:
    """One parameter as a double precision number, so that filtered transformations differentiate it.

    Raises
    ------
    ValueError
        If more than one number is given.
    """
    number = as_double(value, "a joint parameter")
    if number.ndim:
        raise ValueError(f"a joint parameter has shape {number.shape}; it needs one number (use vmap for many joints)")
    return number


def parameter(default: float | None = None) -> Any:
    """Make a field that holds one number in SI units, optionally with a default."""
    if default is None:
        return eqx.field(converter=_scalar)
    return eqx.field(converter=_scalar, default=default)


class Joint(eqx.Module):
    r"""A local force :math:`f` that resists the relative displacement :math:`x` of its two ends.

    With the direction :math:`b` over the DoFs, :math:`x = b^T u` and the structure feels :math:`-b f`.

    Attributes
    ----------
    slug
        Short name, as in files and in the diagnosis.
    units, bounds
        Unit and physical range of each parameter, by field name.
    odd
        Whether :math:`f(-x, -v) = -f(x, v)`: a symmetric motion then has odd harmonics only and no mean.
    """

    slug: ClassVar[str]
    units: ClassVar[dict[str, str]]
    bounds: ClassVar[dict[str, tuple[float, float]]]
    odd: ClassVar[bool] = True

    def __str__(self) -> str:
        """Name and parameters with units."""
        return of_joint(self)

    @property
    def parameters(self) -> dict[str, Array]:
        """Parameters by name, in SI units."""
        return {name: getattr(self, name) for name in self.units}

    @abc.abstractmethod
    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        r"""Equivalent stiffness :math:`N = f_1/x_1` [N/m] under :math:`x = A\cos\omega t`.

        Parameters
        ----------
        A, omega
            Amplitude across the joint [m] and circular frequency [rad/s], shapes that broadcast.
        """

    def energy(self, A: Any, omega: Any) -> Float[Array, "..."]:
        r"""Energy that one cycle of amplitude ``A`` [m] takes, :math:`\pi A^2\,\mathrm{Im}N` [J]."""
        return jnp.pi * jnp.asarray(A) ** 2 * self.describing(A, omega).imag


class Memoryless(Joint):
    """A joint whose force depends on displacement and velocity at the same instant."""

    @abc.abstractmethod
    def force(self, x: Any, v: Any) -> Float[Array, "..."]:
        """Force [N] at relative displacement ``x`` [m] and velocity ``v`` [m/s], elementwise."""

    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        """By quadrature over a cycle; subclasses with a closed form give that instead."""
        return quadrature(self, A, omega)


class Hysteretic(Joint):
    """A rate-independent joint with memory: its force depends on the history of the displacement.

    Attributes
    ----------
    settle
        Cycles of a periodic motion after which the loop is closed.
    """

    settle: ClassVar[int] = 1

    @abc.abstractmethod
    def initial_state(self) -> Any:
        """State of the unloaded joint at x = 0."""

    @abc.abstractmethod
    def step(self, state: Any, x_old: Any, x_new: Any) -> tuple[Any, Float[Array, "..."]]:
        """State and force [N] after a motion from ``x_old`` to ``x_new`` [m] without reversal."""

    def close(self, lap: Callable[[Any], Any], state: Any) -> Any:
        """State of the closed hysteresis loop, found from a state near it; the cycle ``lap`` leaves it unchanged."""
        for _ in range(self.settle):
            state = lap(state)
        return state

    def average(self, state: Any, x_old: Any, x_new: Any, bow: Any = 0.0) -> Float[Array, "..."]:
        r"""Mean force [N] over the time of a step that does not turn back; Simpson's rule unless given exactly.

        Parameters
        ----------
        bow
            Curvature over the step: :math:`x(s) = x_0 + s(x_1 - x_0) + s(1-s)\,\mathrm{bow}`, s from 0 to 1.
        """
        first = self.step(state, x_old, x_old)[1]
        middle = self.step(state, x_old, 0.5 * (x_old + x_new) + 0.25 * bow)[1]
        last = self.step(state, x_old, x_new)[1]
        return (first + 4 * middle + last) / 6

    def describing(self, A: Any, omega: Any) -> Complex[Array, "..."]:
        """By stepping around the closed loop; subclasses with a closed form give that instead."""
        return quadrature(self, A, omega)


def quadrature(joint: Joint, A: Any, omega: Any, points: int = QUADRATURE_POINTS) -> Complex[Array, "..."]:
    r"""Integrate the describing function of any joint, :math:`\frac{1}{\pi A}\int_0^{2\pi} f e^{-j\tau}\,d\tau`.

    Parameters
    ----------
    A, omega
        Amplitude [m], not zero, and circular frequency [rad/s], shapes that broadcast.
    points
        Samples of a cycle.
    """
    A, omega = jnp.broadcast_arrays(as_double(A, "A"), as_double(omega, "omega"))
    tau = 2 * jnp.pi * jnp.arange(points) / points
    x = A[..., None] * jnp.cos(tau)
    if isinstance(joint, Hysteretic):
        f = _loop(joint, x)
    else:
        assert isinstance(joint, Memoryless)
        f = joint.force(x, -(omega * A)[..., None] * jnp.sin(tau))
    return 2 * jnp.mean(f * jnp.exp(-1j * tau), axis=-1) / A


def _loop(joint: Hysteretic, x: Float[Array, "*batch points"]) -> Float[Array, "*batch points"]:
    """Force along the closed loop of periodic motions ``x``."""

    def one(way: Float[Array, " points"]) -> Float[Array, " points"]:
        def advance(carry: tuple[Any, Array], new: Array) -> tuple[tuple[Any, Array], Array]:
            state, old = carry
            state, f = joint.step(state, old, new)
            return (state, new), f

        def lap(state: Any) -> Any:
            return jax.lax.scan(advance, (state, way[-1]), way)[0][0]

        start = joint.step(joint.initial_state(), jnp.zeros(()), way[-1])[0]
        return jax.lax.scan(advance, (joint.close(lap, start), way[-1]), way)[1]

    flat = x.reshape(-1, x.shape[-1])
    return jax.vmap(one)(flat).reshape(x.shape)
