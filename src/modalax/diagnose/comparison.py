"""Comparison of a measurement with a simulation: the data that all steps of a diagnosis share."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from modalax._numerics.cuts import cut
from modalax.data import FRF, Measurement
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes.base import Cause, ElementCause, LinesCause, UndampedCause
from modalax.diagnose.causes.groups import GroupCause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import HumLines
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.fitting.gauss_newton import ROUNDS, fit_many
from modalax.diagnose.fitting.hypothesis import Hypothesis, searched
from modalax.diagnose.fitting.nuisance import WIDE, Nuisance, make_nuisance
from modalax.diagnose.fitting.residual import complex_of, free_basis, jacobian_of, residual_of
from modalax.diagnose.prediction.frf import NOWHERE, predicted
from modalax.diagnose.prediction.harmonics import with_harmonics
from modalax.diagnose.setup.modal_form import kept_coupling, modal_form_of
from modalax.diagnose.setup.noise import TRUSTED, Noise, noise_of
from modalax.diagnose.setup.problem import Held, Problem, make_problem, padded
from modalax.model import ModalModel, Structure

AGAIN = 2  # times that noise read off the lines is read again


@dataclass(frozen=True)
class Comparison:
    """Data, simulation, noise and nuisances.

    Attributes
    ----------
    measurement
        As receptances, without the line at 0 Hz.
    problem, pooled
        With the runs apart and together; ``rest`` is the chi-square between runs that pooling leaves out.
    scene
        What causes may look at.
    nuisance
        Modal parameters that may adapt; ``pooled_nuisance`` is the same for the pooled problem.
    question
        ``fixed`` or ``free``.
    notes
        Sentences for the answer.
    late
        When no further step of a search begins.
    only
        Places of elements and joints that are looked at; all if there are none.
    """

    measurement: Measurement
    simulation: Structure | ModalModel | ExtendedSimulation
    noise: Noise
    problem: Problem
    pooled: Problem
    rest: float
    scene: Scene
    nuisance: Nuisance
    pooled_nuisance: Nuisance
    question: str
    notes: tuple[str, ...]
    late: Deadline = NEVER
    only: tuple[Place, ...] = ()
    cache: dict[Any, Any] = field(default_factory=dict)

    def joint_places(self) -> list[Place]:
        """Places of elements and joints that are looked at."""
        return list(self.only) or self.scene.pairs()

    def side(self, per_run: bool) -> tuple[Problem, Nuisance, float]:
        """The problem and nuisance for causes that differ from run to run or not, and the chi-square to add."""
        return (self.problem, self.nuisance, 0.0) if per_run else (self.pooled, self.pooled_nuisance, self.rest)

    def fit(self, starts: Sequence[Hypothesis], rounds: int) -> list[Hypothesis]:
        """Fit hypotheses of any kinds; their chi-squares count all runs."""
        out: list[Hypothesis | None] = [None] * len(starts)
        for kind in {h.kind for h in starts}:
            which = [k for k, h in enumerate(starts) if h.kind == kind]
            problem, nuisance, rest = self.side(starts[which[0]].per_run)
            found = fit_many([starts[k] for k in which], problem, nuisance, rounds, self.late)
            for k, h in zip(which, found, strict=True):
                out[k] = replace(h, chi2=h.chi2 + rest)
        return [h for h in out if h is not None]

    def residual(self, h: Hypothesis) -> np.ndarray:
        """Whitened residual of a hypothesis, complex, shape ``(run, f, o, i)`` as padded."""
        return complex_of(self.real_residual(h), self.problem.data.shape[0])

    def real_residual(self, h: Hypothesis) -> np.ndarray:
        """Whitened residual of a hypothesis, real and imaginary parts, shape ``(o, i, run f 2)`` as padded."""
        return residual_of(self._predicted(h), self.nuisance.basis, self.problem)

    def slopes(self, h: Hypothesis) -> np.ndarray:
        """Derivatives of that by all unknowns of the causes as searched, shape ``(unknown, o, i, run f 2)``."""
        nuisance = self.nuisance
        at = h.causes, h.index, h.extras, searched(h), h.theta, nuisance.spread, nuisance.basis, self.problem
        return np.asarray(jacobian_of(*at))

    def chi2(self, h: Hypothesis) -> float:
        """Chi-square of a hypothesis at its parameters, that of the claimed spread of modal parameters included."""
        return float((np.abs(self.residual(h)) ** 2).sum() + (np.asarray(h.theta) ** 2).sum())

    def prediction(self, h: Hypothesis) -> np.ndarray:
        """Receptances of a hypothesis at the measured lines and channels, shape ``(run, f, o, i)``, unpadded."""
        H = self._predicted(h)
        n_out, n_in = self.problem.channels
        shape = (self.problem.data.shape[0], *H.shape[1:])
        return np.broadcast_to(H, shape)[:, : self.problem.lines, :n_out, :n_in]

    def _predicted(self, h: Hypothesis) -> np.ndarray:
        return predicted(h.causes, h.index, h.extras, h.params, h.theta * self.nuisance.spread, self.problem)

    def live(self) -> np.ndarray:
        """Which samples count, shape ``(run, f, o, i)`` as padded."""
        return np.asarray(self.problem.weight) > 0

    def without(self, lines: np.ndarray) -> "Comparison":
        """The comparison without some lines, those of hum."""
        mask = np.zeros(self.problem.data.shape[1], bool)
        mask[: len(lines)] = lines
        keep = np.where(mask, 0.0, 1.0)[None, :, None, None]
        return self.reweighted(np.asarray(self.problem.weight) * keep)

    def with_noise(self, noise: Noise) -> "Comparison":
        """The comparison with a better estimate of the noise."""
        order = DERIVATIVES[self.measurement.form]
        sigma = noise.sigma / (2 * np.pi * self.scene.freq[:, None, None]) ** order
        weight = np.zeros(self.problem.weight.shape)
        n_out, n_in = self.problem.channels
        weight[:, : self.problem.lines, :n_out, :n_in] = np.sqrt(2) / sigma
        weight = np.where(self.live(), weight, 0.0)
        return replace(self.reweighted(weight), noise=noise)

    def centred(self, h: Hypothesis) -> "Comparison":
        """The same with complex modes exact about the modal parameters, and the coupling kept, of a hypothesis.

        Where modes are not coupled nothing changes.
        """
        mixing, held = self.problem.modal_form.mixing, self.problem.held
        if mixing is None or self.question == "free":
            return self
        base = self.simulation.base if isinstance(self.simulation, ExtendedSimulation) else self.simulation
        about = h.theta * self.nuisance.spread + (0.0 if held is None else np.asarray(held.theta))
        every = list(zip(h.causes, h.index, h.params, strict=True))
        every += [] if held is None else list(zip(held.causes, held.index, held.params, strict=True))
        for cause, index, p in every:
            if isinstance(cause, UndampedCause):
                about = about + np.asarray(cause.undamped(*map(jnp.asarray, (about, index, p))))
        coupling = kept_coupling((cause, p) for cause, _, p in every)
        modal_form = padded(modal_form_of(base, float(self.scene.freq[0]), about, coupling))
        if modal_form.mixing is None:
            return self
        problem, pooled = (eqx.tree_at(lambda p: p.modal_form, p, modal_form) for p in (self.problem, self.pooled))
        return replace(self, problem=problem, pooled=problem if self.pooled is self.problem else pooled, cache={})

    def reweighted(self, weight: np.ndarray) -> "Comparison":
        """The comparison with other weights."""
        problem = self.problem.weighted(weight)
        pooled, rest = problem.pooled()
        free = self.question == "free"
        return replace(
            self, problem=problem, pooled=pooled, rest=rest, cache={},
            nuisance=replace(self.nuisance, basis=free_basis(problem) if free else None),
            pooled_nuisance=replace(self.pooled_nuisance, basis=free_basis(pooled) if free else None),
        )  # fmt: skip


def hum_of(cause: LinesCause, place: Place, comparison: Comparison, residual: np.ndarray) -> HumLines:
    """Find what hum at the mains frequency would explain of a residual.

    Parameters
    ----------
    place
        Fundamental frequency, as the first number of the place.
    residual
        Whitened, complex, shape ``(run, f, o, i)``.
    """
    lines = comparison.problem.lines

    def columns(x: np.ndarray) -> np.ndarray:
        """Shape ``(run i, o, f)``."""
        x = x.transpose(0, 3, 2, 1)
        return x.reshape(-1, *x.shape[2:])[..., :lines]

    r, live = columns(residual), columns(comparison.live())
    noise = comparison.noise
    return cause.explain(comparison.scene.freq, float(place.index[0]), r / noise.line_spread, live, noise.known)


def as_measurement(data: Measurement | FRF) -> Measurement:
    """Receptances without the line at 0 Hz, and a default force level where none is known.

    Raises
    ------
    ValueError
        If it is neither a measurement nor an FRF, or no line is left.
    """
    if isinstance(data, FRF):
        data = Measurement.from_frfs([data])
    if not isinstance(data, Measurement):
        raise ValueError(f"a measurement is a Measurement or an FRF, not a {type(data).__name__}")
    if data.ends[0] == 0:
        if len(data.freq) < 2:
            raise ValueError("the measurement holds only the line at 0 Hz; at least one other is needed")
        take = lambda a: None if a is None else cut(a, (slice(None), slice(1, None)))
        data = data.replace(
            freq=cut(data.freq, slice(1, None)), H=take(data.H), variance=take(data.variance),
            coherence=take(data.coherence), force=take(data.force),
        )  # fmt: skip
    return data


def make_comparison(
    data: Measurement | FRF, simulation: Structure | ModalModel | ExtendedSimulation, question: str = "auto"
) -> Comparison:
    """Prepare the comparison of a measurement with a simulation.

    Parameters
    ----------
    data
        Runs of FRFs of any form; a line at 0 Hz is left out.
    simulation
        A structure, a modal model or an extended simulation whose DoFs hold all measured ones by name.
    question
        ``auto``, ``fixed`` or ``free``, as :func:`~modalax.diagnose.diagnose` takes it.

    Raises
    ------
    ValueError
        If a measured DoF is not in the simulation, or ``question`` is not one of the three.
    """
    if question not in ("auto", "fixed", "free"):
        raise ValueError(f"question is {question!r}; it must be auto, fixed or free")
    measurement = as_measurement(data)
    freq = np.asarray(measurement.freq)
    base, held = _taken_apart(simulation, measurement)
    modal_form = modal_form_of(base, float(freq[0]), None if held is None else np.asarray(held.theta))
    level = np.asarray(measurement.level)
    notes = []
    if np.isnan(level).any():
        known = np.nanmedian(level) if np.isfinite(level).any() else 1.0
        level = np.where(np.isnan(level), known, level)
        notes.append(f"force levels unknown, taken as {known:g} N: thresholds of joints scale with that")
    force = level if measurement.force is None else np.asarray(measurement.force)
    asked, why = _question(question, base)
    notes.append(why)
    order = DERIVATIVES[measurement.form]
    unit = (2j * np.pi * freq[:, None, None]) ** order
    receptance = np.asarray(measurement.H) / unit
    zero = np.zeros(receptance.shape)
    draft = make_problem(
        freq, receptance, zero, force, measurement.outputs, measurement.inputs, modal_form, held, order
    )
    if draft.held is not None:
        assert isinstance(simulation, ExtendedSimulation)
        held = replace(draft.held, extras=_held_in_full(draft, simulation))
        draft = replace(draft, held=held)
    n_out, n_in = draft.channels
    still = np.zeros((2, draft.modal_form.stiffness.shape[0]))
    alone = predicted((), NOWHERE, (), (), still, draft)[0, : len(freq), :n_out, :n_in]
    noise = noise_of(measurement, alone * unit)
    notes.append(noise.source)
    sigma = noise.sigma / np.abs(unit)
    problem = make_problem(
        freq, receptance, sigma, force, measurement.outputs, measurement.inputs, modal_form, None, order
    )
    problem = replace(problem, held=draft.held)
    pooled, rest = problem.pooled()
    spread = np.stack([np.asarray(problem.modal_form.frequency_std), np.asarray(problem.modal_form.damping_std)])
    free = asked == "free"
    if free:
        live = np.abs(np.asarray(problem.modal_form.shapes)).max(axis=1) > 0
        spread = np.where(live, WIDE, 0.0) * np.ones((2, 1))
    nuisance = make_nuisance(spread, free_basis(problem) if free else None, problem)
    scene = Scene(
        freq, modal_form.dofs, measurement.outputs, measurement.inputs, modal_form.frequency_hz,
        np.asarray(modal_form.damping / (2 * np.sqrt(modal_form.stiffness))), level, modal_form, modal_form.scaled,
        measurement.form, _coupled(base),
    )  # fmt: skip
    return Comparison(
        measurement, simulation, noise, problem, pooled, rest, scene,
        nuisance, replace(nuisance, basis=free_basis(pooled) if free else None), asked, tuple(notes),
    )  # fmt: skip


def noise_beside(comparison: Comparison, h: Hypothesis) -> Noise | None:
    """Estimate missing variances from the residual of a fitted hypothesis; None where variances were given."""
    if comparison.noise.freedom >= TRUSTED or comparison.question == "free":
        return None
    order = DERIVATIVES[comparison.measurement.form]
    predicted = comparison.prediction(h) * (2j * np.pi * comparison.scene.freq[:, None, None]) ** order
    return noise_of(comparison.measurement, predicted)


def _coupled(simulation: Structure | ModalModel) -> np.ndarray | None:
    """Pairs of DoFs that the matrices of a structure couple; None if all are (condensed matrices) or none is known."""
    if not isinstance(simulation, Structure):
        return None
    K = np.abs(np.asarray(simulation.K))
    unit = np.sqrt(np.maximum(np.diag(K), 1e-300))
    coupled = K / unit[:, None] / unit[None] > 1e-6
    return None if coupled.all() else coupled


def _taken_apart(
    simulation: Structure | ModalModel | ExtendedSimulation, measurement: Measurement
) -> tuple[Structure | ModalModel, Held | None]:
    """Modes of a simulation and, of an extended one, its causes."""
    if not isinstance(simulation, ExtendedSimulation):
        return simulation, None
    faults = [c.slug for c in simulation.causes if c.on_measured_channels]
    channels = measurement.outputs, measurement.inputs
    if faults and channels != (simulation.outputs, simulation.inputs):
        raise ValueError(
            f"the extended simulation has {', '.join(faults)} on outputs {', '.join(simulation.outputs)} and inputs "
            f"{', '.join(simulation.inputs)}; the measurement has {', '.join(channels[0])} and {', '.join(channels[1])}"
        )
    index = jnp.array([p.index for p in simulation.places], dtype=jnp.int64).reshape(-1, 3)
    return simulation.base, Held(index, simulation.extras, simulation.params, simulation.theta, simulation.causes)


def _held_in_full(problem: Problem, simulation: ExtendedSimulation) -> tuple[Any, ...]:
    """What the causes of an extended simulation need besides parameters, the effect of a joint's harmonics included."""
    held = problem.held
    assert held is not None
    highest = simulation.harmonics or (1,) * len(held.causes)
    alone = replace(problem, held=None)
    return with_harmonics(held.causes, held.index, held.extras, held.params, held.theta, alone, highest)


