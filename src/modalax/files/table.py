"""FRFs as text in columns (CSV): a header names them, the first column holds the frequencies."""

import itertools
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.guard import MOST_NAMES, Refused, reading
from modalax.files.lines import lines_of, table_of
from modalax.files.sniff import COMMENTS, PREAMBLE, looks_like_header
from modalax.files.table_titles import (
    HOW,
    Column,
    both_parts,
    cells_of,
    check_columns,
    column_of,
    factor_of_frequencies,
    pairs_of,
    unit_of_columns,
)

PLAIN_DEGREES = 45.0  # size of phases above which they are no radians


def read_table(path: Path) -> dict[str, Any]:
    """Arrays ``freq`` [Hz], ``H`` (line, column), and names of outputs and inputs where the header tells them.

    Columns are parted by comma, semicolon or tab; with semicolon or tab, numbers may have decimal commas. Names of
    columns as ``2:+Z/1:+Z`` are output and input. Lines before the header, and those that begin with # or %, are
    comments; units stand in brackets in the header, or in a line of their own below it. Magnitudes in dB are twenty
    times the decimal logarithm. A column may hold complex numbers such as ``1.2-3.4i``. Names such as ``H(2Z;1Z)`` or
    ``2Z ref 1Z`` tell output and input too, and ``H21`` where the indices fill every pair.

    Raises
    ------
    ValueError
        If the header does not say what the columns are, or a number cannot be read; the message names the line.
    """
    with reading("the table"):
        rows = lines_of(path, COMMENTS)
        above = list(itertools.islice(rows, PREAMBLE + 1))
        place = next((k for k, (_, line) in enumerate(above) if looks_like_header(line)), 0)
        head, rows = above[place][1], itertools.chain(above[place + 1 :], rows)
    first = next(rows, None)
    mark = _mark(head, first[1] if first else "")
    titles = cells_of(head, mark)
    if len(titles) > 4 * MOST_NAMES:
        raise Refused(f"the table has {len(titles)} columns; at most {4 * MOST_NAMES} are read")
    cells = cells_of(first[1], mark) if first else []
    if first and not any(_is_number(cell) for cell in cells if cell):
        units = [*cells, *[""] * len(titles)]
        titles = [
            f"{title} [{unit.strip('[]()')}]" if unit else title for title, unit in zip(titles, units, strict=False)
        ]
        first = next(rows, None)
        cells = cells_of(first[1], mark) if first else []
    whole = {k for k, cell in enumerate(cells) if _is_complex(cell)}
    try:
        columns = [c for k, title in enumerate(titles) for c in (both_parts(title) if k in whole else [title])][1:]
        columns = [column_of(c) if isinstance(c, str) else c for c in columns]
        factor = factor_of_frequencies(titles[0])
        check_columns(columns, titles)
        unit = unit_of_columns(columns)
    except ValueError as error:
        raise ValueError(f"{error}; the file begins with {head[:40]!r}") from error
    rows = rows if first is None else itertools.chain([first], rows)
    numbers = table_of(rows, lambda line, k: _numbers(line, mark, len(titles), whole, k), len(titles) + len(whole))
    numbers = _rows_with_frequency(numbers)
    names, values = _frfs(columns, numbers)
    found = {"freq": factor * numbers[:, 0], **_channels(names, np.array(values).T)}
    return found | ({"unit": unit} if unit else {})


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_complex(cell: str) -> bool:
    return bool(cell) and cell[-1] in "ij)" and not _is_number(cell)


def _mark(head: str, first: str) -> str | None:
    """The sign that parts the columns: one that gives as many titles as the next line has cells; None for blanks."""
    found = [m for m in ("\t", ";", ",") if m in head]
    fits = (m for m in found if len(cells_of(head, m)) == len(cells_of(first.rstrip(m), m)) > 1)
    return next(fits, next(iter(found), None))


def _numbers(line: str, mark: str | None, count: int, whole: set[int], row: int) -> list[float]:
    """Numbers of a line, two of the cells that are ``whole`` complex numbers; NaN for an empty cell."""
    cells = line.split(mark) if mark else line.split()
    if len(cells) == count + 1 and not cells[-1].strip():
        cells = cells[:-1]
    if len(cells) != count:
        raise ValueError(f"line {row} has {len(cells)} columns, the header {count}")
    cells = [c.strip() or "nan" for c in cells]
    decimal = (lambda c: c.replace(",", ".")) if mark in ("\t", ";") else (lambda c: c)
    try:
        if whole:
            return [v for k, c in enumerate(cells) for v in (_two(decimal(c)) if k in whole else (float(decimal(c)),))]
        return [float(decimal(c)) for c in cells]
    except ValueError as error:
        raise ValueError(f"line {row} holds what is no number ({error})") from error


