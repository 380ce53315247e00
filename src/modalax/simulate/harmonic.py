r"""Predicted FRFs of a structure with non-linear joints, by harmonic balance over frequencies and force levels.

The joints' relative displacements q solve :math:`q + (b^T H b) f(q) = b^T H F`; all other motion follows linearly,
:math:`x = H F - H b f`. Cost beyond the receptance does not depend on the size of the structure.
"""

import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_array, as_double, is_traced
from modalax._numerics.cuts import cut, spread_over
from modalax._numerics.known import Numbers, by_numpy, circular, host, joined
from modalax.data.checks import check_axis
from modalax.data.dofs import as_names
from modalax.data.frf import DERIVATIVES, check_form
from modalax.data.measurement import Measurement
from modalax.model.receptance import AnyStructure, directions, dof_names, receptance
from modalax.simulate.aft import Harmonics, joint_forces
from modalax.simulate.balance import FOLD, Line, Plan, make_plan
from modalax.simulate.joints import Joint
from modalax.simulate.overview import of_response
from modalax.simulate.sweep import solve_lines, solved

SAMPLES = 128  # instants of a cycle at which joint forces are evaluated by default


class Response(eqx.Module):
    r"""Steady motion of a structure with joints under a sine force, at each level and frequency, for each input.

    Harmonics are complex amplitudes, :math:`x(t) = \sum_k \mathrm{Re}(X_k e^{jk\omega t})`.

    Attributes
    ----------
    freq, level
        Excitation frequencies, shape ``(f,)`` [Hz], and force amplitudes, shape ``(level,)`` [N].
    q, force
        Displacement across each joint [m] and its force [N], shape ``(level, f, j, h, i)``.
    X
        Displacement of the outputs [m], shape ``(level, f, o, h, i)``.
    residual
        Residual of the balance, relative to the motion without joints, shape ``(level, f, i)`` [-].
    margin
        How much the balance changes, at least, with a unit of motion, shape ``(level, f, i)`` [-]: 0 at a fold.
    harmonics, outputs, inputs
        Which harmonics, and the DoF names.
    """

    freq: Float[Array, " f"]
    level: Float[Array, " level"]
    q: Complex[Array, "level f j h i"]
    force: Complex[Array, "level f j h i"]
    X: Complex[Array, "level f o h i"]
    residual: Float[Array, "level f i"]
    margin: Float[Array, "level f i"]
    harmonics: Harmonics = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)

    def __str__(self) -> str:
        """Lines, levels, channels, and how many points are solved."""
        return of_response(self)

    @property
    def converged(self) -> Bool[Array, "level f i"]:
        """Whether the balance is solved, shape ``(level, f, i)``; elsewhere the values are the best that were found."""
        return solved(self.residual)

    @property
    def at_fold(self) -> Bool[Array, "level f i"]:
        """Whether a point lies at a fold, where two motions merge and have no derivative, so that gradients are NaN.

        Move the line, or differentiate along the branch, see :func:`modalax.simulate.follow_branch`.
        """
        return self.margin < FOLD

    @property
    def fundamental(self) -> Complex[Array, "level f o i"]:
        """Displacement of the outputs at the excitation frequency [m]."""
        return cut(self.X, (slice(None), slice(None), slice(None), self.harmonics.index(1)))

    def limit(self, coarse: "Response") -> Complex[Array, "level f o i"]:
        r"""Fundamental in the limit of all harmonics [m], from this and a ``coarse`` response with fewer.

        A force that jumps, as in dry friction, leaves an error in proportion to :math:`1/(h + 1)`, ``h`` the highest
        harmonic, so that :math:`((h+1)X_h - (h'+1)X_{h'})/(h - h')` is better than both (Richardson, 1911). Laws
        without jumps converge faster, and need no limit.

        Raises
        ------
        ValueError
            If the two have other lines, levels or DoFs, or ``coarse`` does not have fewer harmonics.
        """
        h, fewer = max(self.harmonics), max(coarse.harmonics)
        same = (self.outputs, self.inputs, self.X.shape[:2]) == (coarse.outputs, coarse.inputs, coarse.X.shape[:2])
        if not same or fewer >= h:
            raise ValueError(
                f"the limit needs two responses alike but for fewer harmonics in the coarse one: highest {fewer} and "
                f"{h}, {coarse.X.shape[:2]} and {self.X.shape[:2]} levels and lines"
            )
        return ((h + 1) * self.fundamental - (fewer + 1) * coarse.fundamental) / (h - fewer)

    def frf_values(self, form: str = "receptance") -> Complex[Array, "level f o i"]:
        """Fundamental response over force."""
        return _over_force(self.fundamental, self.freq, self.level, steps=DERIVATIVES[check_form(form)])

    def measurement(self, form: str = "receptance") -> Measurement:
        """The FRFs as a measurement, with a run for each level."""
        return Measurement(
            self.freq, self.frf_values(form), level=self.level, form=form, outputs=self.outputs, inputs=self.inputs
        )