def _question(question: str, simulation: Structure | ModalModel) -> tuple[str, str]:
    if question != "auto":
        return question, f"the {question.upper()} question was asked for"
    if isinstance(simulation, ModalModel) and simulation.fitted:
        return "free", (
            "the simulation is a modal fit (it has residual terms), so its modal parameters are free (FREE question): "
            "only what no linear modal model explains is named"
        )
    return "fixed", (
        "the data is held against this simulation and the spread its author claims (FIXED question); "
        "ask with question='free' for what no linear modal model explains"
    )


def causes_of(causes: Sequence[Cause] | None, comparison: Comparison, default: Sequence[Cause]) -> list[Cause]:
    """Choose the causes to look for: those given, or of the catalogue those that the question can see.

    Parameters
    ----------
    causes
        What the user asked for; None for the whole catalogue.
    default
        The catalogue; where only some places of joints are looked at, its elements and joints.
    """
    chosen: list[Cause] = list(default if causes is None else causes)
    if comparison.only:
        chosen = [c for c in chosen if isinstance(c, ElementCause)]
    chosen = [c for c in chosen if not isinstance(c, GroupCause)]
    held = comparison.problem.held
    if held is not None and any(c.only_one for c in held.causes):
        chosen = [c for c in chosen if not c.only_one]  # one record or sweep is what it is
    if comparison.question == "free" and causes is None:
        chosen = [c for c in chosen if c.visible_when_free or c.per_run]
    return chosen


def with_noise_beside(comparison: Comparison) -> Comparison:
    """The comparison with missing variances estimated from the residual of the fitted simulation."""
    for _ in range(AGAIN):
        noise = noise_beside(comparison, comparison.fit([empty(comparison)], ROUNDS)[0])
        if noise is None:
            return comparison
        comparison = comparison.with_noise(noise)
    return comparison


def empty(comparison: Comparison) -> Hypothesis:
    """The hypothesis without causes: the simulation alone."""
    return Hypothesis(theta=np.zeros((2, comparison.problem.modal_form.stiffness.shape[0])))
