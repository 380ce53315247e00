"""The catalogue of causes, one family a file."""

from collections.abc import Sequence

from modalax.diagnose.causes.base import (
    Cause,
    ChannelCause,
    CouplingCause,
    ElementCause,
    HystereticCause,
    JointCause,
    KernelCause,
    LinesCause,
    LocalCause,
    ModesCause,
    PatternCause,
    UndampedCause,
    WindowCause,
)
from modalax.diagnose.causes.channels import CHANNELS
from modalax.diagnose.causes.couplings import COUPLINGS
from modalax.diagnose.causes.damping import DAMPING
from modalax.diagnose.causes.drift import DRIFTS, DriftingSpring, TimeVaryingSteps
from modalax.diagnose.causes.forces import FORCES
from modalax.diagnose.causes.groups import GROUPS
from modalax.diagnose.causes.joints import JOINTS
from modalax.diagnose.causes.local import LOCAL
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.missing_modes import MISSING_MODES
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.power_laws import POWER_LAWS, MicroSlip
from modalax.diagnose.causes.records import RECORDS
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.sensors import SENSORS
from modalax.diagnose.causes.viscoelastic import VISCOELASTIC

MOST_RUNS = 12  # runs of a test whose changes from run to run a saved file can hold, less one
EVERY: tuple[Cause, ...] = (
    *LOCAL, *GROUPS, *VISCOELASTIC, *COUPLINGS, *DAMPING, *RECORDS, *DRIFTS, *CHANNELS, *SENSORS, *FORCES,
    *MISSING_MODES, MainsHum(), *JOINTS, *POWER_LAWS, DriftingSpring(),
)  # fmt: skip


def catalogue(runs: int = 1) -> list[Cause]:
    """All causes that the answer may name, the linear ones first; some slugs stand twice, for forms of one cause.

    One form has an unknown for each of three ``runs`` or more.
    """
    return [*(c for c in EVERY if c.named), *([TimeVaryingSteps(runs)] if runs > 2 else [])]


def imitators() -> list[Cause]:
    """Things without a name in the answer, but that one of its causes may imitate.

    They are looked for only to doubt a name: where one of them explains the data better than what was found, the answer
    is ``unknown`` and its advice says what it looks like. Each is thought rare, so a name stands where they do as well
    as it.
    """
    return [c for c in EVERY if not c.named]


def as_causes(asked: Sequence[Cause | str] | str | None) -> list[Cause] | None:
    """Causes for names: each name stands for all forms of its cause, a cause for itself; None for None.

    Those that were named come first, in the order of the catalogue and each once.

    Raises
    ------
    ValueError
        If a name is not in the catalogue.
    """
    if asked is None:
        return None
    asked = [asked] if isinstance(asked, str) else asked
    names, every = {name for name in asked if isinstance(name, str)}, [*catalogue(), *imitators()]
    known = {c.slug for c in every}
    if unknown := sorted(names - known):
        raise ValueError(f"unknown causes: {', '.join(unknown)}; known are {', '.join(sorted(known))}")
    return [*(c for c in every if c.slug in names), *(c for c in asked if not isinstance(c, str))]


def saved_causes() -> list[Cause]:
    """All causes that an extended simulation in a file may hold."""
    return [*catalogue(), MicroSlip(), *(TimeVaryingSteps(runs) for runs in range(3, MOST_RUNS))]


__all__ = [
    "Cause", "ChannelCause", "CouplingCause", "ElementCause", "HystereticCause", "JointCause", "KernelCause",
    "LinesCause", "LocalCause", "ModesCause", "Parameter", "PatternCause", "Place", "Scene", "UndampedCause",
    "WindowCause", "as_causes", "catalogue", "imitators", "saved_causes", "strengths",
]  # fmt: skip
