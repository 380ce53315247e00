"""A spring that seems to drift from run to run may be a joint that follows the level: its laws, started from there."""

from collections.abc import Sequence

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.joints import FRACTIONS, DriftingSpring
from modalax.diagnose.fit import Hypothesis
from modalax.diagnose.search import refit
from modalax.diagnose.state import State
from modalax.diagnose.study import Study

SIZES = (0.6, 1.0, 1.6)  # stiffness of the joint over the drift seen


def joints_for_drifts(
    study: Study, null: Hypothesis, found: Sequence[Hypothesis], causes: Sequence[Cause], state: State
) -> list[Hypothesis]:
    """Joints of stiffness and threshold where the leading hypothesis is one spring that drifts.

    A joint that is stiff at one level and lets go at the next is far from any small size that it is screened at.
    """
    if not found or not found[0].causes or not isinstance(found[0].causes[0], DriftingSpring):
        return []
    at, drift = found[0].places[0].index, abs(float(found[0].params[0][0]))
    laws = [c for c in causes if c.stage == "joint" and [q.unit for q in c.parameters] == ["N/m", "m"]]
    out: list[Hypothesis] = []
    for cause in laws:
        place = next((p for p in cause.places(study.scene) if p.index == at), None)
        if place is not None:
            starts = [np.array([k * drift, x]) for k in SIZES for x in study.scene.amplitudes(place, FRACTIONS)]
            out += refit(study, null, [null.with_cause(cause, place, None, p) for p in starts], state)
    return out
