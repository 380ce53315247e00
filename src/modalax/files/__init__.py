"""Reading and writing measurements, structures, modal models and geometry.

Its names load when they are first asked for, so that a file can be found missing or of no known kind before JAX is
imported.
"""

from typing import TYPE_CHECKING

from modalax._lazy import lazily

if TYPE_CHECKING:
    from modalax.files.load_save import load, save
    from modalax.files.mode_files import load_mode_table
    from modalax.files.modes import save_modes
    from modalax.files.records import load_records
    from modalax.files.uff import load_geometry, load_modes

__all__ = ["load", "load_geometry", "load_mode_table", "load_modes", "load_records", "save", "save_modes"]

__getattr__, __dir__ = lazily(
    __name__,
    {
        "load": "modalax.files.load_save", "save": "modalax.files.load_save",
        "load_geometry": "modalax.files.uff", "load_modes": "modalax.files.uff",
        "load_mode_table": "modalax.files.mode_files", "load_records": "modalax.files.records",
        "save_modes": "modalax.files.modes",
    },
)  # fmt: skip
