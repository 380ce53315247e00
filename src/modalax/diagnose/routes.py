"""Which way an answer comes about: line by line about the simulation as it is, or in the modal domain.

Line by line is exact: it sees effects of a ten-thousandth, where all else is exact. Where every element of a simulation
is a little off it has nothing to stand on, and the modal domain has. Large problems are for the modal domain as well,
since line by line every place costs as much as all samples.
"""

from collections.abc import Callable

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import ModalDiagnosis
from modalax.diagnose.result import Diagnosis
from modalax.model import Structure

# Samples times places, and places, beyond which a search line by line takes minutes; and places beyond which it is
# spared where the modal domain is decisive
WORK, PLACES, MANY = 5e6, 300, 120
DECISIVE = 0.999  # probability of the names from which nothing else is looked for
LEFT = 0.01  # chance under noise alone of what is left, from which on nothing is left
AS_NOISE = 1.2  # chi-square per sample on the held-out block up to which a fit predicts it
UNEXPLAINED = 1.5  # the same, beyond which a fit does not
OFF = 3e-4  # relative error of the modes' stiffness or mass from which a simulation is off in general


def _may_use_modes(measurement: Measurement, simulation: Structure, question: str) -> bool:
    known = {*measurement.outputs, *measurement.inputs} <= set(simulation.dofs)
    return known and question in ("auto", "fixed") and len(simulation.dofs) > 1


def needs_modes(measurement: Measurement, simulation: Structure) -> bool:
    """Whether the author says that every element is off, or a search line by line would take too long."""
    claims = [simulation.stiffness_std, simulation.mass_std]
    places = len(simulation.dofs) * (len(simulation.dofs) + 1) / 2
    large = places > PLACES or places * 2 * measurement.H.size > WORK
    return large or any(c is not None and float(c) > 0 for c in claims)


def only_modes_claimed(simulation: Structure) -> bool:
    """Whether the author claims a spread of frequencies or damping ratios, mode by mode."""
    return bool(np.any(np.asarray(simulation.frequency_std)) or np.any(np.asarray(simulation.damping_std)))


def off_everywhere(found: ModalDiagnosis) -> bool:
    """Whether elements that are a little off explain what they should, and nothing else is left."""
    off = any(
        found.inaccuracy[name]["interval"][0] > 0 and found.inaccuracy[name]["value"] > OFF
        for name in ("stiffness", "mass")
    )
    return off and found.verdict != "unknown" and found.after.p_value > LEFT and found.gain.chi2_after < AS_NOISE


def decisive(found: ModalDiagnosis) -> bool:
    """Whether a cause is named beyond doubt, nothing is left, and the problem is large."""
    places = len(found.stage.simulation.dofs) * (len(found.stage.simulation.dofs) + 1) / 2
    sure = found.verdict == "named" and found.causes[0]["probability"] >= DECISIVE and not found.alternatives
    return places > MANY and sure and found.after.p_value > LEFT and found.gain.chi2_after < AS_NOISE


def unexplained(found: Diagnosis) -> bool:
    """Whether a search line by line found no explanation that predicts."""
    return found.verdict == "unknown" or found.gain.chi2_after > UNEXPLAINED


def routed(
    measurement: Measurement, simulation: object, question: str, every_cause: bool, exact: Callable[[], Diagnosis],
    modal: Callable[[], ModalDiagnosis | None],
) -> Diagnosis:  # fmt: skip
    """The answer by the way that suits; each way is gone once at most.

    Parameters
    ----------
    every_cause
        Whether the whole catalogue is looked for; with some of it only, what is left is not for the inaccuracy.
    exact, modal
        The two ways; the second gives None where there is no mode to compare.
    """
    if not isinstance(simulation, Structure) or not _may_use_modes(measurement, simulation, question):
        return exact()
    if needs_modes(measurement, simulation):
        return modal() or exact()
    if not every_cause:
        return exact()
    first = None if only_modes_claimed(simulation) else modal()
    if first is not None and (off_everywhere(first) or decisive(first)):
        return first
    found = exact()
    if not unexplained(found):
        return found
    first = first if first is not None else modal()
    better = first is not None and first.verdict != "unknown" and first.gain.chi2_after < found.gain.chi2_after
    return first if first is not None and better else found
