"""Facts about a task, and about an answer, on which the choice of the method depends."""

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.decision.route import Outcome, Task
from modalax.diagnose.modal_domain.diagnosis import ModalDiagnosis
from modalax.diagnose.result import Diagnosis
from modalax.model import Structure


def task_of(measurement: Measurement, simulation: object, question: str, whole_catalogue: bool) -> Task:
    """What the choice of the method depends on."""
    if not isinstance(simulation, Structure):
        return Task(has_modes=False)
    known = {*measurement.outputs, *measurement.inputs} <= set(simulation.dofs)
    count = len(simulation.dofs)
    claims = simulation.stiffness_std, simulation.mass_std
    return Task(
        known and question in ("auto", "fixed") and count > 1, count * (count + 1) / 2, 2 * measurement.H.size,
        any(c is not None and float(c) > 0 for c in claims),
        bool(np.any(np.asarray(simulation.frequency_std)) or np.any(np.asarray(simulation.damping_std))),
        whole_catalogue,
    )  # fmt: skip


def outcome_of(found: Diagnosis) -> Outcome:
    """What the choice of the method depends on once it has answered."""
    causes, (_, after) = found.causes, found.tests
    return Outcome(
        found.verdict, found.gain.chi2_after, after.p_value, causes[0]["probability"] if causes else 0.0,
        len(found.alternatives), found.inaccuracy if isinstance(found, ModalDiagnosis) else None,
        len({frozenset(c["where"]) for c in causes}), isinstance(found, ModalDiagnosis) and found.joint is not None,
    )  # fmt: skip
