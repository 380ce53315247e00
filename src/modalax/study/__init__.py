"""Studies: thousands of fits or diagnoses, in chunks, on as many processes and machines as there are.

A study is described by a file (:func:`study`, or ``modalax study FILE.toml``) and is one of five kinds:

``noise``
    The same fit over draws of the noise: bias, scatter, and whether error bars hold.
``bootstrap``
    Fits of draws from one measurement: its repeats, or its noise variance.
``parameter``
    Noise studies over combinations of settings of the simulation and the fit.
``diagnosis``
    How often an effect of some size is named rightly.
``function``
    Whatever a function of a seed gives.

Every draw has a seed of its own, from the seed of the study and its number, and every chunk of draws is stored as soon
as it is done. So a study may be stopped in any way and started again: nothing is lost, nothing is done twice, and the
results are the same bit for bit. The package can be called: ``modalax.study(...)`` is ``modalax.study.study(...)``.
"""

import sys
import types
from typing import TYPE_CHECKING, Any

from modalax._lazy import lazily

if TYPE_CHECKING:
    from modalax.study.examples import EXAMPLES
    from modalax.study.run import Results, study
    from modalax.study.statistics import summary
    from modalax.study.work import Work

__all__ = ["EXAMPLES", "Results", "Work", "study", "summary"]

__getattr__, __dir__ = lazily(
    __name__,
    {"Results": "modalax.study.run", "study": "modalax.study.run", "Work": "modalax.study.work"}
    | {"summary": "modalax.study.statistics", "EXAMPLES": "modalax.study.examples"},
)


class _CallablePackage(types.ModuleType):
    """A package that is called as its function :func:`study`."""

    def __call__(self, *args: Any, **kwargs: Any) -> "Results":
        from modalax.study.run import study

        return study(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
