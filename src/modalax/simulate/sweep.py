"""Many lines and levels: a quick sweep with few harmonics picks the branch, then all lines are balanced at once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from modalax.simulate.aft import Harmonics, has_closed_form
from modalax.simulate.balance import CLOSED, Line, Plan, find, left_over, motion_scale, polish, stop
from modalax.simulate.joints import Joint

LOAD_STEPS = 12
"""Steps in which the force is raised to its level on the first line of a sweep."""
SWEEP_SAMPLES = 64  # instants of a cycle in the quick sweep, at most
TURNS = np.array([1.0, 0.3, -0.3, 0.05, -1.0, 1j, -1j, -2.0, 0.0])
"""Starting points of a repeated search, relative to the motion without joints."""
AMPLITUDES = np.geomspace(1e-5, 1e3, 129)
CHUNK = 64
"""Number of lines balanced together: few enough that easy lines do not wait for hard ones and the cache suffices."""


def few(plan: Plan, joints: tuple[Joint, ...]) -> Plan:
    """Cheapest balance that shows which branch a line is on: the fundamental, and the mean where a law is not odd."""
    mean = (0,) if 0 in plan.harmonics and not all(joint.odd for joint in joints) else ()
    return Plan(plan.joints, (*mean, 1), min(plan.samples, SWEEP_SAMPLES))


def _pick(line: Line, have: Harmonics, want: Harmonics) -> Line:
    at = jnp.array([have.index(k) for k in want])
    return Line(line.G[..., at, :, :], line.u[..., at, :], line.omega)


def _pad(q: Complex[Array, "j h"], have: Harmonics, want: Harmonics) -> Complex[Array, "j h2"]:
    return jnp.zeros((q.shape[0], len(want)), complex).at[:, jnp.array([want.index(k) for k in have])].set(q)


def amplitude_roots(joint: Joint, line: Line) -> Complex[Array, " 2"]:
    r"""Smallest and largest motion that one joint allows, roots of :math:`A\,|1 + G N(A)| = |u|` on a grid of A [m]."""
    G, u = line.G[0, 0, 0], line.u[0, 0]
    A = AMPLITUDES * motion_scale(line)
    mismatch = jnp.log(jnp.abs(1 + G * joint.describing(A, line.omega)) * A) - jnp.log(jnp.maximum(jnp.abs(u), 1e-300))
    crossing = mismatch[:-1] * mismatch[1:] <= 0
    share = mismatch[:-1] / jnp.where(crossing, mismatch[:-1] - mismatch[1:], 1.0)
    root = jnp.exp(jnp.log(A[:-1]) + jnp.where(crossing, share, 0.0) * np.log(AMPLITUDES[1] / AMPLITUDES[0]))
    ends = jnp.stack([root[jnp.argmax(crossing)], root[-1 - jnp.argmax(crossing[::-1])]])
    return u / (1 + G * joint.describing(ends, line.omega))


def branch(plan: Plan, joints: tuple[Joint, ...], lines: Line) -> Float[Array, "f r"]:
    """Solutions (scaled reals) of a sweep through ``lines`` in their order, each started from the one before.

    The force is raised to its level on the first line. Where the branch ends, at a fold, the search starts anew from
    the motion without joints, from smaller ones and from rest: the jump.
    """
    share = jnp.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:]
    raised = jax.tree.map(lambda a: jnp.broadcast_to(a[0], (LOAD_STEPS, *a.shape[1:])), lines)
    raised = raised._replace(u=share[:, None, None] * raised.u)
    way = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), raised, lines)

    def advance(q: Complex[Array, "j h"], line: Line) -> tuple[Complex[Array, "j h"], Array]:
        scale = motion_scale(line)
        anew = jnp.asarray(TURNS)[:, None, None] * line.u.T / scale
        if plan.joints == 1 and plan.harmonics == (1,) and has_closed_form(joints[0]):
            anew = jnp.concatenate([amplitude_roots(joints[0], line)[:, None, None] / scale, anew])
        starts = jnp.concatenate([plan.real(q)[None] / scale, jax.vmap(plan.real)(anew)])
        y, _ = find(plan, joints, line, starts)
        return scale * plan.complex(y), y

    _, ys = jax.lax.scan(advance, raised.u[0].T, way)
    return ys[LOAD_STEPS:]


def in_chunks(solve: Callable[[Array], Any], lanes: Int[Array, " n"]) -> Any:
    """``solve`` for every lane by its number, ``CHUNK`` at a time; the last lane fills the last chunk."""
    count = lanes.shape[0]
    size = min(CHUNK, count)
    chunks = -(-count // size)
    at = lanes[jnp.minimum(jnp.arange(chunks * size), count - 1)].reshape(chunks, size)
    made = jax.lax.map(jax.vmap(solve), at)
    return jax.tree.map(lambda a: a.reshape(chunks * size, *a.shape[2:])[:count], made)


def solve_lines(
    plan: Plan, joints: tuple[Joint, ...], lines: Line, downward: Bool[Array, ""] | bool = False
) -> tuple[Complex[Array, "s f j h"], Float[Array, "s f"], Float[Array, "s f"]]:
    """Balance of every line of every sweep on the branch of an upward (or downward) sweep; differentiable.

    ``lines.u`` has a leading axis of sweeps (levels and inputs). Returns displacement harmonics of the joints [m], the
    residual left, over the motion without joints, and the margin.
    """
    cheap = few(plan, joints)
    own, given = stop((joints, lines))
    turn = lambda a: jnp.where(downward, a[::-1], a)

    def swept(u: Complex[Array, "f h j"]) -> Float[Array, "f r"]:
        few_harmonics = _pick(given._replace(u=u), plan.harmonics, cheap.harmonics)
        return turn(branch(cheap, own, jax.tree.map(turn, few_harmonics)))

    coarse = jax.vmap(swept)(given.u)
    sweeps, f = coarse.shape[:2]
    coarse = coarse.reshape(sweeps * f, -1)

    def line(of: Line, k: Int[Array, ""]) -> Line:
        return Line(of.G[k % f], of.u.reshape(sweeps * f, *of.u.shape[2:])[k], of.omega[k % f])

    def whole(k: Int[Array, ""]) -> Float[Array, " r"]:
        return plan.real(_pad(cheap.complex(coarse[k]), cheap.harmonics, plan.harmonics))

    def finish(k: Int[Array, ""]) -> Float[Array, " r"]:
        return find(plan, own, line(given, k), whole(k)[None] * jnp.array([1.0, 0.9, 1.1])[:, None])[0]

    lanes, ends = jnp.arange(sweeps * f), coarse
    if plan != cheap:
        # lines of like difficulty together, so that a chunk of easy ones is done at once
        order = jnp.argsort(in_chunks(lambda k: left_over(plan, own, line(given, k), whole(k)), lanes))
        ends = jnp.zeros((sweeps * f, plan.size)).at[order].set(in_chunks(finish, order))
    made = in_chunks(lambda k: polish(plan, joints, line(lines, k), ends[k]), lanes)
    return jax.tree.map(lambda a: a.reshape(sweeps, f, *a.shape[1:]), made)


def solved(left: Float[Array, "..."]) -> Bool[Array, "..."]:
    """Whether each balance is solved."""
    return left < CLOSED
