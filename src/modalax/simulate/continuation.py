r"""A whole response branch, through its folds, by pseudo-arclength continuation of the harmonic balance.

Unknowns are the joints' harmonics and the frequency. A step goes along the tangent and is corrected at right angles to
it; its length follows the number of corrections. Where a contact begins, a branch has a corner and may turn back by
more than a right angle: no step ahead leads on. Then a step goes along the tangent of the far side, in the direction
that keeps the sign of the determinant of Jacobian and tangent (the orientation of a piecewise smooth path; Allgower and
Georg, Numerical Continuation Methods, 1990). Nothing here looks at values, so a trace is one compiled scan.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_double, is_traced
from modalax.model.modal import ModalModel
from modalax.model.receptance import AnyStructure, directions, receptance, seen_at
from modalax.model.solve import DIRECT_DOFS
from modalax.model.structure import Structure
from modalax.simulate.aft import Harmonics
from modalax.simulate.balance import CLOSED, Line, Plan, find, make_plan, motion_scale, residual
from modalax.simulate.joints import Joint
from modalax.simulate.overview import of_branch

CORRECTIONS = 8
"""Newton corrections allowed in a step."""
LONGEST, SHORTEST = 0.05, 1e-7
"""Limits of a step, in parts of the band and of the largest motion."""
CORNER = 1e-4
"""A step of this length or less that fails is followed by one round the corner."""
BACK = 1e-3
"""Angle to the last direction reversed within which a step has turned back instead of passing a corner."""


class Branch(eqx.Module):
    """Points along a response branch, in the order in which the trace met them.

    Attributes
    ----------
    freq
        Excitation frequency of each point, shape ``(s,)`` [Hz]; it turns back at folds.
    q
        Displacement harmonics across the joints, shape ``(s, j, h)`` [m].
    arc
        Arclength, in parts of the band and of the largest motion together, shape ``(s,)`` [-].
    direction
        How the frequency changes along the branch, shape ``(s,)`` [Hz]; it changes sign at folds.
    valid
        Which points belong to the branch: False after its end in the band, or where no step succeeded.
    harmonics
        Which harmonics.
    """

    freq: Float[Array, " s"]
    q: Complex[Array, "s j h"]
    arc: Float[Array, " s"]
    direction: Float[Array, " s"]
    valid: Bool[Array, " s"]
    harmonics: Harmonics = eqx.field(static=True)

    def __str__(self) -> str:
        """Points, range of frequencies and folds."""
        return of_branch(self)

    def folds(self) -> np.ndarray:
        """Frequencies [Hz] at which the branch turns back; between two points the direction changes evenly."""
        ok = np.asarray(self.valid)
        freq, arc, way = (np.asarray(a)[ok] for a in (self.freq, self.arc, self.direction))
        k = np.flatnonzero(way[1:] * way[:-1] < 0)
        return freq[k] + 0.5 * (arc[k + 1] - arc[k]) * way[k] ** 2 / (way[k] - way[k + 1])


class _Problem(NamedTuple):
    """The structure as a function of frequency, and the scales of a trace."""

    structure: AnyStructure
    joints: tuple[Joint, ...]
    b: Array
    force: Array
    low: Array
    width: Array
    scale: Array


def _line(plan: Plan, p: _Problem, omega: Float[Array, ""]) -> Line:
    k = jnp.array(plan.harmonics)
    columns = jnp.concatenate([p.b.T, p.force[:, None]], axis=1)
    H = receptance(p.structure, omega * k, p.b, columns)
    u = jnp.where((k == 1)[:, None], H[:, :, -1], 0.0)
    return Line(H[:, :, :-1], u, omega)


def _missing(plan: Plan, p: _Problem, z: Float[Array, " r1"]) -> Float[Array, " r"]:
    line = _line(plan, p, p.low + p.width * z[-1])
    return plan.real(residual(plan, p.scale * plan.complex(z[:-1]), p.joints, line)) / p.scale


def _tangent(jacobian: Float[Array, "r r1"], before: Float[Array, " r1"]) -> Float[Array, " r1"]:
    """Direction of the branch, on the side of the tangent before."""
    square = jnp.concatenate([jacobian, before[None]])
    t = jnp.linalg.solve(square, jnp.zeros_like(before).at[-1].set(1.0))
    return t / jnp.linalg.norm(t)


def _orientation(jacobian: Float[Array, "r r1"], t: Float[Array, " r1"]) -> Float[Array, ""]:
    """Sign of the determinant of Jacobian and tangent, the same on both sides of a corner."""
    return jnp.linalg.slogdet(jnp.concatenate([jacobian, t[None]]))[0]


class _State(NamedTuple):
    """Position of a trace, its direction and next step; ``corner`` says whether that step passes a corner."""

    z: Array
    t: Array
    step: Array
    corner: Array
    ended: Array


@eqx.filter_jit
def _trace(plan: Plan, p: _Problem, points: int, downward: bool) -> tuple[Array, Array, Array, Array]:
    line = _line(plan, p, p.low + p.width * (1.0 if downward else 0.0))
    free = plan.real(line.u.T / motion_scale(line))
    y, left = find(plan, p.joints, line, jnp.stack([c * free for c in (1.0, 0.3, 0.05, 0.0)]))
    z = jnp.append(y * motion_scale(line) / p.scale, 1.0 if downward else 0.0)
    slope = jax.jacfwd(lambda z: _missing(plan, p, z))
    outward = jnp.zeros_like(z).at[-1].set(-1.0 if downward else 1.0)
    start = _State(z, _tangent(slope(z), outward), jnp.array(0.1 * LONGEST), jnp.array(False), left > CLOSED)

    def round_the_corner(s: _State) -> Array:
        beyond = slope(s.z + s.step * s.t)
        t = _tangent(beyond, s.t)
        return t * _orientation(beyond, t) * _orientation(slope(s.z), s.t)

    def correct(s: _State, t: Array) -> tuple[Array, Array, Array]:
        ahead = s.z + s.step * t

        def newton(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            z, _, count = carry
            square = jnp.concatenate([slope(z), t[None]])
            both = jnp.append(_missing(plan, p, z), t @ (z - ahead))
            z = z - jnp.linalg.solve(square, both)
            return z, jnp.max(jnp.abs(_missing(plan, p, z))), count + 1

        go_on = lambda c: (c[1] > 0.01 * CLOSED) & (c[2] < CORRECTIONS)
        return jax.lax.while_loop(go_on, newton, (ahead, jnp.array(jnp.inf), jnp.zeros((), int)))

    def advance(s: _State, _: None) -> tuple[_State, tuple[Array, Array, Array]]:
        way = jax.lax.cond(s.corner, round_the_corner, lambda s: s.t, s)
        z, left, count = correct(s, way)
        chord = z - s.z
        far = jnp.linalg.norm(chord) > 2 * s.step
        back = jnp.linalg.norm(chord + jnp.linalg.norm(chord) * s.t) < BACK * jnp.linalg.norm(chord)
        good = (left < CLOSED) & ~far & ~back & ~s.ended
        t = jnp.where(good, _tangent(slope(jnp.where(good, z, s.z)), way), s.t)
        corner = ~good & ~s.corner & (s.step <= CORNER)
        # a sharp turn or many corrections ask for shorter steps
        calm = (count <= 3) & (t @ way > 0.98)
        longer = jnp.where(calm, 1.5, jnp.where((count > 5) | (t @ way < 0.9), 0.6, 1.0))
        step = jnp.clip(s.step * jnp.where(good, longer, jnp.where(corner, 1.0, 0.4)), SHORTEST, LONGEST)
        z = jnp.where(good, z, s.z)
        ended = s.ended | (z[-1] < -1e-9) | (z[-1] > 1 + 1e-9)
        return _State(z, t, step, corner, ended), (z, t[-1], good & ~ended)

    _, (zs, way, valid) = jax.lax.scan(advance, start, None, length=points)
    return zs[:, -1], zs[:, :-1], way, valid


def follow_branch(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    band: tuple[float, float],
    level: Any,
    *,
    input: str,
    harmonics: int | tuple[int, ...] = 1,
    samples: int = 128,
    points: int = 400,
    downward: bool = False,
) -> Branch:
    """Follow the response branch at one force level from one end of a band, through all folds, unstable parts included.

    A hard contact needs many samples: the branch has a corner wherever one more of them is in contact, and may end
    where they are too few (a mass with a stop twenty times as stiff: 512 are, 4,096 are not).

    Parameters
    ----------
    band
        Frequencies between which the branch is followed [Hz].
    level
        Force amplitude [N] at the DoF ``input``.
    points
        Steps made; points after the branch left the band are marked as not valid.
    downward
        Start at the upper end of the band.

    Raises
    ------
    ValueError
        If the band is empty, no motion is found where the branch starts, joints and places differ in number, a large
        structure with hysteretic damping has to be taken apart into modes, or a modal model has no drive point that
        scales a DoF.
    """
    low, high = (2 * np.pi * float(f) for f in band)
    if not 0 < low < high:
        raise ValueError(f"the band {band[0]:g} to {band[1]:g} Hz must rise and lie above 0 Hz")
    plan = make_plan(joints, places, harmonics, samples)
    if isinstance(structure, Structure) and len(structure.dofs) > DIRECT_DOFS:
        structure = structure.modal()
    if isinstance(structure, ModalModel):
        structure = seen_at(structure, sorted({input, *(dof for place in places for dof in place)}))
    b, force = directions(structure, places), as_double(level, "level") * directions(structure, [[input]])[0]
    grid = jnp.linspace(low, high, 400)
    scale = jnp.max(jnp.abs(receptance(structure, grid, b, force[:, None])))
    p = _Problem(structure, tuple(joints), b, force, jnp.array(low), jnp.array(high - low), scale)
    share, ys, way, valid = _trace(plan, p, points, downward)
    if not is_traced(valid) and not bool(valid.any()):
        raise ValueError(
            f"no motion was found at {band[1] if downward else band[0]:g} Hz, where the branch is to start; "
            "start at the other end or elsewhere, or take more samples or fewer harmonics"
        )
    q = scale * jax.vmap(plan.complex)(ys)
    arc = jnp.cumsum(jnp.linalg.norm(jnp.diff(jnp.column_stack([ys, share]), axis=0, prepend=0.0), axis=1))
    width = (high - low) / (2 * np.pi)
    return Branch(low / (2 * np.pi) + width * share, q, arc, width * way, valid, plan.harmonics)
