"""``diagnose``: a measurement and a simulation in, what is wrong and what it gains to mend it out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax._numerics.checks import require_double
from modalax._numerics.programs import release_programs
from modalax.data import FRF, Measurement
from modalax.diagnose.causes import catalogue, imitators
from modalax.diagnose.causes.base import Cause, UndampedCause
from modalax.diagnose.comparison import Comparison, causes_of, empty, make_comparison, with_noise_beside
from modalax.diagnose.decision.detection import Detection, detect
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.decision.posterior import Ranked, evidence, posterior
from modalax.diagnose.decision.verdict import _verdict
from modalax.diagnose.extend import ExtendedSimulation, extend
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.holdout import Gain, measure
from modalax.diagnose.result import Diagnosis, Naming
from modalax.diagnose.screening.every_cause import Screening, chosen, screen_all
from modalax.diagnose.screening.score_state import ScoreState, score_state_of
from modalax.diagnose.search.candidates import best_of_each
from modalax.diagnose.search.compounds import FURTHER, Rest, exchanged, one_more_cause, rest_of
from modalax.diagnose.search.imitator_check import apart, imitations, likeness
from modalax.diagnose.search.singles import PATIENT, fit_single, from_home, joints_for_drifts
from modalax.model import ModalModel, Structure

NEAR = 12.0  # nats behind the best up to which hypotheses are fitted again where complex modes are exact
DEEPEST = 3  # causes in one answer
CENTRED = 3  # times that complex modes are made exact about what was fitted


def diagnose(
    measurement: Measurement | FRF,
    simulation: Structure | ModalModel | ExtendedSimulation,
    *,
    question: str = "auto",
    causes: Sequence[Cause] | None = None,
) -> Diagnosis:
    """Find what a simulation gets wrong, name the cause, extend the simulation and measure the gain.

    Parameters
    ----------
    measurement
        Runs of FRFs, of any form; force levels [N] where joints are in question.
    simulation
        What was expected; its DoFs hold all measured ones by name. An extended simulation keeps what it has, at the
        parameters it has, and what is found comes on top.
    question
        ``fixed``: does the data agree with *this* simulation, within the spread its author claims? ``free``: does any
        linear modal model explain the data? ``auto`` takes ``free`` for a modal fit (a modal model with residual
        terms), else ``fixed``.
    causes
        What to look for; the whole catalogue if None.

    Returns
    -------
    Diagnosis
        With ``to_dict()``, the extended simulation, and residuals before and after.

    Raises
    ------
    ValueError
        If double precision is off, a measured DoF is not in the simulation, or the data holds too few lines.
    """
    require_double("diagnose")
    release_programs()
    comparison = with_noise_beside(make_comparison(measurement, simulation, question))
    default = catalogue(comparison.problem.data.shape[0])
    doubted = imitators() if causes is None else ()
    naming = name(comparison, causes_of(causes, comparison, default), causes_of(None, comparison, doubted))
    gain = measure(naming.comparisons, naming.null, naming.best)
    naming = _if_it_predicts(naming, gain)
    found, (alone, comparison) = naming.best, naming.comparisons
    n_out, n_in = comparison.problem.channels
    cut = lambda a: a[:, : comparison.problem.lines, :n_out, :n_in]  # noqa: E731
    unit = (2j * np.pi * comparison.scene.freq[:, None, None]) ** {"receptance": 0, "mobility": 1, "accelerance": 2}[
        comparison.measurement.form
    ]
    return Diagnosis(
        naming.verdict, naming, comparison, extend(comparison, found) if found.causes else None,
        gain, comparison.scene.freq,
        cut(alone.residual(naming.null)), cut(comparison.residual(found)),
        alone.prediction(naming.null) * unit, comparison.prediction(found) * unit,
    )  # fmt: skip


def _if_it_predicts(naming: Naming, gain: Gain) -> Naming:
    """Several causes together can imitate a third thing on what they are fitted to, but hardly predict it elsewhere."""
    if naming.verdict != "named" or len(naming.best.causes) < 2 or not gain.fails:
        return naming
    said = (
        f"fitted without {gain.held_out}, {' and '.join(c.slug for c in naming.best.causes)} leave a chi-square of "
        f"{gain.chi2_after:.2f} a sample there, fitted with it {gain.chi2_within:.2f}: something else that they imitate"
    )
    return replace(naming, verdict="unknown", notes=(*naming.notes, said))


@dataclass(frozen=True)
class Look:
    """The simulation alone beside the data: what it leaves, what the causes would explain of that, and the chance.

    Where dampers couple the modes, ``again`` is the same with complex modes exact about the parameters fitted to that.
    """

    comparison: Comparison
    null: Hypothesis
    omnibus: Omnibus
    state: ScoreState
    screening: Screening
    detection: Detection
    again: "Look | None" = None


def look(comparison: Comparison, causes: Sequence[Cause]) -> Look:
    """Whether anything is wrong at all."""
    first = _look(comparison, causes)
    if not first.detection.anything or comparison.problem.modal_form.mixing is None or not comparison.nuisance.active:
        return first
    # complex modes follow undamped ones to first order only: what that leaves is no finding
    about = comparison
    for _ in range(CENTRED):
        about = about.centred(about.fit([empty(comparison)], ROUNDS)[0])
    again = _look(about, causes)
    return replace(first, again=again) if again.detection.anything else again


def _look(comparison: Comparison, causes: Sequence[Cause]) -> Look:
    null = comparison.fit([empty(comparison)], ROUNDS)[0]
    before = omnibus(comparison.residual(null), comparison.live(), comparison.noise.freedom)
    state = score_state_of(comparison, null)
    screening = screen_all(comparison, null, causes, state)
    found = detect(screening.trials, state.sides, before, comparison.noise.spread)
    return Look(comparison, null, before, state, screening, found)


def name(comparison: Comparison, causes: Sequence[Cause], imitators: Sequence[Cause] = ()) -> Naming:
    """Search the causes; ``imitators`` have no name, but may explain better what is about to be named."""
    first = look(comparison, causes)
    null, before, state, screening, detection = first.null, first.omnibus, first.state, first.screening, first.detection
    if not detection.anything:
        return Naming("clean", [], null, screening, detection, before, before, (first.comparison, first.comparison))
    samples = comparison.problem.samples

    def weigh(found: list[Hypothesis]) -> list[Ranked]:
        each = best_of_each(found, comparison)
        return posterior([(h, evidence(h, comparison.scene, samples, null.chi2)) for h in each])

    found = _singles(comparison, first, causes)
    found += joints_for_drifts(comparison, null, best_of_each(found, comparison), causes, state)
    ranked = weigh(found)
    if not ranked or ranked[0].best.chi2 > null.chi2 - 9.0:
        return Naming("unknown", [], null, screening, detection, before, before, (comparison, comparison))
    alone, comparison = comparison, comparison.centred(ranked[0].best)
    if comparison is not alone:
        near = [r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - NEAR and r.best.hum is None]
        found = comparison.fit(near, PATIENT) + [h for h in found if not any(h is other for other in near)]
        ranked = weigh(found)
    rests: dict[int, tuple[Hypothesis, Rest]] = {}  # the hypothesis is kept, so that its number stays its own

    def rest(h: Hypothesis) -> Rest:
        if id(h) not in rests:
            rests[id(h)] = h, rest_of(comparison, h, null, causes)
        return rests[id(h)][1]

    for depth in range(2, DEEPEST + 1):
        more = one_more_cause(comparison, ranked, rest)
        found += more
        ranked = weigh(found)
        if not more or len(ranked[0].names) < depth:
            break
        # the first cause was found while the second still hid its like
        found += exchanged(comparison, ranked[0].best, lambda h: rest(h).trials, FURTHER)
        ranked = weigh(found)
    last = rest(ranked[0].best)
    verdict, notes = _verdict(ranked, last.p_value), ()
    hum = ranked[0].best.hum is not None and bool(ranked[0].best.causes)
    if verdict != "ambiguous" and imitators and not hum:
        ranked, nameless = apart(weigh(found + imitations(comparison, null, state, ranked[0].best, imitators)))
        likelier = sum(r.probability for r in nameless) > 0.5
        verdict, notes = "unknown" if likelier else _verdict(ranked, last.p_value), likeness(nameless)
    return Naming(verdict, ranked, null, screening, detection, before, last.omnibus, (alone, comparison), notes)


def _singles(comparison: Comparison, first: Look, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Single causes, fitted."""
    found = fit_single(comparison, first.null, chosen(first.screening.trials), first.state)
    found += from_home(comparison, first.null, causes)
    if first.again is not None:  # a modal parameter far off is found where the modes follow it exactly
        other = first.again
        some = [t for t in chosen(other.screening.trials) if isinstance(t.cause, UndampedCause)]
        found += fit_single(other.comparison, other.null, some, other.state) if some else []
    return found
