r"""Modal parameters beside a free force at one place.

With the force :math:`q` of every line free, what the residual r shows of the modal parameters :math:`\theta`, in units
of their claimed spread, is what is left of it at right angles to the whitened responses :math:`d` to that force,

.. math:: \chi^2 = |P(r - J\theta)|^2 + |\theta|^2, \qquad P = I - \frac{d\,d^H}{|d|^2},

with J the change, by the parameters, of the whitened FRF with the force in it. The minimum is found by steps of Gauss
and Newton (variable projection in the form of Kaufman 1975, BIT 15:49).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax._numerics.checks import as_array
from modalax._numerics.compiler import lightly
from modalax.diagnose.causes.scene import Place, across
from modalax.diagnose.causes.signals import ModalTerms
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.fitting.residual import complex_of, modal_directions
from modalax.diagnose.prediction.frf import gains_of
from modalax.diagnose.screening.products import gains_and_ends
from modalax.diagnose.setup.problem import Problem

SHARES = (1.0, 0.5, 0.25, 0.1)  # of a step, tried one after the other
ENOUGH = 1.0  # change of chi-square at which steps end
STEPS = 6  # at most
Direction = Callable[["Beside"], tuple[Any, ...]]  # a direction, and its change by the modal parameters if it has any


@dataclass(frozen=True)
class Beside:
    """The simulation with its modes at some modal parameters, beside the data.

    Attributes
    ----------
    theta
        Modal parameters in units of their spread, shape ``(2, n)``.
    change
        Whitened data less prediction, shape ``(run, f, o, i)``.
    slopes
        Change of the whitened prediction by each parameter, shape ``(2 n, run, f, o, i)``; none where modes are exact.
    gains
        Of the modes and their conjugates, shape ``(f, m)`` each [s].
    shapes, participation
        Of the modes, shape ``(m, dof)`` each.
    weight
        Shape ``(run, f, o, i)`` [1/m N].
    """

    comparison: Comparison
    theta: np.ndarray
    change: np.ndarray
    slopes: np.ndarray
    gains: tuple[np.ndarray, np.ndarray]
    shapes: np.ndarray
    participation: np.ndarray
    weight: np.ndarray

    @classmethod
    def nominal(cls, comparison: Comparison) -> "Beside":
        """At the modal parameters of the simulation."""
        return cls.at(comparison, np.zeros((2, comparison.problem.modal_form.stiffness.shape[0])))

    @classmethod
    def at(cls, comparison: Comparison, theta: np.ndarray) -> "Beside":
        """Evaluate at modal parameters."""
        problem, nuisance, scene = comparison.problem, comparison.nuisance, comparison.scene
        n_out, n_in = problem.channels
        cut = (slice(None), slice(problem.lines), slice(n_out), slice(n_in))
        weight = np.asarray(problem.weight)[cut]
        change = weight * (np.asarray(problem.data)[cut] - comparison.prediction(Hypothesis(theta=theta)))
        slopes = np.zeros((0, *change.shape), complex)
        if nuisance.active:
            J = np.asarray(modal_directions(theta, nuisance.spread, None, problem))
            slopes = complex_of(J, problem.data.shape[0])[(slice(None), *cut)]
        form = problem.modal_form
        both, shapes, part = map(
            np.asarray, gains_and_ends(form, as_array(scene.omega), as_array(theta * nuisance.spread))
        )
        half = both.shape[1] // 2
        return cls(comparison, theta, change, slopes, (both[:, :half], both[:, half:]), shapes, part, weight)

    def along(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        """Modal displacement across a place, and participation of a force there, shape ``(m,)`` each."""
        return across(self.shapes, place), across(self.participation, place)

    def between(self, psi: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Receptance from forces of some participation to displacements of some shapes, ``(f, *)``."""
        u, v = self.gains
        return u @ (psi * part) + v @ (psi * part).conj()

    def direction(self, place: Place) -> np.ndarray:
        """Whitened response of the outputs to a force across a place, shape ``(run, f, o, i)``."""
        _, part = self.along(place)
        out = np.asarray(self.comparison.problem.outputs)[: self.change.shape[2]]
        return self.weight * self.between(self.shapes[:, out], part[:, None])[:, :, None]

    def turned(self, place: Place) -> np.ndarray:
        """Change of that response by each modal parameter, ``(2 n, run, f, o, i)``; none where modes are exact."""
        if not len(self.slopes):
            return self.slopes
        out = np.asarray(self.comparison.problem.outputs)[: self.change.shape[2]]
        J = self._by_parameters(lambda psi, part: across(part, place)[..., None] * psi[..., out])
        return self.weight * J[:, None, ..., None]

    def across_by_parameters(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        """Change of :meth:`motion` and :meth:`drive` by each modal parameter, ``(2 n, f, i)`` and ``(2 n, f)``."""
        inputs = np.asarray(self.comparison.problem.inputs)[: self.change.shape[3]]
        motion = self._by_parameters(lambda psi, part: across(psi, place)[..., None] * part[..., inputs])
        drive = self._by_parameters(lambda psi, part: (across(psi, place) * across(part, place))[..., None])
        return motion, drive[..., 0]

    @cached_property
    def _by_modes(self) -> "ByModes":
        problem = self.comparison.problem
        omega = as_array(self.comparison.scene.omega)
        return ByModes(*map(np.asarray, _by_modes(self.theta, self.comparison.nuisance.spread, omega, problem)))

    def _by_parameters(self, residues: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """Change of receptances by each modal parameter, ``(2 n, f, x)``, of residues of shapes and participation."""
        by, n = self._by_modes, self.theta.shape[1]
        X = residues(self.shapes, self.participation)
        made = [(G[:, :n, None] * X + G[:, n:, None] * X.conj()).swapaxes(0, 1) for G in (by.k_gains, by.c_gains)]
        if by.shapes is None or by.participation is None:  # each parameter is of one mode
            own = [np.diagonal(a, axis1=1, axis2=2)[:, :, None, None] for a in (by.k, by.c)]
            return (own[0] * made[0] + own[1] * made[1]).reshape(2 * n, *made[0].shape[1:])
        flat = lambda a: a.reshape(2 * n, n)
        J = np.tensordot(flat(by.k), made[0], 1) + np.tensordot(flat(by.c), made[1], 1)
        # the residues are products, whose change is that of either factor
        moved = residues(self.shapes, by.participation) + residues(by.shapes, self.participation)
        dX = np.moveaxis(moved, 2, 0).reshape(n, -1)
        more = (self.gains[0] @ dX + self.gains[1] @ dX.conj()).reshape(-1, 2 * n, J.shape[2])
        return J + more.swapaxes(0, 1)

    def motion(self, place: Place) -> np.ndarray:
        """Displacement across a place for each input, shape ``(f, i)`` [m/N]."""
        psi, _ = self.along(place)
        inputs = np.asarray(self.comparison.problem.inputs)[: self.change.shape[3]]
        return self.between(psi[:, None], self.participation[:, inputs])

    def drive(self, place: Place) -> np.ndarray:
        """Receptance across a place, shape ``(f,)`` [m/N]."""
        psi, part = self.along(place)
        return self.between(psi, part)

    def fault(self, output: int) -> np.ndarray:
        """Direction of anything at one output, shape ``(run, f, o, i)``."""
        return self.weight * (np.arange(self.change.shape[2]) == output)[:, None]

    def of_mode(self, mode: int) -> np.ndarray:
        """Direction of any amplitude of one mode, shape ``(run, f, o, i)``."""
        out = np.asarray(self.comparison.problem.outputs)[: self.change.shape[2]]
        return self.weight * self.shapes[mode, out][:, None]

    def linear(self, d: np.ndarray, turned: Any = 0.0) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        r"""Chi-square beside a free amplitude a along a direction, and how it changes with the modal parameters.

        It is :math:`\chi^2 - 2g^T\delta + \delta^T A\delta` after a step :math:`\delta`, and the amplitude
        :math:`a - Q\delta`. ``turned`` is the change of the direction by each modal parameter.

        Returns
        -------
        tuple
            :math:`\chi^2`, g of shape ``(2 n,)``, A of shape ``(2 n, 2 n)`` and Q of shape ``(2 n, run, f, i)``.
        """
        length = np.maximum((np.abs(d) ** 2).sum(axis=2, keepdims=True), 1e-300)

        def along(x: np.ndarray) -> np.ndarray:
            return (d.conj() * x).sum(axis=-2, keepdims=True) / length

        amplitude = along(self.change)
        slopes = self.slopes + turned * amplitude
        Q = along(slopes)
        J, r = (slopes - d * Q).reshape(len(slopes), -1), (self.change - d * amplitude).ravel()
        now = self.theta.ravel()
        g = (J.conj() @ r).real - now
        chi2 = float((np.abs(r) ** 2).sum() + now @ now)
        return chi2, g, (J.conj() @ J.T).real + np.eye(len(J)), Q[..., 0, :]

    def step(self, d: np.ndarray, turned: Any = 0.0) -> tuple[float, float, np.ndarray]:
        """Chi-square that a free amplitude along a direction leaves, that promised by one step, and the step.

        ``turned`` is the change of the direction by each modal parameter.
        """
        if not len(self.slopes):
            length = np.maximum((np.abs(d) ** 2).sum(axis=2, keepdims=True), 1e-300)
            aside = self.change - d * ((d.conj() * self.change).sum(axis=2, keepdims=True) / length)
            left = float((np.abs(aside) ** 2).sum())
            return left, left, np.zeros(self.theta.shape)
        here, g, A, _ = self.linear(d, turned)
        move = np.linalg.solve(A, g)
        return here, here - float(move @ g), move.reshape(self.theta.shape)

    def settled(self, direction: Direction, steps: int) -> "tuple[float, Beside]":
        """Chi-square and modes beside a free amplitude, after steps that each leave less; others are shortened."""
        now, (here, _, move) = self, self.step(*direction(self))
        for _ in range(steps):
            for share in SHARES:
                other = Beside.at(self.comparison, now.theta + share * move)
                there, _, next_move = other.step(*direction(other))
                if there < here:
                    break
            else:
                break
            done = here - there < ENOUGH
            now, here, move = other, there, next_move
            if done:
                break
        return here, now


class ByModes(NamedTuple):
    """Changes of the modes by each modal parameter, and of their gains by stiffness and damping.

    Attributes
    ----------
    k_gains, c_gains
        Change of the gains of the modes and their conjugates by each mode's own, shape ``(f, m)``.
    k, c
        Change of each mode's stiffness and damping, shape ``(2, n, n)``: parameters, then modes.
    shapes, participation
        Change of these, shape ``(2, n, n, dof)``; None where they do not.
    """

    k_gains: np.ndarray
    c_gains: np.ndarray
    k: np.ndarray
    c: np.ndarray
    shapes: np.ndarray | None = None
    participation: np.ndarray | None = None


@partial(jax.jit, compiler_options=lightly(0))
def _by_modes(theta: Array, spread: Array, omega: Array, problem: Problem) -> tuple[Array, ...]:
    form = problem.modal_form
    follow = form.mixing is not None
    made = lambda t: form.adapted(t * spread)[: 4 if follow else 2]
    k, c = made(theta)[:2]
    parameters_first = lambda J: jnp.moveaxis(J, (-2, -1), (0, 1))

    def gains(k: Array, c: Array) -> Array:
        modes = ModalTerms(k[None], c[None], form.hysteresis[None])
        return gains_of(1j * omega, modes, form.poles, [], follow)[0]

    one, none = jnp.ones_like(k), jnp.zeros_like(k)
    both = [jax.jvp(gains, (k, c), along)[1] for along in ((one, none), (none, one))]
    return *both, *map(parameters_first, jax.jacfwd(made)(theta))


def modes_beside(
    comparison: Comparison, places: Sequence[Place], refined: int, late: Deadline = NEVER,
    known: Sequence[tuple[Place, float, Beside]] = (),
) -> list[tuple[Place, float, Beside]]:  # fmt: skip
    """Each place with the chi-square that a free force leaves, and the modes beside it; the likeliest are settled.

    Parameters
    ----------
    comparison
        Data and simulation.
    places
        Where a force may act.
    refined
        How many of the places, the best by one step, are settled; at others the modes stay nominal.
    late
        From when on no further place is looked at; those that are left out are not returned.
    known
        What this has returned with fewer of them settled, which is gone on with.
    """
    nominal = Beside.nominal(comparison)
    if not known:
        steps = ((nominal.step(nominal.direction(p), nominal.turned(p)), p) for p in places if not late())
        first = sorted(steps, key=lambda one: one[0][1])
        known = [(place, here, nominal) for (here, _, _), place in first]
    out = []
    for k, (place, here, beside) in enumerate(known):
        if k < refined and comparison.nuisance.active and not beside.theta.any() and not late():
            out.append((place, *nominal.settled(lambda b, p=place: (b.direction(p), b.turned(p)), STEPS)))
        else:
            out.append((place, here, beside))
    return out
