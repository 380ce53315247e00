r"""Harmonic balance on the relative coordinates of the joints, at one frequency: :math:`q + (b^T H b) f(q) = b^T H F`.

There are a few real unknowns, whatever the size of the structure. A damped Newton iteration, which tries several step
lengths and starts anew where it gets stuck, finds the solution; one more step by optimistix gives its derivatives by
the implicit function theorem.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Complex, Float

from modalax.simulate.aft import Harmonics, choose_harmonics, joint_forces, real_size, to_complex, to_real
from modalax.simulate.joints import Joint

STEPS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])
"""Step lengths of a damped Newton step: the full one, or the best of all where the full one does not reduce enough."""
CLOSED = 1e-9
"""Residual, relative to the motion without joints, below which a balance counts as solved."""
TIGHT = 1e-12
"""Residual at which the search stops; one more Newton step follows."""
FOLD = 1e-5
"""Margin below which derivatives are NaN, because rounding of the balance alone makes them wrong by 1 %."""


class Line(NamedTuple):
    """The structure as the balance at one frequency needs it.

    Attributes
    ----------
    G
        Receptance between the joints at each harmonic, shape ``(h, j, j)`` [m/N].
    u
        Motion of the joints' ends without joint forces, shape ``(h, j)`` [m].
    omega
        Circular frequency of the excitation [rad/s].
    """

    G: Complex[Array, "*batch h j j"]
    u: Complex[Array, "*batch h j"]
    omega: Float[Array, "*batch"]


class Plan(NamedTuple):
    """Orders of a balance, all static."""

    joints: int
    harmonics: Harmonics
    samples: int

    @property
    def size(self) -> int:
        """Number of real unknowns."""
        return real_size(self.joints, self.harmonics)

    def real(self, q: Complex[Array, "j h"]) -> Float[Array, " r"]:
        """Harmonics as reals."""
        return to_real(q, self.harmonics)

    def complex(self, y: Float[Array, " r"]) -> Complex[Array, "j h"]:
        """Reals as harmonics."""
        return to_complex(y, self.joints, self.harmonics)


def make_plan(
    joints: Sequence[Joint], places: Sequence[Sequence[str]], harmonics: int | tuple[int, ...], samples: int
) -> Plan:
    """Orders of a balance of ``joints``, each at its place.

    Raises
    ------
    ValueError
        If joints and places differ in number, there is no joint, or harmonics and samples do not fit.
    """
    strange = [j for j in joints if not isinstance(j, Joint)] if isinstance(joints, Sequence) else [joints]
    if strange:
        wrapped = ": write [joint]" if isinstance(strange[0], Joint) else ""
        raise ValueError(
            f"joints holds a {type(strange[0]).__name__}; it needs a list of joints of modalax.simulate.joints{wrapped}"
        )
    if len(joints) != len(places) or not joints:
        raise ValueError(
            f"{len(joints)} joints for {len(places)} places; at least one joint, and a place for each, is needed"
        )
    kept = choose_harmonics(tuple(joints), harmonics)
    if samples < 4 * max(kept) or samples % 2:
        raise ValueError(
            f"{samples} samples for harmonic {max(kept)}; an even number of at least {4 * max(kept)} is needed"
        )
    return Plan(len(joints), kept, samples)


def residual(plan: Plan, q: Complex[Array, "j h"], joints: tuple[Joint, ...], line: Line) -> Complex[Array, "j h"]:
    """Residual of the balance, ``q + G f(q) - u`` [m]."""
    f = joint_forces(joints, q, line.omega, plan.harmonics, plan.samples)
    return q + jnp.einsum("hjk,kh->jh", line.G, f) - line.u.T


def motion_scale(line: Line) -> Float[Array, "*batch"]:
    """Largest motion without joint forces [m], 1 where there is none."""
    largest = jnp.max(jnp.abs(line.u), axis=(-2, -1))
    return jnp.where(largest > 0, largest, 1.0)


def _scaled(y: Float[Array, " r"], args: tuple[Plan, tuple[Joint, ...], Line, Array]) -> Float[Array, " r"]:
    """The residual as reals, over the scale of the motion."""
    plan, joints, line, scale = args
    return plan.real(residual(plan, scale * plan.complex(y), joints, line)) / scale


def left_over(plan: Plan, joints: tuple[Joint, ...], line: Line, y: Float[Array, " r"]) -> Float[Array, ""]:
    """Largest part of the residual at ``y`` (scaled reals), over the motion without joints."""
    left = jnp.max(jnp.abs(_scaled(y, (plan, joints, line, motion_scale(line)))))
    return jnp.where(jnp.isfinite(left), left, jnp.inf)


class _Search(NamedTuple):
    """State of a search: where it is, its start, steps since, and the best so far."""

    y: Array
    start: Array
    count: Array
    best: Array
    left: Array


def find(
    plan: Plan, joints: tuple[Joint, ...], line: Line, starts: Float[Array, "s r"], limit: int = 25
) -> tuple[Float[Array, " r"], Float[Array, ""]]:
    """Damped Newton iteration from each start (scaled reals) in turn until one leads to a solution.

    Returns where it ends and the residual left there. Not differentiated: see :func:`polish`, whose one step is all
    that a first start needs which is solved already.
    """
    args = (plan, joints, line, motion_scale(line))

    def both(y: Float[Array, " r"]) -> tuple[Array, Array]:
        missing = _scaled(y, args)
        return missing, missing

    def go_on(s: _Search) -> Bool[Array, ""]:
        fresh = (s.start == 0) & (s.count == 0)
        return (s.left > jnp.where(fresh, CLOSED, TIGHT)) & (s.start < len(starts))

    def improve(s: _Search) -> _Search:
        jacobian, missing = jax.jacfwd(both, has_aux=True)(s.y)
        before, step = jnp.max(jnp.abs(missing)), jnp.linalg.solve(jacobian, missing)

        def unhappy(t: tuple[Array, Array]) -> Bool[Array, ""]:
            # the full step where it serves nearly as well, so that the end is quadratic
            return (t[0] == 0) | (t[0] < len(STEPS)) & ~(t[1][0] < 0.5 * before)

        def attempt(t: tuple[Array, Array]) -> tuple[Array, Array]:
            k, sizes = t
            return k + 1, sizes.at[k].set(left_over(plan, joints, line, s.y - jnp.asarray(STEPS)[k] * step))

        _, sizes = jax.lax.while_loop(unhappy, attempt, (zero, jnp.full(len(STEPS), jnp.inf)))
        choice = jnp.argmin(sizes)
        after, tried = sizes[choice], s.y - jnp.asarray(STEPS)[choice] * step
        record = after < s.left
        best, left = jnp.where(record, tried, s.best), jnp.where(record, after, s.left)
        over = ~(after < before) | (s.count >= limit)
        # a search that cannot go on below the rounding of the residual is at its end, not stuck
        start = jnp.where(over, jnp.where(left < CLOSED, len(starts), s.start + 1), s.start)
        y = jnp.where(over, starts[jnp.minimum(start, len(starts) - 1)], tried)
        return _Search(y, start, jnp.where(over, 0, s.count + 1), best, left)

    zero, first = jnp.zeros((), int), left_over(plan, joints, line, starts[0])
    end = jax.lax.while_loop(go_on, improve, _Search(starts[0], zero, zero, starts[0], first))
    return end.best, end.left


class _OneStep(optx.AbstractRootFinder):
    r"""A single Newton step with the Jacobian column by column: a third of what a linearised function costs here.

    Its state is the margin of the balance, :math:`1/\|J^{-1}\|`, and the largest part of the residual before the step.
    """

    rtol: float = 0.0
    atol: float = 0.0
    norm: Any = optx.max_norm

    def init(self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> Any:
        return jnp.array(jnp.inf), jnp.array(jnp.inf)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Array, Any, Any]:
        def both(y: Array) -> tuple[Array, tuple[Array, Any]]:
            missing, aux = fn(y, args)
            return missing, (missing, aux)

        jacobian, (missing, aux) = jax.jacfwd(both, has_aux=True)(y)
        inverse = jnp.linalg.inv(jacobian)
        margin = 1 / jnp.max(jnp.sum(jnp.abs(inverse), axis=1))
        return y - inverse @ missing, (margin, jnp.max(jnp.abs(missing))), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Array, Any]:
        return jnp.isfinite(state[0]), optx.RESULTS.successful

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        return y, aux, {}


def _without_derivative(value: Array, given: Any, where: Array) -> Array:
    """Return the numbers unchanged, but with derivatives by ``given`` that are NaN at the points in ``where``."""
    leaves = [leaf for leaf in jax.tree.leaves(given) if jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)]
    of = jnp.sum(jnp.stack([jnp.sum(leaf.real) + jnp.sum(leaf.imag) for leaf in leaves]))
    # the root of 0 has an infinite slope, and zero times it is NaN; its value is 0, and so is its slope elsewhere
    nothing = 0.0 * jnp.sqrt(jnp.where(where, of - jax.lax.stop_gradient(of), 1.0))
    return jnp.where(where, jax.lax.stop_gradient(value), value) + nothing


def polish(
    plan: Plan, joints: tuple[Joint, ...], line: Line, y: Float[Array, " r"]
) -> tuple[Complex[Array, "j h"], Float[Array, ""], Float[Array, ""]]:
    """One Newton step from a solution, differentiable in joints, receptance and excitation by the implicit function.

    Returns the joints' displacement harmonics [m], the residual left, over the motion without joints, and the margin:
    how much the balance changes, at least, with a unit of motion. It is 0 at a fold, where the motion has no
    derivative; below ``FOLD`` derivatives are NaN.
    """
    scale = jax.lax.stop_gradient(motion_scale(line))
    args = (plan, joints, line, scale)
    y = jax.lax.stop_gradient(y)
    solution = optx.root_find(
        _scaled, _OneStep(), y, args, max_steps=1, throw=False, adjoint=optx.ImplicitAdjoint(linear_solver=lx.LU())
    )
    # where nothing was found an undamped step may lead anywhere; the best point found is kept there
    margin, before = jax.lax.stop_gradient(solution.state)
    margin = jnp.where(jnp.isfinite(margin), margin, 0.0)
    value = jnp.where(before < CLOSED, solution.value, y)
    value = _without_derivative(value, (joints, line), margin < FOLD)
    left = jnp.minimum(before, jnp.max(jnp.abs(_scaled(solution.value, args))))
    return scale * plan.complex(value), jax.lax.stop_gradient(left), margin


def stop(tree: Any) -> Any:
    """Return the numbers unchanged, with all derivatives zero."""
    return jax.tree.map(jax.lax.stop_gradient, tree)
