r"""Comparison of joint laws on a test at several levels, fitted together with linear modes that are not known either.

A linear fit of a jointed structure is itself bent by the joint, even at the lowest level. Here everything is fitted
together: the laws, the modes (frequency, damping, complex size in each output) and the residual terms. Where the motion
across the joint was measured, the laws are first evaluated at that motion, so that no equation has to be solved and no
jump of the response is in the way (equation error); only then at the motion that the model predicts itself.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array, require_double
from modalax.data import Measurement
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.fitting.hypothesis import bounds_of, from_search, slopes, split, to_search
from modalax.diagnose.overview import of_explained
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.setup.modal_form import modal_form_of
from modalax.diagnose.setup.problem import Problem
from modalax.model import ModalModel

STARTS = 3  # rows of each law's grid that a fit starts from
TRIED = 9  # best starts that are fitted at the measured motion
KEPT = 2  # fits that go on from the measured motion to the predicted one
NEWTON = 40  # steps to a mode at an amplitude
FIXED = 1e-9  # relative change that is granted to linear modes that stay as they are
BLOCK = 8  # neighbouring lines whose errors may go together


@dataclass(frozen=True)
class Explained:
    """Laws fitted together with the linear modes.

    Attributes
    ----------
    extended
        The simulation with the laws, everything refitted; its ``spread`` holds standard deviations.
    chi2, samples, unknowns
        Sum of squared whitened residuals, real samples, fitted numbers.
    probability
        Among the sets compared, by Schwarz's criterion; the noise scaled so that the best set leaves no more than it.
    residual
        Whitened, complex, shape ``(run, f, o, i)``.
    vector, covariance
        All unknowns as searched and their covariance, robust against errors that go together over ``BLOCK``
        neighbouring lines (Liang and Zeger 1986, Biometrika 73:13).
    """

    extended: ExtendedSimulation
    chi2: float
    samples: int
    unknowns: int
    probability: float
    residual: np.ndarray
    vector: np.ndarray
    covariance: np.ndarray

    def __str__(self) -> str:
        """Laws with their sizes, and how probable they are among those compared."""
        return of_explained(self)

    @property
    def slugs(self) -> tuple[str, ...]:
        """The laws by name; empty for the linear model."""
        return self.extended.slugs

    @property
    def criterion(self) -> float:
        """Schwarz's criterion (1978, Ann. Statist. 6:461); smaller is better."""
        return self.chi2 + self.unknowns * float(np.log(self.samples))


class Measured(JointCause):
    """A law evaluated at the measured motion: its parameters are those of the law, and the amplitudes."""

    def __init__(self, law: Any):
        self.by = law
        self.parameters = law.parameters

    def impedance(self, A: Array, omega: Array, p: Any) -> Array:
        """Describing function at the measured amplitude, whatever ``A``."""
        return self.by.impedance(p[1] + 0 * A, omega, p[0])


@dataclass(frozen=True)
class Task:
    """Data, places and the linear model that a search starts from; ``whole`` counts the runs that are held out too."""

    problem: Problem
    whole: Problem
    base: ModalModel
    motion: np.ndarray
    scene: Scene
    place: Place
    lowest_hz: float


