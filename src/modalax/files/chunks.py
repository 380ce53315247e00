"""What the packed chunks of HDF5 and Zarr truly unpack to, counted before a library unpacks them into memory."""

import bz2
import gzip
import math
import struct
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from modalax.files.guard import LONGEST_NAME, MORE, REMEDY, Refused

# Filters of HDF5 by their registered numbers.
DEFLATE, SZIP, LZF = 1, 4, 32000
KEEPING = (2, 3, 5, 6)  # shuffle, checksum, n-bit, scale and offset: nothing grows
LZF_GROWTH = 90  # three bytes stand for up to 264
SLACK = 64  # bytes of checksums and headers
PACKERS = ("zlib", "gzip", "bz2", "zstd", "lz4", "blosc")
ZSTD_BLOCK = 2**17  # largest block of a frame, unpacked
WORDS = ("vlen-utf8", "vlen-bytes")


def check_hdf5_chunks(node: Any, name: str) -> None:
    """Refuse an HDF5 dataset of which a chunk unpacks to more than the chunk's shape says, or by unknown means.

    Raises
    ------
    ValueError
        Naming the filter, or both sizes.
    """
    if node.chunks is None:
        return
    plan = node.id.get_create_plist()
    filters = [plan.get_filter(k)[0] for k in range(plan.get_nfilters())]
    packers = [f for f in filters if f not in KEEPING]
    if len(packers) > 1 or set(packers) - {DEFLATE, SZIP, LZF}:
        raise Refused(f"{name} is packed by HDF5 filters {', '.join(map(str, packers))}; save it by gzip or unpacked")
    if not packers:
        return
    wanted = math.prod(node.chunks) * node.dtype.itemsize + SLACK
    for k in range(node.id.get_num_chunks()):
        skipped, content = node.id.read_direct_chunk(node.id.get_chunk_info(k).chunk_offset)
        if skipped & (1 << filters.index(packers[0])):
            continue
        _check(_hdf5_size(packers[0], content, wanted), wanted, name)


def _hdf5_size(packer: int, content: bytes, most: int) -> int:
    if packer == DEFLATE:
        return counted(zlib.decompressobj, content, most)
    if packer == SZIP:
        return struct.unpack_from("<I", content)[0]
    largest = LZF_GROWTH * len(content)  # cannot be told but by unpacking
    return most + 1 if largest > max(MORE, most) else 0


def check_zarr_chunks(files: Iterable[Path], codecs: list[str], shape: list[int], item: int, name: str) -> None:
    """Refuse a Zarr array of which a chunk unpacks to more than the chunk's ``shape`` and bytes an ``item`` say.

    Raises
    ------
    ValueError
        Naming both sizes.
    """
    packers = [c for c in codecs if c in PACKERS]
    if len(packers) > 1:
        raise Refused(f"{name} is packed twice ({', '.join(packers)}), which is not read; {REMEDY}")
    count, words = math.prod(shape), any(c in WORDS for c in codecs)
    wanted = count * (4 * LONGEST_NAME + 4 if words else item) + SLACK
    for file in files:
        content = file.read_bytes()
        if packers:
            _check(packed_size(packers[0], content, wanted), wanted, name)
        if words:
            plain = _unpacker(packers[0])(content) if packers else content
            if int.from_bytes(plain[:4], "little") != count:
                raise Refused(f"a chunk of {name} does not hold the {count} words that its shape says; {REMEDY}")


def _check(size: int, wanted: int, name: str) -> None:
    if size > wanted:
        raise Refused(f"a chunk of {name} unpacks to more than the {wanted / 1e6:.3g} MB that its shape says; {REMEDY}")


def packed_size(packer: str, content: bytes, most: int) -> int:
    """Size of a packed chunk when unpacked, or a bound above it; counted up to ``most``."""
    if packer in ("zlib", "gzip", "bz2"):
        make = {"zlib": zlib.decompressobj, "gzip": lambda: zlib.decompressobj(31), "bz2": bz2.BZ2Decompressor}[packer]
        return counted(make, content, most, several=packer != "zlib")
    if packer == "zstd":
        return zstd_bound(content)
    return struct.unpack_from("<I", content, 4 if packer == "blosc" else 0)[0]


def counted(make: Callable[[], Any], content: bytes, most: int, several: bool = False) -> int:
    """Bytes that come out of an unpacker, counted up to ``most``; ``several`` parts may follow each other."""
    total = 0
    while content and total <= most:
        unpack = make()
        while not unpack.eof and total <= most:
            piece = unpack.decompress(content, 1 << 20)
            content = getattr(unpack, "unconsumed_tail", b"")
            total += len(piece)
            if not piece and not content:
                break
        content = unpack.unused_data if several and unpack.eof else b""
    return total


def zstd_bound(content: bytes) -> int:
    """A bound above what a frame of Zstandard unpacks to: by its header, else by its blocks.

    References
    ----------
    RFC 8878 (2021), sections 3.1.1.1 and 3.1.1.2.
    """
    if content[:4] != b"\x28\xb5\x2f\xfd":
        raise ValueError("not in the format of Zstandard")
    told = content[4]
    single, size_code = told >> 5 & 1, told >> 6
    at = 5 + (not single) + (0, 1, 2, 4)[told & 3]
    width = (1 if single else 0, 2, 4, 8)[size_code]
    if width:
        return int.from_bytes(content[at : at + width], "little") + (256 if width == 2 else 0)
    total, last = 0, False
    while not last:
        word = int.from_bytes(content[at : at + 3], "little")
        last, kind, size = bool(word & 1), word >> 1 & 3, word >> 3
        if at + 3 > len(content):
            raise EOFError("the chunk is cut short")
        total += ZSTD_BLOCK if kind == 2 else size
        at += 3 + (1 if kind == 1 else size)
    return total


def _unpacker(packer: str) -> Callable[[bytes], bytes]:
    import numcodecs

    known: dict[str, Any] = {"zlib": zlib.decompress, "gzip": gzip.decompress, "bz2": bz2.decompress}
    return known.get(packer) or getattr(numcodecs, packer).decompress
