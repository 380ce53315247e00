"""MATLAB ``.mat`` files, with the same names of arrays as in ``.npz``."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse

from modalax.files.arrays import NOTHING, READ_KEYS, Saved, from_arrays, to_arrays
from modalax.files.guard import LONGEST_NAME, MORE, Refused, check_names, reading
from modalax.files.inside import check_datasets, check_elements
from modalax.files.plain import Told


def read_mat(path: Path, told: Told = NOTHING) -> Saved:
    """Read a measurement, structure or modal model from a ``.mat`` file of any version.

    MATLAB drops trailing axes of length one; they are put back from the names of the inputs and outputs.

    Raises
    ------
    ValueError
        If the file is damaged or what it holds is none of the three.
    """
    with path.open("rb") as file:
        newest = file.read(19) == b"MATLAB 7.3 MAT-file"
    return from_arrays(_with_short_axes(_newest(path) if newest else _classic(path), told.axes), told)


def _classic(path: Path) -> dict[str, Any]:
    with reading("the .mat file"):
        check_elements(path)
        kinds = {name: kind for name, _, kind in scipy.io.whosmat(path)}
        names = list(kinds)
        whole = [name for name, kind in kinds.items() if kind == "struct"]
        if whole and not set(names) & READ_KEYS:
            return _fields(path, whole)
        found = scipy.io.loadmat(path, variable_names=sorted(READ_KEYS))
        return {name: _value(name, found[name]) if name in found else None for name in names}


def _fields(path: Path, structs: list[str]) -> dict[str, Any]:
    """What the one struct of a file holds, as if its fields had been saved by themselves."""
    remedy = f"save its fields: save('FILE', '-struct', '{structs[0]}')"
    if len(structs) > 1:
        raise Refused(
            f"the file holds the structs {', '.join(structs[:4])}, of which none is read; of the one, {remedy}"
        )
    struct = scipy.io.loadmat(path, variable_names=structs)[structs[0]]
    if struct.size != 1:
        raise Refused(f"{structs[0]} is an array of {struct.size} structs, which is not read; of one, {remedy}")
    found = {name: struct[name].item() for name in struct.dtype.names or ()}
    if not set(found) & READ_KEYS:
        raise Refused(f"{structs[0]} is a struct of {', '.join(list(found)[:6])}, none of which is read; {remedy}")
    warnings.warn(f"the fields of {structs[0]} are read", stacklevel=2)
    return {name: _value(name, value) if name in READ_KEYS else None for name, value in found.items()}


def _value(name: str, value: Any) -> Any:
    """Cell arrays of text as arrays of it, sparse matrices in full."""
    if scipy.sparse.issparse(value):
        if value.shape[0] * value.shape[1] * 8 > MORE:
            raise Refused(f"{name} is a sparse matrix of shape {value.shape}, too large to be written out in full")
        return value.toarray()
    if isinstance(value, np.ndarray) and value.dtype == object:
        words = [np.asarray(item) for item in value.ravel()]
        if any(word.dtype.kind != "U" or word.size > 1 for word in words):
            raise Refused(f"{name} is a cell array that holds other things than words")
        return _words([str(word.item()) if word.size else "" for word in words], value.shape, name)
    return value


def _newest(path: Path) -> dict[str, Any]:
    """Arrays of a version 7.3 file, which is HDF5 with the axes reversed."""
    try:
        import h5py
    except ImportError as error:
        raise ValueError("a .mat file of version 7.3 needs h5py: pip install 'modalax[files]'") from error
    arrays: dict[str, Any] = {}
    with reading("the .mat file"), h5py.File(path, "r") as file:
        names = set(file) - {"#refs#", "#subsystem#"}
        check_datasets(file, READ_KEYS & names, path)
        for name in names:
            arrays[name] = _dataset(file, name) if name in READ_KEYS else None
    return arrays


def _dataset(file: Any, name: str) -> Any:
    node = file[name]
    if node.dtype.kind == "O":
        check_names(node.size, name)
        refs = np.asarray(node[()]).T
        return _words([_letters(file[ref], name) for ref in refs.ravel()], refs.shape, name)
    if node.attrs.get("MATLAB_class") == b"char":
        return np.array(_letters(node, name), dtype=str)
    value = np.asarray(node[()])
    if value.dtype.names == ("real", "imag"):
        value = value["real"] + 1j * value["imag"]
    return value.T


def _words(words: list[str], shape: tuple[int, ...], name: str) -> np.ndarray:
    """Words as an array, which holds every one at the length of the longest."""
    longest = max((len(word) for word in words), default=0)
    if longest > LONGEST_NAME:
        raise Refused(f"{name} holds a word of {longest} letters; names have at most {LONGEST_NAME}")
    return np.array(words, dtype=str).reshape(shape)


def _letters(node: Any, name: str) -> str:
    if node.dtype.kind not in "iu" or node.size > LONGEST_NAME:
        raise Refused(
            f"{name} holds {node.size} items of type {node.dtype} where a word of at most "
            f"{LONGEST_NAME} letters should be"
        )
    return "" if node.attrs.get("MATLAB_empty") else "".join(chr(c) for c in np.asarray(node[()]).ravel())


def _with_short_axes(arrays: dict[str, Any], told: str | None = None) -> dict[str, Any]:
    """Put back axes of length one at the end, as told or else as the file says, where names tell of one channel."""
    shaped = dict(arrays)
    one = [key in arrays and np.size(arrays[key]) == 1 for key in ("outputs", "inputs")]
    said = arrays.get("axes", "run f o i") if told is None else told.replace(",", " ")
    axes = " ".join(str(word) for word in np.ravel(said)).split()
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
    # What is large and shrinks far would be refused when it is read again.
    large = sum(np.asarray(value).nbytes for value in arrays.values()) > MORE
    scipy.io.savemat(path, arrays, do_compression=not large)
