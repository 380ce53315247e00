r"""Whether a simulation of which an inaccuracy of its modes is claimed is off in its elements.

Where only frequencies and damping ratios are off, mode by mode, all shapes are those of the simulation, and one cause
beside them bends shapes in a way of its own; elements that are off bend every shape. Both are fitted to the measured
modes, without and with each leading cause, and their evidence tells which it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.explain import one_cause, one_more
from modalax.diagnose.modal_domain.explanation import Explanation
from modalax.diagnose.modal_domain.inaccuracy import CLAIMED, Inaccuracy, own_damping
from modalax.diagnose.modal_domain.linear import SMALLEST
from modalax.diagnose.modal_domain.measured import Measured
from modalax.diagnose.modal_domain.stage import posed
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import Structure


@dataclass(frozen=True)
class ClaimCompared:
    """What the measured modes say of a claim that modes are off.

    Attributes
    ----------
    elements_show
        Whether the modes are those of a simulation that is off in its elements, not mode by mode.
    by_modes
        The explanations by frequencies and damping ratios that are off, with at most two causes beside them, by falling
        probability.
    """

    elements_show: bool = False
    by_modes: Sequence[Explanation] = ()

    @property
    def explained(self) -> bool:
        """Whether the best of these leaves no more of the measured modes than usual."""
        return bool(self.by_modes) and self.by_modes[0].misfit <= THRESHOLDS.misfit


def compared(measurement: Measurement, simulation: Structure, measured: Measured, late: Deadline) -> ClaimCompared:
    """Explain the measured modes as its author claims they are off, and by elements where that leaves something.

    Of two causes beside modes as claimed and one beside elements that are off, the likelier is told.
    """
    if not len(measured.features.poles):
        return ClaimCompared()
    task = posed(measurement, simulation, measured)
    highest = 2 * np.pi * float(measurement.freq[-1])
    claimed = replace(task.setting, inaccuracy=off_by_modes(simulation, task.coordinates, highest))
    alone = one_cause(claimed, task.candidates, late)
    said = ClaimCompared(by_modes=alone)
    if said.explained:
        return said
    bent = one_cause(task.setting, task.candidates, late)
    if late():
        return said
    bends = bool(bent) and bent[0].misfit <= THRESHOLDS.misfit
    if bends and (not alone or alone[0].misfit > THRESHOLDS.elements_lead * max(bent[0].misfit, 1.0)):
        return ClaimCompared(True, alone)
    if not alone or not alone[0].causes:
        return said
    two = ClaimCompared(by_modes=one_more(claimed, alone, task.candidates, late))
    return said if bends and two.by_modes[0].fit.log_evidence < bent[0].fit.log_evidence else two


def off_by_modes(simulation: Structure, c: Coordinates, highest: float) -> Inaccuracy:
    """The inaccuracy that is claimed of frequencies and damping ratios, each mode by itself, and no other."""
    few = own_damping(c, highest)
    frequency, damping = (
        np.broadcast_to(np.asarray(claim, float), (len(simulation.dofs),))[: len(few)]
        for claim in (simulation.frequency_std, simulation.damping_std)
    )
    stiffness = np.zeros_like(few)
    for k in range(len(few)):
        stiffness[k, k, k] = 2 * c.frequencies[k] ** 2  # of a relative change of the frequency
    usual = [max(float(np.sqrt((claim**2).mean())), SMALLEST) for claim in (frequency, damping)]
    return Inaccuracy(
        ("stiffness", "damping"), (stiffness, few), np.array(usual), np.full(2, CLAIMED), (True, True),
        np.repeat([False, True], len(few)),
    )  # fmt: skip
