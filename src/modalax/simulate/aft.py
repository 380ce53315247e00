r"""Fourier coefficients of joint forces under periodic motion, by alternating frequency and time.

A motion is :math:`x(t) = \sum_k \mathrm{Re}(q_k e^{jk\omega t})` over the harmonics kept; the mean, k = 0, is real.
With odd harmonics and odd laws half a cycle is enough.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.simulate.joints import Hysteretic, Joint, Memoryless

Harmonics = tuple[int, ...]


def choose_harmonics(joints: tuple[Joint, ...], harmonics: int | tuple[int, ...]) -> Harmonics:
    """The harmonics to keep, given the highest: odd ones if every law is odd, else all and the mean; a tuple is kept.

    Raises
    ------
    ValueError
        If the fundamental is not among them, or one is negative.
    """
    if isinstance(harmonics, int):
        odd = all(joint.odd for joint in joints)
        harmonics = tuple(range(1, harmonics + 1, 2)) if odd else tuple(range(harmonics + 1))
    kept = tuple(sorted(set(harmonics)))
    if 1 not in kept or kept[0] < 0:
        raise ValueError(f"harmonics {kept} must hold the fundamental, 1, and none below 0")
    return kept


def real_size(joints: int, harmonics: Harmonics) -> int:
    """Number of real unknowns: two for each joint and harmonic, one for the mean."""
    return joints * (2 * len(harmonics) - (0 in harmonics))


def to_real(q: Complex[Array, "j h"], harmonics: Harmonics) -> Float[Array, " r"]:
    """Stack real parts, then imaginary parts (none for the mean)."""
    return jnp.concatenate([q.real.ravel(), q[:, 0 in harmonics :].imag.ravel()])


def to_complex(y: Float[Array, " r"], joints: int, harmonics: Harmonics) -> Complex[Array, "j h"]:
    """Undo :func:`to_real`."""
    split = joints * len(harmonics)
    imag = y[split:].reshape(joints, -1)
    if 0 in harmonics:
        imag = jnp.concatenate([jnp.zeros((joints, 1)), imag], axis=1)
    return y[:split].reshape(joints, -1) + 1j * imag


def has_closed_form(joint: Joint) -> bool:
    """Whether the joint's class has its describing function in closed form."""
    return type(joint).describing not in (Memoryless.describing, Hysteretic.describing)


@eqx.filter_jit
def joint_forces(
    joints: tuple[Joint, ...],
    q: Complex[Array, "j h"],
    omega: Float[Array, ""],
    harmonics: Harmonics,
    samples: int,
) -> Complex[Array, "j h"]:
    """Force harmonics [N] of each joint under its own displacement harmonics ``q`` [m].

    A single harmonic of a joint with a describing function is exact; otherwise forces are evaluated at ``samples``
    instants of a cycle.
    """
    rows = []
    for joint, own in zip(joints, q, strict=True):
        if harmonics == (1,) and has_closed_form(joint):
            rows.append(joint.describing(_modulus(own), omega) * own)
        elif isinstance(joint, Hysteretic):
            rows.append(_with_memory(joint, own, omega, harmonics, samples))
        else:
            assert isinstance(joint, Memoryless)
            rows.append(_memoryless(joint, own, omega, harmonics, samples))
    return jnp.stack(rows)


def _modulus(z: Complex[Array, " h"]) -> Float[Array, " h"]:
    """Absolute value with derivative 0 at 0."""
    square = z.real**2 + z.imag**2
    still = square == 0
    return jnp.where(still, 0.0, jnp.sqrt(jnp.where(still, 1.0, square)))


def _half(joint: Joint, harmonics: Harmonics) -> bool:
    return joint.odd and all(k % 2 for k in harmonics)


def _times(harmonics: Harmonics, samples: int, half: bool) -> np.ndarray:
    """Phases of a cycle, or of its first half, the end included."""
    count = samples // 2 if half else samples
    return 2 * np.pi * np.arange(count + 1) / samples


def _motion(
    q: Complex[Array, " h"], omega: Float[Array, ""], harmonics: Harmonics, tau: np.ndarray
) -> tuple[Float[Array, " t"], Float[Array, " t"]]:
    """Displacement and velocity at the phases ``tau``."""
    k = np.array(harmonics)
    cosine, sine = np.cos(np.outer(tau, k)), np.sin(np.outer(tau, k))
    parts = jnp.concatenate([q.real, q.imag])
    x = jnp.asarray(np.concatenate([cosine, -sine], axis=1)) @ parts
    return x, -omega * (jnp.asarray(np.concatenate([sine * k, cosine * k], axis=1)) @ parts)