def compare_laws(
    measurement: Measurement, simulation: ModalModel, laws: Sequence[Sequence[Cause]], *, place: str | Sequence[str],
    sigma: Any, full: int | None = None, held_out: Sequence[int] = (), starts: Sequence[np.ndarray] = (),
) -> list[Explained]:  # fmt: skip
    r"""Fit sets of laws of one joint together with the linear modes, and rank them.

    Parameters
    ----------
    measurement
        Runs at several levels, with ``force`` where it was recorded line by line.
    simulation
        Modes to start from; their residues and the residual terms are free.
    laws
        Sets of joint causes; an empty set is the linear model.
    place
        DoF between which and the ground the joint acts, or the two that it joins; with one mode in the band, any joint
        acts like one to the ground up to the scale of forces and displacements. They must be measured.
    sigma
        Standard deviation of each complex sample in the measurement's unit, shape ``(run, f, o, i)`` or fewer axes:
        what no law can be asked to explain, the repeatability of the test included.
    full
        How many sets, the best at the measured motion, are fitted at the predicted motion; all if None.
    held_out
        Runs that are not fitted; ``residual`` has them all the same.
    starts
        Of one set: all unknowns as searched to start from, in the place of a grid over the laws' sizes.

    Raises
    ------
    ValueError
        If double precision is off, the simulation is no modal model, the place was not measured or has no scale (it
        is no input), or a cause is no joint.
    """
    require_double("compare_laws")
    strange = [c.slug for c in itertools.chain(*laws) if not isinstance(c, JointCause)]
    if strange:
        raise ValueError(f"{strange[0]} is no law of a joint; compare_laws takes joint causes only")
    task = joint_task(measurement, simulation, place, sigma, held_out)
    first: dict[tuple[Any, ...], list[Any]] = {}
    for s in sorted((tuple(s) for s in laws), key=len):
        first[s] = _at_measured_motion(task, s, list(starts) or starts_of(task, s, first))
    order = sorted(first, key=lambda s: first[s][0].cost + 0.5 * len(first[s][0].x) * np.log(task.problem.samples))
    found = [_at_own_motion(task, s, first[s]) for s in order[:full]]
    found.sort(key=lambda e: e.criterion)
    scale = max(1.0, found[0].chi2 / max(found[0].samples - found[0].unknowns, 1))
    value = np.array([e.chi2 / scale + e.unknowns * np.log(e.samples) for e in found])
    weight = np.exp(-0.5 * (value - value.min()))
    told = [_with_probability(e, float(w)) for e, w in zip(found, weight / weight.sum(), strict=True)]
    return sorted(told, key=lambda e: -e.probability)


def _with_probability(e: Explained, p: float) -> Explained:
    return Explained(**{**vars(e), "probability": p})


def joint_task(
    measurement: Measurement, simulation: ModalModel, place: str | Sequence[str], sigma: Any,
    held_out: Sequence[int] = (),
) -> Task:  # fmt: skip
    """Lay out what a search for laws needs; parameters and errors as :func:`compare_laws` has them."""
    if not isinstance(simulation, ModalModel):
        raise ValueError(f"compare_laws starts from a ModalModel, not from a {type(simulation).__name__}")
    ends = (place,) if isinstance(place, str) else tuple(place)
    missing = [e for e in ends if e not in measurement.outputs]
    if missing:
        raise ValueError(f"the motion at {missing[0]!r} was not measured; outputs are {', '.join(measurement.outputs)}")
    freq = np.asarray(measurement.freq)
    modal_form = modal_form_of(simulation, float(freq[0]))
    if not modal_form.scaled:
        raise ValueError("the modal model has no DoF that is output and input, so that joints have no scale")
    unit = (2j * np.pi * freq[:, None, None]) ** DERIVATIVES[measurement.form]
    H = np.asarray(measurement.H) / unit
    weight = np.sqrt(2) / (np.broadcast_to(np.asarray(sigma, float), H.shape) / np.abs(unit))
    force = measurement.level[:, None] + 0 * measurement.freq if measurement.force is None else measurement.force
    whole = Problem(
        2 * jnp.pi * measurement.freq, as_array(H), as_array(weight), as_array(force),
        jnp.array([modal_form.index(n) for n in measurement.outputs]),
        jnp.array([modal_form.index(n) for n in measurement.inputs]), modal_form, len(freq), H.shape[2:],
    )  # fmt: skip
    fitted = ~np.isin(np.arange(len(H)), held_out)
    zeta = np.asarray(modal_form.damping / (2 * np.sqrt(modal_form.stiffness)))
    scene = Scene(
        freq, modal_form.dofs, measurement.outputs, measurement.inputs, modal_form.frequency_hz, zeta,
        np.asarray(force)[fitted].max(axis=1), modal_form,
    )  # fmt: skip
    across = H[:, :, measurement.outputs.index(ends[0])]
    if len(ends) > 1:
        across = across - H[:, :, measurement.outputs.index(ends[1])]
    index = (*(modal_form.index(e) for e in ends), *(() if len(ends) > 1 else (-1,)), 0)
    return Task(
        whole.weighted(weight * fitted[:, None, None, None]), whole, simulation,
        np.asarray(force)[:, :, None] * np.abs(across), scene, Place(ends, index), float(freq[0]),
    )  # fmt: skip


