r"""Joint laws inside a step of time marching: from the motion of the joint's ends to the moments of its force.

Within a step the ends move as the cubic that fits displacement and velocity at both sides. The law is sampled on it at
``FINE`` intervals, so contact and slip that begin or end inside a step are met there; the force enters the structure
by its first three Legendre moments :math:`c_k = (2k+1)\int_0^1 f P_k\,ds`. Dry friction is a law of the velocity with a
jump: there the instant of standstill is found in closed form, and from it on the slider sticks or turns. Where the
steps resolve its creep, it is the elasto-slip law that it then is.
"""

from functools import singledispatch
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax.simulate.joints import CoulombFriction, Hysteretic, Joint, Memoryless

FINE = 8
"""Intervals of a step in which a law is sampled."""


class Way(NamedTuple):
    """Relative displacement [m] and velocity [m/s] of a joint's ends at both sides of a step of length ``h`` [s]."""

    x0: Array
    v0: Array
    x1: Array
    v1: Array
    h: Array


class Push(NamedTuple):
    """Force of a joint over a step.

    Attributes
    ----------
    moments
        Legendre moments, shape ``(k,)`` [N].
    end
        Force at the end of the step [N].
    state
        The joint's state there.
    """

    moments: Float[Array, " k"]
    end: Array
    state: Any


def _moment_weights() -> np.ndarray:
    """Composite Simpson rule for the moments, shape ``(k, FINE + 1)``."""
    s = np.linspace(0, 1, FINE + 1)
    rule = np.full(FINE + 1, 2.0)
    rule[1::2] = 4.0
    rule[[0, -1]] = 1.0
    return np.stack([np.ones_like(s), 3 * (2 * s - 1), 5 * (6 * s**2 - 6 * s + 1)]) * rule / (3 * FINE)


WEIGHTS = _moment_weights()
_S = np.linspace(0, 1, FINE + 1)
HERMITE = np.stack([2 * _S**3 - 3 * _S**2 + 1, _S**3 - 2 * _S**2 + _S, 3 * _S**2 - 2 * _S**3, _S**3 - _S**2], axis=1)
SLOPES = np.stack([6 * _S**2 - 6 * _S, 3 * _S**2 - 4 * _S + 1, 6 * _S - 6 * _S**2, 3 * _S**2 - 2 * _S], axis=1)


def fine_way(way: Way) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
    """Displacement and velocity at the ends of the fine intervals."""
    nodes = jnp.stack([way.x0, way.h * way.v0, way.x1, way.h * way.v1])
    return jnp.asarray(HERMITE) @ nodes, jnp.asarray(SLOPES) @ nodes / way.h


@singledispatch
def rest(joint: Joint) -> Any:
    """State of a joint before any motion."""
    raise TypeError(f"{type(joint).__name__} has no law in time; it needs force(x, v) or step(state, x_old, x_new)")


@singledispatch
def push(joint: Joint, state: Any, way: Way, own: Float[Array, "2 k"], guess: Float[Array, " k"]) -> Push:
    """Force of a joint over a step.

    Parameters
    ----------
    way
        Its motion with the force ``guess``.
    own
        What each moment of its own force adds to displacement and velocity at the end of the step.
    guess
        Moments with which ``way`` was found.
    """
    raise TypeError(f"{type(joint).__name__} has no law in time; it needs force(x, v) or step(state, x_old, x_new)")


@rest.register
def _(joint: Memoryless) -> Any:
    return ()


@push.register
def _(joint: Memoryless, state: Any, way: Way, own: Array, guess: Array) -> Push:
    x, v = fine_way(way)
    f = joint.force(x, v)
    return Push(jnp.asarray(WEIGHTS) @ f, f[-1], state)


@rest.register
def _(joint: Hysteretic) -> Any:
    return joint.initial_state()


@push.register
def _(joint: Hysteretic, state: Any, way: Way, own: Array, guess: Array) -> Push:
    return _step_along(joint, state, way)


def _step_along(joint: Hysteretic, state: Any, way: Way) -> Push:
    """A law with memory along the fine intervals."""
    x, _ = fine_way(way)
    first = joint.step(state, x[0], x[0])[1]
    state, f = jax.lax.scan(lambda state, ends: joint.step(state, *ends), state, (x[:-1], x[1:]))
    return Push(jnp.asarray(WEIGHTS) @ jnp.concatenate([first[None], f]), f[-1], state)


@rest.register
def _(joint: CoulombFriction) -> Any:
    """Sticking: the direction of slip, 0 where the slider sticks, and the force of the creeping contact."""
    return jnp.zeros_like(joint.slip_force), joint.initial_state()


@push.register
def _(joint: CoulombFriction, state: Any, way: Way, own: Array, guess: Array) -> Push:
    direction, force = state
    rigid, creeping = _rigid_friction(joint, direction, way, own, guess), _step_along(joint, force, way)
    # creep is resolved where it is no less than the way that friction itself makes the structure go in a step
    resolved = joint.creep >= joint.slip_force * jnp.abs(own[0, 0])
    moments, end = (jnp.where(resolved, c, r) for c, r in zip(creeping[:2], rigid[:2], strict=True))
    return Push(moments, end, (rigid.state, creeping.state))


