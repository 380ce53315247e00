r"""Whether measured modes have another account than elements that are all off: modes as claimed, or few causes.

Where only frequencies and damping ratios are off, mode by mode, all shapes are those of the simulation, and one cause
beside them bends shapes in a way of its own; elements that are off bend every shape. Both are fitted to the measured
modes, without and with each leading cause, and their evidence tells which it is.

Where every element is off by a little, no two causes bend all modes alike. Two small things that are wrong of a
simulation that is exact do look like a general inaccuracy, of a size far below what any simulation has; the search line
by line, which takes all else as exact, tells them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.inaccuracy import CLAIMED, Inaccuracy, own_damping
from modalax.diagnose.modal_domain.fitting.linear import SMALLEST
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.search.explain import one_cause, one_more
from modalax.diagnose.modal_domain.stage import Stage, posed
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import Structure

EXACT, HELD = 1e-6, 0.1  # size that a general inaccuracy is held to, and the spread of its logarithm
BEHIND = 40.0  # nats that they may be behind, as a further cause may bring line by line (``search.compounds``)


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


def few_causes_near(stage: Stage, late: Deadline) -> bool:
    """Whether at most two causes beside no general inaccuracy are hardly less likely than what was found.

    Parameters
    ----------
    stage
        The diagnosis by modes.
    late
        When no further step begins.
    """
    a = stage.setting.inaccuracy
    exact = replace(a, usual=np.full_like(a.usual, EXACT), spread=np.full_like(a.spread, HELD))
    setting = replace(stage.setting, inaccuracy=exact)
    found = one_cause(setting, stage.candidates, late)
    if found and found[0].causes:
        found = one_more(setting, found, stage.candidates, late)
    return bool(found and found[0].log_posterior > stage.explanations[0].log_posterior - BEHIND)
