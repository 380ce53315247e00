"""Matrices as text: Matrix Market and Harwell-Boeing.

Read here and not by scipy, whose readers end the process on some damaged files, and do not take the symmetric matrices
and packed columns that Harwell-Boeing files of finite-element programs have.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from modalax.files.guard import Refused
from modalax.files.lines import lines_of, table_of

MOST_DOFS = 2_000_000


class Entries(NamedTuple):
    """Entries of a square matrix: rows and columns from 0, values, its size, and whether the other triangle mirrors."""

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    size: int
    mirrored: bool


def read_market(path: Path) -> Entries:
    """A real matrix in Matrix Market form, by coordinates or as an array.

    Raises
    ------
    ValueError
        If it is not square or not real, or its lines do not fit its heading.

    References
    ----------
    R. F. Boisvert, R. Pozo, K. A. Remington: The Matrix Market exchange formats, NISTIR 5935 (1996).
    """
    with path.open(encoding="latin-1") as file:
        head = file.readline(1000).lower().split()
    if len(head) != 5 or head[2] not in ("coordinate", "array") or head[3] not in ("real", "integer", "double"):
        raise Refused(f"the file begins with {' '.join(head)[:60]!r}; a real matrix is needed, by coordinate or array")
    if head[4] not in ("general", "symmetric"):
        raise Refused(f"the matrix is {head[4][:20]}; general and symmetric ones are read")
    rows, by_place = lines_of(path, "%"), head[2] == "coordinate"
    place, line = next(rows, (0, ""))
    declared = _whole(line, place, 3 if by_place else 2)
    n = _square(declared[0], declared[1], path)
    width = 3 if by_place else 1
    table = table_of(rows, lambda line, place: _numbers(line, place, width), width)
    if by_place:
        wanted, index = declared[2], table[:, :2].T - 1
    elif head[4] == "general":
        wanted, index = n * n, np.indices((n, n)).reshape(2, -1)[::-1] if len(table) == n * n else np.zeros((2, 0))
    else:
        wanted = n * (n + 1) // 2
        index = np.array(np.tril_indices(n)) if len(table) == wanted else np.zeros((2, 0))
        order = np.lexsort((index[0], index[1]))  # column by column
        index = index[:, order]
    if len(table) != wanted:
        raise Refused(f"the matrix has {len(table)} entries and announces {wanted}; it is damaged or cut short")
    return _checked(index, table[:, -1], n, head[4] == "symmetric")


def read_boeing(path: Path) -> Entries:
    """A real assembled matrix in Harwell-Boeing form, column by column.

    Raises
    ------
    ValueError
        If it is not square or not real, or its lines do not fit its heading.

    References
    ----------
    I. S. Duff, R. G. Grimes, J. G. Lewis: Users' guide for the Harwell-Boeing sparse matrix collection (1992).
    """
    with path.open(encoding="latin-1") as file:
        head = [file.readline(1000).rstrip("\r\n") for _ in range(4)]
        kind = head[2][:3].upper()
        if len(kind) < 3 or kind[0] != "R" or kind[1] not in "US" or kind[2] != "A":
            raise Refused(f"the matrix is of type {kind!r}; RUA (all entries) and RSA (one triangle) are read")
        counts = [int(head[1][k : k + 14] or "0") for k in (14, 28, 42)]
        rows, columns, entries = (int(head[2][k : k + 14]) for k in (14, 28, 42))
        n = _square(rows, columns, path)
        if not 0 < entries <= path.stat().st_size or min(counts) < 1:
            raise Refused(f"the matrix announces {entries} entries in {counts} lines; it is damaged")
        formats = [head[3][:16], head[3][16:32], head[3][32:52]]
        if head[1][56:70].strip() not in ("", "0"):
            file.readline(1000)  # of right-hand sides
        start, index, values = (
            np.array(list(_fields(file, lines, form, wanted)))
            for lines, form, wanted in zip(counts, formats, (n + 1, entries, entries), strict=True)
        )
    if start[0] != 1 or start[-1] != entries + 1 or (np.diff(start) < 0).any():
        raise Refused(f"the columns begin at entries {start[0]:g} to {start[-1]:g} of {entries}; they do not fit")
    column = np.repeat(np.arange(n), np.diff(start).astype(int))
    return _checked(np.array([index - 1, column]), values, n, kind[1] == "S")


def _fields(file: TextIO, lines: int, form: str, wanted: int) -> Iterator[float]:
    """Numbers in the next lines: by blanks where these part as many as the format has in a line, else by its width."""
    found = re.search(r"(\d*)\s*[IEDFG]\s*(\d+)", re.sub(r"[+-]?\d+P,?", "", form.upper()))
    if found is None or not 0 < int(found[2]) <= 80:
        raise Refused(f"{form.strip()!r} is no format of numbers")
    each, width, count = int(found[1] or 1), int(found[2]), 0
    for _ in range(lines):
        line = file.readline(1000).rstrip()
        words = line.split()
        if len(words) != min(each, wanted - count):
            words = [line[k : k + width] for k in range(0, len(line), width)]
        yield from map(_number, words)
        count += len(words)
    if count != wanted:
        raise Refused(f"the matrix has {count} numbers where {wanted} are announced; it is damaged or cut short")


def _number(text: str) -> float:
    return float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"E\1", text.strip().upper().replace("D", "E")))


def _whole(line: str, place: int, count: int) -> list[int]:
    words = line.split()
    if len(words) != count or not all(word.isdigit() for word in words):
        raise Refused(f"line {place} reads {line[:60]!r}; the {count} sizes of the matrix are needed")
    return [int(word) for word in words]


def _numbers(line: str, place: int, count: int) -> list[float]:
    words = line.split()
    if len(words) != count:
        raise Refused(f"line {place} reads {line[:60]!r}; {count} numbers are needed")
    return [float(word) for word in words]


def _square(rows: int, columns: int, path: Path) -> int:
    """The size, if the matrix is square and no larger than its file can hold."""
    if rows != columns:
        raise Refused(f"the matrix has shape ({rows}, {columns}); it needs square")
    most = min(MOST_DOFS, path.stat().st_size)
    if not 0 < rows <= most:
        raise Refused(f"the matrix declares {rows} DoFs; a file of this size holds 1 to {most}")
    return rows


def _checked(index: np.ndarray, values: np.ndarray, n: int, mirrored: bool) -> Entries:
    if not ((index >= 0) & (index < n) & (index == np.floor(index))).all():
        raise Refused(f"an entry stands outside the {n} rows and columns of the matrix")
    rows, columns = index.astype(int)
    below, above = bool((rows > columns).any()), bool((rows < columns).any())
    if mirrored and below and above:
        raise Refused("the matrix is called symmetric and has entries on both sides of the diagonal")
    return Entries(rows, columns, values, n, below != above)  # one triangle of a matrix called general as well
