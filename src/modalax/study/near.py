"""Modes selected from a stabilization diagram near given ones, as a function that compiles."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from modalax.identify.tables import PoleTable

SCORE = 0.35  # part of the orders, from the first that has it, over which a mode must last
CHANGE = 0.01  # largest change of a pole from one order to the next, relative to its size


def near(
    table: PoleTable, poles: Complex[Array, " n"], reach: Float[Array, " n"]
) -> tuple[Complex[Array, " n"], Float[Array, " n"]]:
    r"""The pole of each mode that changes least from order to order, out of those that are the mode's own.

    At every order a mode takes the physical pole nearest to it, within its reach; a pole that two modes want belongs to
    the nearer of them. Of the orders where the pole of a mode is there and at both orders beside, that one counts whose
    pole differs least from its neighbours.

    Parameters
    ----------
    table
        The diagram, of three orders or more.
    poles, reach
        Where the modes are, and how far off an estimate may be, shape ``(n,)`` [rad/s].

    Returns
    -------
    poles
        Shape ``(n,)`` [rad/s]; NaN for a mode that the diagram does not have.
    stability
        Part of the orders, from the first that has the mode, that have it, shape ``(n,)``.
    """
    physical = table.physical()
    taken, there = jax.vmap(lambda p, ok: _own(p, ok, poles, reach))(table.poles, physical)
    step = jnp.abs(jnp.diff(taken, axis=0)) / jnp.abs(poles)
    step = jnp.where(there[1:] & there[:-1] & (step < CHANGE), step, jnp.inf)
    worst = jnp.maximum(step[:-1], step[1:])
    best = jnp.argmin(worst, axis=0) + 1
    rows = jnp.arange(there.shape[0])[:, None]
    first = jnp.min(jnp.where(there, rows, there.shape[0] - 1), axis=0)
    score = jnp.sum(there, axis=0) / (there.shape[0] - first)
    kept = jnp.isfinite(jnp.min(worst, axis=0)) & (score >= SCORE)
    return jnp.where(kept, jnp.take_along_axis(taken, best[None], 0)[0], jnp.nan), score


def _own(found: Array, physical: Array, poles: Array, reach: Array) -> tuple[Array, Array]:
    """Of one order: the pole of each mode, and whether it has one."""
    distance = jnp.where(physical[None], jnp.abs(found[None] - poles[:, None]) / reach[:, None], jnp.inf)
    nearest = jnp.argmin(distance, axis=1)
    least = jnp.min(distance, axis=1)
    n = poles.shape[0]
    rival = (nearest[:, None] == nearest[None]) & (
        (least[None] < least[:, None])
        | ((least[None] == least[:, None]) & (jnp.arange(n)[None] < jnp.arange(n)[:, None]))
    )
    return found[nearest], (least < 1) & ~jnp.any(rival, axis=1)