def linear_unknowns(problem: Problem) -> int:
    """Unknowns of the linear part: two per mode, a complex size per mode and output, a complex constant per channel."""
    n, (o, i) = len(problem.modal_form.poles), problem.data.shape[2:]
    return 2 * n + 2 * n * o + 2 * o * i


def _placed(problem: Problem, x: Array) -> tuple[Problem, Array]:
    """The problem with sizes and residual terms from the linear unknowns, and the changes of the poles."""
    n, (o, i) = len(problem.modal_form.poles), problem.data.shape[2:]
    theta = x[: 2 * n].reshape(2, n)
    parts = x[2 * n : 2 * n + 2 * n * o].reshape(2, n, o)
    far = x[2 * n + 2 * n * o :].reshape(2, o, i) * _size(problem)
    modal_form, out = problem.modal_form, problem.outputs
    shapes = modal_form.shapes.at[:, out].set(modal_form.shapes[:, out] * (1 + parts[0] + 1j * parts[1]))
    upper = modal_form.upper.at[jnp.ix_(out, problem.inputs)].add(far[0] + 1j * far[1])
    return eqx.tree_at(lambda p: (p.modal_form.shapes, p.modal_form.upper), problem, (shapes, upper)), theta


def _size(problem: Problem) -> Array:
    return jnp.sqrt(jnp.mean(jnp.abs(problem.data) ** 2))


def _unpack(causes: tuple[Cause, ...], x: Any) -> list[Any]:
    return [from_search(c, u) for c, u in zip(causes, split(causes, x), strict=True)]


def _whitened(causes: Any, index: Any, x: Array, problem: Problem, motion: Any) -> Array:
    count = x.shape[0] - linear_unknowns(problem)
    params = _unpack(causes, x[:count])
    problem, theta = _placed(problem, x[count:])
    if motion is not None:
        params = [(p, motion) for p in params]
    H = predict(causes, index, (None,) * len(causes), params, theta, problem)
    r = problem.weight * (H - problem.data)
    return jnp.stack([r.real, r.imag])


@partial(jax.jit, static_argnums=0)
def _value(causes, index, x, problem, motion):
    return _whitened(causes, index, x, problem, motion).ravel()


@partial(jax.jit, static_argnums=0)
def _slope(causes, index, x, problem, motion):
    return jax.jacfwd(lambda x: _whitened(causes, index, x, problem, motion).ravel())(x)


def solve(
    task: Task, causes: tuple[Any, ...], x: np.ndarray, motion: Any, steps: int, *, modes_free: bool = True
) -> Any:  # fmt: skip
    """Least squares from one start, at the measured motion if it is given; the modes free or as they are."""
    low, high = bounds_of(causes)
    free = np.full(linear_unknowns(task.problem), np.inf if modes_free else FIXED)
    bounds = np.concatenate([low, -free]), np.concatenate([high, free])
    index = np.array([task.place.index] * len(causes), dtype=np.int64).reshape(-1, 3)
    return scipy.optimize.least_squares(
        lambda x: np.nan_to_num(np.asarray(_value(causes, index, x, task.problem, motion)), nan=1e6, posinf=1e6),
        np.clip(x, bounds[0] + 1e-12, bounds[1] - 1e-12),
        lambda x: np.nan_to_num(np.asarray(_slope(causes, index, x, task.problem, motion))),
        bounds=bounds, x_scale="jac", max_nfev=steps,
    )  # fmt: skip


