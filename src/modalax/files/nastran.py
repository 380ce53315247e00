"""Nastran's text files: bulk data cards, grid points with their coordinate systems, and matrices as DMIG cards.

The layout of the cards is that of the MSC Nastran Quick Reference Guide (entries GRID, CORD1R to CORD2S, DMIG).
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modalax.files.matrices import Matrix

_EXPONENT = re.compile(r"^([+-]?[0-9.]+)([+-][0-9]+)$")
SYMMETRIC, SQUARE = 6, 1  # forms of DMIG matrices
ELEMENTS = {  # fields that hold the grid points of an element
    "CBAR": (2, 4), "CBEAM": (2, 4), "CROD": (2, 4), "CONROD": (1, 3), "CTUBE": (2, 4), "CBUSH": (2, 4),
    "CQUAD4": (2, 6), "CTRIA3": (2, 5), "CQUAD8": (2, 6), "CTRIA6": (2, 5), "CSHEAR": (2, 6),
}  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """A grid point: its position in basic coordinates and the axes in which its displacements are given.

    Attributes
    ----------
    xyz
        Position, shape ``(3,)``, in the unit of length of the deck.
    axes
        Unit vectors of the local displacement axes by row, in basic coordinates, shape ``(3, 3)``.
    """

    xyz: np.ndarray
    axes: np.ndarray


def number(text: str) -> float:
    """Read a Nastran real or integer, such as ``7.+10``, ``1.5D-3`` or ``12``.

    Raises
    ------
    ValueError
        If it is neither, or not finite.
    """
    plain = text.strip().upper().replace("D", "E")
    short = _EXPONENT.match(plain)
    try:
        found = float(f"{short[1]}E{short[2]}" if short else plain)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise ValueError(f"{text.strip()!r} stands where a number is needed")
    return found


def whole(text: str) -> int:
    """Read a whole number, such as that of a grid point.

    Raises
    ------
    ValueError
        If it is none.
    """
    found = number(text)
    if found != int(found):
        raise ValueError(f"{text.strip()!r} stands where a whole number is needed")
    return int(found)


def cards(path: Path, read: set[Path] | None = None) -> Iterator[tuple[str, list[str]]]:
    """Bulk data entries of a deck or punch file, continued lines joined: name and fields as text.

    Small fields (8 characters), large fields (``*``, 16 characters), free fields (commas) and ``INCLUDE`` are read.

    Raises
    ------
    ValueError
        If an included file does not exist, or stands in the deck twice, as where files include one another.
    """
    read = set() if read is None else read
    if path.resolve() in read:
        raise ValueError(f"{path} is included a second time; a deck holds each file once")
    read.add(path.resolve())
    name, fields = "", []
    with path.open(encoding="latin-1") as file:
        for raw in file:
            line = raw.split("$", 1)[0].rstrip().expandtabs(8)
            if not line.strip():
                continue
            if line.upper().startswith("INCLUDE"):
                if name:
                    yield name, fields
                    name, fields = "", []
                yield from cards(_included(path, line), read)
                continue
            head, more = _fields(line)
            if head == "":
                fields += more
                continue
            if name:
                yield name, fields
            name, fields = head, more
    if name:
        yield name, fields


def _included(path: Path, line: str) -> Path:
    target = path.parent / line[len("INCLUDE") :].strip().strip("'\"")
    if not target.is_file():
        raise ValueError(f"{path} includes {target.name}, which is not beside it; put it there")
    return target


def _fields(line: str) -> tuple[str, list[str]]:
    """Name and fields of one line; the name is empty where the line continues the one before."""
    if "," in line:
        parts = [part.strip() for part in line.split(",")]
        head, parts = parts[0], parts[1:9]
    else:
        head, width = line[:8], 16 if "*" in line[:8] else 8
        parts = [line[k : k + width].strip() for k in range(8, 72, width)]
    head = head.strip().upper().rstrip("*")
    return ("" if head[:1] in ("+", "") else head), parts


def read_dmig(path: Path) -> dict[str, Matrix]:
    """Square matrices of a punch file or deck (DMIG entries) by name.

    Raises
    ------
    ValueError
        If the file holds none, or an entry cannot be read.
    """
    heads: dict[str, int] = {}
    entries: dict[str, list[tuple[tuple[int, int], tuple[int, int], float]]] = {}
    digits: dict[str, int] = {}
    for card, fields in cards(path):
        if card != "DMIG":
            continue
        name = fields[0]
        if fields[1] == "0":
            heads[name], entries[name], digits[name] = whole(fields[2]), [], 1
            if whole(fields[3] or "1") > 2:
                raise ValueError(f"matrix {name} is complex (type {fields[3]}); stiffness and mass are real")
            continue
        if name not in entries:
            raise ValueError(f"matrix {name} has columns before its heading (DMIG {name} 0 ...)")
        column = _point(fields[1], fields[2])
        for k in range(4, len(fields) - 2, 4):
            if fields[k]:
                entries[name].append((_point(fields[k], fields[k + 1]), column, number(fields[k + 2])))
                digits[name] = max(digits[name], sum(c.isdigit() for c in re.split("[ED]", fields[k + 2].upper())[0]))
    square = {name: _assembled(entries[name], heads[name], digits[name]) for name in entries
              if heads[name] in (SYMMETRIC, SQUARE) and entries[name]}  # fmt: skip
    if not square:
        raise ValueError(
            "no square matrix (DMIG) in it; let Nastran punch stiffness and mass: EXTSEOUT(STIF,MASS,DMIGPCH) or "
            "PARAM,EXTOUT,DMIGPCH"
        )
    return square


def _point(grid: str, component: str) -> tuple[int, int]:
    return whole(grid), whole(component or "0")


def _assembled(entries: list, form: int, digits: int) -> Matrix:
    dofs = sorted({dof for row, column, _ in entries for dof in (row, column)})
    at = {dof: k for k, dof in enumerate(dofs)}
    rows, columns = (np.array([at[entry[k]] for entry in entries]) for k in (0, 1))
    values = np.array([value for *_, value in entries])
    return Matrix.of(tuple(dofs), rows, columns, values, digits, mirrored=form == SYMMETRIC)


def read_grids(path: Path) -> dict[int, Grid]:
    """Grid points of a deck, with the decks that it includes.

    Raises
    ------
    ValueError
        If there are none, or a coordinate system that they name is missing.
    """
    points: dict[int, list[str]] = {}
    systems: dict[int, tuple[str, list[str]]] = {}
    default = ["", ""]
    for card, fields in cards(path):
        if card == "GRID":
            points[whole(fields[0])] = [*fields, *[""] * 8]
        elif card == "GRDSET":
            fields = [*fields, *[""] * 8]
            default = [fields[1], fields[5]]
        elif card[:4] == "CORD" and card[4:] in ("1R", "1C", "1S", "2R", "2C", "2S"):
            fields = [*fields, *[""] * 12]
            if card[4] == "2":
                systems[whole(fields[0])] = card, fields[1:11]
            else:
                for k in (0, 4):
                    if fields[k]:
                        systems[whole(fields[k])] = card, fields[k + 1 : k + 4]
    if not points:
        raise ValueError(f"{path} holds no GRID entries; give the bulk data deck")
    frames = _Frames(points, systems, default)
    return {name: frames.grid(name) for name in points}


def read_lines(path: Path) -> list[tuple[int, ...]]:
    """Grid points that each bar, beam, rod, spring, plate or shell of a deck joins; plates as closed lines."""
    found = []
    for card, fields in cards(path):
        first, last = ELEMENTS.get(card, (0, 0))
        points = [whole(text) for text in fields[first:last] if text.isdigit()]
        if len(points) > 1:
            found.append((*points, points[0]) if len(points) > 2 else tuple(points))
    return found


class _Frames:
    """Coordinate systems resolved on demand: origin, axes by row, and kind (R, C or S)."""

    def __init__(self, points: dict[int, list[str]], systems: dict[int, tuple[str, list[str]]], default: list[str]):
        self.points, self.systems, self.default = points, systems, default
        self.known: dict[int, tuple[np.ndarray, np.ndarray, str]] = {0: (np.zeros(3), np.eye(3), "R")}
        self.open: set[int] = set()

    def frame(self, name: int) -> tuple[np.ndarray, np.ndarray, str]:
        if name in self.known:
            return self.known[name]
        if name not in self.systems:
            raise ValueError(f"coordinate system {name} is used but not defined (CORD1R ... CORD2S)")
        if name in self.open:
            raise ValueError(f"coordinate system {name} is defined by way of itself")
        self.open.add(name)
        card, fields = self.systems[name]
        if card[4] == "2":
            about = whole(fields[0] or "0")
            given = [number(text or "0") for text in fields[1:10]]
            a, b, c = (self.basic(np.array(given[k : k + 3]), about) for k in (0, 3, 6))
        else:
            a, b, c = (self.position(whole(text)) for text in fields[:3])
        y = np.cross(b - a, c - a)
        if not np.isfinite(y).all() or not y.any():
            raise ValueError(f"coordinate system {name} has no axes: its three points lie on a line")
        z, y = (b - a) / np.linalg.norm(b - a), y / np.linalg.norm(y)
        self.known[name] = a, np.stack([np.cross(y, z), y, z]), card[5]
        return self.known[name]

    def basic(self, at: np.ndarray, name: int) -> np.ndarray:
        origin, axes, kind = self.frame(name)
        if kind == "C":
            angle = np.deg2rad(at[1])
            at = np.array([at[0] * np.cos(angle), at[0] * np.sin(angle), at[2]])
        elif kind == "S":
            polar, angle = np.deg2rad(at[1:])
            at = at[0] * np.array([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
        return origin + at @ axes

    def position(self, name: int) -> np.ndarray:
        if name not in self.points:
            raise ValueError(f"grid point {name} is used by a coordinate system but not defined")
        fields = self.points[name]
        return self.basic(np.array([number(t or "0") for t in fields[2:5]]), whole(fields[1] or self.default[0] or "0"))

    def grid(self, name: int) -> Grid:
        xyz = self.position(name)
        origin, axes, kind = self.frame(whole(self.points[name][5] or self.default[1] or "0"))
        local = (xyz - origin) @ axes.T
        if kind == "C":
            axes = _cylindrical(np.arctan2(local[1], local[0])) @ axes
        elif kind == "S":
            around = _cylindrical(np.arctan2(local[1], local[0])) @ axes
            polar = np.arctan2(np.hypot(local[0], local[1]), local[2])
            s, c = np.sin(polar), np.cos(polar)
            axes = np.array([[s, 0.0, c], [c, 0.0, -s], [0.0, 1.0, 0.0]]) @ around
        return Grid(xyz, axes)


def _cylindrical(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def read_punched_modes(path: Path) -> tuple[np.ndarray, tuple[tuple[int, int], ...], np.ndarray]:
    r"""Eigenvectors that Nastran punched (``VECTOR(PUNCH)=ALL``).

    Returns
    -------
    tuple
        Eigenvalues :math:`\omega^2`, shape ``(mode,)``; grid point and component of each entry; and the eigenvectors,
        shape ``(mode, dof)``.

    Raises
    ------
    ValueError
        If the file holds none, or modes of different grid points.
    """
    values: list[float] = []
    shapes: list[dict[int, list[float]]] = []
    point, inside = 0, False
    with path.open(encoding="latin-1") as file:
        for line in file:
            text = line[:72].rstrip()
            if text.startswith("$"):
                inside = inside and not text.startswith(("$TITLE", "$SUBTITLE")) or text.startswith("$EIGENVECTOR")
                if inside and text.startswith("$EIGENVALUE"):
                    values.append(number(text.split("=")[1].split("MODE")[0]))
                    shapes.append({})
                continue
            if not inside or not shapes:
                continue
            row = [number(text[k : k + 18]) for k in range(18, 72, 18) if text[k : k + 18].strip()]
            if text.startswith("-CONT-"):
                shapes[-1][point] += row
            else:
                point = whole(text[:10])
                shapes[-1][point] = row
    if not shapes:
        raise ValueError("no eigenvectors in it; let Nastran punch them: VECTOR(PUNCH)=ALL")
    points = sorted(shapes[0])
    if any(sorted(one) != points for one in shapes):
        raise ValueError("its modes are given at different grid points; punch all of them at the same ones")
    count = {p: len(shapes[0][p]) for p in points}
    dofs = tuple((p, k + 1 if count[p] > 1 else 0) for p in points for k in range(count[p]))
    return np.array(values), dofs, np.array([[v for p in points for v in one[p]] for one in shapes])
