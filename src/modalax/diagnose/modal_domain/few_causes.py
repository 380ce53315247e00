"""Whether a few causes of a simulation that is exact in all else explain about as much as a general inaccuracy.

Where every element is off by a little, no two causes bend all modes alike. Two small things that are wrong of a
simulation that is exact do look like a general inaccuracy, of a size far below what any simulation has; the search line
by line, which takes all else as exact, tells them.
"""

from dataclasses import replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.explain import one_cause, one_more
from modalax.diagnose.modal_domain.stage import Stage

EXACT, HELD = 1e-6, 0.1  # size that a general inaccuracy is held to, and the spread of its logarithm
BEHIND = 40.0  # nats that they may be behind, as a further cause may bring line by line (``search.compounds``)


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
