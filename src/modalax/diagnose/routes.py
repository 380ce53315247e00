"""Facts about a task, and about an answer, on which the choice of the method depends."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.causes import Cause, catalogue
from modalax.diagnose.causes.groups import GROUPS, GroupCause
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.route import Outcome, Task, hardly_off, in_time, nothing_left, suffices, surely_named
from modalax.diagnose.decision.verdict import fails
from modalax.diagnose.modal_domain.answer import ModalDiagnosis
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.claimed_modes import ClaimCompared, few_causes_near
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.throughout import only_scaled
from modalax.diagnose.modal_domain.judged import standing_out
from modalax.diagnose.modal_domain.modes.measured import prepared
from modalax.diagnose.modal_domain.stage import KNOWN
from modalax.diagnose.modal_domain.structure.modes_only import modes_only
from modalax.diagnose.result import Diagnosis
from modalax.diagnose.search.named_before import NamedCause
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import ModalModel, Structure

RANKED = 1000  # DoFs up to which a rank is read; larger models are never asked about line by line for long
GROUP_SLUGS = {c.slug for c in GROUPS}


def task_of(measurement: Measurement, simulation: object, question: str, causes: Sequence[Cause] | None = None) -> Task:
    """What the choice of the method depends on; ``causes`` are those to look for, None for the whole catalogue."""
    if isinstance(simulation, ModalModel):
        return _task_of_modes(measurement, simulation, question, causes)
    if not isinstance(simulation, Structure):
        return Task(has_modes=False)
    known = {*measurement.outputs, *measurement.inputs} <= set(simulation.dofs)
    count = len(simulation.dofs)
    claims = simulation.stiffness_std, simulation.mass_std
    return Task(
        known and question in ("auto", "fixed") and count > 1, count * (count + 1) / 2, 2 * measurement.H.size,
        any(c is not None and float(c) > 0 for c in claims),
        bool(np.any(np.asarray(simulation.frequency_std)) or np.any(np.asarray(simulation.damping_std))),
        causes is None,
        simulation.groups is not None and (causes is None or any(isinstance(c, GroupCause) for c in causes)),
        causes is None or all(c.slug in KNOWN or isinstance(c, GroupCause) for c in causes),
        bool(np.linalg.matrix_rank(np.asarray(simulation.M)) < count) if count <= RANKED else False,
    )  # fmt: skip


def _task_of_modes(
    measurement: Measurement, simulation: ModalModel, question: str, causes: Sequence[Cause] | None
) -> Task:  # fmt: skip
    """The same of a modal model, which may be a measured one: its residual terms tell."""
    alone = modes_only(simulation) if question == "fixed" or question == "auto" and not simulation.fitted else None
    if alone is None or not {*measurement.outputs, *measurement.inputs} <= set(alone.dofs):
        return Task(has_modes=False)
    count = len(alone.dofs)
    return Task(
        count > 1, count * (count + 1) / 2, 2 * measurement.H.size,
        modes_off=bool(np.any(alone.frequency_std) or np.any(alone.damping_std)), whole_catalogue=causes is None,
        known_to_modes=causes is None or all(c.slug in KNOWN for c in causes), modes_alone=True,
    )  # fmt: skip


def check_groups(simulation: object, causes: Sequence[Cause] | None) -> None:
    """Raise ``ValueError`` where a parameter of groups is asked about that the simulation does not name.

    Not where the whole catalogue is asked for, with further causes beside it.
    """
    asked = [c.slug for c in causes or () if isinstance(c, GroupCause)]
    whole = {c.slug for c in catalogue()} <= {c.slug for c in causes or ()}
    if asked and not whole and getattr(simulation, "groups", None) is None:
        raise ValueError(
            f"cause {asked[0]} needs a simulation with groups of elements (group_names, group_K and group_M in its "
            "file); this one names none"
        )


def outcome_of(found: Diagnosis) -> Outcome:
    """What the choice of the method depends on once it has answered."""
    causes, (_, after), gain = found.causes, found.tests, found.gain
    unforeseen = gain.chi2_unforeseen
    if math.isnan(unforeseen) and not fails(gain) and gain.chi2_within < gain.chi2_after:
        unforeseen = gain.chi2_within  # what errors of a fit without the block miss there by no more than chance
    return Outcome(
        found.verdict, gain.chi2_after, after.p_value, causes[0]["probability"] if causes else 0.0,
        len(found.alternatives), found.inaccuracy if isinstance(found, ModalDiagnosis) else None,
        len({frozenset(c["where"]) for c in causes}), isinstance(found, ModalDiagnosis) and found.joint is not None,
        any(c["name"] in GROUP_SLUGS for c in causes), of_elements(found), unforeseen,
        found.throughout if isinstance(found, ModalDiagnosis) else {},
        isinstance(found, ModalDiagnosis) and found.verdict == "clean" and bool(found.chosen.causes),
        isinstance(found, ModalDiagnosis) and only_scaled(found.stage.setting, found.chosen.fit),
        isinstance(found, ModalDiagnosis) and found.askew,
    )  # fmt: skip


def outcome_beside_few(found: Diagnosis, task: Task, late: Deadline) -> Outcome:
    """The same, modes that are hardly off being asked whether a few causes of an exact simulation are as likely."""
    outcome = outcome_of(found)
    small = in_time(task) and not task.elements_off and hardly_off(outcome)
    if small and isinstance(found, ModalDiagnosis):
        return replace(outcome, exact_near=few_causes_near(found.stage, late))
    return outcome


def all_in_general(found: Diagnosis, task: Task, late: Deadline) -> bool:
    """Whether by their modes elements that are off explain all, so that no cause is missing at any one place."""
    said = outcome_beside_few(found, task, late)
    return said.verdict == "clean" and nothing_left(said) and suffices("modes", said, task)


def of_elements(found: Diagnosis) -> bool:
    """Whether a change of a whole element, of its end, of several places or with damping is told: lines have none.

    Not where the modes do not tell it from one that lines have, which tell more of that.
    """
    if not isinstance(found, ModalDiagnosis) or not found.causes:
        return False
    if not _unknown_to_lines(standing_out(found.stage, found.chosen)):
        return False
    others = (e.probability for e in found.stage.explanations if not _unknown_to_lines(e.causes))
    return sum(others) < 1 - THRESHOLDS.certain


def _unknown_to_lines(causes: Sequence[Change]) -> bool:
    return any((c.kind == "K" and c.pattern is not None) or len(c.told_as) > 1 or bool(c.along) for c in causes)


def has_levels(measurement: Measurement) -> bool:
    """Whether runs were measured at several force levels."""
    return len(np.unique(measurement.level[np.isfinite(measurement.level)])) > 1


def may_tell_joints(measurement: Measurement) -> bool:
    """Whether runs at several force levels differ by more than noise, as those of a joint that is not linear do."""
    return has_levels(measurement) and len(prepared(measurement, None)[2]) < len(measurement.H)


def named_before(modes: Diagnosis | None) -> list[NamedCause]:
    """What the modal domain names beyond doubt and leaves no more than noise; nothing where lines have no such cause.

    Joints, hum and a force that shows on lines only are looked for there anew.
    """
    if not isinstance(modes, ModalDiagnosis) or not surely_named(outcome_of(modes)):
        return []
    if modes.joint is not None or modes.forced is not None or modes.hum is not None:
        return []
    return in_catalogue(modes.chosen, standing_out(modes.stage, modes.chosen))


def named_beside_claim(said: ClaimCompared) -> list[NamedCause]:
    """The causes that explain the measured modes beyond doubt beside frequencies and damping ratios as claimed."""
    if not said.explained or said.by_modes[0].probability < THRESHOLDS.decisive:
        return []
    return in_catalogue(said.by_modes[0], said.by_modes[0].causes)


def in_catalogue(found: Explanation, told: Sequence[Change]) -> list[NamedCause]:
    """The causes that are ``told``, in the words of lines; nothing where lines have no such cause."""
    named = []
    for k, (c, u) in enumerate(with_sizes(found.causes, found.fit.u)):
        own = own_sizes(found.causes, k)
        values, _, shape = c.as_catalogue(u, found.fit.covariance[own, own])
        if c not in told:
            continue
        if c.pattern is not None or shape is not None or c.along:
            return []
        named.append(NamedCause(c.slug, c.where, tuple(map(float, values)), c.variant))
    return named
