"""Universal files: what they hold, set by set, by pyuff; here FRFs (58) are put together and taken apart."""

import contextlib
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modalax.data.frf import FRF
from modalax.data.geometry import Geometry
from modalax.data.measurement import Measurement
from modalax.files.guard import reading
from modalax.files.messages import about
from modalax.files.sniff import sniff
from modalax.files.uff_binary import with_numbers, with_numbers_apart, without_numbers
from modalax.files.uff_functions import function_sets, functions_of, measurement_of
from modalax.files.uff_index import index_of
from modalax.files.uff_nodes import Modes, geometry_of, geometry_sets, mode_sets, modes_of
from modalax.files.uff_units import SI, units_of
from modalax.model.modal import ModalModel
from modalax.model.structure import Structure

Set = Mapping[str, Any]
READ = (15, 55, 58, 82, 151, 164, 2411, 2412, 2414)
# Columns of the second line of a binary data set 58 that hold the number of bytes after the header.
N_BYTES = slice(31, 43)


def _pyuff() -> Any:
    try:
        import pyuff
    except ImportError as error:
        raise ValueError("reading and writing UFF needs pyuff: pip install 'modalax[files]'") from error
    return pyuff


def set_types(path: Path) -> list[int]:
    """Types of the data sets of a universal file, in their order; ``ValueError`` if it is damaged."""
    _require_whole(path)
    try:
        return [entry.kind for entry in index_of(path)]
    except ValueError:  # a header that tells too many or too few bytes; pyuff looks for the end of each set
        with reading("the universal file"):
            return [int(t) for t in _pyuff().UFF(str(path)).get_set_types()]


def read_sets(path: Path) -> list[dict[str, Any]]:
    """All data sets of kinds that are known here, each with the units (``"units"``) that stand before it.

    Raises
    ------
    ValueError
        If the file is cut short or a set is damaged; the message names the set.
    """
    pyuff = _pyuff()
    _require_whole(path)
    entries = with_numbers_apart(path)
    with without_numbers(path, entries) as headers:
        with reading("the universal file"):
            file = pyuff.UFF(str(headers if entries else path))
            kinds = [int(t) for t in file.get_set_types()]
            if entries and kinds != [entry.kind for entry in entries]:  # lines that pyuff takes otherwise
                entries, file = [], pyuff.UFF(str(path))
                kinds = [int(t) for t in file.get_set_types()]
        content = np.memmap(path, dtype=np.uint8, mode="r") if entries else np.zeros(0, np.uint8)
        sets, units, axis = [], None, None
        for k, kind in enumerate(kinds):
            if kind not in READ:
                continue
            numbers = entries[k].numbers if entries else None
            try:
                # pyuff prints what it cannot do; what is missing is judged here.
                with contextlib.redirect_stdout(None):
                    found = file.read_sets(k, header_only=numbers is not None)
                found = found if numbers is None else with_numbers(found, content[numbers])
                units = units_of(found) if kind == 164 else units
            except Exception as error:
                reason = " ".join(str(error.__context__ or error).split())[:300]
                raise ValueError(f"data set {k + 1}, of type {kind}, is damaged: {reason}") from error
            if kind == 58 and found.get("x") is not None:  # functions with the same axis share it
                axis = found["x"] if axis is None or not np.array_equal(axis, found["x"]) else axis
                found["x"] = axis
            sets.append({**found, "units": units})
    if not sets:
        held = ", ".join(str(t) for t in sorted(set(kinds))) or "none"
        raise ValueError(f"holds no data set that is read here ({', '.join(map(str, READ))}); its types: {held}")
    return sets


