"""The answer of the modal domain, with the interface of every other diagnosis."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax._numerics.text import percent
from modalax.check.finding import Finding
from modalax.data import Measurement
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.advice import advise_modes
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.decision.beyond import BeyondUsual, held_out_verdict, lines_verdict
from modalax.diagnose.decision.levels import outweighing
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.decision.sets import rivals
from modalax.diagnose.modal_domain.causes import UNITS, own_sizes, with_sizes
from modalax.diagnose.modal_domain.coordinates import coordinates_of
from modalax.diagnose.modal_domain.corrected import frf_of, inaccuracy_told
from modalax.diagnose.modal_domain.explanation import Explanation
from modalax.diagnose.modal_domain.extension import extension_of
from modalax.diagnose.modal_domain.fit import fit
from modalax.diagnose.modal_domain.forced import Forced, force_beside, force_rivals, force_said, force_told
from modalax.diagnose.modal_domain.held_out import gain_of
from modalax.diagnose.modal_domain.judged import inaccuracy_of_fit, judge, of_the_joint, on_its_lines, standing_out
from modalax.diagnose.modal_domain.levels.answer import causes_told, judge_levels, rivals_told
from modalax.diagnose.modal_domain.levels.explain import JointFound
from modalax.diagnose.modal_domain.levels.seen import at_levels, drift_by_run
from modalax.diagnose.modal_domain.mains import hum_told, mains_hum
from modalax.diagnose.modal_domain.measured import Measured
from modalax.diagnose.modal_domain.misplaced import Moved, moved, other_places
from modalax.diagnose.modal_domain.own_peaks import mass_of_sensor, own_peaks, without_output
from modalax.diagnose.modal_domain.prior import NONE
from modalax.diagnose.modal_domain.screen import errors_of
from modalax.diagnose.modal_domain.short_records import short_record
from modalax.diagnose.modal_domain.stage import Stage, identified, posed, run_stage
from modalax.diagnose.modal_domain.swept import fast_sweep
from modalax.diagnose.modal_domain.throughout import throughout_said, throughout_told
from modalax.diagnose.over_levels import levels_said
from modalax.diagnose.result import Diagnosis, within
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.identify.shared_noise import shared_notes
from modalax.model import Structure

ROUNDS = 3  # most in which a force, and the structure without it, are looked for


@dataclass(frozen=True)
class Facts:
    """What was compared: in the place of a comparison line by line."""

    measurement: Any
    question: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ModalDiagnosis(Diagnosis):
    """A diagnosis that also gives the general inaccuracy of the simulation.

    Attributes
    ----------
    stage
        Modes, candidates and explanations behind it.
    chosen
        The explanation that the answer is about.
    sets
        What stands out: the set of the answer first, the others by falling probability.
    inaccuracy
        Relative error of stiffness, mass and damping, each with an interval.
    throughout
        By how much stiffness, mass or damping of the simulation are too high throughout, with standard deviations;
        empty where none surely is.
    before, after
        Tests of what the simulation and the extended one leave.
    hum
        Mains hum, which shows on lines only; None where there is none.
    forced
        A force at one place that shows on lines only, without which everything else here is; None where there is none.
    moved
        Outputs that are at other DoFs than their names; None where all are where they should be.
    """

    found: None  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    comparison: Facts  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    stage: Stage
    chosen: Explanation
    sets: tuple[BeyondUsual, ...]
    inaccuracy: dict[str, Any]
    throughout: dict[str, dict[str, float]]
    before: Omnibus
    after: Omnibus
    hum: Finding | None = None
    forced: Forced | None = None
    moved: Moved | None = None

    @property
    def candidates(self) -> list[Any]:
        """Explanations by falling probability."""
        return self.stage.explanations

    @property
    def candidate_rows(self) -> list[tuple[str, float, float]]:
        """Name, probability and log evidence of each explanation."""
        return [
            (
                " and ".join(cause_at(c.slug, c.where) for c in e.causes) or "the general inaccuracy alone",
                e.probability, e.log_posterior,
            )
            for e in self.stage.explanations
        ]  # fmt: skip

    @property
    def joint(self) -> JointFound | None:
        """The joint that tells the force levels apart."""
        return None if self.stage.seen is None else self.stage.seen.joint

    @property
    def tests(self) -> tuple[Omnibus, Omnibus]:
        """What the simulation leaves, and what the extended one leaves."""
        return self.before, self.after

    @property
    def modes_in_band(self) -> np.ndarray:
        """Frequencies [Hz] and damping ratios of the simulation in the band, shape ``(2, n)``."""
        c = self.stage.coordinates
        w = np.maximum(c.frequencies, 1e-300)
        return within(np.stack([w / 2 / np.pi, np.diag(c.damping) / 2 / w]), self.freq)

    @property
    def _causes(self) -> list[dict[str, Any]]:
        """What stands out beyond the general inaccuracy."""
        if self.verdict == "clean":
            return []
        elsewhere = [] if self.moved is None else self.moved.told()
        levels = [] if self.stage.seen is None else causes_told(self.stage.seen, self.stage.whole)
        on_lines = [] if self.forced is None else [force_told(self.forced)]
        return elsewhere + self._linear + levels + on_lines + ([] if self.hum is None else [hum_told(self.hum)])

    @property
    def _linear(self) -> list[dict[str, Any]]:
        core, sure = standing_out(self.stage, self.chosen), self.sets[0].probability
        told, covariance, off = [], self.chosen.fit.covariance, inaccuracy_of_fit(self.stage, self.chosen)
        for k, (c, u) in enumerate(with_sizes(self.chosen.causes, self.chosen.fit.u)):
            if c not in core:
                continue
            own = own_sizes(self.chosen.causes, k)
            variance = covariance[own, own] + c.variance_beside(u, off)
            told += [{**each, "probability": float(min(sure, 1.0))} for each in c.told_each(u, variance)]
        return told

    @property
    def alternatives(self) -> list[list[dict[str, Any]]]:
        """Rivals of the leading set; of a named one those that are likely enough."""
        if self.verdict not in ("ambiguous", "named"):
            return []
        others = [] if self.stage.seen is None else rivals_told(self.stage.seen, self.verdict == "named")
        if self.forced is not None:
            others = force_rivals(self.forced, self.verdict == "named")
        if others:
            kept = [{"name": c["name"], "where": c["where"]} for c in self._linear]
            return [[*kept, *one] for one in others]
        joint = [] if self.stage.seen is None else causes_told(self.stage.seen, self.stage.whole)
        joint = joint if self.forced is None else [*joint, force_told(self.forced)]
        beside = [{"name": c["name"], "where": c["where"]} for c in joint]
        return [
            [{"name": slug, "where": list(where)} for slug, where in s.names] + beside
            for s in rivals(self.verdict, self.sets)
        ]

    @property
    def strength_parameters(self) -> dict[str, Parameter]:
        """What the strength of each cause is."""
        return {slug: Parameter(*UNITS[slug]) for slug in UNITS}

    @property
    def smallest_detectable(self) -> dict[str, float]:
        """Strength of each cause that nine in ten such measurements would have shown, at its median place."""
        every = errors_of(self.stage.setting, self.chosen.fit, self.stage.candidates)
        values: dict[str, list[float]] = {}
        for c, error in zip(self.stage.candidates, every, strict=True):
            if np.isfinite(error) and c.slug in UNITS and c.pattern is None:
                values.setdefault(c.slug, []).append(float(error) * c.scale)
        return {slug: float(np.median(v)) * (THRESHOLDS.stands_out + THRESHOLDS.power) for slug, v in values.items()}

    @property
    def advice(self) -> str | None:
        """What would tell the alternatives apart."""
        odd = self.stage.odd.name if self.stage.odd is not None and self.sets[0].names else None
        return advise_modes(self.verdict, len(self.alternatives), odd)

    def to_dict(self) -> dict[str, Any]:
        """The answer as plain data, in the agreed form."""
        return {
            "verdict": self.verdict,
            "causes": self.causes,
            "alternatives": self.alternatives,
            "advice": self.advice,
            "smallest_detectable": self.smallest_detectable,
            "inaccuracy": self.inaccuracy,
            "throughout": self.throughout,
            "reasons": [*self.reasons, *levels_said(self.verdict, self.evidence)],
            "gain": self.gain.to_dict(),
            "question": self.question,
            "notes": list(self.notes),
            "p_value": None,
            "evidence": self.evidence,
        }


def diagnose_modes(
    measurement: Measurement, simulation: Structure, *, question: str = "fixed", late: Deadline | None = None,
    wanted: Callable[[str], bool] = lambda _: True, tell: Callable[[str], None] = lambda _: None,
    measured: Measured | None = None,
) -> ModalDiagnosis | None:  # fmt: skip
    """Diagnose in the modal domain; None where the measurement shows no mode to compare.

    ``measured`` is the measurement as :func:`identified`, where that is known.
    """
    late = late or Deadline()
    ended = _short_record(measurement, simulation, wanted, tell)
    if ended is None:
        measured = measured or identified(measurement, simulation, tell)
        ended = fast_sweep(measurement, simulation, measured, late, tell) if wanted("fast_sweep") else None
    if ended is not None or measured is None:
        return _diagnosed(measurement, simulation, question, late, wanted, tell, ended)
    found = _elsewhere(measurement, simulation, question, late, wanted, tell, measured)
    if found is not None:
        return found
    found = _beside_own_peaks(measurement, simulation, question, late, wanted, tell, measured)
    found = found or _diagnosed(measurement, simulation, question, late, wanted, tell, measured=measured)
    if found is None or late() or found.after.p_value > THRESHOLDS.left_by_modes:
        return found
    if found.verdict in ("clean", "named") and found.gain.chi2_unforeseen < THRESHOLDS.as_noise:
        return found  # it foretells what it was not fitted to: a force would stand for errors that no element holds
    rest: ModalDiagnosis | None = found
    nats = None
    for _ in range(ROUNDS):  # the modes without the force are known once it is
        forced = None if rest is None else force_beside(rest.stage, measurement, wanted, late, tell)
        if forced is None:
            return found
        nats = forced.nats if nats is None else nats
        forced = replace(forced, nats=nats)
        rest = _diagnosed(measurement, simulation, question, late, wanted, tell, forced)
        if rest is None or rest.after.p_value > THRESHOLDS.left_by_modes or late():
            break
    if rest is None or (found.verdict == "named" and _named(found) <= _named(rest)):
        return found  # beside what is named already a small force may stand for an error of no element
    better = rest.verdict != "unknown" and rest.after.z < found.after.z
    return rest if better else found


def _short_record(
    measurement: Measurement, simulation: Structure, wanted: Callable[[str], bool], tell: Callable[[str], None]
) -> Forced | None:  # fmt: skip
    """What a record that ended too early adds to the FRFs."""
    if not wanted("leakage"):
        return None
    highest = 2 * np.pi * float(measurement.freq[-1])
    return short_record(measurement, coordinates_of(simulation, measurement.outputs, measurement.inputs, highest), tell)


def _beside_own_peaks(
    measurement: Measurement, simulation: Structure, question: str, late: Deadline, wanted: Callable[[str], bool],
    tell: Callable[[str], None], measured: Measured,
) -> ModalDiagnosis | None:  # fmt: skip
    """The diagnosis beside the mass of one sensor, where its output has peaks of its own and a mass explains them."""
    which = own_peaks(measured, len(measurement.outputs), len(measurement.inputs)) if wanted("sensor_mass") else None
    if which is None:
        return None
    tell(f"looking for the mass of a sensor at {measurement.outputs[which]}, whose peaks are its own")
    stage = run_stage(without_output(measurement, which), simulation, late, wanted, tell)
    forced = None if stage is None else mass_of_sensor(stage, measurement, measured, which, late)
    return None if forced is None else _diagnosed(measurement, simulation, question, late, wanted, tell, forced)


def _elsewhere(
    measurement: Measurement, simulation: Structure, question: str, late: Deadline, wanted: Callable[[str], bool],
    tell: Callable[[str], None], measured: Measured,
) -> ModalDiagnosis | None:  # fmt: skip
    """The diagnosis with outputs at other DoFs than their names, where some surely are and it explains the modes."""
    if not wanted("sensor_place") or not len(measured.features.poles):
        return None
    setting = posed(measurement, simulation, measured).setting
    places = other_places(setting, simulation.dofs, measurement.outputs)
    plain = fit(setting) if places else None
    if plain is None:
        return None
    if any(at in places for at in places.values()):  # sensors in each other's place: an exchange is tried before
        found = _diagnosed(measurement, simulation, question, late, wanted, tell, measured=measured)
        if found is not None and found.verdict == "named" and found.after.p_value > THRESHOLDS.left_by_modes:
            return found
    tell(f"looking whether {' and '.join(f'{name} is at {at}' for name, at in places.items())}")
    renamed = measurement.replace(outputs=tuple(places.get(name, name) for name in measurement.outputs))
    names = {"outputs": measurement.outputs, "inputs": measurement.inputs}
    before = np.asarray(simulation.frf(measured.freq, form=measurement.form, **names).H)[None]
    found = _diagnosed(renamed, simulation, question, late, wanted, tell, measured=measured, before=before)
    if found is None or found.verdict not in ("clean", "named"):
        return None
    among = len(measurement.outputs) * len(simulation.dofs)
    held = found.stage.explanations[0].log_posterior + believed("sensor_place")
    there = moved(places, held, plain.log_evidence + math.log(NONE), among)
    if there.probability < THRESHOLDS.certain:
        return None
    return replace(found, verdict="named", moved=there, reasons=(there.said(), *found.reasons))


def _named(found: ModalDiagnosis) -> set[tuple[str, frozenset[str]]]:
    """What stands out, by name and place."""
    return {(c["name"], frozenset(map(str, c["where"]))) for c in found.causes}


def _diagnosed(
    measurement: Measurement, simulation: Structure, question: str, late: Deadline, wanted: Callable[[str], bool],
    tell: Callable[[str], None], forced: Forced | None = None, measured: Measured | None = None,
    before: np.ndarray | None = None,
) -> ModalDiagnosis | None:  # fmt: skip
    """The diagnosis of what is left once a force that was found is taken out of the FRFs.

    ``before`` are the simulation's FRFs where its outputs have other names.
    """
    effect = 0.0 if forced is None else forced.effect
    less = measurement if forced is None else measurement.replace(H=np.asarray(measurement.H) - effect)
    stage = run_stage(less, simulation, late, wanted, tell, measured)
    if stage is None:
        return None
    judged = judge(stage)
    if stage.seen is None or stage.seen.joint is None:
        judged = replace(judged, chosen=on_its_lines(stage, judged.chosen))
    chosen, inaccuracy = judged.chosen, inaccuracy_told(stage.setting, judged.likeliest.fit)
    joined, further = judge_levels(stage.seen, stage.whole)
    explained = judged.likeliest.misfit <= THRESHOLDS.misfit  # what a fit that failed has learnt is no finding
    throughout = throughout_told(stage.setting, judged.likeliest.fit) if explained else {}
    word = outweighing(judged.word, joined)
    reasons = [said(inaccuracy)] if explained else []
    reasons += [*throughout_said(throughout), *judged.reasons, *further]
    reasons += [
        f"{cause_at(c.slug, c.where)} of {c.size(u):.3g} {UNITS[c.slug][1]} counts as that joint's own at low amplitude"
        for c, u in with_sizes(chosen.causes, chosen.fit.u) if of_the_joint(stage, c) and stage.whole is None
    ]  # fmt: skip
    if word != "clean":
        reasons += [c.said() for c in standing_out(stage, chosen) if c.said()]
    if not stage.in_time:
        reasons.append("time was up before every explanation had been tried")
    tell("predicting the held-out data")
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
    word, reasons = lines_verdict(word, reasons, left, stage.measured.misfit)
    joint = seen is not None and seen.joint is not None
    hum = mains_hum(measurement, stage.measured.freq, residuals[1], joint) if wanted("mains_hum") else None
    if hum is not None:
        word, reasons = outweighing(word, "named"), (*reasons, f"beside it there is mains hum: {hum.evidence}")
    notes = (
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
        word, reasons, None, Facts(measurement, question, notes), extended, gain,
        stage.measured.freq, residuals[0], residuals[1], np.broadcast_to(predicted[0], shape),
        np.broadcast_to(predicted[1], shape), stage, chosen, judged.sets, inaccuracy, throughout,
        tests[0], tests[1], hum, forced,
    )  # fmt: skip


def said(inaccuracy: dict[str, Any]) -> str:
    """General inaccuracy in one sentence."""
    parts = [
        f"{percent(v['value'])} ({percent(v['interval'][0])} to {percent(v['interval'][1])}) in {name}"
        for name, v in inaccuracy.items()
    ]
    return f"the modes of the simulation are generally off by {', '.join(parts)}"
