"""Faults of a measurement, found without a model of the structure.

``modalax.check(measurement)`` calls :func:`check`; the same name is the package that holds the detectors and the
findings.
"""

import sys
import types
from typing import Any

from modalax.check.checking import check
from modalax.check.finding import WORDS, Finding, Findings, Picture
from modalax.check.records import Records

__all__ = ["WORDS", "Finding", "Findings", "Picture", "Records", "check"]


class _CallablePackage(types.ModuleType):
    """The package itself, callable, so that ``modalax.check(...)`` works whichever was imported first."""

    def __call__(self, *args: Any, **kwargs: Any) -> Findings:
        return check(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
