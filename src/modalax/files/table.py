"""FRFs as text in columns (CSV): a header names them, the first column holds the frequencies."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.guard import MOST_NAMES, Refused, reading
from modalax.files.lines import lines_of, table_of
from modalax.files.sniff import FREQUENCY
from modalax.files.units import frequency_factor

KINDS = {
    "real": r"re|real", "imag": r"im|imag|imaginary", "size": r"mag|magnitude|abs|amp|amplitude",
    "phase": r"phase|phi|arg|angle",
}  # fmt: skip
HOW = "a header names the columns: freq, then 're NAME' and 'im NAME' (or 'mag NAME', 'phase NAME [deg]') of each FRF"


def read_table(path: Path) -> dict[str, Any]:
    """Arrays ``freq`` [Hz], ``H`` (line, column), and names of outputs and inputs where the header tells them.

    Columns are parted by comma, semicolon or tab; with semicolon or tab, numbers may have decimal commas. Names of
    columns as ``2:+Z/1:+Z`` are output and input.

    Raises
    ------
    ValueError
        If the header does not say what the columns are, or a number cannot be read; the message names the line.
    """
    with reading("the table"):
        rows = lines_of(path, "#")
        head = next(rows)[1]
    mark = next((m for m in ("\t", ";", ",") if m in head), None)
    titles = [t.strip().strip('"').strip() for t in (head.split(mark) if mark else head.split())]
    if len(titles) > 4 * MOST_NAMES:
        raise Refused(f"the table has {len(titles)} columns; at most {4 * MOST_NAMES} are read")
    try:
        kinds = [_kind(title) for title in titles[1:]]
        factor = _frequency_factor(titles[0])
        _complete(titles, kinds)
    except ValueError as error:
        raise ValueError(f"{error}; the file begins with {head[:40]!r}") from error
    numbers = table_of(rows, lambda line, k: _numbers(line, mark, len(titles), k), len(titles))
    names, columns = _frfs(kinds, numbers)
    return {"freq": factor * numbers[:, 0], **_channels(names, np.array(columns).T)}


def _numbers(line: str, mark: str | None, count: int, row: int) -> list[float]:
    cells = line.split(mark) if mark else line.split()
    if len(cells) == count + 1 and not cells[-1].strip():
        cells = cells[:-1]
    if len(cells) != count:
        raise ValueError(f"line {row} has {len(cells)} columns, the header {count}")
    try:
        return [float(c.replace(",", ".") if mark in ("\t", ";") else c) for c in cells]
    except ValueError as error:
        raise ValueError(f"line {row} holds what is no number ({error})") from error


def _frequency_factor(title: str) -> float:
    if not FREQUENCY.fullmatch(re.split(r"[\s\[(_/]", title)[0]):
        raise ValueError(f"the first column is {title!r}; {HOW}")
    unit = re.search(r"[\[(](.*?)[\])]", title) or re.search(r"_(k?hz)$", title, re.IGNORECASE)
    return frequency_factor(unit[1]) if unit else 1.0


Column = tuple[str, str, bool | None]


def _complete(titles: list[str], kinds: list[Column]) -> None:
    """Refuse columns that are none of an FRF in full."""
    parts: dict[str, set[str]] = {}
    for title, (kind, name, degrees) in zip(titles[1:], kinds, strict=True):
        if kind == "phase" and degrees is None:
            raise ValueError(f"column {title!r} does not say whether the phase is in deg or rad; {HOW}")
        if kind in parts.setdefault(name, set()):
            raise ValueError(f"column {title!r} stands twice; each FRF needs a name of its own")
        parts[name].add(kind)
    for name, found in parts.items():
        if found not in ({"real", "imag"}, {"size", "phase"}):
            raise ValueError(f"of FRF {name or '(without name)'} there is {', '.join(sorted(found))} only; {HOW}")
    if not parts:
        raise ValueError(f"the table has the columns {', '.join(titles[:6])}; {HOW}")


def _frfs(kinds: list[Column], numbers: np.ndarray) -> tuple[list[str], list[np.ndarray]]:
    """Names of the FRFs in the columns, and their values."""
    parts: dict[str, dict[str, np.ndarray]] = {}
    for k, (kind, name, degrees) in enumerate(kinds, start=1):
        parts.setdefault(name, {})[kind] = np.deg2rad(numbers[:, k]) if degrees else numbers[:, k]
    values = [
        p["real"] + 1j * p["imag"] if "real" in p else p["size"] * np.exp(1j * p["phase"]) for p in parts.values()
    ]
    return list(parts), values


def _kind(title: str) -> Column:
    """What a column holds (real, imag, size, phase), of which FRF, and whether a phase is in degrees."""
    unit = re.search(r"[\[(]\s*(deg|degrees|°|rad)\s*[\])]|_(deg|rad)\b", title, re.IGNORECASE)
    degrees = None if unit is None else not (unit[1] or unit[2]).lower().startswith("rad")
    bare = re.sub(r"\[.*?\]|\((?:deg|degrees|°|rad)\)|_(?:deg|rad)\b", "", title, flags=re.IGNORECASE).strip()
    for kind, pattern in KINDS.items():
        for shape in (
            rf"(?:{pattern})\s*\(\s*(.*?)\s*\)",
            rf"(?:{pattern})(?:[\s_:.]+(.*))?",
            rf"(.*?)[\s_.]+(?:{pattern})",
        ):
            match = re.fullmatch(shape, bare, re.IGNORECASE)
            if match:
                return kind, (match[1] or "").strip(), degrees
    raise ValueError(f"column {title!r} is neither a real nor imaginary part, magnitude nor phase; {HOW}")


def _channels(names: list[str], H: np.ndarray) -> dict[str, Any]:
    """``H`` by outputs and inputs where all columns are named so; else by columns, and their names."""
    pairs = [name.split("/") for name in names]
    if all(len(pair) == 2 and all(p.strip() for p in pair) for pair in pairs):
        ends = [(a.strip(), b.strip()) for a, b in pairs]
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