@by_numpy
def _over_force(xp: ModuleType, X: Any, freq: Any, level: Any, *, steps: int) -> Complex[Numbers, "level f o i"]:
    return X * ((2j * np.pi * freq) ** steps)[:, None, None] / level[:, None, None, None]


class Receptances(eqx.Module):
    """The structure, of whatever kind, as harmonic balance needs it.

    Attributes
    ----------
    joints
        Between the joints at each harmonic, shape ``(f, h, j, j)`` [m/N].
    outputs
        From the joints to the outputs at each harmonic, shape ``(f, h, o, j)``.
    driven, direct
        From the inputs to the joints, ``(f, j, i)``, and to the outputs, ``(f, o, i)``, at the fundamental.
    omega
        Circular frequencies [rad/s].
    """

    joints: Complex[Array, "f h j j"]
    outputs: Complex[Array, "f h o j"]
    driven: Complex[Array, "f j i"]
    direct: Complex[Array, "f o i"]
    omega: Float[Array, " f"]


def receptances(
    structure: AnyStructure, b: Float[Array, "j n"], omega: Any, outputs: Any, inputs: Any, harmonics: Harmonics
) -> Receptances:
    """Receptances at all harmonics; ``outputs`` and ``inputs`` are directions, shapes ``(o, n)`` and ``(i, n)``.

    Raises
    ------
    ValueError
        If the structure floats freely and a mean displacement is among the harmonics.
    """
    omega = as_double(omega, "omega")
    j, f, h = b.shape[0], omega.shape[0], len(harmonics)
    all_omega, rows = (host(omega)[:, None] * np.array(harmonics)).ravel(), joined([b, outputs])
    to_joints = host(receptance(structure, all_omega, rows, host(b).T)).reshape(f, h, -1, j)
    if 0 in harmonics and not is_traced(to_joints) and not np.isfinite(to_joints).all():
        raise ValueError(
            "the structure floats freely at 0 Hz, so a joint whose law is not odd has no mean position there; "
            "hold the structure, or choose harmonics without 0"
        )
    at_one = host(receptance(structure, omega, rows, host(inputs).T))
    return Receptances(
        as_array(to_joints[:, :, :j]), as_array(to_joints[:, :, j:]), as_array(at_one[:, :j]), as_array(at_one[:, j:]),
        omega,
    )  # fmt: skip


def balance_levels(
    R: Receptances, joints: tuple[Joint, ...], level: Any, plan: Plan, downward: Bool[Array, ""] | bool = False
) -> tuple[Complex[Array, "level f j h i"], Float[Array, "level f i"], Float[Array, "level f i"]]:
    """Joint displacements [m] at all levels [N] and inputs, with residuals and margins; works under jit, vmap, grad."""
    at, level, i = plan.harmonics.index(1), jnp.asarray(level), R.driven.shape[-1]
    u = jnp.zeros((*R.joints.shape[:2], *R.driven.shape[1:]), complex).at[:, at].set(R.driven)
    sweeps = (level[:, None, None, None, None] * jnp.moveaxis(u, -1, 0)).reshape(-1, *u.shape[:-1])
    made = solve_lines(plan, joints, Line(R.joints, sweeps, R.omega), downward)
    q, left, margin = (jnp.moveaxis(a.reshape(level.shape[0], i, *a.shape[1:]), 1, -1) for a in made)
    return q, left, margin


def respond(
    R: Receptances, joints: tuple[Joint, ...], q: Complex[Array, "level f j h i"], level: Any, plan: Plan
) -> tuple[Complex[Array, "level f j h i"], Complex[Array, "level f o h i"]]:
    """Joint forces [N] and output displacements [m] that belong to joint displacements."""
    force = jax.vmap(
        jax.vmap(
            jax.vmap(lambda q, w: joint_forces(joints, q, w, plan.harmonics, plan.samples), (-1, None), -1), (0, 0)
        ),
        (0, None),
    )(q, R.omega)
    X = -jnp.einsum("fhoj,lfjhi->lfohi", R.outputs, force)
    at = plan.harmonics.index(1)
    return force, X.at[:, :, :, at].add(jnp.asarray(level)[:, None, None, None] * R.direct)


