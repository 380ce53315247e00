"""Numbers of binary data sets 58, taken from where they lie in the file.

pyuff looks for the end of each set byte by byte and turns every number into a Python object first. Here it is handed
the file without its numbers, of which it reads the headers and all other sets.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.uff_index import HEADER, Entry, index_of


def with_numbers_apart(path: Path) -> list[Entry]:
    """The index of a file whose binary functions can be read from their places; empty where pyuff is to read all."""
    try:
        entries = index_of(path)
    except ValueError:  # a header that tells too many or too few bytes; pyuff looks for the end of each set
        return []
    functions = [e for e in entries if e.numbers is not None]
    return entries if functions and all(len(e.header) == HEADER for e in functions) else []


@contextmanager
def without_numbers(path: Path, entries: Sequence[Entry]) -> Iterator[Path]:
    """A copy of the file without the numbers of its binary functions, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "headers.uff"
        with path.open("rb") as source, copy.open("wb") as target:
            at = 0
            for entry in entries:
                if entry.numbers is not None:
                    source.seek(at)
                    target.write(source.read(entry.numbers.start - at))
                    at = entry.numbers.stop
            source.seek(at)
            target.write(source.read())
        yield copy


def with_numbers(found: dict[str, Any], numbers: np.ndarray) -> dict[str, Any]:
    """A data set 58 of which the header was read, with its abscissae ``x`` and values ``data`` from its bytes.

    Numbers that already are as they are used here stay a view of the file.

    Raises
    ------
    ValueError
        If the values are not pairs or triples, as their kind needs them.
    """
    kind, even = found["ord_data_type"], found["abscissa_spacing"] != 0
    if kind not in (2, 4, 5, 6):
        return found  # refused when it is asked for
    letter = ("<" if found["byte_ordering"] == 1 else ">") + ("f4" if kind in (2, 5) else "f8")
    size = np.dtype(letter).itemsize
    values = numbers[: len(numbers) // size * size].view(letter).astype(float, copy=False)
    width = (1 if kind in (2, 4) else 2) + (not even)
    if len(values) % width:
        raise ValueError(f"its {len(values)} numbers do not make groups of {width}")
    rows = values.reshape(-1, width)
    data = rows[:, -1] if kind in (2, 4) else _complex(rows[:, -2:])
    x = found["abscissa_min"] + found["abscissa_inc"] * np.arange(len(rows)) if even else rows[:, 0].copy()
    return {**found, "x": x, "data": data}


def _complex(pairs: np.ndarray) -> np.ndarray:
    """Pairs of real and imaginary part as complex numbers."""
    return pairs.view(complex)[:, 0] if pairs.flags.c_contiguous else pairs[:, 0] + 1j * pairs[:, 1]
