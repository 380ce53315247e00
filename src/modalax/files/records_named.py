"""Time records from files of named arrays: MATLAB, NumPy ``.npz``, HDF5."""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from modalax.data.recording import Recording, rate_of
from modalax.files.guard import reading
from modalax.files.inside import check_datasets, check_elements
from modalax.files.npz import npz_arrays
from modalax.files.records_tables import from_array, split_unit

_RATE = re.compile(r"^(fs|f_s|fsamp\w*|sampl\w*_?(rate|freq\w*)|rate|sr)$", re.IGNORECASE)
_STEP = re.compile(r"^(dt|ts|delta_?t|step|increment)$", re.IGNORECASE)
_TIME = re.compile(r"^(t|time|times)$", re.IGNORECASE)
LEAST = 16  # samples of what counts as a record


def read_named(path: Path, kind: str, fs: float | None, array: str) -> Recording:
    """All arrays of one length as channels, or one array by name; the rate from an entry such as ``Fs``, ``dt``, ``t``.

    Raises
    ------
    ValueError
        If the file is damaged, its arrays do not go together, or there is no rate.
    """
    arrays, units = {"npz": _npz, "mat": _mat, "hdf5": _hdf5}[kind](path)
    rate = fs if fs is not None else _rate(arrays)
    if array:
        if array not in arrays:
            raise ValueError(f"holds no array {array!r}; there are {_shown(arrays)}")
        return from_array(arrays[array], rate, split_unit(array)[0])
    long = {
        k: v for k, v in arrays.items()
        if v.dtype.kind in "iuf" and v.ndim and v.size and max(v.shape) >= LEAST and not _TIME.match(k)
    }  # fmt: skip
    if not long:
        raise ValueError(f"holds no time records; its arrays: {_shown(arrays)}")
    if len(long) == 1 and next(iter(long.values())).ndim > 2:
        return from_array(next(iter(long.values())), rate, "")
    columns = _columns(long)
    if columns is None:
        raise ValueError(f"its arrays do not go together; say which one to read (array): {_shown(long)}")
    if len(long) == 1 and next(iter(long.values())).ndim == 2:
        name, value = next(iter(long.items()))
        return from_array(value, rate, name)
    if rate is None:
        raise ValueError(
            f"holds no sampling rate (such as Fs, dt or t); give it in Hz (fs, --fs); its arrays: {_shown(arrays)}"
        )
    names, labels = [], []
    for name, value in columns.items():
        plain, unit = split_unit(name)
        count = value.shape[2]
        names += [plain] if count == 1 else [f"{plain} {k + 1}" for k in range(count)]
        labels += [units.get(name, unit)] * count
    data = np.concatenate(list(columns.values()), axis=2)
    return Recording(data, rate, tuple(names), tuple(labels), tuple(range(1, len(names) + 1)))


def _columns(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """The arrays as ``(segment, t, channel)``; None where their segments or lengths differ.

    Where one array has three axes, segments first, those of two are ``(segment, t)`` of one channel; else all are of
    one segment.
    """
    several = any(value.ndim > 2 for value in arrays.values())
    if several and not all(value.ndim in (2, 3) for value in arrays.values()):
        return None
    columns = {name: _along_time(value, several) for name, value in arrays.items()}
    kinds = {value.shape[:2] for value in columns.values()}
    if len(kinds) > 1:
        return None
    if several:
        count, samples = kinds.pop()
        warnings.warn(f"its arrays are taken as {count} records of {samples} samples each", stacklevel=3)
    return columns


def _along_time(value: np.ndarray, several: bool) -> np.ndarray:
    """An array as ``(segment, t, channel)``, time along its longest axis."""
    if not several:
        value = np.atleast_2d(value)[None]
    elif value.ndim == 2:
        value = value[:, :, None]
    return np.moveaxis(value.astype(float), int(np.argmax(value.shape)), 1)


def _rate(arrays: dict[str, np.ndarray]) -> float | None:
    for name, value in arrays.items():
        if value.size == 1 and value.dtype.kind in "iuf":
            number = float(value.ravel()[0])
            if _RATE.match(name):
                warnings.warn(f"sampling rate {number:g} Hz from its {name}", stacklevel=3)
                return number
            if _STEP.match(name) and number != 0:
                warnings.warn(f"sampling rate {1 / number:g} Hz from its {name} = {number:g} s", stacklevel=3)
                return 1 / number
    for name, value in arrays.items():
        if _TIME.match(name) and value.size >= LEAST and value.dtype.kind in "iuf":
            rate = rate_of(value.ravel().astype(float))
            warnings.warn(f"sampling rate {rate:g} Hz from its {name}", stacklevel=3)
            return rate
    return None


def _shown(arrays: dict[str, np.ndarray]) -> str:
    return ", ".join(f"{k} {v.shape}" for k, v in arrays.items()) or "none"


Named = tuple[dict[str, np.ndarray], dict[str, str]]


def _npz(path: Path) -> Named:
    return npz_arrays(path, every=True), {}


def _mat(path: Path) -> Named:
    import scipy.io

    with reading("the .mat file"):
        check_elements(path)
        found = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    arrays: dict[str, np.ndarray] = {}
    for name, value in found.items():
        if not name.startswith("__"):
            arrays |= _unfolded(name, value)
    return arrays, {}


def _unfolded(name: str, value: Any) -> dict[str, np.ndarray]:
    """An array by its name; the fields of a structure by ``structure.field``."""
    if hasattr(value, "_fieldnames"):
        found: dict[str, np.ndarray] = {}
        for field in value._fieldnames:
            found |= _unfolded(field if _RATE.match(field) or _STEP.match(field) else f"{name}.{field}",
                               getattr(value, field))  # fmt: skip
        return found
    return {name: np.asarray(value)}


def _hdf5(path: Path) -> Named:
    try:
        import h5py
    except ImportError as error:
        raise ValueError("reading HDF5 needs h5py: pip install 'modalax[files]'") from error
    names: list[str] = []

    def visit(name: str, node: Any) -> None:
        if not name.startswith("#") and isinstance(node, h5py.Dataset) and node.dtype.kind in "iuf":
            names.append(name)

    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    with reading("the HDF5 file"), h5py.File(path, "r") as file:
        file.visititems(visit)
        check_datasets(file, names, path)
        arrays |= _rates(file.attrs)
        for name in names:
            node: Any = file[name]
            arrays[name] = np.asarray(node[()])
            word = next((node.attrs[key] for key in ("unit", "units", "unit_str") if key in node.attrs), None)
            if word is not None:
                units[name] = word.decode() if isinstance(word, bytes) else str(word)
            arrays = _rates(node.attrs) | arrays
    return arrays, units


def _rates(attributes: Any) -> dict[str, np.ndarray]:
    """Rates and steps among attributes."""
    found = {}
    for key in attributes:
        if _RATE.match(key) or _STEP.match(key):
            word = np.asarray(attributes[key])
            if word.size == 1 and word.dtype.kind in "iuf":
                found[key] = word.astype(float)
    return found
