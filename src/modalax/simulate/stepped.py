"""Stepped sine by time marching: at each line the sine acts until the motion repeats itself, then the next line."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from modalax._numerics.checks import as_array, as_double, is_traced
from modalax._numerics.cuts import cut
from modalax.data.checks import check_axis
from modalax.data.dofs import as_names
from modalax.data.frf import DERIVATIVES, check_form
from modalax.data.measurement import Measurement
from modalax.model.receptance import AnyStructure
from modalax.simulate.blocks import Propagator, propagator
from modalax.simulate.joints import Joint
from modalax.simulate.march import Motion, Rig, advance, at_rest, check_agreement, make_rig, prepare, see_outputs
from modalax.simulate.overview import of_stepped

SWEEPS = ("up", "down", "each")


class SteppedSine(eqx.Module):
    r"""Steady motion at each level and line: fundamental amplitudes :math:`X` of :math:`\mathrm{Re}(Xe^{j\omega t})`.

    Attributes
    ----------
    freq, level
        Frequencies, shape ``(f,)`` [Hz], and force amplitudes, shape ``(level,)`` [N].
    X
        Displacement of the outputs, shape ``(level, f, o, i)`` [m].
    q
        Displacement across the joints, shape ``(level, f, j, i)`` [m].
    periods
        Periods marched at each line.
    change
        What the last period still changed, divided by what is left of a free vibration after it: an estimate of the
        distance to the steady motion, over the motion [-].
    settled
        Whether ``change`` came below the tolerance.
    outputs, inputs
        DoF names.
    """

    freq: Float[Array, " f"]
    level: Float[Array, " level"]
    X: Complex[Array, "level f o i"]
    q: Complex[Array, "level f j i"]
    periods: Int[Array, "level f i"]
    change: Float[Array, "level f i"]
    settled: Bool[Array, "level f i"]
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)

    def __str__(self) -> str:
        """Lines, levels, channels, and how many points are settled."""
        return of_stepped(self)

    def measurement(self, form: str = "receptance") -> Measurement:
        """FRFs, fundamental over force, with a run for each level."""
        H = self.X / self.level[:, None, None, None]
        H = H * ((2j * jnp.pi * self.freq) ** DERIVATIVES[check_form(form)])[:, None, None]
        return Measurement(self.freq, H, level=self.level, form=form, outputs=self.outputs, inputs=self.inputs)


def _sine_moments(steps: int) -> np.ndarray:
    """Moments of a unit cosine over each step of a period, shape ``(steps, k)``."""
    s, w = np.polynomial.legendre.leggauss(10)
    s, w = 0.5 * (s + 1), 0.5 * w
    legendre = np.stack([np.ones_like(s), 3 * (2 * s - 1), 5 * (6 * s**2 - 6 * s + 1)])
    return np.cos(2 * np.pi * (np.arange(steps)[:, None] + s) / steps) @ (legendre * w).T


class _Plan(NamedTuple):
    """Static orders of a stepped sine."""

    steps: int
    tolerance: float
    limit: int
    follow: bool


class _Line(eqx.Module):
    """State of a line after some periods."""

    now: Motion
    X: Array
    periods: Array
    change: Array
    calm: Array


def _settle(rig: Rig, ahead: Propagator, fades: Array, level: Array, start: Motion, plan: _Plan) -> _Line:
    """March periods of one sine until the motion repeats itself; ``fades`` of a free vibration goes in a period."""
    steps, tolerance, limit, _ = plan
    step = prepare(rig, ahead)
    drive = level * jnp.asarray(_sine_moments(steps))[:, None, :]
    turn = jnp.exp(-2j * jnp.pi * jnp.arange(1, steps + 1) / steps) * 2 / steps

    def one(carry: tuple[Motion, Array], part: tuple[Array, Array]) -> tuple[tuple[Motion, Array], None]:
        (now, X), (moments, phase) = carry, part
        now = advance(rig, step, now, moments)
        seen = jnp.concatenate([now.x, see_outputs(rig, step, now, moments, 0)])
        return (now, X + phase * seen), None

    def period(line: _Line) -> _Line:
        (now, X), _ = jax.lax.scan(one, (line.now, jnp.zeros_like(line.X)), (drive, turn))
        size = jnp.maximum(jnp.abs(X), 1e-3 * jnp.max(jnp.abs(X)))
        moved = jnp.max(jnp.abs(X - line.X) / jnp.where(size > 0, size, 1.0)) / fades
        calm = jnp.where(moved < tolerance, line.calm + 1, 0)
        return _Line(now, X, line.periods + 1, moved, calm)

    rows = rig.blocks.C.shape[0]
    still = start._replace(left=jnp.zeros(()), size=jnp.zeros(()))
    first = _Line(still, jnp.zeros(rows, complex), jnp.array(0), jnp.array(jnp.inf), jnp.array(0))
    return jax.lax.while_loop(lambda line: (line.calm < 2) & (line.periods < limit), period, first)


@eqx.filter_jit
def _all_lines(rig: Rig, ahead: Propagator, fades: Array, levels: Array, plan: _Plan) -> tuple[Array, ...]:
    """Every level and line; with ``follow`` each line starts from the motion of the one before."""

    def result(line: _Line) -> tuple[Array, Array, Array, Array, Array]:
        left = line.now.left / jnp.where(line.now.size > 0, line.now.size, 1.0)
        return line.X, line.periods, line.change, line.calm >= 2, left

    def in_turn(level: Array) -> tuple[Array, ...]:
        def next_line(now: Motion, part: tuple[Propagator, Array]) -> tuple[Motion, tuple[Array, ...]]:
            line = _settle(rig, *part, level, now, plan)
            return line.now, result(line)

        return jax.lax.scan(next_line, at_rest(rig), (ahead, fades))[1]

    def at_once(level: Array) -> tuple[Array, ...]:
        return jax.vmap(lambda a, f: result(_settle(rig, a, f, level, at_rest(rig), plan)))(ahead, fades)

    return jax.vmap(in_turn if plan.follow else at_once)(levels)


def stepped_sine(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    freq: Any,
    level: Any,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str] | None = None,
    sweep: str = "up",
    steps: int = 256,
    tolerance: float = 1e-6,
    limit: int = 2000,
) -> SteppedSine:
    """March a structure with joints under sines of constant force amplitude until the motion is steady.

    Parameters
    ----------
    structure
        Matrices or a modal model.
    joints, places
        The joints, and where each sits: ``[dof, dof]`` or ``[dof]`` to the ground.
    freq
        Frequencies, increasing, shape ``(f,)`` [Hz].
    level
        Force amplitudes, one number or shape ``(level,)`` [N].
    inputs
        DoFs at which the force acts, one at a time.
    outputs
        DoFs whose motion is wanted; all by default.
    sweep
        ``up`` or ``down``: lines follow one another, the motion and its phase going on, as on a shaker; it decides the
        branch where there are several. ``each``: every line by itself from rest, all at once, which is faster.
    steps
        Steps a period.
    tolerance
        A line is left when the estimated distance to the steady motion, over the motion, is below this twice.
    limit
        Most periods spent on a line.

    Raises
    ------
    ValueError
        If the input cannot be used, or a joint is too stiff for so few steps.
    """
    freq = as_double(freq, "freq")
    check_axis(freq)
    if sweep not in SWEEPS:
        raise ValueError(f"sweep is {sweep!r}; it must be one of {', '.join(SWEEPS)}")
    if float(freq[0]) == 0:
        raise ValueError("freq starts at 0 Hz; a sine needs a frequency above 0")
    if steps < 16:
        raise ValueError(f"{steps} steps per period; at least 16 are needed")
    level = as_double(level, "level")
    level = level if level.ndim else cut(level, None)
    turn = slice(None, None, -1) if sweep == "down" else slice(None)
    period = 1 / np.asarray(freq)[turn]
    plan = _Plan(steps, tolerance, limit, sweep != "each")
    inputs = as_names(inputs)
    columns, names = [], ()
    for name in inputs:
        rig, names = make_rig(structure, joints, places, outputs, [name])
        # free vibrations that decay by less than a thousandth in a period are not waited for
        fades = -np.expm1(-np.maximum(rig.blocks.decay * period, 1e-3))
        columns.append(_all_lines(rig, propagator(rig.blocks, period / steps), as_array(fades), level, plan))
    X, periods, change, settled, left = (_columns(part)[:, turn] for part in zip(*columns, strict=True))
    check_agreement(left, f"{steps} steps per period")
    j = len(joints)
    q, X = as_array(X[:, :, :j]), as_array(X[:, :, j:])
    steady = as_array(periods), as_array(change), as_array(settled)
    return SteppedSine(freq, level, X, q, *steady, names, inputs)


def _columns(parts: Sequence[Any]) -> Any:
    """What was found for each input, along the last axis; of NumPy where the numbers are known."""
    return jnp.stack(parts, axis=-1) if is_traced(*parts) else np.stack([np.asarray(p) for p in parts], axis=-1)
