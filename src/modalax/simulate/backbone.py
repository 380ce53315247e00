r"""Frequency and damping of a mode against amplitude, by the extended periodic motion concept.

The structure is kept in steady free motion by an artificial negative damping :math:`-2\zeta\omega M`: the frequency and
the damping ratio at which the fundamental of the mode stays at a given amplitude are those of the non-linear mode.
Source: Krack (2015), Nonlinear modal analysis of nonconservative systems, Comput. Struct. 154, eq. 5-8.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import scipy.linalg
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_double
from modalax.model.receptance import directions
from modalax.model.structure import Structure
from modalax.simulate.aft import Harmonics, choose_harmonics, joint_forces
from modalax.simulate.balance import CLOSED, Plan
from modalax.simulate.joints import Joint


class Backbone(eqx.Module):
    """A non-linear mode over its amplitude.

    Attributes
    ----------
    amplitude
        Fundamental of the modal coordinate, for a mass-normalised shape, shape ``(a,)`` [m sqrt(kg)].
    frequency_hz, damping_ratio
        Of the mode at that amplitude, shape ``(a,)`` [Hz], [-].
    q
        Displacement harmonics across the joints, shape ``(a, j, h)`` [m].
    residual
        What is missing to balance, relative to the amplitude, shape ``(a,)`` [-].
    harmonics
        Which harmonics.
    """

    amplitude: Float[Array, " a"]
    frequency_hz: Float[Array, " a"]
    damping_ratio: Float[Array, " a"]
    q: Complex[Array, "a j h"]
    residual: Float[Array, " a"]
    harmonics: Harmonics = eqx.field(static=True)

    @property
    def converged(self) -> Bool[Array, " a"]:
        """Which amplitudes are solved."""
        return self.residual < CLOSED


class _Modes(NamedTuple):
    """The structure in its real modes: squares of frequencies, damping matrices, and the joints' parts."""

    square: Array
    damping: Array
    hysteretic: Array
    part: Array


def _missing(y: Float[Array, " r"], args: tuple) -> Float[Array, " r"]:
    """Balance of the joints' motion over the amplitude, and of the mode itself over its stiffness."""
    plan, mode, joints, modes, a = args
    own = modes.square[mode]
    omega, zeta = jnp.sqrt(own) * y[-2], y[-1]
    q = a * plan.complex(y[:-2])
    f = joint_forces(joints, q, omega, plan.harmonics, plan.samples)
    others = np.delete(np.arange(len(modes.square)), mode)
    rows, balance = [], jnp.zeros((), complex)
    for h, k in enumerate(plan.harmonics):
        extra = modes.damping - 2 * zeta * omega * jnp.eye(len(modes.square))
        Z = jnp.diag(modes.square - (k * omega) ** 2) + 1j * (k * omega * extra + np.sign(k) * modes.hysteretic)
        push = -(modes.part @ f[:, h])
        if k == 1:
            rest = jnp.linalg.solve(Z[jnp.ix_(others, others)], push[others] - a * Z[others, mode])
            eta = jnp.zeros(len(modes.square), complex).at[others].set(rest).at[mode].set(a)
            balance = (Z[mode] @ eta - push[mode]) / (own * a)
        else:
            eta = jnp.linalg.solve(Z, push)
        rows.append(q[:, h] - modes.part.T @ eta)
    joint_part = plan.real(jnp.stack(rows, axis=1)) / a
    return jnp.concatenate([joint_part, jnp.stack([balance.real, balance.imag])])


@eqx.filter_jit
def _follow(plan: Plan, mode: int, joints: tuple[Joint, ...], modes: _Modes, amplitudes: Array) -> tuple[Array, Array]:
    start = jnp.zeros(plan.size + 2).at[-2].set(1.0)
    start = start.at[jnp.arange(plan.joints) * len(plan.harmonics) + plan.harmonics.index(1)].set(modes.part[mode])

    def advance(y: Array, a: Array) -> tuple[Array, tuple[Array, Array]]:
        args = (plan, mode, joints, modes, a)
        solution = optx.root_find(
            _missing, optx.Dogleg(rtol=1e-12, atol=1e-14, linear_solver=lx.AutoLinearSolver(well_posed=None)), y, args,
            max_steps=60, throw=False, adjoint=optx.ImplicitAdjoint(),
        )  # fmt: skip
        y = solution.value
        return y, (y, jnp.max(jnp.abs(_missing(y, args))))

    _, (ys, left) = jax.lax.scan(advance, start, amplitudes)
    return ys, left


def backbone(
    structure: Structure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    mode: int,
    amplitudes: Any,
    *,
    harmonics: int | tuple[int, ...] = 1,
    samples: int = 128,
    modes: int | None = None,
) -> Backbone:
    """Follow one mode over rising amplitudes.

    Parameters
    ----------
    mode
        Number of the mode of the linear structure, from 1.
    amplitudes
        Fundamentals of the modal coordinate (mass-normalised shape), rising from where the joints are nearly linear,
        shape ``(a,)`` [m sqrt(kg)].
    modes
        How many modes of the structure take part; all by default.

    Raises
    ------
    ValueError
        If there is no such mode, or an amplitude is not above 0.
    """
    amplitudes = as_double(amplitudes, "amplitudes")
    if not bool(jnp.all(amplitudes > 0)):
        raise ValueError(f"amplitudes hold {float(jnp.min(amplitudes)):g}; they must be above 0")
    square, shapes = scipy.linalg.eigh(np.asarray(structure.K), np.asarray(structure.M))
    count = len(square) if modes is None else min(modes, len(square))
    if not 1 <= mode <= count:
        raise ValueError(f"mode {mode} asked for; modes are counted from 1 to {count}")
    square, shapes = square[:count], shapes[:, :count]
    kept = choose_harmonics(tuple(joints), harmonics)
    b = np.asarray(directions(structure, places))
    C, D = (shapes.T @ np.asarray(A) @ shapes for A in (structure.C, structure.D))
    taken = _Modes(jnp.asarray(square), jnp.asarray(C), jnp.asarray(D), jnp.asarray(shapes.T @ b.T))
    plan = Plan(len(joints), kept, samples)
    ys, left = _follow(plan, mode - 1, tuple(joints), taken, amplitudes)
    q = amplitudes[:, None, None] * jax.vmap(plan.complex)(ys[:, :-2])
    frequency = ys[:, -2] * np.sqrt(square[mode - 1]) / (2 * np.pi)
    return Backbone(amplitudes, frequency, ys[:, -1], q, left, kept)
