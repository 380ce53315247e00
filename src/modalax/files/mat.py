"""MATLAB ``.mat`` files, with the same names of arrays as in ``.npz``."""

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from modalax.files.arrays import READ_KEYS, Saved, from_arrays, to_arrays


def read_mat(path: Path) -> Saved:
    """Read a measurement, structure or modal model from a ``.mat`` file of any version.

    MATLAB drops trailing axes of length one; they are put back from the names of the inputs and outputs.

    Raises
    ------
    ValueError
        If the file is damaged or what it holds is none of the three.
    """
    with path.open("rb") as file:
        newest = file.read(19) == b"MATLAB 7.3 MAT-file"
    arrays = _newest(path) if newest else _classic(path)
    return from_arrays(_with_short_axes(arrays))


def _classic(path: Path) -> dict[str, Any]:
    try:
        found = scipy.io.loadmat(path)
    except (OSError, EOFError, TypeError, NotImplementedError, scipy.io.matlab.MatReadError) as error:
        raise ValueError(f"the .mat file is damaged or cut short ({error}); copy or save it again") from error
    return {name: _text(value) for name, value in found.items() if not name.startswith("__")}


def _text(value: Any) -> Any:
    """Cell arrays of text as arrays of text."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return np.array([str(np.asarray(item).item()) for item in value.ravel()], dtype=str).reshape(value.shape)
    return value


def _newest(path: Path) -> dict[str, Any]:
    """Arrays of a version 7.3 file, which is HDF5 with the axes reversed."""
    try:
        import h5py
    except ImportError as error:
        raise ValueError("a .mat file of version 7.3 needs h5py: pip install 'modalax[files]'") from error
    arrays: dict[str, Any] = {}
    try:
        with h5py.File(path, "r") as file:
            for name in READ_KEYS & set(file):
                node = file[name]
                if isinstance(node, h5py.Dataset):
                    arrays[name] = _dataset(file, node)
    except OSError as error:
        raise ValueError(f"the .mat file is damaged or cut short ({error}); copy or save it again") from error
    return arrays


def _dataset(file: Any, node: Any) -> np.ndarray:
    value = np.asarray(node[()])
    if node.attrs.get("MATLAB_class") == b"char":
        return np.array(_letters(value), dtype=str)
    if value.dtype.kind == "O":
        words = [_letters(np.asarray(file[ref][()])) for ref in value.T.ravel()]
        return np.array(words, dtype=str).reshape(value.T.shape)
    if value.dtype.names == ("real", "imag"):
        value = value["real"] + 1j * value["imag"]
    return value.T


def _letters(codes: np.ndarray) -> str:
    return "".join(chr(c) for c in codes.ravel())


def _with_short_axes(arrays: dict[str, Any]) -> dict[str, Any]:
    """Put back axes of length one at the end, where the names say that there is one channel."""
    shaped = dict(arrays)
    one = [key in arrays and np.size(arrays[key]) == 1 for key in ("outputs", "inputs")]
    axes = "".join(np.atleast_1d(np.asarray(arrays.get("axes", "run f o i"))).ravel().tolist()).split()
    for name in ("H", "variance", "coherence"):
        if name not in arrays or not one[1]:
            continue
        value = np.asarray(arrays[name])
        short = len(axes) - value.ndim
        if short == 1 or (short == 2 and one[0]):
            shaped[name] = value.reshape(*value.shape, *[1] * short)
    return shaped


def write_mat(what: Any, path: Path) -> None:
    """Write the arrays of the ``.npz`` contract, names as cell arrays of text."""
    arrays: dict[str, Any] = dict(to_arrays(what))
    for name, value in arrays.items():
        if value.dtype.kind == "U" and value.ndim:
            cells = np.empty(value.shape, dtype=object)
            cells[:] = value.tolist()
            arrays[name] = cells
    scipy.io.savemat(path, arrays, do_compression=True)
