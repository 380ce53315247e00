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

from modalax._numerics.checks import as_array, as_double
from modalax.model.modal import ModalModel
from modalax.model.receptance import AnyStructure, Modified, directions, seen_at
from modalax.model.structure import Structure
from modalax.simulate.aft import Harmonics, joint_forces
from modalax.simulate.balance import CLOSED, Plan, make_plan
from modalax.simulate.joints import Joint
from modalax.simulate.overview import of_backbone

COMPLEX = 0.05
"""Largest imaginary part of a mode shape of a modal model, relative to the shape, that is neglected."""


class Backbone(eqx.Module):
    """Frequency, damping and motion of a non-linear mode as functions of its amplitude.

    Attributes
    ----------
    amplitude
        Fundamental of the modal coordinate, for a mass-normalised shape, shape ``(a,)`` [m sqrt(kg)].
    frequency_hz, damping_ratio
        Of the mode at that amplitude, shape ``(a,)`` [Hz], [-].
    q
        Displacement harmonics across the joints, shape ``(a, j, h)`` [m].
    modal
        Displacement harmonics of all modes of the linear structure, mass-normalised, shape ``(a, n, h)`` [m sqrt(kg)].
    residual
        Residual of the balance, relative to the amplitude, shape ``(a,)`` [-].
    harmonics
        Which harmonics.
    """

    amplitude: Float[Array, " a"]
    frequency_hz: Float[Array, " a"]
    damping_ratio: Float[Array, " a"]
    q: Complex[Array, "a j h"]
    modal: Complex[Array, "a n h"]
    residual: Float[Array, " a"]
    harmonics: Harmonics = eqx.field(static=True)

    def __str__(self) -> str:
        """How frequency and damping change over the amplitude."""
        return of_backbone(self)

    @property
    def converged(self) -> Bool[Array, " a"]:
        """Whether the balance is solved at each amplitude, shape ``(a,)``."""
        return self.residual < CLOSED

    @property
    def loss(self) -> Float[Array, " a"]:
        r"""Energy that joints and damping take in each cycle [J], shape ``(a,)``.

        What the artificial damping puts in, :math:`2\pi\zeta\omega^2\sum_k k^2\|\eta_k\|^2` over the harmonics k.
        """
        square = (jnp.asarray(self.harmonics) ** 2 * jnp.abs(self.modal) ** 2).sum(axis=(1, 2))
        return 2 * jnp.pi * self.damping_ratio * (2 * jnp.pi * self.frequency_hz) ** 2 * square

    def force(self, shape: Any) -> Float[Array, " a"]:
        r"""Amplitude of the force that holds each amplitude at phase resonance [N], shape ``(a,)``.

        A sine force a quarter cycle ahead of the displacement u where it acts puts in :math:`\pi F|u_1|` a cycle, which
        must be what is lost.

        Parameters
        ----------
        shape
            Mass-normalised mode shapes of the linear structure where the force acts, shape ``(n,)`` [1/sqrt(kg)].

        Raises
        ------
        ValueError
            If there is no component for each mode.
        """
        shape = as_double(shape, "shape")
        if shape.shape != self.modal.shape[1:2]:
            raise ValueError(f"shape is {shape.shape}; the backbone holds {self.modal.shape[1]} modes")
        return self.loss / (jnp.pi * jnp.abs(self.modal[:, :, self.harmonics.index(1)] @ shape))


class _Modes(NamedTuple):
    """The structure in its real modes, shapes mass-normalised.

    Attributes
    ----------
    square
        Squares of circular frequencies, shape ``(n,)`` [rad^2/s^2].
    damping, hysteretic
        Viscous and structural damping between the modes, shape ``(n, n)`` [1/s], [1/s^2].
    part
        Motion across the joints in each mode, shape ``(n, j)`` [1/sqrt(kg)].
    static
        Compliance of modes left out, between the joints, shape ``(j, j)`` [m/N].
    """

    square: Array
    damping: Array
    hysteretic: Array
    part: Array
    static: Array


def _modes_of(structure: Structure | ModalModel, places: Sequence[Sequence[str]], most: int | None) -> _Modes:
    """The lowest ``most`` modes; a modal model's residual terms become free-body modes and static compliance."""
    if isinstance(structure, Structure):
        square, shapes = scipy.linalg.eigh(np.asarray(structure.K), np.asarray(structure.M))
        square, shapes = square[:most], shapes[:, :most]
        b = np.asarray(directions(structure, places))
        C, D = (shapes.T @ np.asarray(A) @ shapes for A in (structure.C, structure.D))
        return _Modes(*(as_array(A) for A in (square, C, D, shapes.T @ b.T, np.zeros((len(b), len(b))))))
    small = seen_at(structure, sorted({dof for place in places for dof in place}))
    b = np.asarray(directions(small, places))
    poles, shapes, driven = (np.asarray(a)[:most] for a in (small.poles, small.shapes, small.participation))
    # residues of a real mode are phi phi^T / (2 j omega_d)
    top = np.argmax(np.abs(shapes), axis=1)[:, None]
    driven, seen = (np.take_along_axis(a, top, axis=1) for a in (driven, shapes))
    phi = shapes * np.sqrt(2j * poles.imag[:, None] * driven / seen)
    turned = np.abs(phi.imag).max(axis=1) / np.abs(phi).max(axis=1)
    if turned.max() > COMPLEX:
        worst = int(np.argmax(turned))
        raise ValueError(
            f"the shape of mode {worst + 1} has an imaginary part of {100 * turned[worst]:.2g} % at the joints; a "
            f"backbone needs real modes (at most {100 * COMPLEX:g} %), or matrices"
        )
    weight, free = np.linalg.eigh(b @ np.asarray(small.lower).real @ b.T)
    free = free[:, weight > 1e-12 * weight.max()] * np.sqrt(weight[weight > 1e-12 * weight.max()])
    square = np.concatenate([np.abs(poles) ** 2, np.zeros(free.shape[1])])
    damping = np.diag(np.concatenate([-2 * poles.real, np.zeros(free.shape[1])]))
    part = np.concatenate([phi.real @ b.T, free.T])
    upper = b @ np.asarray(small.upper).real @ b.T
    return _Modes(*(as_array(A) for A in (square, damping, np.zeros_like(damping), part, upper)))


