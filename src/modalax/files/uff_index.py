"""What a universal file holds, found without reading its numbers: types, places and headers of its data sets."""

from pathlib import Path
from typing import BinaryIO, NamedTuple

LONGEST = 4096  # bytes of a line beyond which it is no text
HEADER = 11  # lines of the header of a data set 58
# Columns of the first line of a binary data set 58: lines of the header, bytes after it.
N_LINES, N_BYTES = slice(19, 31), slice(31, 43)


class Entry(NamedTuple):
    """A data set: its type, the byte where it begins, and of functions (58) the lines of their header.

    ``numbers`` are the bytes of the numbers of a binary function, from ``numbers.start`` up to ``numbers.stop``.
    """

    kind: int
    start: int
    header: tuple[str, ...]
    numbers: slice | None = None


def index_of(path: Path) -> list[Entry]:
    """The data sets of a universal file in their order; the numbers of binary ones are skipped, not read.

    Raises
    ------
    ValueError
        If a set is not closed where its own header says, or a type is no number.
    """
    found = []
    with path.open("rb") as file:
        while line := file.readline(LONGEST):
            if line.strip() == b"-1":
                found.append(_entry(file, file.tell() - len(line)))
    return found


def _entry(file: BinaryIO, start: int) -> Entry:
    """The data set whose opening line was just read; leaves the file behind its closing line."""
    first = file.readline(LONGEST)
    kind, binary = first[:6].strip(), first[6:7] == b"b"
    if not kind.isdigit():
        raise ValueError(f"the data set at byte {start} has the type {kind!r}; a number is needed")
    header: list[str] = []
    if int(kind) == 58:
        count = int(first[N_LINES] or 0) if binary else HEADER
        header = [file.readline(LONGEST).decode("latin-1").rstrip() for _ in range(min(count, 2 * HEADER))]
    if not binary:
        while line := file.readline(LONGEST):
            if line.strip() == b"-1":
                return Entry(int(kind), start, tuple(header))
    else:
        numbers = slice(file.tell(), file.tell() + int(first[N_BYTES]))
        file.seek(numbers.stop)
        line = file.readline(LONGEST)
        if not line.strip():
            line = file.readline(LONGEST)
        if line.strip() == b"-1":
            return Entry(int(kind), start, tuple(header), numbers if int(kind) == 58 else None)
    raise ValueError(f"the data set at byte {start}, of type {int(kind)}, is not closed where its header says")