def _rows(task: Task, cause: Any) -> list[np.ndarray]:
    """A few sizes of a law to start from, in the variables of the search."""
    grid = cause.grid(task.scene, task.place)
    grid = grid[np.abs(grid[:, 0]) > np.abs(grid[:, 0]).max() * 5e-3]
    pick = np.unique(np.linspace(0, len(grid) - 1, STARTS).round().astype(int))
    return [to_search(cause, grid[k]) for k in pick]


def starts_of(task: Task, causes: tuple[Any, ...], solved: dict[tuple[Any, ...], list[Any]]) -> list[np.ndarray]:
    """The laws at a few sizes in all combinations, and each joining a fit of the others; ``solved`` holds such fits."""
    linear = linear_unknowns(task.problem)
    plain = [np.concatenate([*row, np.zeros(linear)]) for row in itertools.product(*(_rows(task, c) for c in causes))]
    joined = []
    for k, cause in enumerate(causes):
        rest = causes[:k] + causes[k + 1 :]
        if rest not in solved:
            continue
        x = solved[rest][0].x
        cut = sum(len(c.parameters) for c in rest[:k])
        joined += [np.concatenate([x[:cut], row, x[cut:]]) for row in _rows(task, cause)]
    return [*joined, *plain]


def _at_measured_motion(task: Task, causes: tuple[Any, ...], starts: Sequence[np.ndarray]) -> list[Any]:
    """Fits at the measured motion, the best first."""
    known = tuple(Measured(c) for c in causes)
    index = np.array([task.place.index] * len(causes), dtype=np.int64).reshape(-1, 3)
    miss = [np.sum(np.asarray(_value(known, index, x, task.problem, task.motion)) ** 2) for x in starts]
    fits = [solve(task, known, starts[k], task.motion, 60) for k in np.argsort(miss)[:TRIED]]
    return sorted(fits, key=lambda f: f.cost)


def _at_own_motion(task: Task, causes: tuple[Any, ...], fits: list[Any]) -> Explained:
    """Continue the fits from the measured motion to the motion that the model predicts."""
    best = min((solve(task, causes, f.x, None, 80) for f in fits[:KEPT]), key=lambda f: f.cost)
    r, J, x, problem = best.fun, best.jac, best.x, task.problem
    samples = problem.samples
    covariance = _robust(J, r, problem)
    count = len(x) - linear_unknowns(problem)
    placed, theta = _placed(problem, as_array(x[count:]))
    form, channels = placed.modal_form, (task.base.outputs, task.base.inputs)
    at = [jnp.array([form.dofs.index(n) for n in names]) for names in channels]
    base = task.base.replace(
        shapes=form.shapes[:, at[0]],
        upper=form.upper[jnp.ix_(*at)],
        participation=task.base.participation,
    )
    params = [np.asarray(p) for p in _unpack(causes, x[:count])]
    std = np.sqrt(np.maximum(np.diag(covariance)[:count], 0.0))
    spread = [s * np.abs(slopes(c, p)) for s, p, c in zip(split(causes, std), params, causes, strict=True)]
    extended = ExtendedSimulation(
        base, tuple(map(jnp.asarray, params)), tuple(map(jnp.asarray, spread)), theta, (None,) * len(causes), causes,
        (task.place,) * len(causes), task.scene.outputs, task.scene.inputs, task.lowest_hz,
    )  # fmt: skip
    index = np.array([task.place.index] * len(causes), dtype=np.int64).reshape(-1, 3)
    real, imag = np.asarray(_value(causes, index, x, task.whole, None)).reshape(2, *problem.data.shape)
    return Explained(extended, float(r @ r), samples, len(x), np.nan, real + 1j * imag, x, covariance)


