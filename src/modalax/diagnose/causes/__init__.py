"""The catalogue of causes, one family a file."""

from modalax.diagnose.causes.base import Cause, JointCause, LocalCause, Parameter, Place, Scene, strengths
from modalax.diagnose.causes.channels import CHANNELS, ChannelCause
from modalax.diagnose.causes.damping import DAMPING
from modalax.diagnose.causes.drift import DriftingSpring, TimeVarying, TimeVaryingSteps
from modalax.diagnose.causes.joints import JOINTS
from modalax.diagnose.causes.local import LOCAL
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.missing_modes import MISSING_MODES
from modalax.diagnose.causes.records import RECORDS


def catalogue(runs: int = 1) -> list[Cause]:
    """All causes known, the linear ones first; some slugs stand twice, for forms of one cause.

    One form has an unknown for each of three ``runs`` or more.
    """
    steps = [TimeVaryingSteps(runs)] if runs > 2 else []
    return [
        *LOCAL, *DAMPING, *RECORDS, TimeVarying(), *CHANNELS, *MISSING_MODES, MainsHum(), *JOINTS, DriftingSpring(),
        *steps,
    ]  # fmt: skip


__all__ = [
    "Cause", "ChannelCause", "JointCause", "LocalCause", "MainsHum", "Parameter", "Place", "Scene", "catalogue",
    "strengths",
]  # fmt: skip