def _rigid_friction(joint: CoulombFriction, state: Array, way: Way, own: Array, guess: Array) -> Push:
    """Friction that holds without creep, the standstill found within the step."""
    limit = joint.slip_force
    # the motion if the slider goes on in its direction
    forward = state * limit
    change = own @ (jnp.array([1.0, 0.0, 0.0]) * forward - guess)
    x1, v1 = way.x1 + change[0], way.v1 + change[1]
    stop = jnp.where(state == 0, 0.0, _standstill(state, way._replace(x1=x1, v1=v1)))
    # from the standstill on: the force that keeps it still, as far as friction can
    moments = jnp.stack([1 - stop, 3 * stop * (1 - stop), -5 * stop * (2 * stop - 1) * (stop - 1)])
    hold = own[1] @ moments
    held = forward - v1 / jnp.where(hold == 0, -1.0, hold)
    after = jnp.where(stop < 1, jnp.clip(held, -limit, limit), forward)
    end = jnp.where(stop < 1, jnp.where(jnp.abs(held) < limit, 0.0, jnp.sign(after)), state)
    slips = Push(jnp.array([1.0, 0.0, 0.0]) * forward + moments * (after - forward), after, end)
    # a slider that sticks over the whole step: the linear force that keeps both place and velocity
    free = jnp.stack([way.x1 - way.x0, way.v1]) - own @ guess
    (a, b), (c, d) = own[:, :2]
    span = jnp.where(a * d == b * c, 1.0, a * d - b * c)
    level, slope = (b * free[1] - d * free[0]) / span, (c * free[0] - a * free[1]) / span
    stuck = (state == 0) & (jnp.abs(level) + jnp.abs(slope) < limit)
    return jax.tree.map(
        lambda sticking, slipping: jnp.where(stuck, sticking, slipping),
        Push(jnp.stack([level, slope, jnp.zeros_like(level)]), level + slope, jnp.zeros_like(end)),
        slips,
    )


def _standstill(direction: Array, way: Way) -> Array:
    """Share of the step after which the velocity, positive along ``direction``, is zero; 1 where it stays positive."""
    v0, v1, mean = direction * way.v0, direction * way.v1, direction * (way.x1 - way.x0) / way.h
    a, b = 3 * (v0 + v1) - 6 * mean, 6 * mean - 4 * v0 - 2 * v1
    square = b**2 - 4 * a * v0
    root = jnp.sqrt(jnp.where(square > 0, square, 0.0))
    below = root - b
    s = jnp.where((square >= 0) & (below > 0), 2 * v0 / jnp.where(below > 0, below, 1.0), 1.0)
    return jnp.clip(s, 0.0, 1.0)


def solve_step(
    joints: tuple[Joint, ...],
    states: tuple[Any, ...],
    start: tuple[Float[Array, " j"], Float[Array, " j"]],
    free: tuple[Float[Array, " j"], Float[Array, " j"]],
    compliance: Float[Array, "2 j j k"],
    h: Array,
    guess: Float[Array, "j k"],
    passes: int,
) -> tuple[tuple[Push, ...], Float[Array, "2 j"], Array]:
    """Forces of all joints that agree with the motion they make, by ``passes`` of Newton's iteration.

    Parameters
    ----------
    start, free
        Displacement and velocity of each joint at the start, and at the end without joint forces.
    compliance
        What each moment of each joint's force adds at the end.
    guess
        Moments to start from.

    Returns
    -------
    pushes, end, left
        Forces, displacement and velocity at the end, and by how much forces and motion disagree there [m].
    """

    def motion(moments: Float[Array, "j k"]) -> Float[Array, "2 j"]:
        return jnp.stack(free) + jnp.einsum("bpjk,jk->bp", compliance, moments)

    def forces(moments: Float[Array, "j k"]) -> tuple[Float[Array, "j k"], tuple[Push, ...]]:
        end = motion(moments)
        pushes = tuple(
            push(joint, state, Way(start[0][k], start[1][k], end[0, k], end[1, k], h), compliance[:, k, k], moments[k])
            for k, (joint, state) in enumerate(zip(joints, states, strict=True))
        )
        return jnp.stack([p.moments for p in pushes]), pushes

    def newton(moments: Float[Array, "j k"], _: None) -> tuple[Float[Array, "j k"], None]:
        slope, (answer, _) = _with_value(forces, moments)
        way = jnp.linalg.solve(jnp.eye(guess.size) - slope.reshape(guess.size, guess.size), (answer - moments).ravel())
        return moments + way.reshape(guess.shape), None

    moments, _ = jax.lax.scan(newton, guess, None, length=passes)
    answer, pushes = forces(moments)
    left = jnp.max(jnp.abs(motion(answer) - motion(moments)))
    return pushes, motion(answer), left


def _with_value(function: Any, at: Array) -> tuple[Array, Any]:
    """Jacobian of the first output, and all outputs."""

    def both(z: Array) -> tuple[Array, Any]:
        out = function(z)
        return out[0], out

    return jax.jacfwd(both, has_aux=True)(at)


def initial_states(joints: tuple[Joint, ...]) -> tuple[Any, ...]:
    """States of unloaded joints, as arrays that a loop can carry."""
    return tuple(jax.tree.map(jnp.asarray, rest(joint)) for joint in joints)
