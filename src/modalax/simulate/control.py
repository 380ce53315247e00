"""Stepped sine at constant response: the force that gives the wanted amplitude at every frequency."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double, is_traced
from modalax.data.checks import check_axis
from modalax.data.dofs import as_names
from modalax.data.measurement import Measurement
from modalax.model.receptance import AnyStructure, directions, dof_names
from modalax.simulate.aft import joint_forces
from modalax.simulate.balance import CLOSED, Line, Plan, make_plan, residual
from modalax.simulate.harmonic import SAMPLES, Receptances, receptances
from modalax.simulate.joints import Joint
from modalax.simulate.overview import of_controlled


class ControlledResponse(eqx.Module):
    """Force and FRF of one controlled run.

    Attributes
    ----------
    freq
        Shape ``(f,)`` [Hz].
    force
        Amplitude of the sine force that holds the response, shape ``(f,)`` [N].
    X
        Fundamental displacement of the outputs over the phase of the force, shape ``(f, o)`` [m].
    residual
        Residual of the balance, relative to the amplitude held, shape ``(f,)`` [-].
    outputs, input
        DoF names.
    """

    freq: Float[Array, " f"]
    force: Float[Array, " f"]
    X: Complex[Array, "f o"]
    residual: Float[Array, " f"]
    outputs: tuple[str, ...] = eqx.field(static=True)
    input: str = eqx.field(static=True)

    def __str__(self) -> str:
        """Lines, force and channels."""
        return of_controlled(self)

    @property
    def converged(self) -> Array:
        """Whether the balance is solved at each line, shape ``(f,)``."""
        return self.residual < CLOSED

    def measurement(self, form: str = "receptance") -> Measurement:
        """The FRF as a measurement of one run; the level is unknown, for it changes from line to line."""
        H = (self.X / self.force[:, None])[None, :, :, None]
        return Measurement(self.freq, H, outputs=self.outputs, inputs=(self.input,)).to_form(form)


def _missing(z: Float[Array, " r2"], args: tuple) -> Float[Array, " r2"]:
    """Balance under the complex force ``z[-2] + j z[-1]`` times the linear one, and how far the response is off.

    The held response keeps the phase 0: it is the force that turns through a resonance, the joints hardly move.
    """
    plan, joints, line, row, direct, linear, wanted, at = args
    F = linear * (z[-2] + 1j * z[-1])
    q = wanted * plan.complex(z[:-2])
    f = joint_forces(joints, q, line.omega, plan.harmonics, plan.samples)
    missing = residual(plan, q, joints, line._replace(u=F * line.u)) / wanted
    off = (F * direct - row @ f[:, at]) / wanted - 1
    return jnp.concatenate([plan.real(missing), jnp.stack([off.real, off.imag])])


@eqx.filter_jit
def _hold(plan: Plan, joints: tuple[Joint, ...], R: Receptances, wanted: Array) -> tuple[Array, Array, Array]:
    at = plan.harmonics.index(1)
    u = jnp.zeros(R.joints.shape[:3], complex).at[:, at].set(R.driven[:, :, 0])
    # output 0 is the one that is held
    linear = wanted / R.direct[:, 0, 0]

    def advance(z: Array, line: tuple) -> tuple[Array, tuple[Array, Array, Array]]:
        G, u, omega, rows, direct, linear = line
        args = (plan, joints, Line(G, u, omega), rows[at, 0], direct[0, 0], linear, wanted, at)
        solver = optx.Dogleg(rtol=1e-12, atol=1e-14, linear_solver=lx.AutoLinearSolver(well_posed=None))
        z = optx.root_find(_missing, solver, z, args, max_steps=80, throw=False).value
        F, q = linear * (z[-2] + 1j * z[-1]), wanted * plan.complex(z[:-2])
        f = joint_forces(joints, q, omega, plan.harmonics, plan.samples)
        X = (F * direct[:, 0] - rows[at] @ f[:, at]) * jnp.abs(F) / F
        return z, (jnp.abs(F), X, jnp.max(jnp.abs(_missing(z, args))))

    start = jnp.concatenate([plan.real(linear[0] * u[0].T) / wanted, jnp.array([1.0, 0.0])])
    _, answer = jax.lax.scan(advance, start, (R.joints, u, R.omega, R.outputs, R.direct, linear))
    return answer


def constant_response(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    freq: Any,
    amplitude: Any,
    *,
    held: str,
    input: str,
    outputs: Sequence[str] | None = None,
    harmonics: int | tuple[int, ...] = 1,
    samples: int = SAMPLES,
) -> ControlledResponse:
    """Force that holds the fundamental displacement of a DoF at an amplitude, line by line; differentiable.

    At constant amplitude a single joint acts as a linear one, so that resonance peaks neither bend nor jump.

    Parameters
    ----------
    amplitude
        Fundamental displacement of the DoF ``held`` [m].
    input
        DoF at which the force acts.
    outputs
        DoFs whose motion is wanted; all by default.
    harmonics, samples
        As for :func:`modalax.simulate.harmonic_balance`.

    Raises
    ------
    ValueError
        If the amplitude is not above 0, joints and places differ in number, or a name or harmonic cannot be used.
    """
    freq, amplitude = as_double(freq, "freq"), as_double(amplitude, "amplitude")
    check_axis(freq)
    if not is_traced(amplitude) and not bool(amplitude > 0):
        raise ValueError(f"amplitude is {float(amplitude):g} m; it must be above 0")
    plan = make_plan(joints, places, harmonics, samples)
    names = dof_names(structure) if outputs is None else as_names(outputs)
    b, o, i = (directions(structure, p) for p in (places, [[n] for n in (held, *names)], [[input]]))
    R = receptances(structure, b, 2 * jnp.pi * freq, o, i, plan.harmonics)
    force, X, left = _hold(plan, tuple(joints), R, amplitude)
    return ControlledResponse(freq, force, X[:, 1:], left, names, input)
