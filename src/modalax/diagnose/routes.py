"""The two methods of diagnosis, tried in the order that :mod:`modalax.diagnose.decision.route` decides."""

from collections.abc import Callable

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.decision.route import Outcome, Route, Task, choice, order, suffices
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
        isinstance(found, ModalDiagnosis) and found.joint is not None,
    )  # fmt: skip


def routed(
    measurement: Measurement, simulation: object, question: str, whole_catalogue: bool,
    lines: Callable[[], Diagnosis], modes: Callable[[], ModalDiagnosis | None],
) -> Diagnosis:  # fmt: skip
    """The answer of the method that suits; each is run once at most.

    Parameters
    ----------
    whole_catalogue
        Whether every cause of the catalogue is looked for.
    lines, modes
        The two methods; the second gives None where there is no mode to compare.
    """
    task = task_of(measurement, simulation, question, whole_catalogue)
    answers: dict[Route, Diagnosis] = {}
    for route in order(task):
        found = lines() if route == "lines" else modes()
        if found is None:
            continue
        answers[route] = found
        if suffices(route, outcome_of(found), task):
            break
    return answers[choice({route: outcome_of(found) for route, found in answers.items()})]
