"""What a simulation gets wrong, why, and what it gains to mend it.

``modalax.diagnose(measurement, simulation)`` calls :func:`diagnose`; the same name is the package that holds the
catalogue and the results.
"""

import sys
import types
from typing import Any

from modalax.diagnose.causes import (
    Cause,
    ChannelCause,
    JointCause,
    LocalCause,
    Parameter,
    Place,
    Scene,
    catalogue,
    strengths,
)
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.pipeline import diagnose
from modalax.diagnose.result import Diagnosis

__all__ = [
    "Cause", "ChannelCause", "Diagnosis", "ExtendedSimulation", "JointCause", "LocalCause", "Parameter", "Place",
    "Scene", "catalogue", "diagnose", "strengths",
]  # fmt: skip


class _CallablePackage(types.ModuleType):
    """The package itself, callable, so that ``modalax.diagnose(...)`` works whichever was imported first."""

    def __call__(self, *args: Any, **kwargs: Any) -> Diagnosis:
        return diagnose(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
