"""Lines of a text file one by one, and the numbers in them, without holding the whole text."""

import codecs
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from modalax.files.guard import Refused

LONGEST_LINE = 2**22
BLOCK = 4096  # lines whose numbers are put into one array


def encoding_of(path: Path) -> str:
    """UTF-16 where the file says so, UTF-8 where it is that, else Latin-1, in which every byte is a letter."""
    with path.open("rb") as file:
        if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return "utf-16"
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        try:
            while piece := file.read(2**20):
                decoder.decode(piece)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "latin-1"
    return "utf-8-sig"


def lines_of(path: Path, comments: str) -> Iterator[tuple[int, str]]:
    """Lines with something in them that do not begin with a sign of ``comments``, each with its number from 1.

    Raises
    ------
    ValueError
        If a line is longer than any table has.
    """
    with path.open(encoding=encoding_of(path)) as file:
        for number, line in enumerate(file, start=1):
            if len(line) > LONGEST_LINE:
                raise Refused(f"line {number} has {len(line)} letters; at most {LONGEST_LINE} are read")
            if line.strip() and not line.lstrip().startswith(tuple(comments)):
                yield number, line.rstrip("\r\n")


def table_of(rows: Iterable[tuple[int, str]], numbers: Callable[[str, int], list[float]], width: int) -> np.ndarray:
    """Numbers of all rows, shape ``(row, width)``; ``numbers`` gives those of a line and its number."""
    blocks, block = [], []
    for number, line in rows:
        block.append(numbers(line, number))
        if len(block) == BLOCK:
            blocks.append(np.array(block, dtype=float))
            block = []
    return np.concatenate([*blocks, np.array(block, dtype=float).reshape(-1, width)])
