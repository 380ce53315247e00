"""modalax: differentiable experimental modal analysis in JAX."""

import os

# On few cores JAX's CPU runtime can wait for itself when batched factorisations run inside a loop (seen with two
# cores and jaxlib 0.10.1); a larger pool of threads prevents it. It counts only until JAX runs its first computation.
os.environ.setdefault("NPROC", str(max(16, os.cpu_count() or 1)))

import importlib
from typing import Any

from modalax.data import FRF, Measurement
from modalax.files import load, save
from modalax.files.arrays import register
from modalax.model import ModalModel, Structure

__version__ = "0.1.0"

__all__ = ["FRF", "Measurement", "ModalModel", "Structure", "__version__", "diagnose", "load", "save"]


def _extended(arrays: Any, **options: Any) -> Any:
    return importlib.import_module("modalax.diagnose.extend").from_arrays(arrays, **options)


register("causes", _extended)


def __getattr__(name: str) -> Any:
    """Load the heavier parts when they are first asked for, so that ``import modalax`` stays light."""
    if name == "diagnose":
        return importlib.import_module("modalax.diagnose")
    raise AttributeError(f"module 'modalax' has no attribute {name!r}")
