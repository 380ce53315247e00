"""What a simulation gets wrong, why, and how much better it predicts once extended.

The package can be called: ``modalax.diagnose(measurement, simulation)`` is
``modalax.diagnose.diagnose(measurement, simulation)``. Python binds the name of a package to its parent as soon as
anything in it is imported, so a function of the same name there would come and go with the order of imports. Giving the
package itself a ``__call__``, at the end of this module, makes the call work always.
"""

import sys
import types
from typing import Any

from modalax.diagnose.causes import (
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
    Parameter,
    PatternCause,
    Place,
    Scene,
    UndampedCause,
    WindowCause,
    catalogue,
    strengths,
)
from modalax.diagnose.causes.power_laws import MicroSlip
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.joint_laws import Explained, compare_laws, modes_at
from modalax.diagnose.pipeline import diagnose
from modalax.diagnose.result import Diagnosis

__all__ = [
    "Cause", "ChannelCause", "CouplingCause", "Diagnosis", "ElementCause", "Explained", "ExtendedSimulation",
    "HystereticCause", "JointCause", "KernelCause", "LinesCause", "LocalCause", "MicroSlip", "ModesCause", "Parameter",
    "PatternCause", "Place", "Scene", "UndampedCause", "WindowCause", "catalogue", "compare_laws", "diagnose",
    "modes_at", "strengths",
]  # fmt: skip


class _CallablePackage(types.ModuleType):
    """A package that is called as its function :func:`diagnose`."""

    def __call__(self, *args: Any, **kwargs: Any) -> Diagnosis:
        return diagnose(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
