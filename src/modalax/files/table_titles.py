"""What the titles of a table's columns say: part of a complex number, name of the FRF, and units."""

import re
import warnings
from typing import NamedTuple

from modalax.files.sniff import FREQUENCY
from modalax.files.units import frequency_factor, response_unit

KINDS = {
    "real": r"re|real", "imag": r"im|imag|imaginary", "size": r"mag|magnitude|abs|amp|amplitude",
    "phase": r"phase|phi|arg|angle",
}  # fmt: skip
HOW = "a header names the columns: freq, then 're NAME' and 'im NAME' (or 'mag NAME', 'phase NAME [deg]') of each FRF"
ANGLE = re.compile(r"[\[(]\s*(deg|degrees|°|rad)\s*[\])]|_(deg|rad)\b", re.IGNORECASE)
DECIBEL = re.compile(r"[\[(]\s*dB\s*[\])]|[_\s]dB\b", re.IGNORECASE)
PAIRS = tuple(
    re.compile(pattern, re.IGNORECASE)
    for pattern in (
        r"(?:(?:H|FRF|TF|G)\b)?\s*[\[({]\s*([^/;,|]+?)\s*[/;,|]\s*([^/;,|]+?)\s*[\])}]",
        r"(?:FRF\b)?\s*(?:(?:resp|response|point|node|output|out)\b\.?)?\s*([^/;,|]+?)\s*[/;,|]?\s*"
        r"\b(?:ref|reference|input|excitation|force)\b\.?\s*([^/;,|]+)",
        r"([^/]+?)\s*/\s*([^/]+)",
    )
)
INDICES = re.compile(r"([A-Za-z]+)_?(?:(\d)(\d)|(\d+)_(\d+))")
BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")


class Column(NamedTuple):
    """What a column holds.

    Attributes
    ----------
    title
        As it stands in the file.
    kind
        ``real``, ``imag``, ``size`` or ``phase``.
    name
        Of the FRF; empty where there is none.
    degrees
        Whether a phase is in degrees; None where the title does not say.
    decibel
        Whether a magnitude is in dB.
    unit
        Of the FRF, such as ``g/N``; empty where the title has none.
    """

    title: str
    kind: str
    name: str
    degrees: bool | None
    decibel: bool
    unit: str


def column_of(title: str) -> Column:
    """The meaning of a title.

    Raises
    ------
    ValueError
        If it names no part of an FRF.
    """
    angle = ANGLE.search(title)
    degrees = None if angle is None else not (angle[1] or angle[2]).lower().startswith("rad")
    decibel = DECIBEL.search(title) is not None
    unit, bare = _without_unit(DECIBEL.sub("", ANGLE.sub("", title)))
    bare = re.sub(r"\[.*?\]", "", bare).strip()
    for kind, pattern in KINDS.items():
        for shape in (
            rf"(?:{pattern})\s*\(\s*(.*?)\s*\)",
            rf"(?:{pattern})(?:[\s_:.]+(.*))?",
            rf"(.*?)[\s_.]+(?:{pattern})",
            rf"(.*?)[\s_.]*\(\s*(?:{pattern})\s*\)",
        ):
            match = re.fullmatch(shape, bare, re.IGNORECASE)
            if match:
                name = (match[1] or "").strip()
                name = f"({name})" if re.search(r"[,;|]", name) and bare.endswith(f"({name})") else name
                return Column(title, kind, name, degrees, decibel, unit)
    raise ValueError(f"column {title!r} is neither a real nor imaginary part, magnitude nor phase; {HOW}")


def both_parts(title: str) -> list[Column]:
    """The two columns of a title whose cells hold complex numbers."""
    unit, bare = _without_unit(title)
    return [Column(title, kind, re.sub(r"\[.*?\]", "", bare).strip(), None, False, unit) for kind in ("real", "imag")]


