r"""FRFs predicted by a simulation with causes added.

Stages follow the way of the signal: the modes, what a finite record or a sweep makes of them, local linear elements,
one non-linear joint, and the channels. Everything is written on the receptance, so that any causes can be combined.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.compiler import lightly
from modalax.diagnose.causes.base import (
    ChannelCause,
    CouplingCause,
    HystereticCause,
    JointCause,
    KernelCause,
    LocalCause,
    ModesCause,
    UndampedCause,
    WindowCause,
)
from modalax.diagnose.causes.signals import Channels, ModalTerms
from modalax.diagnose.prediction.amplitude import TINY, amplitude
from modalax.diagnose.setup.problem import Problem

NOWHERE = np.zeros((0, 3), np.int64)  # places of no cause


@eqx.filter_jit
def predict(
    causes: Sequence[Any], index: Any, extras: Sequence[Any], params: Sequence[Any],
    theta: Float[Array, "two n"], problem: Problem,
) -> Complex[Array, "run f o i"]:  # fmt: skip
    """Receptances with causes in place; the run axis has length 1 where no cause depends on the run.

    Parameters
    ----------
    index
        Place of each cause, whole numbers, shape ``(cause, 3)``.
    extras
        Further data of each cause (a pattern over channels, what higher harmonics do to a joint's force), or None.
    params
        Parameters of each cause.
    theta
        Relative changes of the modal frequencies and damping ratios (logarithms).
    """
    return predict_with_channels(causes, index, extras, params, theta, problem)[0]


_compiled = jax.jit(predict, static_argnums=0, compiler_options=lightly(0))  # which runs once or twice


def predicted(
    causes: Sequence[Any], index: Any, extras: Sequence[Any], params: Sequence[Any], theta: Any, problem: Problem
) -> np.ndarray:
    """As :func:`predict`, of known numbers: one program for all values of a hypothesis of some causes."""
    return np.asarray(_compiled(causes, index, extras, params, theta, problem))


def predict_with_channels(
    causes: Sequence[Any], index: Any, extras: Sequence[Any], params: Sequence[Any], theta: Array, problem: Problem
) -> tuple[Complex[Array, "run f o i"], Channels]:
    """As :func:`predict`, and what a further fault of a channel may look at: it acts on these receptances."""
    at = list(zip(causes, index, extras, params, strict=True))
    if problem.held is not None:
        held = problem.held
        at = list(zip(held.causes, held.index, held.extras, held.params, strict=True)) + at
        theta = theta + held.theta
    s = 1j * problem.omega + sum(cause.shift(p) for cause, _, _, p in of(WindowCause, at))
    without = without_joints(s, at, theta, problem)
    H, channels = _with_joints(without, of(JointCause, at), problem), without.channels
    if of(WindowCause, at):  # the window was on what was measured, not on displacements
        H = H * ((s / s.imag / 1j) ** problem.order)[:, None, None]
    for cause, where, extra, p in of(ChannelCause, at):
        H = cause.channels(H, channels, where, extra, p)
    return H, channels


def of(stage: Any, at: list[Any]) -> list[Any]:
    """The causes that act at one of some stages, each with its place, extra and parameters."""
    return [one for one in at if isinstance(one[0], stage)]


def _shapes(problem: Any) -> tuple[Any, Any]:
    return problem.modal_form.shapes, problem.modal_form.participation


def gains_of(
    s: Array, modes: ModalTerms, poles: Array, kernels: list[Any], mixing: bool, order: int = 0
) -> Complex[Array, "run f m"]:
    r"""Gains of the modes and of their conjugates, shape ``(run, f, m)``.

    A kernel :math:`\kappa(x)` in place of :math:`1/x` acts on the response that was measured, the n-th derivative of
    the displacement, so :math:`1/x` becomes :math:`1/x + (\lambda/s)^n(\kappa(x) - 1/x)`, :math:`x = s - \lambda`: what
    answers at once, the direct part of an accelerance, no window alters.

    Parameters
    ----------
    s
        Laplace variable of each line [rad/s].
    modes
        Coefficients of the modal equations.
    poles
        Poles to which the residues belong.
    kernels
        What a record or a sweep makes of each decay: causes with place and parameters, of which the first counts.
    mixing
        Whether complex modes follow the undamped ones, so that residues belong to the poles as they are.
    order
        Derivatives of the displacement that were measured.
    """
    s = s[None, :, None]
    D = s**2 + modes.c[:, None] * s + modes.k[:, None] + 1j * modes.h[:, None]
    if not kernels and not mixing:
        return jnp.concatenate([(s - poles.conj()) / D, (s - poles) / D], axis=-1)
    root = jnp.sqrt(modes.k[:, None] - 0.25 * modes.c[:, None] ** 2 + 0j)
    moved = -0.5 * modes.c[:, None] + 1j * root
    ratio = poles.imag / jnp.where(jnp.abs(root) > 0, root, 1.0)
    ratio = jnp.where(jnp.abs(poles.imag) > 0, ratio, 1.0)
    if not kernels:
        return jnp.concatenate([ratio * (s - moved + 2j * root) / D, ratio * (s - moved) / D], axis=-1)
    cause, where, p = kernels[0]

    def through(pole: Array) -> Array:
        plain = 1 / (s - pole)
        return ratio * (plain + (pole / s) ** order * (cause.kernel(s - pole, where, p) - plain))

    return jnp.concatenate([through(moved), through(moved.conj())], axis=-1)


class Linear(NamedTuple):
    """Receptances with all but the joints in place; ``b`` stands for the displacements across the joints.

    Attributes
    ----------
    H
        From inputs to outputs, shape ``(run or 1, f, o, i)`` [m/N].
    H_ob, H_bi, H_bb
        From joints to outputs, inputs to joints, and joints to joints.
    channels
        What the causes of stage 7 may look at.
    """

    H: Array
    H_ob: Array
    H_bi: Array
    H_bb: Array
    channels: Channels


def without_joints(s: Array, at: list[Any], theta: Array, problem: Problem) -> Linear:
    """Receptances with all but the joints in place.

    Parameters
    ----------
    s
        Laplace variable of each line [rad/s].
    at
        Causes, each with its place, extra and parameters.
    theta
        Relative changes of the modal frequencies and damping ratios (logarithms).
    problem
        The data and the simulation.
    """
    modal_form = problem.modal_form
    theta = theta + sum(cause.undamped(theta, where, p) for cause, where, _, p in of(UndampedCause, at))
    k, c, shapes, participation = modal_form.adapted(theta)
    follow, kept = (
        modal_form.mixing is not None,
        [cause.viscous(p) for cause, _, _, p in of(HystereticCause, at)],
    )
    if kept and modal_form.uncoupled is not None:
        k, c, shapes, participation = modal_form.uncoupled.at(math.prod(kept), k, c, shapes, participation)
        follow = True
    modes = ModalTerms(k[None], c[None], modal_form.hysteresis[None])
    for cause, where, _, p in of(ModesCause, at):
        modes = cause.modes(modes, where, p, problem.level.shape[0])
    kernels = [(c, w, p) for c, w, _, p in of(KernelCause, at)]
    gains = gains_of(s, modes, modal_form.poles, kernels, follow, problem.order)
    return _assemble(s, gains, at, eqx.tree_at(_shapes, problem, (shapes, participation)))


def _assemble(s: Array, gains: Array, at: list[Any], problem: Problem) -> Linear:
    """Receptances between channels and joints with local elements in place."""
    modal_form = problem.modal_form
    psi = jnp.concatenate([modal_form.shapes, modal_form.shapes.conj()])
    part = jnp.concatenate([modal_form.participation, modal_form.participation.conj()])
    far = (lambda o, i: modal_form.upper[o][:, i] - 0j, lambda o, i: modal_form.lower[o][:, i])

    def between(left: Array, right: Array) -> Array:
        return jnp.einsum("rfm,mx,my->rfxy", gains, left, right)

    def at_itself(d: Array) -> Array:
        modal = jnp.einsum("fm,md->fd", gains[0], psi[:, d] * part[:, d])
        return modal + modal_form.upper[d, d] + modal_form.lower[d, d] / s[:, None] ** 2

    o, i = problem.outputs, problem.inputs
    H = between(psi[:, o], part[:, i]) + far[0](o, i) + far[1](o, i) / s[:, None, None] ** 2
    own, drive = at_itself(o), at_itself(i)
    taken, reach = between(psi[:, o], part[:, :0]), between(psi[:, :0], part)  # by no elements, of no direction

    def channels() -> Channels:
        return Channels(s, own, drive, problem.level, gains[0], psi[:, o], part, taken[0], reach[0])

    local = [(c, w, p) for c, w, _, p in of((LocalCause, CouplingCause), at)]
    joints = [(c, w, p) for c, w, _, p in of(JointCause, at)]
    if not local and not joints:
        none = H[..., :0, :0]
        return Linear(H, H[..., :0], H[..., :0, :], none, channels())
    blocks = [(c.ends(psi, w), c.ends(part, w)) for c, w, _ in local + joints]
    left, right = (jnp.concatenate([b[k] for b in blocks], axis=1) for k in (0, 1))
    H_ob, H_bi, H_bb = between(psi[:, o], right), between(left, part[:, i]), between(left, right)
    count = left.shape[1] - len(joints)
    if local:
        Z = block_diagonal([c.block(s, p) for c, _, p in local])
        inner = jnp.eye(count) + Z @ H_bb[:, :, :count, :count]
        X = jnp.linalg.solve(inner, jnp.broadcast_to(Z, inner.shape)) if count > 1 else Z / inner
        taken, reach = H_ob[..., :count] @ X, between(left[:, :count], part)
        H = H - taken @ H_bi[:, :, :count]
        own = own - jnp.einsum("foq,fqo->fo", taken[0], reach[0][:, :, o])
        from_inputs = between(psi[:, i], right[:, :count]) @ X
        drive = drive - jnp.einsum("fiq,fqi->fi", from_inputs[0], reach[0][:, :, i])
        H_ob, H_bi, H_bb = (
            H_ob[..., count:] - taken @ H_bb[:, :, :count, count:],
            H_bi[:, :, count:] - H_bb[:, :, count:, :count] @ X @ H_bi[:, :, :count],
            H_bb[:, :, count:, count:] - H_bb[:, :, count:, :count] @ X @ H_bb[:, :, :count, count:],
        )
    return Linear(H, H_ob, H_bi, H_bb, channels())


def _with_joints(without: Linear, joints: list[Any], problem: Problem) -> Array:
    """Receptances between the channels with joints in place, each balanced at the fundamental."""
    H, H_ob, H_bi, H_bb, _ = without
    places = [jnp.asarray(w) for _, w, _, _ in joints]
    for k, (cause, where, harmonics, p) in enumerate(joints):
        drive_bb, motion = H_bb[:, :, k, k], H_bi[:, :, k]
        first = 1.0
        if len(joints) > 1:
            # joints at one place share one motion: the first of them stands for all
            same = [jnp.all(where == other).astype(float) for other in places]
            first = jnp.prod(1 - jnp.stack([jnp.zeros(()), *same[:k]]))
            share = tuple(
                s if e is None or c.rigid else s * factor_at(e, q) for s, (c, _, e, q) in zip(same, joints, strict=True)
            )
            cause, p = Together(tuple(c for c, *_ in joints)), (tuple(q for *_, q in joints), share)
            harmonics = None
        Z = first * equivalent(cause, p, problem.omega, drive_bb, motion, problem.level, harmonics)
        force = Z / (1 + Z * (drive_bb[..., None] - in_series(harmonics))) * motion
        if harmonics is not None:
            force = jnp.where(harmonics[DIRECT] != 0, by_parameters(harmonics, p), force)
            force = jnp.where(harmonics[GIVEN] != 0, harmonics[GIVEN], force)
        H = H - H_ob[..., k, None] * force[:, :, None]
    return H


class Together:
    """Joints side by side at one place: their forces add up."""

    rigid = False  # no motion of all of them together is known before it is searched

    def __init__(self, causes: tuple[Any, ...]):
        self.causes = causes

    def impedance(self, A: Array, omega: Array, p: tuple[tuple[Any, ...], tuple[Array, ...]]) -> Array:
        """Sum of the describing functions; the second of ``p`` is 1 for the causes at this place, else 0.

        What the higher harmonics do to the force of a cause is a factor in it.
        """
        parts = [s * c.impedance(A, omega, q) for c, q, s in zip(self.causes, *p, strict=True)]
        return jnp.sum(jnp.stack(parts), axis=0)


def block_diagonal(blocks: list[Array]) -> Array:
    """Matrices at every line, shape ``(f, n, n)`` each, one after the other along the diagonal."""
    size = sum(b.shape[-1] for b in blocks)
    out = jnp.zeros((blocks[0].shape[0], size, size), jnp.complex128)
    k = 0
    for b in blocks:
        n = b.shape[-1]
        out = out.at[:, k : k + n, k : k + n].set(b)
        k += n
    return out


DIRECT, SERIES, NEAR, GIVEN = -4, -3, -2, -1  # what stands after the factor's numbers; see factor_at


def by_parameters(harmonics: Complex[Array, "five_p run f i"], p: Float[Array, " p"]) -> Complex[Array, "run f i"]:
    """What is linear in a joint's parameters: the factor of :func:`factor_at`, or the force itself."""
    return harmonics[0] + jnp.tensordot(p, harmonics[1:DIRECT], 1)


def factor_at(harmonics: Complex[Array, "five_p run f i"], p: Float[Array, " p"]) -> Complex[Array, "run f i"]:
    r"""Factor :math:`\rho(p) = \rho_0 + \sum_k \rho_k p_k` of higher harmonics on a describing function.

    Parameters
    ----------
    harmonics
        What a joint needs besides its parameters: :math:`\rho_0`, the slope by each parameter, 1 where these two give
        the force over that at the input and no factor (else 0), the compliance in series with the joint
        (:mod:`~modalax.diagnose.prediction.harmonics`), the amplitude that was measured across it [m] (0 where it was
        not), and the force that was measured there over that at the input (0 where the law gives it).
    p
        Parameters of the joint.
    """
    return jnp.where(harmonics[DIRECT] != 0, 1.0, by_parameters(harmonics, p))


def in_series(harmonics: Complex[Array, "two_p run f i"] | None) -> Any:
    """Compliance in series with a joint [m/N], shape ``(run, f, i)``, by which the structure's is less; else 0."""
    return 0.0 if harmonics is None else harmonics[SERIES].real


def equivalent(
    cause: Any, p: Any, omega: Array, drive: Array, motion: Array, level: Array, harmonics: Any = None
) -> Complex[Array, "run f i"]:
    r"""Equivalent stiffness of a joint in place, from :math:`A\,|1 + N(A)\,b^THb| = |b^THF|`.

    The smallest amplitude that solves it, or the one nearest to what was measured, is found by bisection on a
    logarithmic scale and polished by one Newton step, which also carries the derivatives. Where three solve it, as for
    a cubic spring under a large force, the middle one is of no steady motion and is not taken, unless it is the one
    that is known: with the effect of higher harmonics held, the balance may fall at a motion that is steady.

    Parameters
    ----------
    drive
        :math:`b^THb`, shape ``(run or 1, f)`` [m/N].
    motion
        :math:`b^TH`, shape ``(run or 1, f, i)`` [m/N].
    harmonics
        By what factor higher harmonics change the force at the fundamental, and what else :func:`factor_at` tells,
        shape ``(5 + p, run, f, i)``; no factor, no compliance and no measured amplitude if None.
    """
    free = level[:, :, None] * jnp.abs(motion) + TINY
    flat = jnp.broadcast_to(drive[..., None] - in_series(harmonics), free.shape)
    w = omega[None, :, None]

    def force(log_a: Array, p: Any) -> Array:
        """Force a unit displacement at an amplitude, that of higher harmonics included."""
        A = jnp.exp(log_a)
        if harmonics is None:
            return cause.impedance(A, w, p)
        return factor_at(harmonics, p) * cause.impedance_in_series(A, w, p, in_series(harmonics))

    def miss(log_a: Array, free: Array, flat: Array, p: Any) -> tuple[Array, Array]:
        Z = force(log_a, p)
        return log_a + jnp.log(jnp.abs(1 + Z * flat) + TINY) - jnp.log(free), Z

    fixed = jax.lax.stop_gradient((free, flat, p))
    near = jnp.zeros(free.shape) if harmonics is None else jax.lax.stop_gradient(harmonics[NEAR].real)
    known = harmonics is not None
    root = jax.lax.stop_gradient(amplitude(lambda x: miss(x, *fixed), jnp.log(fixed[0]), near, known))
    slope = jnp.where(jnp.abs(root.slope) > 0.05, root.slope, jnp.where(root.slope < 0, -0.05, 0.05))
    # one more step, to first order, carries the derivatives
    value, Z = miss(root.at, free, flat, p)
    return Z - root.change * jnp.where(jnp.abs(root.value) < 1e-3, value / slope, 0.0)
