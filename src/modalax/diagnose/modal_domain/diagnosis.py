"""The diagnosis in the modal domain: what to ask about, in which order, and what is left of the data then."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.decision.beyond import held_out_verdict, lines_verdict, one_missed
from modalax.diagnose.decision.levels import outweighing
from modalax.diagnose.decision.omnibus import omnibus
from modalax.diagnose.modal_domain.answer import Facts, ModalDiagnosis
from modalax.diagnose.modal_domain.causes.change import UNITS, Change, with_sizes
from modalax.diagnose.modal_domain.corrected import extension_of, frf_of, inaccuracy_said, inaccuracy_told
from modalax.diagnose.modal_domain.fitting.attempts import explains
from modalax.diagnose.modal_domain.fitting.explanation import NONE
from modalax.diagnose.modal_domain.fitting.fit import fit, without_causes
from modalax.diagnose.modal_domain.fitting.outlying import outlying_said
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.fitting.throughout import throughout_said, throughout_told
from modalax.diagnose.modal_domain.held_out import gain_of
from modalax.diagnose.modal_domain.judged import judge, of_the_joint, on_its_lines, standing_out
from modalax.diagnose.modal_domain.levels.answer import judge_levels
from modalax.diagnose.modal_domain.levels.seen import at_levels, drift_by_run
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.odd_channels.misplaced import moved, other_places
from modalax.diagnose.modal_domain.records.forced import Forced, force_beside, force_said
from modalax.diagnose.modal_domain.records.mains import lines_without_hum, mains_hum
from modalax.diagnose.modal_domain.records.own_peaks import mass_of_sensor, own_peaks, without_output
from modalax.diagnose.modal_domain.records.short_records import short_record
from modalax.diagnose.modal_domain.records.swept import fast_sweep
from modalax.diagnose.modal_domain.stage import Stage, identified, posed, run_stage
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.identify.shared_noise import shared_notes

OF_MODES = (
    "the simulation is given as modes: what modes above its last add to each FRF is taken from the measurement, and a "
    "change of one of its elements is told as general inaccuracy, or as the spring or mass that comes nearest to it"
)
AS_STIFF = "loss", "N/m"  # how the size of a joint that loses energy is told: its force over the displacement
ROUNDS = 3  # most in which a force, and the structure without it, are looked for


@dataclass(frozen=True)
class _Task:
    """What measurements are compared with, until when, which causes are wanted, and who is told each step."""

    simulation: Simulation
    late: Deadline
    wanted: Callable[[str], bool]
    tell: Callable[[str], None]


def diagnose_modes(
    measurement: Measurement, simulation: Simulation, *, late: Deadline | None = None,
    wanted: Callable[[str], bool] = lambda _: True, tell: Callable[[str], None] = lambda _: None,
    measured: Measured | None = None,
) -> ModalDiagnosis | None:  # fmt: skip
    """Diagnose in the modal domain; None where the measurement shows no mode to compare.

    ``measured`` is the measurement as :func:`identified`, where that is known.
    """
    task = _Task(simulation, late or Deadline(), wanted, tell)
    found = _asked(measurement, task, measured)
    if found is None or found.hum is None or task.late():
        return found
    tell("looking beside the lines that hold mains hum")
    less = measurement.lines(lines_without_hum(found.freq, found.residual_after))
    again = _asked(less, replace(task, wanted=lambda slug: slug != "mains_hum" and wanted(slug)), None)
    return found if again is None or again.verdict == "unknown" or task.late() else again.beside_hum(found.hum)


def _asked(measurement: Measurement, task: _Task, measured: Measured | None) -> ModalDiagnosis | None:
    """The diagnosis of all that is known to show in other ways than in modes alone, one after the other."""
    late, tell = task.late, task.tell
    ended = _short_record(measurement, task)
    if ended is None:
        measured = measured or identified(measurement, task.simulation, tell)
        sweeps = task.wanted("fast_sweep")
        ended = fast_sweep(measurement, task.simulation, measured, late, tell) if sweeps else None
    if ended is not None or measured is None:
        return _diagnosed(measurement, task, ended)
    moved_there, plain = _elsewhere(measurement, task, measured)
    if moved_there is not None:
        return moved_there
    found = _beside_own_peaks(measurement, task, measured) or plain or _diagnosed(measurement, task, measured=measured)
    alone = isinstance(task.simulation, ModesOnly)  # which end at some mode: lines are never explained to the last
    if found is None or late() or alone or found.after.p_value > THRESHOLDS.left_by_modes:
        return found
    if found.verdict in ("clean", "named") and found.gain.chi2_unforeseen < THRESHOLDS.as_noise:
        return found  # it foretells what it was not fitted to: a force would stand for errors that no element holds
    rest: ModalDiagnosis | None = found
    nats = None
    for _ in range(ROUNDS):  # the modes without the force are known once it is
        forced = None if rest is None else force_beside(rest.stage, measurement, task.wanted, late, tell)
        if forced is None:
            return found
        nats = forced.nats if nats is None else nats
        forced = replace(forced, nats=nats)
        rest = _diagnosed(measurement, task, forced)
        if rest is None or rest.after.p_value > THRESHOLDS.left_by_modes or late():
            break
    if rest is None or (found.verdict == "named" and _named(found) <= _named(rest)):
        return found  # beside what is named already a small force may stand for an error of no element
    better = rest.verdict != "unknown" and rest.after.z < found.after.z
    return rest if better else found


def _short_record(measurement: Measurement, task: _Task) -> Forced | None:
    """What a record that ended too early adds to the FRFs."""
    if not task.wanted("leakage"):
        return None
    highest = 2 * np.pi * float(measurement.freq[-1])
    c = coordinates_of(task.simulation, measurement.outputs, measurement.inputs, highest)
    return short_record(measurement, c, task.tell)


def _beside_own_peaks(measurement: Measurement, task: _Task, measured: Measured) -> ModalDiagnosis | None:
    """The diagnosis beside the mass of one sensor, where its output has peaks of its own and a mass explains them."""
    if not task.wanted("sensor_mass") or isinstance(task.simulation, ModesOnly):  # whose coordinates are the channels'
        return None
    if len(measured.runs) < len(np.asarray(measurement.H)):  # levels that differ bend peaks, of some outputs more
        return None
    which = own_peaks(measured, len(measurement.outputs), len(measurement.inputs))
    if which is None:
        return None
    task.tell(f"looking for the mass of a sensor at {measurement.outputs[which]}, whose peaks are its own")
    stage = run_stage(without_output(measurement, which), task.simulation, task.late, task.wanted, task.tell)
    if stage is not None and _explains_all(stage, posed(measurement, task.simulation, measured).setting):
        return None  # a structure that is changed much may have modes that one output hardly shows
    forced = None if stage is None else mass_of_sensor(stage, measurement, measured, which, task.late)
    return None if forced is None else _diagnosed(measurement, task, forced)


def _explains_all(stage: Stage, whole: Setting) -> bool:
    """Whether what explains the modes of some outputs explains those of all, ``whole``, too."""
    best = stage.best.fit
    if any(c.in_channels for c in best.causes):
        return False
    setting = replace(stage.setting, coordinates=whole.coordinates, features=whole.features, whitener=whole.whitener)
    found = fit(setting, best.causes, without_causes(best), best.u, temperatures=(3.0,))
    return found is not None and explains(found)


def _elsewhere(
    measurement: Measurement, task: _Task, measured: Measured
) -> tuple[ModalDiagnosis | None, ModalDiagnosis | None]:  # fmt: skip
    """The diagnosis with outputs at other DoFs than their names, where some surely are and it explains the modes.

    And that with all where they say, if it was asked for; either None.
    """
    if not task.wanted("sensor_place") or not len(measured.features.poles):
        return None, None
    simulation = task.simulation
    setting = posed(measurement, simulation, measured).setting
    places = other_places(setting, simulation.dofs, measurement.outputs)
    plain = fit(setting) if places else None
    if plain is None:
        return None, None
    other = _diagnosed(measurement, task, measured=measured)
    told = other if other is not None and other.verdict in ("named", "ambiguous") else None
    in_turn = any(at in places for at in places.values())  # sensors in each other's place may be an exchange
    exact = told is not None and (isinstance(simulation, ModesOnly) or told.after.p_value > THRESHOLDS.left_by_modes)
    named = told is not None and told.verdict == "named" and exact
    if task.late() or in_turn and named:
        return None, other
    task.tell(f"looking whether {' and '.join(f'{name} is at {at}' for name, at in places.items())}")
    renamed = measurement.replace(outputs=tuple(places.get(name, name) for name in measurement.outputs))
    names = {"outputs": measurement.outputs, "inputs": measurement.inputs}
    before = np.asarray(simulation.frf(measured.freq, form=measurement.form, **names).H)[None]
    found = _diagnosed(renamed, task, measured=measured, before=before)
    if found is None or found.verdict not in ("clean", "named"):
        return None, other
    among = len(measurement.outputs) * len(simulation.dofs)
    held = found.stage.explanations[0].log_posterior + believed("sensor_place")
    against = plain.log_evidence + math.log(NONE)
    if told is not None:  # what holds two points together has one move as the other
        against = max(against, told.stage.explanations[0].log_posterior)
    there = moved(places, held, against, among)
    if there.probability < THRESHOLDS.certain:
        return None, other
    return replace(found, verdict="named", moved=there, reasons=(there.said(), *found.reasons)), other


def _named(found: ModalDiagnosis) -> set[tuple[str, frozenset[str]]]:
    """What stands out, by name and place."""
    return {(c["name"], frozenset(map(str, c["where"]))) for c in found.causes}


def _missed_alone(stage: Stage, residual: np.ndarray, asked: bool) -> tuple[Stage, tuple[str, ...]]:
    """The stage with the only channel whose lines are not explained, and what is said of it; as it is if not asked."""
    if not asked or stage.odd is not None:
        return stage, ()
    each = np.abs(residual[stage.measured.runs]) ** 2 / 2
    channels = stage.measurement.outputs, stage.measurement.inputs
    odd = one_missed(each.mean(axis=(0, 1)), each.shape[0] * each.shape[1], stage.measured.misfit, *channels)
    return replace(stage, odd=odd), () if odd is None else (odd.said,)


def _joints_own(c: Change, u: np.ndarray) -> str:
    """A cause that is what a joint does at any level."""
    unit = UNITS.get(c.slug, AS_STIFF)[1]
    return f"{cause_at(c.slug, c.where)} of {c.size(u):.3g} {unit} counts as that joint's own at low amplitude"


def _diagnosed(
    measurement: Measurement, task: _Task, forced: Forced | None = None, measured: Measured | None = None,
    before: np.ndarray | None = None,
) -> ModalDiagnosis | None:  # fmt: skip
    """The diagnosis of what is left once a force that was found is taken out of the FRFs.

    ``before`` are the simulation's FRFs where its outputs have other names.
    """
    effect = 0.0 if forced is None else forced.effect
    less = measurement if forced is None else measurement.replace(H=np.asarray(measurement.H) - effect)
    stage = run_stage(less, task.simulation, task.late, task.wanted, task.tell, measured)
    if stage is None:
        return None
    judged = judge(stage)
    stage = replace(stage, odd=judged.odd)
    if stage.seen is None or stage.seen.joint is None:
        judged = replace(judged, chosen=on_its_lines(stage, judged.chosen))
    chosen, inaccuracy = judged.chosen, inaccuracy_told(stage.setting, judged.likeliest.fit)
    joined, further = judge_levels(stage.seen, stage.whole)
    # what a fit has learnt that failed, or that took a channel askew for errors of elements, is no finding
    explained = judged.likeliest.misfit <= THRESHOLDS.misfit and not (judged.odd is not None and judged.odd.along)
    throughout = throughout_told(stage.setting, judged.likeliest.fit) if explained else {}
    word = outweighing(judged.word, joined)
    likeliest = judged.likeliest.fit
    reasons = [inaccuracy_said(inaccuracy), *outlying_said(stage.setting, likeliest)] if explained else []
    reasons += [*throughout_said(throughout), *judged.reasons, *further]
    sized = with_sizes(chosen.causes, chosen.fit.u) if stage.whole is None else ()
    reasons += [_joints_own(c, u) for c, u in sized if of_the_joint(stage, c)]
    if word != "clean":
        reasons += [c.said() for c in standing_out(stage, chosen) if c.said()]
    if not stage.in_time:
        reasons.append("time was up before every explanation had been tried")
    task.tell("predicting the held-out data")
    H = np.asarray(measurement.H)
    predicted = [frf_of(stage, None) if before is None else before, frf_of(stage, chosen.fit)]
    before, seen = predicted[0] - effect, stage.seen
    predicted[1] = predicted[1] + effect
    level = np.asarray(measurement.level)
    if seen is not None and seen.joint is not None:
        predicted[1] = at_levels(seen, seen.joint, level)
    elif seen is not None:
        predicted[1] = predicted[1] + drift_by_run(seen, stage.measured, level)
    sigma = stage.measured.noise.sigma
    residuals = [np.sqrt(2) * (H - p) / sigma for p in predicted]
    tests = [omnibus(r, np.ones(r.shape, bool), stage.measured.noise.freedom) for r in residuals]
    gain = gain_of(stage, chosen, before)
    word, reasons = held_out_verdict(word, reasons, gain)
    left = float((np.abs(residuals[1][stage.measured.runs]) ** 2).mean() / 2)
    several = len(standing_out(stage, chosen)) > 1
    joint = seen is not None and seen.joint is not None
    by_joint = joint and joined in ("named", "ambiguous")
    word, reasons = lines_verdict(word, reasons, left, stage.measured.misfit, several, by_joint)
    stage, further = _missed_alone(stage, residuals[1], word == "unknown" and joined == "clean")
    reasons = (*reasons, *further)
    hum = mains_hum(measurement, stage.measured.freq, residuals[1], joint) if task.wanted("mains_hum") else None
    if hum is not None:
        word, reasons = outweighing(word, "named"), (*reasons, f"beside it there is mains hum: {hum.evidence}")
    notes = (
        *([OF_MODES] if isinstance(task.simulation, ModesOnly) else []),
        stage.measured.noise.source,
        f"{len(stage.measured.features.poles)} modes were identified in the band from "
        f"{len(stage.measured.runs)} of {len(H)} runs, chi-square per sample {stage.measured.misfit:.3g}",
        *shared_notes(stage.measured.shared),
    )
    if forced is not None:
        word = outweighing(word, "named" if forced.probability >= THRESHOLDS.certain else "ambiguous")
        reasons = (*reasons, force_said(forced))
    if forced is not None or hum is not None or (seen is not None and (seen.joint or seen.drift)):
        reasons = tuple(reason.replace("nothing stands", "nothing else stands") for reason in reasons)
    extended = extension_of(stage, chosen.fit, forced)
    shape = H.shape
    return ModalDiagnosis(
        word, reasons, None, Facts(measurement, notes), extended, gain,
        stage.measured.freq, residuals[0], residuals[1], np.broadcast_to(predicted[0], shape),
        np.broadcast_to(predicted[1], shape), stage, chosen, judged.sets, inaccuracy, throughout,
        tests[0], tests[1], hum, forced,
    )  # fmt: skip
