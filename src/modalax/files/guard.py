"""What is believed of a file: how much it may unpack to, how many names it holds, what a reader library says of it."""

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

# A file may unpack to its own size and this much more [bytes]; zeros shrink a thousandfold, measurements hardly do.
MORE = 2**28
MOST_NAMES, LONGEST_NAME = 20_000, 256  # names in one file, and letters in a name, at most
REMEDY = "copy or save it again"


class Refused(ValueError):
    """A file that is not read on, for a reason that needs no more words."""


@contextmanager
def reading(what: str, said: type[Exception] = Refused) -> Iterator[None]:
    """Say of every error of a reader library what could not be read, why, and what helps.

    Errors of the kind ``said`` are clear as they are: with ``ValueError`` those of code that names what is wrong.

    Raises
    ------
    ValueError
        In place of whatever is raised inside, but for what was refused here already and files closed to the user.
    """
    try:
        yield
    except (Refused, PermissionError, said):
        raise
    except MemoryError as error:
        raise Refused(f"{what} declares more than the memory holds: it is damaged; {REMEDY}") from error
    except Exception as error:
        words = " ".join(str(error).split())[:300] or type(error).__name__
        raise Refused(f"{what} is damaged, cut short or cannot be read ({words}); {REMEDY}") from error


def room(path: Path) -> int:
    """How much a file, or all files of a folder, may unpack to [bytes]."""
    files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
    return sum(p.stat().st_size for p in files) + MORE


def check_size(size: int, path: Path, what: str) -> None:
    """Refuse to read what declares itself larger than its file can reasonably hold.

    Raises
    ------
    ValueError
        With both sizes.
    """
    most = room(path)
    if not 0 <= size <= most:
        raise Refused(
            f"{what} declares {size / 1e6:.6g} MB; read is at most the file's own size and {MORE / 1e6:.0f} MB, here "
            f"{most / 1e6:.6g} MB: if that is not a mistake, save it uncompressed"
        )


def check_names(count: int, what: str) -> None:
    """Refuse more names than any measurement has."""
    if count > MOST_NAMES:
        raise Refused(f"{what} holds {count} names; at most {MOST_NAMES} are read")


def bytes_of(shape: Any, itemsize: int) -> int:
    """Size of an array [bytes]; an array of nothing counts one byte an item."""
    return math.prod(int(n) for n in shape) * max(1, int(itemsize))


def unpacked_size(stream: BinaryIO, count: int, most: int, word: bytes) -> tuple[int, bytes, int]:
    """Size of the next ``count`` bytes of zlib's format when unpacked, counted up to ``most``.

    With it come its first bytes, and how often it holds a ``word``.
    """
    unpack, total, head, times = zlib.decompressobj(), 0, b"", 0
    while count > 0 and total <= most:
        packed = stream.read(min(count, 1 << 16))
        if not packed:
            raise EOFError("the file ends within a compressed part")
        count -= len(packed)
        while packed and total <= most:
            piece = unpack.decompress(packed, 1 << 20)
            packed = unpack.unconsumed_tail
            total += len(piece)
            times += piece.count(word)
            head += piece[: 512 - len(head)]
            if not piece and not packed:
                break
    return total, head, times