def harmonic_balance(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    freq: Any,
    level: Any,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str] | None = None,
    harmonics: int | tuple[int, ...] = 1,
    samples: int = SAMPLES,
    sweep: str = "up",
) -> Response:
    r"""Balance a structure with joints under sine forces of constant amplitude.

    Parameters
    ----------
    structure
        Matrices, a modal model, or either with local changes.
    joints, places
        The joints, and where each sits: ``[dof, dof]`` or ``[dof]`` to the ground.
    freq
        Excitation frequencies, increasing, shape ``(f,)`` [Hz].
    level
        Force amplitudes, one number or shape ``(level,)`` [N].
    inputs
        DoFs at which the force acts, one at a time.
    outputs
        DoFs whose motion is wanted; all by default.
    harmonics
        Highest harmonic: all up to it, with the mean, are kept, only the odd ones if all laws are odd; or which ones.
    samples
        Times of a cycle at which forces are evaluated, where more than a describing function is needed.
    sweep
        ``up`` or ``down``: which branch is returned where there are several.

    Returns
    -------
    Response
        Differentiable in joints, structure, level and frequency, except where two branches merge: at ``at_fold`` the
        derivative does not exist and comes out as NaN.

    Raises
    ------
    ValueError
        If joints and places differ in number, or a name, harmonic, level or frequency cannot be used.
    """
    freq = as_double(freq, "freq")
    check_axis(freq)
    if sweep not in ("up", "down"):
        raise ValueError(f"sweep is {sweep!r}; it must be up or down")
    level = as_double(level, "level")
    level = level if level.ndim else cut(level, None)
    if not is_traced(level) and not (np.asarray(level) > 0).all():
        raise ValueError(f"level holds {float(np.min(level)):g} N; force amplitudes must be above 0")
    plan = make_plan(joints, places, harmonics, samples)
    out_names = dof_names(structure) if outputs is None else as_names(outputs)
    inputs = as_names(inputs)
    b, o, i = (directions(structure, p) for p in (places, [[n] for n in out_names], [[n] for n in inputs]))
    R = receptances(structure, b, circular(freq), o, i, plan.harmonics)
    q, left, margin, force, X = _answer(R, tuple(joints), level, plan, jnp.array(sweep == "down"))
    return Response(freq, level, q, force, X, left, margin, plan.harmonics, out_names, inputs)


@eqx.filter_jit
def _answer(
    R: Receptances, joints: tuple[Joint, ...], level: Float[Array, " level"], plan: Plan, downward: Bool[Array, ""]
) -> tuple[Array, Array, Array, Array, Array]:
    q, left, margin = balance_levels(R, joints, level, plan, downward)
    return q, left, margin, *respond(R, joints, q, level, plan)


def simulate(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    freq: Any,
    level: Any,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str] | None = None,
    form: str = "receptance",
    **orders: Any,
) -> Measurement:
    """Predicted FRFs with a run for each level; without joints the linear ones.

    Parameters are those of :func:`harmonic_balance`. A warning names points that did not converge.
    """
    if not joints:
        from modalax.model.receptance import frf

        linear = frf(structure, freq, form=form, outputs=outputs, inputs=inputs)
        level = as_double(level, "level")
        level = level if level.ndim else cut(level, None)
        H = spread_over(linear.H, (level.shape[0], *linear.H.shape))
        return Measurement(linear.freq, H, level=level, form=form, outputs=linear.outputs, inputs=linear.inputs)
    response = harmonic_balance(structure, joints, places, freq, level, inputs=inputs, outputs=outputs, **orders)
    if not is_traced(response.residual):
        _warn_of_unsolved(response)
    return response.measurement(form)


def _warn_of_unsolved(response: Response) -> None:
    failed = np.argwhere(~np.asarray(response.converged))
    if len(failed):
        run, line, _ = failed[0]
        warnings.warn(
            f"{len(failed)} of {response.residual.size} points did not converge, the first at "
            f"{float(response.freq[line]):g} Hz and {float(response.level[run]):g} N; "
            "try more samples, finer lines or fewer harmonics",
            stacklevel=3,
        )
