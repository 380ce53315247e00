r"""Effect of the higher harmonics of the motion across a joint on its force at the fundamental.

:func:`~modalax.diagnose.prediction.frf.predict` balances one harmonic: the force of a joint is :math:`f_1 = N(A)\,x_1`,
:math:`A = |x_1|`. The force of a non-linear law drives other harmonics too, :math:`x_h = -H_{bb}(h\omega)\,f_h`, and
these change the force at the fundamental to :math:`f_1 = \rho\,N(A)\,x_1`. The factor :math:`\rho` and its slopes by
the joint's parameters are found by harmonic balance at the parameters of a hypothesis; the hypothesis is then fitted
again with :math:`\rho` linear in them. A few rounds of both settle. Where the other harmonics make most of the force,
as where their motion and not the fundamental's reaches a stop, the force itself is taken as linear in the parameters.

Rigid friction has no force that follows from the motion while it sticks. It is the same as a spring of any stiffness
:math:`1/c` in series with the slider, in a structure whose receptance across the joint is less by c: the displacement
of spring and slider is :math:`z = x + cf`, so :math:`x + Gf = u` becomes :math:`z + (G - c)f = u`. Sticking or
slipping, f follows from z. With :math:`c = |G|` the balance is as stiff as the structure (the idea of the dynamic
Lagrangian of Nacivet, Pierre, Thouverez and Jezequel 2003, J. Sound Vib. 265:201).
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import is_traced
from modalax._numerics.known import host
from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import CubicStiffness
from modalax.diagnose.prediction.frf import Linear, equivalent, of, without_joints
from modalax.diagnose.prediction.friction import Sliding, sliding
from modalax.diagnose.setup.problem import Problem
from modalax.simulate.aft import choose_harmonics, joint_forces
from modalax.simulate.balance import CLOSED, Line, Plan, find, motion_scale, polish, stop
from modalax.simulate.sweep import in_chunks

HIGHEST = 9  # highest harmonic kept where harmonics are asked for
NEARLY_STILL = 1e-3  # circular frequency of the receptance for the mean displacement, over that of the line
SAMPLES_A_HARMONIC = 16  # instants of a cycle at which forces are evaluated, for each harmonic kept
STAND_IN = CubicStiffness()  # of any joint
MOSTLY = 3.0  # force over that of the fundamental alone from which on it is no factor on that
STEP = 1e-2  # relative change of a parameter by which slopes are taken
TURNS = (1.0, 0.5, 0.9, 1.1, 1.5)  # motions that a balance starts from, over that of the fundamental alone
NEWTON = 20  # Newton steps from each
INSTANTS, FEWER_INSTANTS = 48, 24  # of half a cycle of dry friction, and those that show the error
MORE_INSTANTS = 96  # where friction's force is compared with one that was measured


def with_harmonics(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[Array, "two n"], problem: Problem,
    highest: Sequence[int],
) -> tuple[Any, ...]:  # fmt: skip
    """Extras with the effect of one joint's harmonics in them, differentiable by the parameters.

    Where several joints are predicted together, they stay as given.

    Parameters
    ----------
    causes, index, extras, params, theta
        As :func:`~modalax.diagnose.prediction.frf.predict` takes them; joints without the effect of harmonics.
    problem
        Frequencies, levels, channels and the simulation.
    highest
        Highest harmonic of each cause.
    """
    joints = [k for k, c in enumerate(causes) if isinstance(c, JointCause)]
    if len(joints) != 1 or highest[joints[0]] < 2:
        return tuple(extras)
    k = joints[0]
    extra = (
        _sliding_extra(causes, index, extras, *stop((params, theta, problem))) if causes[k].rigid
        else _balanced_extra(causes, index, extras, params, theta, problem, highest[k])
    )  # fmt: skip
    return (*extras[:k], extra, *extras[k + 1 :])


def _balanced_extra(causes: Any, index: Any, extras: Any, params: Any, theta: Any, problem: Any, highest: int) -> Array:
    """What a joint needs besides its parameters; its factor follows them by the implicit function theorem."""
    factor, direct = harmonic_factor(causes, index, extras, params, theta, problem, highest)
    p = next(p for c, p in zip(causes, params, strict=True) if isinstance(c, JointCause))
    no_slopes = jnp.zeros((len(p), *factor.shape), complex)
    # nothing in series, and nothing that was measured of what is predicted
    nothing = jnp.zeros((3, *factor.shape), complex)
    return jnp.concatenate([factor[None], no_slopes, direct[None] + 0j, nothing])


def _sliding_extra(causes: Any, index: Any, extras: Any, params: Any, theta: Any, problem: Any) -> Array:
    """The same of dry friction, its motion found at instants."""
    p = next(p for c, p in zip(causes, params, strict=True) if isinstance(c, JointCause))[0]
    rho, slope, series, amplitude = sliding_factor(causes, index, extras, params, theta, problem, INSTANTS)
    none = jnp.zeros(rho.shape, complex)
    return jnp.stack([rho - slope * p, slope, none, series, amplitude + 0j, none])


@partial(jax.jit, static_argnames=("causes",))
def _beside_joints(causes: Any, index: Any, extras: Any, params: Any, theta: Any, problem: Any, times: Any) -> Any:
    at = [one for one in zip(causes, index, extras, params, strict=True) if one[0].in_structure]
    return _at_harmonic(times, at, theta, problem)[:4]


def beside_joints(
    causes: Any, index: Any, extras: Any, params: Any, theta: Any, problem: Problem, times: int = 1
) -> tuple[Array, Array, Array, Array]:
    """Receptances without the joints at a multiple of every frequency; at nearly 0 Hz for the mean.

    Parameters
    ----------
    causes, index, extras, params, theta
        As :func:`~modalax.diagnose.prediction.frf.predict` takes them.
    problem
        Frequencies, channels and the simulation.
    times
        The multiple.

    Returns
    -------
    tuple
        Between channels, from the joints to the outputs, from the inputs to the joints and across the joints, shapes
        ``(run or 1, f, ...)`` [m/N].
    """
    joints = [isinstance(c, JointCause) for c in causes]  # whose laws are not asked for: one program serves all
    plain = lambda given, stand_in: tuple(stand_in if j else x for j, x in zip(joints, given, strict=True))
    parts = plain(causes, STAND_IN), index, plain(extras, None), plain(params, np.ones(1))
    return _beside_joints(*parts, theta, problem, float(times or NEARLY_STILL))


def _across(
    causes: Any, index: Any, extras: Any, params: Any, theta: Any, problem: Problem, times: int
) -> tuple[Any, Any]:  # fmt: skip
    """Receptance across the joint, ``(f,)``, and motion there, ``(f, i)``, at a multiple of every frequency."""
    _, _, motion, drive = beside_joints(causes, index, extras, params, theta, problem, times)
    return drive[0, :, 0, 0], motion[0, :, 0]


def receptance_across(cause: Any, place: Any, theta: Array, problem: Problem, times: int) -> Array:
    """Receptance across a place at a multiple of every frequency, shape ``(f,)`` [m/N]; at nearly 0 Hz for the mean.

    Parameters
    ----------
    cause
        Any joint.
    place
        Where it sits.
    theta
        Relative changes of the modal frequencies and damping ratios.
    problem
        Frequencies and the simulation.
    times
        The multiple.
    """
    return _across((cause,), np.array([place.index]), (None,), (None,), theta, problem, times)[0]


def sliding_factor(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[Array, "two n"], problem: Problem, instants: int
) -> tuple[Any, Any, Any, Any]:
    r"""Factor :math:`\rho` of a rigid joint, its slope by the slip force, compliance in series and amplitude.

    The motion is found at instants. The amplitude [m] is that of joint and compliance together, 0 where no steady
    motion was found.

    Parameters
    ----------
    causes, index, extras, params, theta, problem
        As :func:`harmonic_factor` takes them.
    instants
        Of half a cycle.
    """
    k = next(k for k, c in enumerate(causes) if isinstance(c, JointCause))
    cause, p = causes[k], params[k]
    across = (_across(causes, index, extras, params, theta, problem, h) for h in range(1, instants, 2))
    G, motion = zip(*(map(host, pair) for pair in across), strict=True)
    level, frequencies = host(problem.level), host(problem.omega)
    xp = jnp if is_traced(p, level, frequencies, *G, *motion) else np  # known numbers need no program of their shapes
    free = level[:, :, None] * motion[0]
    spread = lambda a: xp.broadcast_to(a[None, :, None], (*free.shape, *a.shape[1:])).reshape(free.size, *a.shape[1:])
    G, u, omega = spread(xp.stack(G, axis=-1)), free.ravel(), spread(frequencies)
    q, slope, sound = _slid(G, u, omega, p[0], instants)
    series, step = xp.abs(G[:, 0]), STEP * xp.where(p[0] != 0, xp.abs(p[0]), 1.0)

    def factor(further: Any) -> tuple[Any, Any]:
        force = q + further * slope
        z = u - (G[:, 0] - series) * force
        plainly = _impedance_in_series(cause, xp.abs(z), omega, p + further, series) * z
        known = sound & (xp.abs(plainly) > 0)
        return xp.where(known, force / xp.where(known, plainly, 1.0), 1.0), xp.where(known, xp.abs(z), 0.0)

    (rho, amplitude), (other, _) = factor(0.0), factor(step)
    lay = lambda a: a.reshape(free.shape)
    return lay(rho), lay((other - rho) / step), lay(series) + 0j, lay(amplitude)


@partial(jax.jit, static_argnames="cause")
def _impedance_in_series(cause: JointCause, A: Any, omega: Any, p: Any, series: Any) -> Array:
    return cause.impedance_in_series(A, omega, p, series)


def _slid(G: Any, u: Any, omega: Any, limit: Any, instants: int) -> Sliding:
    """The motion at instants, which NumPy finds, inside a traced function too."""

    def motion(G: Any, u: Any, omega: Any, limit: Any) -> Sliding:
        return sliding(np.asarray(G), np.asarray(u), np.asarray(omega), float(limit), instants)

    if not any(isinstance(a, jax.core.Tracer) for a in (G, u, omega, limit)):
        return motion(G, u, omega, limit)
    shapes = Sliding(*(jax.ShapeDtypeStruct(u.shape, kind) for kind in (complex, complex, bool)))
    return jax.pure_callback(motion, shapes, G, u, omega, limit)


@partial(jax.jit, static_argnames=("causes", "highest"))
def harmonic_factor(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[Array, "two n"], problem: Problem,
    highest: int,
) -> tuple[Complex[Array, "run f i"], Bool[Array, "run f i"]]:  # fmt: skip
    r"""Factor :math:`\rho` on the describing function of one joint that is not rigid, or its force, and where.

    The factor is 1 where the harmonic balance does not settle; where the force is ``MOSTLY`` times that of the
    fundamental alone it is the force over that at the input. It has derivatives by the parameters, by the implicit
    function theorem.

    Parameters
    ----------
    causes, index, extras, params, theta
        As :func:`~modalax.diagnose.prediction.frf.predict` takes them; one cause is a joint.
    problem
        The data and the simulation.
    highest
        Highest harmonic: the odd ones up to it where the law is odd, else all with the mean.
    """
    at = list(zip(causes, index, extras, params, strict=True))
    ((cause, _, _, p),) = of(JointCause, at)
    harmonics = choose_harmonics((cause.law(p),), highest)
    plan = Plan(1, harmonics, SAMPLES_A_HARMONIC * highest)
    linear = [_at_harmonic(h, at, theta, problem) for h in harmonics]
    one = linear[harmonics.index(1)]
    drive, motion = one.H_bb[:, :, 0, 0], one.H_bi[:, :, 0]
    shape = (problem.level.shape[0], *motion.shape[1:])
    free = problem.level[:, :, None] * motion
    first = free / (1 + equivalent(cause, p, problem.omega, drive, motion, problem.level) * drive[..., None])
    G = jnp.stack([jnp.broadcast_to(a.H_bb[:, :, :1, :1], (*shape[:2], 1, 1)) for a in linear], axis=2)

    def factor(k: Any) -> tuple[Array, Array]:
        r, f, i = jnp.unravel_index(k, shape)
        joint = cause.law(p)
        u = jnp.zeros((len(harmonics), 1), complex).at[harmonics.index(1), 0].set(free[r, f, i])
        line = Line(G[r, f], u, problem.omega[f])
        scale = motion_scale(line)
        start = jnp.zeros((1, len(harmonics)), complex).at[0, harmonics.index(1)].set(first[r, f, i])
        starts = jnp.stack([plan.real(turn * start) / scale for turn in TURNS])
        fixed, still, turned = stop(((joint,), line, starts))
        y, left = find(plan, fixed, still, turned, NEWTON)
        q = polish(plan, (joint,), line, y)[0]
        force = joint_forces((joint,), q, line.omega, harmonics, plan.samples)[0, harmonics.index(1)]
        q1 = q[0, harmonics.index(1)]
        plainly = joint.describing(jnp.abs(q1), line.omega) * q1
        direct = (left < CLOSED) & (jnp.abs(force) > MOSTLY * jnp.abs(plainly))
        sound = (left < CLOSED) & (jnp.abs(plainly) > 0) & ~direct
        rho = jnp.where(sound, force / jnp.where(sound, plainly, 1.0), 1.0)
        return jnp.where(direct, force / problem.level[r, f], rho), direct

    made = in_chunks(factor, jnp.arange(shape[0] * shape[1] * shape[2]))
    return made[0].reshape(shape), made[1].reshape(shape)


def _at_harmonic(h: Any, at: list[Any], theta: Array, problem: Problem) -> Linear:
    """Receptances at a multiple of every frequency; for the mean displacement at nearly 0 Hz."""
    times = NEARLY_STILL if isinstance(h, int) and h == 0 else h
    moved = eqx.tree_at(lambda p: p.omega, problem, times * problem.omega)
    return without_joints(1j * moved.omega, [one for one in at if one[0].in_structure], theta, moved)
