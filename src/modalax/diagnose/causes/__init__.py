"""The catalogue of causes, one family a file."""

from modalax.diagnose.causes.base import Cause, JointCause, LocalCause, Parameter, Place, Scene, strengths
from modalax.diagnose.causes.channels import CHANNELS, ChannelCause
from modalax.diagnose.causes.joints import JOINTS
from modalax.diagnose.causes.lines import MainsHum
from modalax.diagnose.causes.local import LOCAL
from modalax.diagnose.causes.modal import MODAL, TimeVaryingSteps
from modalax.diagnose.causes.patterns import PATTERNS


def catalogue(runs: int = 1) -> list[Cause]:
    """All causes known, the linear ones first; some slugs stand twice, for forms of one cause.

    One form has an unknown for each of three ``runs`` or more.
    """
    steps = [TimeVaryingSteps(runs)] if runs > 2 else []
    return [*LOCAL, *MODAL, *CHANNELS, *PATTERNS, MainsHum(), *JOINTS, *steps]


__all__ = [
    "Cause", "ChannelCause", "JointCause", "LocalCause", "MainsHum", "Parameter", "Place", "Scene", "catalogue",
    "strengths",
]  # fmt: skip
