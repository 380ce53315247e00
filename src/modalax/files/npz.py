"""NumPy ``.npz``: the native files of this package."""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.arrays import EXTENDED, READ_KEYS, Saved, from_arrays, to_arrays


def read_npz(path: Path, **options: Any) -> Saved:
    """Read a measurement, structure, modal model or extended simulation.

    Raises
    ------
    ValueError
        If the file is damaged or what it holds is not one of the three.
    """
    arrays = {}
    try:
        # Opened here, because np.load leaves the file open when the archive is damaged.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            extended = EXTENDED in archive.files
            for name in archive.files:
                # What is not read may hold anything; only its name is kept, to see slips of the pen.
                arrays[name] = _array(archive, name) if extended or name in READ_KEYS else None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError) as error:
        raise ValueError(f"the .npz archive is damaged or cut short ({error}); copy or save it again") from error
    return from_arrays(arrays, **options)


def _array(archive: np.lib.npyio.NpzFile, name: str) -> np.ndarray:
    try:
        return archive[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise ValueError(f"array {name!r} is damaged or cut short ({error})") from error
        raise ValueError(
            f"array {name!r} was saved as Python objects, which is unsafe to read; "
            "save text as np.array(names, dtype=str)"
        ) from error


def write_npz(what: Any, path: Path) -> None:
    """Write a measurement, structure, modal model or extended simulation."""
    with path.open("wb") as file:
        np.savez(file, **to_arrays(what))  # pyright: ignore[reportArgumentType]
