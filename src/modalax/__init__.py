"""modalax: differentiable experimental modal analysis in JAX."""

from typing import TYPE_CHECKING

from modalax._lazy import lazily
from modalax._numerics.compiler import set_up

if TYPE_CHECKING:
    from modalax import data, files, identify, model, show, simulate, view
    from modalax.check import check
    from modalax.data import FRF, Geometry, Measurement
    from modalax.diagnose import diagnose
    from modalax.files import load, save
    from modalax.model import ModalModel, Structure
    from modalax.study import study

set_up()

__version__ = "0.2.0"

__all__ = [
    "FRF", "Geometry", "Measurement", "ModalModel", "Structure", "__version__", "check", "data", "diagnose", "files",
    "identify", "load", "model", "save", "show", "simulate", "study", "view",
]  # fmt: skip

# ``modalax.check``, ``.diagnose`` and ``.study`` are packages and, called, their functions of that name: see there.
PACKAGES = ("check", "data", "diagnose", "files", "identify", "model", "show", "simulate", "study", "view")
__getattr__, __dir__ = lazily(
    __name__,
    {name: f"{__name__}.{name}" for name in PACKAGES}
    | {"FRF": "modalax.data", "Geometry": "modalax.data", "Measurement": "modalax.data"}
    | {"ModalModel": "modalax.model", "Structure": "modalax.model"}
    | {"load": "modalax.files", "save": "modalax.files"},
)