def _require_whole(path: Path) -> None:
    """Refuse a file whose last set is not closed: pyuff would drop that set without a word."""
    with path.open("rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - 400))
        tail = file.read().rstrip()
    if not tail.endswith(b"-1"):
        raise ValueError("the file is cut short: its last data set is not closed by a line '    -1'; copy it again")


def read_uff(
    path: Path, form: str | None = None, complete: bool = False, frequency_unit: str | None = None
) -> Measurement | ModalModel:
    """Read the FRFs of a universal file, or, where it has none, its scaled mode shapes.

    Parameters
    ----------
    path
        The file.
    form
        ``receptance``, ``mobility`` or ``accelerance``, for files that do not tell, or tell it wrongly.
    complete
        Where some pairs of output and input are missing: True drops the channels that lack them, with a warning
        that names them; False refuses.
    frequency_unit
        Hz, kHz, rad/s or rpm, for files whose label of the frequency axis does not tell, or tells it wrongly.

    Raises
    ------
    ValueError
        If there is nothing to use; the message says what the file holds.
    """
    with reading("the universal file", ValueError):
        return _frfs_or_modes(read_sets(path), form, complete, frequency_unit)


def _frfs_or_modes(
    sets: list[dict[str, Any]], form: str | None, complete: bool, frequency_unit: str | None
) -> Measurement | ModalModel:
    functions = functions_of([s for s in sets if s["type"] == 58])
    if any(f.kind == "frf" for f in functions):
        shapes = sum(s["type"] in (55, 2414) for s in sets)
        if shapes:
            warnings.warn(
                f"beside the FRFs it holds {shapes} data sets of shapes; modalax.files.load_modes reads mode shapes",
                UserWarning,
                stacklevel=4,
            )
        return measurement_of(functions, form, complete, frequency_unit)
    modes = modes_of(sets)
    if modes is not None:
        return modes.model()
    kinds = sorted({f.title for f in functions}) + sorted({f"type {s['type']}" for s in sets if s["type"] != 58})
    geometry = "nodes and lines are read by modalax.files.load_geometry"
    records = "time records become FRFs by modalax frf" if "time responses" in kinds else ""
    said = "; ".join(filter(None, (records, geometry if any(s["type"] != 58 for s in sets) else "")))
    raise ValueError(f"holds {', '.join(kinds)} but neither FRFs nor mode shapes{said and f'; {said}'}")


def load_geometry(path: Path | str) -> Geometry:
    """Nodes and lines of a universal file (15, 2411, 82, 2412), a table of points (CSV) or triangles (STL), in metres.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it holds no nodes.
    """
    path = Path(path)
    with about(path):
        if path.suffix.lower() in (".stl", ".csv") and path.is_file():
            from modalax.files.points import geometry_of_points, geometry_of_triangles

            return (geometry_of_triangles if path.suffix.lower() == ".stl" else geometry_of_points)(path)
        _check_universal(path)
        with reading("the universal file", ValueError):
            return geometry_of(read_sets(path))


def load_modes(path: Path | str) -> Modes:
    """Mode shapes of a universal file (55, 2414), scaled or not.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it holds no mode shapes.
    """
    path = Path(path)
    with about(path):
        _check_universal(path)
        with reading("the universal file", ValueError):
            modes = modes_of(read_sets(path))
        if modes is None:
            raise ValueError("holds no mode shapes (data set 55 or 2414 at nodes)")
    return modes


def _check_universal(path: Path) -> None:
    kind = sniff(path)
    if kind != "uff":
        raise ValueError(f"is a file of kind {kind}; nodes and mode shapes are read from universal files")


def write_uff(what: Any, path: Path, binary: bool = True, geometry: Geometry | None = None) -> None:
    """Write FRFs (58), or the shapes of a modal model (55), with units (164) and, if given, geometry (2411, 82).

    Shapes do not go to 2414, though they are read from it: pyuff 2.5 writes a negative number there one column too
    wide, as the real part of every pole is, so that fixed columns (its own among them) read the frequency as 0.

    Parameters
    ----------
    what
        A measurement or a modal model.
    path
        The file.
    binary
        True keeps every digit. False writes text: 12 digits of the FRF, and 6 of the frequencies where they are not
        evenly spaced by a step of at most 6 digits. Shapes are always text, of 6 digits.
    geometry
        Nodes and lines to go with them.

    Raises
    ------
    ValueError
        If the object cannot be held by a universal file.
    """
    if isinstance(what, Structure):
        raise ValueError("a Structure (M, C, K) has no place in a universal file; save it as .npz or .mat")
    if isinstance(what, ModalModel):
        names = (*what.outputs, *what.inputs)
        body = mode_sets(what, geometry)
    elif isinstance(what, Measurement | FRF):
        measurement = Measurement.from_frfs([what]) if isinstance(what, FRF) else what
        names = (*measurement.outputs, *measurement.inputs)
        body = function_sets(measurement, binary, geometry)
    else:
        raise ValueError(f"a {type(what).__name__} cannot be written to a universal file")
    places = [] if geometry is None else geometry_sets(geometry, names)
    with path.open("wb") as file:
        for chunk in _encoded([_header(), SI, *places, *body]):
            file.write(chunk)


def _header() -> dict[str, Any]:
    from importlib.metadata import version

    return {
        "type": 151, "model_name": "NONE", "description": "NONE", "db_app": "modalax",
        "program": f"modalax {version('modalax')}",
    }  # fmt: skip


def _encoded(sets: Any) -> Iterator[bytes]:
    """Bytes of each data set, as pyuff writes it to a file of its own.

    Adding set after set to one file would make pyuff read the whole file again each time, a cost that grows with the
    square of the number of channels.
    """
    pyuff = _pyuff()
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "part.uff"
        for one in sets:
            part.unlink(missing_ok=True)
            with warnings.catch_warnings():
                # In binary, pyuff leaves closing the file to the garbage collector.
                warnings.simplefilter("ignore", ResourceWarning)
                # Its mode "overwrite" loses the header of binary sets; "add" to a file that is not there does not.
                try:
                    pyuff.UFF(str(part)).write_sets(dict(one), mode="add")
                except Exception as error:  # pyuff says only that it failed; why, is the error before its own
                    if isinstance(error.__context__, OSError):
                        raise error.__context__ from None
                    raise
            chunk = part.read_bytes()
            yield _true_size(chunk, one) if one.get("binary") else chunk


def _true_size(chunk: bytes, one: Set) -> bytes:
    """Write the true number of data bytes into the header: pyuff counts 8 a line, whatever a line holds."""
    columns = (2 if np.iscomplexobj(one["data"]) else 1) + (not one["abscissa_spacing"])
    start = chunk.index(b"\n") + 1
    line = bytearray(chunk[start : chunk.index(b"\n", start)])
    line[N_BYTES] = b"%12d" % (8 * columns * len(one["data"]))
    return chunk[:start] + bytes(line) + chunk[start + len(line) :]
