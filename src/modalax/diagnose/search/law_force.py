r"""Force of a law at one place, line by line, by harmonic balance across the place.

The motion :math:`x_h + H_{bb}(h\omega)\,f_h(x) = u_h` is sought from the one that was measured, which tells several
steady motions apart, and its slopes by the parameters follow from the same equations (the implicit function theorem).
Whatever structure, lines and outputs are, the programs have the same shapes.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import ElementCause, JointCause, LocalCause
from modalax.diagnose.causes.joints import CubicStiffness
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.prediction.friction import sliding
from modalax.diagnose.prediction.harmonics import (
    FEWER_INSTANTS,
    HIGHEST,
    INSTANTS,
    SAMPLES_A_HARMONIC,
    receptance_across,
)
from modalax.diagnose.search.measured_force import MeasuredForce
from modalax.simulate.aft import choose_harmonics, joint_forces
from modalax.simulate.balance import Line, Plan, find, motion_scale, stop
from modalax.simulate.joints import Hysteretic

TOGETHER = 64  # motions that are balanced at once
NEWTON = 20  # steps of a balance
BALANCED = 1e-6  # residual, over the motion without the force, below which a balance is as good as any measurement
FEWER = 5  # highest harmonic of a second balance, which shows the error of truncation
STEP = 1e-3  # relative change of a parameter by which slopes of friction and of linear elements are taken


@dataclass(frozen=True)
class Seen:
    """The force at one place and what a law needs to be compared with it; one entry a line, run and input, ``(n,)``.

    Attributes
    ----------
    force
        As measured [N].
    precision
        Inverse standard deviation of its parts, times the root of 2 [1/N]; 0 where nothing was measured.
    motion
        Displacement across the place as measured [m].
    free
        The same without any force there [m].
    receptance
        Across the place at harmonics 0 to the highest, shape ``(n, h)`` [m/N].
    omega
        Circular frequency [rad/s].
    level
        Force at the input [N].
    left
        Chi-square that the measured force leaves.
    samples
        Number of real samples of the measurement.
    """

    force: np.ndarray
    precision: np.ndarray
    motion: np.ndarray
    free: np.ndarray
    receptance: np.ndarray
    omega: np.ndarray
    level: np.ndarray
    left: float
    samples: int


def seen_at(comparison: Comparison, force: MeasuredForce) -> Seen:
    """Lay out what was measured at a place line by line.

    Parameters
    ----------
    comparison
        Data and simulation.
    force
        The force that was measured at the place.
    """
    problem = comparison.problem
    shape, lines = force.motion.shape, problem.lines
    theta = as_array(np.asarray(force.theta) * comparison.nuisance.spread)
    orders = range(INSTANTS)
    across = [np.asarray(receptance_across(CubicStiffness(), force.place, theta, problem, h)) for h in orders]
    G = np.stack([a[:lines] for a in across], axis=-1)
    spread = lambda a: np.broadcast_to(a[None, :, None], (*shape, *a.shape[1:])).reshape(-1, *a.shape[1:])
    motion, q = force.motion.ravel(), (force.impedance * force.motion).ravel()
    level, G = np.broadcast_to(np.asarray(problem.level)[:, :lines, None], shape).ravel(), spread(G)
    return Seen(
        q, force.weight.ravel() / np.maximum(np.abs(motion), 1e-300), motion, motion + G[:, 1] * q, G,
        spread(comparison.scene.omega), level, force.chi2 - 2 * motion.size, problem.samples,
    )  # fmt: skip


class Described(eqx.Module):
    """A joint of which only the describing function counts."""

    cause: Any = eqx.field(static=True)
    p: Any
    odd = True

    def describing(self, A: Any, omega: Any) -> Any:
        """Impedance at amplitude ``A``."""
        return self.cause.impedance(A, omega, self.p)


def has_law(cause: ElementCause) -> bool:
    """Whether harmonics are balanced: there is a force law in time, and no more than one slider to follow."""
    if not isinstance(cause, JointCause) or type(cause).law is JointCause.law:
        return False
    law = cause.law(jnp.ones(len(cause.parameters)))
    return not isinstance(law, Hysteretic) or sum(jnp.size(a) for a in jax.tree.leaves(law.initial_state())) == 1


def _joint(cause: Any, p: Any) -> Any:
    return cause.law(p) if has_law(cause) else Described(cause, p)


@partial(jax.jit, static_argnames=("cause", "harmonics"))
def _balanced(cause: Any, p: Any, G: Any, free: Any, omega: Any, start: Any, harmonics: Any) -> tuple[Any, ...]:
    """Force at the fundamental, its slopes, the motion and the residual of the balance, of motions side by side."""
    at, plan = harmonics.index(1), Plan(1, harmonics, SAMPLES_A_HARMONIC * HIGHEST)

    def one(G: Any, free: Any, omega: Any, start: Any) -> tuple[Any, ...]:
        u = jnp.zeros((len(harmonics), 1), complex).at[at, 0].set(free)
        line = Line(G[:, None, None], u, omega)
        scale, n = motion_scale(line), plan.size
        alone = jnp.zeros_like(start).at[at].set(start[at])
        starts = jnp.stack([plan.real(s[None]) / scale for s in (start, alone, u[:, 0])])
        y, left = find(plan, stop((_joint(cause, p),)), line, starts, NEWTON)

        def both(v: Any) -> Any:
            q = scale * plan.complex(v[:n])
            f = joint_forces((_joint(cause, v[n:]),), q, omega, harmonics, plan.samples)
            missing = plan.real(q + G * f - u.T) / scale
            return jnp.concatenate([missing, f[0, at].real[None], f[0, at].imag[None]])

        v = jnp.concatenate([y, p])
        value, J = both(v), jax.jacfwd(both)(v)
        inner = jnp.linalg.solve(J[:n, :n], jnp.concatenate([value[:n, None], J[:n, n:]], axis=1))
        told = jnp.concatenate([value[n:, None], J[n:, n:]], axis=1) - J[n:, :n] @ inner  # one more Newton step in it
        told = told[0] + 1j * told[1]
        return told[0], told[1:], (scale * plan.complex(y))[0], left

    return jax.vmap(one)(G, free, omega, start)


def force_of(
    cause: ElementCause, p: np.ndarray, seen: Seen, near: np.ndarray | None = None, fewer: bool = False
) -> tuple[np.ndarray, ...]:
    """A law's force [N], its slopes by the parameters, whether a motion was found, and that motion.

    Parameters
    ----------
    cause, p
        The law and its parameters.
    seen
        What was measured.
    near
        Motions from which the balance begins, shape ``(n, h)``; the measured ones if None.
    fewer
        Whether fewer harmonics are balanced, which shows how much those left out may do.

    Returns
    -------
    tuple
        Shapes ``(n,)``, ``(parameter, n)``, ``(n,)`` and ``(n, h)``.
    """
    if isinstance(cause, JointCause) and cause.rigid:
        return (*_sliding(p, seen, FEWER_INSTANTS if fewer else INSTANTS), np.zeros((len(seen.force), 1), complex))
    if isinstance(cause, LocalCause):
        return (*_linear(cause, p, seen), np.zeros((len(seen.force), 1), complex))
    highest = FEWER if fewer else HIGHEST
    harmonics = choose_harmonics((cause.law(as_array(p)),), highest) if has_law(cause) else (1,)
    if near is None:
        near = np.zeros((len(seen.force), len(harmonics)), complex)
        near[:, harmonics.index(1)] = seen.motion
    count = len(seen.force)
    order = np.resize(np.arange(count), -(-count // TOGETHER) * TOGETHER)
    G = seen.receptance[:, list(harmonics)]
    made = [
        _balanced(cause, as_array(p), G[k], seen.free[k], seen.omega[k], near[k], harmonics)
        for k in order.reshape(-1, TOGETHER)
    ]
    force, slopes, motion, left = (np.concatenate([np.asarray(m[j]) for m in made])[:count] for j in range(4))
    sound = (left < BALANCED) & np.isfinite(force) & np.isfinite(slopes).all(axis=1)
    return force, slopes.T, sound, motion


def _linear(cause: LocalCause, p: np.ndarray, seen: Seen) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of a linear element, with differences for the slopes."""
    G, s = seen.receptance[:, 1], as_array(1j * seen.omega)

    def force(p: np.ndarray) -> np.ndarray:
        Z = np.asarray(cause.impedance(s, as_array(p)))
        return Z / (1 + G * Z) * seen.free

    with np.errstate(all="ignore"):
        here = force(p)
        steps = [STEP * max(abs(float(v)), 1e-300) * row for v, row in zip(p, np.eye(len(p)), strict=True)]
        slopes = np.stack([(force(p + step) - here) / step.sum() for step in steps])
    return here, slopes, np.isfinite(here) & np.isfinite(slopes).all(axis=0)


def _sliding(p: np.ndarray, seen: Seen, instants: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of dry friction, with a difference for the slope."""
    G, step = seen.receptance[:, 1::2], STEP * max(abs(float(p[0])), 1e-300)
    here, there = (sliding(G, seen.free, seen.omega, float(p[0]) + d, instants) for d in (0.0, step))
    return here.force, ((there.force - here.force) / step)[None], here.sound & there.sound
