"""``load_records``: time records from UFF 58, MATLAB, NumPy, CSV, WAV and HDF5 files."""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from modalax.data.recording import Recording, joined
from modalax.files.guard import reading
from modalax.files.messages import about
from modalax.files.record_kinds import kind_of


def load_records(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], *, fs: float | None = None, array: str = ""
) -> Recording:
    """Read time records; several files of the same channels become the segments of one recording.

    What a file is, is told from its content. What has to be assumed is told by warnings; a sampling rate is never
    assumed.

    Parameters
    ----------
    paths
        One file or several.
    fs
        Sampling rate [Hz], for files that do not hold it.
    array
        Name of the array to read, from files of several that do not go together.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a file cannot be used; the message names it, what was seen and what would be right.
    """
    every = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not every:
        raise ValueError("no file of time records is given")
    read = []
    for k, path in enumerate(every):
        with warnings.catch_warnings():
            if k:  # what is assumed of the first is assumed of all
                warnings.simplefilter("ignore", UserWarning)
            read.append(_read(Path(path), fs, array))
    return read[0] if len(read) == 1 else joined(read)


def _read(path: Path, fs: float | None, array: str) -> Recording:
    kind = kind_of(path)
    with about(path):
        options: dict[str, Any] = {"fs": fs, "array": array}
        if array and kind in ("uff", "wav", "text", "npy"):
            raise ValueError(f"an array by name ({array}) is for .npz, .mat and HDF5 files")
        if kind == "uff":
            from modalax.files.records_uff import read_uff_records

            with reading("the universal file", ValueError):
                return read_uff_records(path, fs)
        if kind in ("npz", "mat", "hdf5"):
            from modalax.files.records_named import read_named

            return read_named(path, kind, **options)
        from modalax.files.records_tables import read_npy, read_text, read_wav

        return {"npy": read_npy, "wav": read_wav, "text": read_text}[kind](path, fs)