def _coefficients(f: Float[Array, " t"], tau: np.ndarray, harmonics: Harmonics) -> Complex[Array, " h"]:
    """Fourier coefficients of samples that fill the cycle, or of half a cycle of an odd motion."""
    k = np.array(harmonics)
    angle, weight = np.outer(k, tau), np.where(k == 0, 1.0, 2.0)[:, None] / len(tau)
    both = jnp.asarray(np.concatenate([weight * np.cos(angle), -weight * np.sin(angle)])) @ f
    return both[: len(k)] + 1j * both[len(k) :]


def _memoryless(
    joint: Memoryless, q: Complex[Array, " h"], omega: Float[Array, ""], harmonics: Harmonics, samples: int
) -> Complex[Array, " h"]:
    tau = _times(harmonics, samples, _half(joint, harmonics))[:-1]
    x, v = _motion(q, omega, harmonics, tau)
    return _coefficients(joint.force(x, v), tau, harmonics)


def _with_memory(
    joint: Hysteretic, q: Complex[Array, " h"], omega: Float[Array, ""], harmonics: Harmonics, samples: int
) -> Complex[Array, " h"]:
    r"""Step around the cycle until the hysteresis loop is closed, through each turning point, and average each step.

    Mean forces instead of samples keep the result continuous where the force jumps; dividing by the transform of a
    step then removes the effect of averaging. A jump, as in Coulomb friction, leaves
    :math:`(k\pi/\mathrm{samples})^2/3` of harmonic k.
    """
    half = _half(joint, harmonics)
    tau = _times(harmonics, samples, half)
    x, v = _motion(q, omega, harmonics, tau)
    step = tau[1] / omega
    old, new, v_old, v_new = x[:-1], x[1:], v[:-1], v[1:]
    turns = v_old * v_new < 0
    share = jnp.where(turns, v_old / jnp.where(turns, v_old - v_new, 1.0), 1.0)
    # the turning point seen from either end, blended so that it moves smoothly from one step into the next
    from_old, from_new = old + 0.5 * v_old * share * step, new - 0.5 * v_new * (1 - share) * step
    turn = jnp.where(turns, (1 - share) * from_old + share * from_new, new)
    v_turn = jnp.where(turns, 0.0, v_new)
    # every step as two, up to its turning point and from there
    ends = tuple(jnp.stack(pair, axis=1).ravel() for pair in ((old, turn), (turn, new)))
    bows = jnp.stack([(v_old - v_turn) * share, (v_turn - v_new) * (1 - share)], axis=1).ravel() * 0.5 * step

    def go(state: Any, ends: tuple[Array, Array]) -> tuple[Any, Any]:
        return joint.step(state, *ends)[0], state

    def run(state: Any, sign: Any) -> tuple[Any, Any]:
        return jax.lax.scan(go, state, (sign * ends[0], sign * ends[1]))

    def lap(state: Any) -> Any:
        return jax.lax.scan(run, state, jnp.array([1.0, -1.0] if half else [1.0]))[0]

    def read(state: Any, part: tuple[Array, ...]) -> tuple[Any, Any]:
        return joint.step(state, *part[:2])[0], joint.average(state, *part)

    state, signs = joint.step(joint.initial_state(), jnp.zeros_like(x[0]), x[0])[0], np.ones(1)
    if type(joint).close is Hysteretic.close:
        # the last way round is read, of an odd motion half of it
        signs = np.resize([1.0, -1.0], 2 * joint.settle) if half else np.ones(1 + joint.settle)
    else:
        state = joint.close(lap, state)
    way = tuple(signs[-1] * part for part in (*ends, bows))
    # A joint with one state takes all means at once after the steps; of many sliders that would fill the memory.
    if len(jax.tree.leaves(state)) == 1 and all(leaf.ndim == 0 for leaf in jax.tree.leaves(state)):
        states = jax.lax.scan(run, state, jnp.asarray(signs))[1]
        means = jax.vmap(joint.average)(jax.tree.map(lambda a: a[-1], states), *way)
    else:
        state = jax.lax.scan(lambda state, sign: (run(state, sign)[0], None), state, jnp.asarray(signs[:-1]))[0]
        means = jax.lax.scan(read, state, way)[1]
    mean = share * means[0::2] + (1 - share) * means[1::2]
    k = np.array(harmonics)
    box = np.sinc(k / samples)
    return _coefficients(signs[-1] * mean, 0.5 * (tau[:-1] + tau[1:]), harmonics) / box