def _missing(y: Float[Array, " r"], args: tuple) -> Float[Array, " r"]:
    """Balance of the joints' motion over the amplitude, and of the mode itself over its stiffness."""
    return _balance(y, args)[0]


def _balance(y: Float[Array, " r"], args: tuple) -> tuple[Float[Array, " r"], Complex[Array, "n h"]]:
    """Residual of the balance, and the motion of all modes."""
    plan, mode, joints, modes, a = args
    own = modes.square[mode]
    omega, zeta = jnp.sqrt(own) * y[-2], y[-1]
    q = a * plan.complex(y[:-2])
    f = joint_forces(joints, q, omega, plan.harmonics, plan.samples)
    others = np.delete(np.arange(len(modes.square)), mode)
    rows, motion, balance = [], [], jnp.zeros((), complex)
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
        motion.append(eta)
        rows.append(q[:, h] - modes.part.T @ eta + modes.static @ f[:, h])
    joint_part = plan.real(jnp.stack(rows, axis=1)) / a
    return jnp.concatenate([joint_part, jnp.stack([balance.real, balance.imag])]), jnp.stack(motion, axis=1)


@eqx.filter_jit
def _follow(
    plan: Plan, mode: int, joints: tuple[Joint, ...], modes: _Modes, amplitudes: Array
) -> tuple[Array, Array, Array]:
    start = jnp.zeros(plan.size + 2).at[-2].set(1.0)
    start = start.at[jnp.arange(plan.joints) * len(plan.harmonics) + plan.harmonics.index(1)].set(modes.part[mode])

    def advance(y: Array, a: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        args = (plan, mode, joints, modes, a)
        solution = optx.root_find(
            _missing, optx.Dogleg(rtol=1e-12, atol=1e-14, linear_solver=lx.AutoLinearSolver(well_posed=None)), y, args,
            max_steps=60, throw=False, adjoint=optx.ImplicitAdjoint(),
        )  # fmt: skip
        y = solution.value
        missing, motion = _balance(y, args)
        return y, (y, motion, jnp.max(jnp.abs(missing)))

    return jax.lax.scan(advance, start, amplitudes)[1]


def backbone(
    structure: AnyStructure,
    joints: Sequence[Joint],
    places: Sequence[Sequence[str]],
    mode: int,
    amplitudes: Any,
    *,
    harmonics: int | tuple[int, ...] = 1,
    samples: int = 128,
    modes: int | None = None,
) -> Backbone:
    """Follow one mode over rising amplitudes by the extended periodic motion concept.

    Parameters
    ----------
    structure
        Matrices, or a modal model of real modes (of nearly real ones the real part is taken).
    mode
        Number of the mode of the linear structure, from 1 (free-body modes of a modal model, which are residual terms,
        are not counted).
    amplitudes
        Fundamentals of the modal coordinate (mass-normalised shape), rising from where the joints are nearly linear,
        shape ``(a,)`` [m sqrt(kg)].
    modes
        How many modes of the structure take part; all by default.

    Raises
    ------
    ValueError
        If there is no such mode, an amplitude is not above 0, joints and places differ in number, or the modes of a
        modal model are complex.
    """
    if isinstance(structure, Modified):
        raise ValueError(
            "a backbone needs matrices or a modal model; make local changes in the matrices (add_spring, ...)"
        )
    amplitudes = as_double(amplitudes, "amplitudes")
    if not bool(jnp.all(amplitudes > 0)):
        raise ValueError(f"amplitudes hold {float(jnp.min(amplitudes)):g}; they must be above 0")
    plan = make_plan(joints, places, harmonics, samples)
    taken = _modes_of(structure, places, modes)
    count = len(taken.square)
    if not 1 <= mode <= count:
        raise ValueError(f"mode {mode} asked for; modes are counted from 1 to {count}")
    ys, modal, left = _follow(plan, mode - 1, tuple(joints), taken, amplitudes)
    q = amplitudes[:, None, None] * jax.vmap(plan.complex)(ys[:, :-2])
    frequency = ys[:, -2] * jnp.sqrt(taken.square[mode - 1]) / (2 * np.pi)
    return Backbone(amplitudes, frequency, ys[:, -1], q, modal, left, plan.harmonics)
