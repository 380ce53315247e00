r"""Effect of the higher harmonics of the motion across a joint on its force at the fundamental.

:func:`~modalax.diagnose.prediction.frf.predict` balances one harmonic: the force of a joint is :math:`f_1 = N(A)\,x_1`,
:math:`A = |x_1|`. The force of a non-linear law drives other harmonics too, :math:`x_h = -H_{bb}(h\omega)\,f_h`, and
these change the force at the fundamental to :math:`f_1 = \rho\,N(A)\,x_1`. The factor :math:`\rho` and its slopes by
the joint's parameters are found by harmonic balance at the parameters of a hypothesis; the hypothesis is then fitted
again with :math:`\rho` linear in them. A few rounds of both settle.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.prediction.frf import Linear, equivalent, of, without_joints
from modalax.diagnose.setup.problem import Problem
from modalax.simulate.aft import choose_harmonics, joint_forces
from modalax.simulate.balance import CLOSED, Line, Plan, find, motion_scale
from modalax.simulate.sweep import in_chunks

NEARLY_STILL = 1e-3  # circular frequency of the receptance for the mean displacement, over that of the line
SAMPLES_A_HARMONIC = 16  # instants of a cycle at which forces are evaluated, for each harmonic kept
STEP = 1e-2  # relative change of a parameter by which slopes are taken
NEWTON = 12  # Newton steps of a balance


def linear_factor(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[Array, "two n"], problem: Problem,
    highest: int, kept: int | None = None,
) -> Complex[np.ndarray, "one_p run f i"]:  # fmt: skip
    r"""Factor :math:`\rho` as :func:`~modalax.diagnose.prediction.frf.factor_at` takes it, about ``params``.

    Slopes are given for a cause some of whose parameters one harmonic does not show; of any other they are 0, as the
    describing function follows its parameters already, and dry friction has none where it sticks.

    Parameters are those of :func:`harmonic_factor`.
    """

    def at(p: Any) -> np.ndarray:
        moved = tuple(p if j == k else q for j, q in enumerate(params))
        return np.asarray(harmonic_factor(causes, index, extras, moved, theta, problem, highest, kept or highest))

    k = next(k for k, c in enumerate(causes) if isinstance(c, JointCause))
    p = np.asarray(params[k], float)
    middle = at(jnp.asarray(p))
    slopes = []
    for j in range(len(p)):
        if not causes[k].unseen:
            slopes.append(np.zeros_like(middle))
            continue
        step = STEP * (abs(p[j]) or 1.0)
        slopes.append((at(jnp.asarray(p + step * np.eye(len(p))[j])) - middle) / step)
    return np.stack([middle - sum(s * v for s, v in zip(slopes, p, strict=True)), *slopes])


@partial(jax.jit, static_argnames=("causes", "highest"))
def harmonic_factor(
    causes: Any, index: Any, extras: Any, params: Any, theta: Float[Array, "two n"], problem: Problem,
    highest: int, kept: Any,
) -> Complex[Array, "run f i"]:  # fmt: skip
    r"""Factor :math:`\rho` on the describing function of one joint, shape ``(run, f, i)``.

    It is 1 where the harmonic balance does not settle.

    Parameters
    ----------
    causes, index, extras, params, theta
        As :func:`~modalax.diagnose.prediction.frf.predict` takes them; one cause is a joint.
    problem
        The data and the simulation.
    highest
        Highest harmonic: the odd ones up to it where the law is odd, else all with the mean.
    kept
        Highest harmonic of which the structure is let move; one program serves all.
    """
    at = list(zip(causes, index, extras, params, strict=True))
    ((cause, _, _, p),) = of(JointCause, at)
    joint = cause.law(p)
    harmonics = choose_harmonics((joint,), highest)
    plan = Plan(1, harmonics, SAMPLES_A_HARMONIC * highest)
    linear = [_at_harmonic(h, at, theta, problem) for h in harmonics]
    one = linear[harmonics.index(1)]
    drive, motion = one.H_bb[:, :, 0, 0], one.H_bi[:, :, 0]
    shape = (problem.level.shape[0], *motion.shape[1:])
    free = problem.level[:, :, None] * motion
    first = free / (1 + equivalent(cause, p, problem.omega, drive, motion, problem.level) * drive[..., None])
    G = jnp.stack([jnp.broadcast_to(a.H_bb[:, :, :1, :1], (*shape[:2], 1, 1)) for a in linear], axis=2)
    G = jnp.where((jnp.array(harmonics) <= kept)[:, None, None], G, 0.0)

    def factor(k: Any) -> Array:
        r, f, i = jnp.unravel_index(k, shape)
        u = jnp.zeros((len(harmonics), 1), complex).at[harmonics.index(1), 0].set(free[r, f, i])
        line = Line(G[r, f], u, problem.omega[f])
        scale = motion_scale(line)
        start = jnp.zeros((1, len(harmonics)), complex).at[0, harmonics.index(1)].set(first[r, f, i])
        y, left = find(plan, (joint,), line, plan.real(start)[None] / scale, NEWTON)
        q = scale * plan.complex(y)
        force = joint_forces((joint,), q, line.omega, harmonics, plan.samples)[0, harmonics.index(1)]
        q1 = q[0, harmonics.index(1)]
        plain = joint.describing(jnp.abs(q1), line.omega) * q1
        sound = (left < CLOSED) & (jnp.abs(plain) > 0)
        return jnp.where(sound, force / jnp.where(sound, plain, 1.0), 1.0)

    return in_chunks(factor, jnp.arange(shape[0] * shape[1] * shape[2])).reshape(shape)


def _at_harmonic(h: int, at: list[Any], theta: Array, problem: Problem) -> Linear:
    """Receptances at a multiple of every frequency; for the mean displacement at nearly 0 Hz."""
    times = h if h else NEARLY_STILL
    moved = eqx.tree_at(lambda p: p.omega, problem, times * problem.omega)
    return without_joints(1j * moved.omega, [one for one in at if one[0].in_structure], theta, moved)