def _robust(J: np.ndarray, r: np.ndarray, problem: Problem) -> np.ndarray:
    """Sandwich covariance: products of gradient and residual summed over blocks of neighbouring lines."""
    runs, lines = problem.data.shape[:2]
    part = (J * r[:, None]).reshape(2, runs, lines, -1, J.shape[1]).sum(axis=(0, 3))
    sums = np.concatenate([part[:, k : k + BLOCK].sum(axis=1) for k in range(0, lines, BLOCK)])
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-100)
    inner = np.linalg.pinv((J / scale).T @ (J / scale))
    few = len(sums) / max(len(sums) - J.shape[1], 1)
    return few * inner @ ((sums / scale).T @ (sums / scale)) @ inner / np.outer(scale, scale)


def modes_at(explained: Explained, amplitude: Any) -> tuple[Float[np.ndarray, "2 n a"], Float[np.ndarray, "2 n a"]]:
    r"""Frequency [Hz] and damping ratio of every mode at amplitudes across the joint [m], and standard deviations.

    The roots s of :math:`1 + N(A, \mathrm{Im}\,s)\,b^T H(s) b = 0`, by Newton's method from the linear poles: the
    modes of the structure with the joint replaced by what it does to the fundamental at that amplitude. Standard
    deviations by first-order propagation of everything that was fitted.

    Returns
    -------
    tuple
        Values and standard deviations, each of shape ``(2, mode, amplitude)``.
    """
    extended = explained.extended
    modal_form = modal_form_of(extended.base, extended.lowest_hz)
    amplitude = jnp.asarray(amplitude, jnp.float64)
    index = extended.places[0].index[0] if extended.places else 0
    own = int(sum(len(c.parameters) for c in extended.causes))
    n, o = len(modal_form.poles), len(extended.outputs)
    column = extended.outputs.index(modal_form.dofs[index])

    def roots(x: Array) -> tuple[Array, Array]:
        params = _unpack(extended.causes, x[:own])
        change = x[own : own + 2 * n].reshape(2, n)
        parts = x[own + 2 * n : own + 2 * n + 2 * n * o].reshape(2, n, o)
        fitted = as_array(explained.vector)[own + 2 * n : own + 2 * n + 2 * n * o].reshape(2, n, o)
        turn = (1 + parts[0] + 1j * parts[1]) / (1 + fitted[0] + 1j * fitted[1])
        k = modal_form.stiffness * jnp.exp(2 * change[0])
        c = modal_form.damping * jnp.exp(change[0] + change[1])
        R = modal_form.shapes[:, index] * turn[:, column] * modal_form.participation[:, index]
        a, b = (R + R.conj()).real, -(R * modal_form.poles.conj() + R.conj() * modal_form.poles).real

        def equation(s: Array, A: Array) -> Array:
            across = jnp.sum((a * s + b) / (s**2 + c * s + k))
            N = sum(cause.impedance(A, s.imag, p) for cause, p in zip(extended.causes, params, strict=True))
            return 1 / (1e-300 + across) + N

        def newton(s: Array, A: Array) -> Array:
            step = 1e-6 * jnp.abs(s)
            value, beside = equation(s, A), jax.lax.stop_gradient(equation(s + step, A))
            return s - value * step / (beside - jax.lax.stop_gradient(value))

        def solve(s: Array, A: Array) -> Array:
            # the last step, from a point that counts as fixed, carries the derivatives
            root = jax.lax.fori_loop(0, NEWTON, lambda _, s: newton(s, A), s)
            return newton(jax.lax.stop_gradient(root), A)

        # beside the pole, where the receptance is infinite
        start = (-0.5 * c + 1j * jnp.sqrt(jnp.maximum(k - 0.25 * c**2, 0.0))) * (1 + 1e-4)
        s = jax.vmap(lambda s: jax.vmap(lambda A: solve(s, A))(amplitude))(start)
        made = jnp.stack([jnp.abs(s) / (2 * jnp.pi), -s.real / jnp.abs(s)])
        return made, made

    J, value = map(np.asarray, jax.jit(jax.jacfwd(roots, has_aux=True))(as_array(explained.vector)))
    return value, np.sqrt(np.maximum(np.einsum("mnap,pq,mnaq->mna", J, explained.covariance, J), 0.0))