def _two(cell: str) -> tuple[float, float]:
    """Real and imaginary part of a cell such as ``1.2-3i``, ``(1.2-3j)`` or ``1.2 - 3i``."""
    value = complex(cell.strip().strip('"').replace(" ", "").replace("i", "j"))
    return value.real, value.imag


def _rows_with_frequency(numbers: np.ndarray) -> np.ndarray:
    """The rows whose first cell is not empty, with a warning where some were left out."""
    nameless = np.isnan(numbers[:, 0])
    if nameless.any() and not nameless.all():
        warnings.warn(f"{nameless.sum()} of {len(nameless)} lines have no frequency; left out", stacklevel=2)
        return numbers[~nameless]
    return numbers


def _frfs(columns: list[Column], numbers: np.ndarray) -> tuple[list[str], list[np.ndarray]]:
    """Names of the FRFs in the columns, and their values.

    Raises
    ------
    ValueError
        If a phase may be in degrees or in radians.
    """
    parts: dict[str, dict[str, np.ndarray]] = {}
    for k, column in enumerate(columns, start=1):
        value = numbers[:, k]
        if column.decibel:
            value = 10 ** (value / 20)
            warnings.warn(f"column {column.title!r} is taken as 20 log10 of the magnitude", stacklevel=2)
        if column.kind == "phase":
            value = np.deg2rad(value) if _in_degrees(column, value) else value
        parts.setdefault(column.name, {})[column.kind] = value
    values = [
        p["real"] + 1j * p["imag"] if "real" in p else p["size"] * np.exp(1j * p["phase"]) for p in parts.values()
    ]
    return list(parts), values


def _in_degrees(column: Column, value: np.ndarray) -> bool:
    if column.degrees is not None:
        return column.degrees
    largest = np.max(np.abs(value), initial=0.0, where=~np.isnan(value))
    if largest > PLAIN_DEGREES:
        warnings.warn(f"column {column.title!r} is taken as degrees, as it reaches {largest:.3g}", stacklevel=2)
        return True
    raise ValueError(f"column {column.title!r} does not say whether the phase is in deg or rad; {HOW}")


def _channels(names: list[str], H: np.ndarray) -> dict[str, Any]:
    """``H`` by outputs and inputs where all columns are named so; else by columns, and their names."""
    ends = pairs_of(names)
    if ends:
        outputs, inputs = (list(dict.fromkeys(side)) for side in zip(*ends, strict=True))
        if len(ends) != len(outputs) * len(inputs):
            missing = next(f"{o}/{i}" for o in outputs for i in inputs if (o, i) not in ends)
            raise ValueError(
                f"FRF {missing} is missing: all of {len(outputs)} outputs and {len(inputs)} inputs are needed"
            )
        order = [ends.index((o, i)) for o in outputs for i in inputs]
        full = H[:, order].reshape(len(H), len(outputs), len(inputs))
        return {"H": full, "outputs": np.array(outputs), "inputs": np.array(inputs), "axes": np.array("f o i")}
    return {"H": H, "columns": np.array(names)}


def names_of_columns(arrays: dict[str, Any], outputs: Any, inputs: Any) -> dict[str, Any]:
    """Columns as outputs of the one input that was named, or as inputs of the one output.

    Raises
    ------
    ValueError
        If neither was named and there are several columns, or the names do not fit.
    """
    if "columns" not in arrays:
        return arrays
    columns = [str(name) for name in arrays.pop("columns")]
    told = math.prod(len(names or ()) for names in (outputs, inputs))
    if len(columns) > 1 and (outputs is None) == (inputs is None) and told != len(columns):
        raise ValueError(
            f"the columns are named {', '.join(columns[:4])}, which does not tell outputs from inputs; name them as "
            "output/input, or name the one input by inputs=['...'] (--inputs) or the one output by outputs=['...']"
        )
    if inputs is not None and len(inputs) == 1 and outputs is None and all(columns):
        names = {"outputs": np.array(columns), "inputs": np.array(list(inputs))}
        return arrays | names | {"H": arrays["H"][:, :, None], "axes": np.array("f o i")}
    if outputs is not None and len(outputs) == 1 and inputs is None and all(columns):
        names = {"outputs": np.array(list(outputs)), "inputs": np.array(columns)}
        return arrays | names | {"H": arrays["H"][:, None, :], "axes": np.array("f o i")}
    return arrays
