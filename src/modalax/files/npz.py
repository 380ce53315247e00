"""NumPy ``.npz``: the native files of this package."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.arrays import EXTENDED, NOTHING, READ_KEYS, Saved, from_arrays, to_arrays
from modalax.files.guard import Refused, bytes_of, check_size, reading
from modalax.files.plain import Told


def read_npz(path: Path, told: Told = NOTHING, **options: Any) -> Saved:
    """Read a measurement, structure, modal model or extended simulation.

    Raises
    ------
    ValueError
        If the file is damaged or what it holds is not one of the three.
    """
    return from_arrays(npz_arrays(path), told, **options)


def npz_arrays(path: Path, every: bool = False) -> dict[str, Any]:
    """The arrays of an archive that are known; of any other only the name is kept, with None as value.

    With ``every``, all are read.

    Raises
    ------
    ValueError
        If an array is damaged, was saved as Python objects, or declares another size than the archive has for it.
    """
    arrays: dict[str, Any] = {}
    with reading("the .npz archive"), path.open("rb") as file, zipfile.ZipFile(file) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        used = entries if every or EXTENDED in entries else READ_KEYS & set(entries)
        check_size(sum(entries[name].file_size for name in used), path, "the .npz archive")
        for name, entry in entries.items():
            arrays[name] = _array(archive, entry, name) if name in used else None
    return arrays


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> np.ndarray:
    with reading(f"array {name!r}"):
        with archive.open(entry) as stream:
            check_header(stream, entry.file_size, f"array {name!r}")
        with archive.open(entry) as stream:
            return np.lib.format.read_array(stream, allow_pickle=False)


def check_header(stream: Any, size: int, what: str) -> None:
    """Refuse an array of NumPy's format that holds objects, or another number of bytes than ``size`` leaves it.

    Raises
    ------
    ValueError
        Naming both.
    """
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in header:
        raise Refused(f"{what} is of format {version}; formats 1.0 and 2.0 are read")
    shape, _, dtype = header[version](stream)
    if dtype.hasobject:
        raise Refused(
            f"{what} was saved as Python objects, which is unsafe to read; save text as np.array(names, dtype=str)"
        )
    left, declared = size - stream.tell(), bytes_of(shape, dtype.itemsize)
    # Text of no letters takes no room, however many items of it are declared.
    if declared > max(left, 64) or (dtype.itemsize and declared != left):
        raise Refused(
            f"{what} declares the shape {shape} of {dtype}, and the file holds {left} bytes of it: it is damaged or "
            "cut short; copy or save it again"
        )


def write_npz(what: Any, path: Path) -> None:
    """Write a measurement, structure, modal model or extended simulation."""
    with path.open("wb") as file:
        np.savez(file, **to_arrays(what))