def _without_unit(title: str) -> tuple[str, str]:
    """The unit of an FRF that stands in brackets, and the title without it."""
    for match in BRACKETS.finditer(title):
        inside = match[1] or match[2] or ""
        try:
            response_unit(inside)
        except ValueError:
            continue
        return inside, (title[: match.start()] + title[match.end() :]).strip()
    return "", title


def pairs_of(names: list[str]) -> list[tuple[str, str]] | None:
    """Output and input that each name tells: ``2:+Z/1:+Z``, ``H(2Z;1Z)``, ``H21`` or ``H_12_3``; None if one does not.

    Indices alone are told from a channel's number only where they fill every output and input.
    """
    for pattern in PAIRS:
        told = [pattern.fullmatch(name.strip()) for name in names]
        if all(told):
            return [(match[1].strip(), match[2].strip()) for match in told if match]
    counted = [INDICES.fullmatch(name) for name in names]
    found = [(m[2] or m[4], m[3] or m[5]) for m in counted if m]
    outputs, inputs = ({end[k] for end in found} for k in (0, 1))
    one_word = len({m[1] for m in counted if m}) == 1
    if len(found) < len(names) or not one_word or len(set(found)) != len(outputs) * len(inputs) or len(found) < 2:
        return None
    text = (
        f"{names[0]} is taken as output {found[0][0]} by input {found[0][1]}, {names[-1]} as output {found[-1][0]} by"
    )
    warnings.warn(f"{text} input {found[-1][1]}", stacklevel=2)
    return found


def cells_of(line: str, mark: str | None) -> list[str]:
    """Cells of a line parted by ``mark`` (blanks without one); what stands in round brackets or quotes stays whole."""
    if mark is None:
        return line.split()
    cells, depth, quoted, begin = [], 0, False, 0
    for k, sign in enumerate(line):
        quoted ^= sign == '"'
        depth = max(depth + (sign == "(") - (sign == ")"), 0)
        if sign == mark and not quoted and (depth == 0 or ")" not in line[k:]):
            cells.append(line[begin:k])
            begin = k + 1
    return [cell.strip().strip('"').strip() for cell in [*cells, line[begin:]]]


def factor_of_frequencies(title: str) -> float:
    """Hz in one of the unit that the title of the first column names; 1 without any.

    Raises
    ------
    ValueError
        If the title is none of frequencies, or the unit is not known.
    """
    if not FREQUENCY.fullmatch(re.split(r"[\s\[(_/]", title)[0]):
        raise ValueError(f"the first column is {title!r}; {HOW}")
    unit = re.search(r"[\[(](.*?)[\])]", title) or re.search(r"_(k?hz)$", title, re.IGNORECASE)
    return frequency_factor(unit[1]) if unit else 1.0


def check_columns(columns: list[Column], titles: list[str]) -> None:
    """Refuse columns that are none of an FRF in full.

    Raises
    ------
    ValueError
        Naming the column or the FRF.
    """
    parts: dict[str, set[str]] = {}
    for column in columns:
        if column.kind in parts.setdefault(column.name, set()):
            raise ValueError(f"column {column.title!r} stands twice; each FRF needs a name of its own")
        parts[column.name].add(column.kind)
    for name, found in parts.items():
        if found not in ({"real", "imag"}, {"size", "phase"}):
            raise ValueError(f"of FRF {name or '(without name)'} there is {', '.join(sorted(found))} only; {HOW}")
    if not parts:
        raise ValueError(f"the table has the columns {', '.join(titles[:6])}; {HOW}")


def unit_of_columns(columns: list[Column]) -> str:
    """The one unit that the titles name; empty where they name none.

    Raises
    ------
    ValueError
        If they name several.
    """
    units = list(dict.fromkeys(column.unit for column in columns if column.unit))
    if len(units) > 1:
        raise ValueError(
            f"the columns are in {', '.join(units[:4])}; FRFs of one file need one unit: put each kind of "
            "sensor into a file of its own"
        )
    return units[0] if units else ""
