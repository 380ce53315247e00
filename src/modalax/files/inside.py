"""What files of MATLAB, HDF5 and Zarr declare, looked at before their readers believe it."""

import json
import math
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from modalax.files.chunks import PACKERS, WORDS, check_hdf5_chunks, check_zarr_chunks
from modalax.files.guard import REMEDY, Refused, bytes_of, check_names, check_size, room, unpacked_size

# Types and classes of the MATLAB file format, level 5.
MATRIX, COMPRESSED = 14, 15
PIECE = 2**20
CELL, STRUCT, OBJECT = 1, 2, 3
MOST_CELLS = 100_000  # elements within one element, over each of which the reader takes its time
# What chunks of a Zarr store may be packed by: numbers and text only; other filters could hold Python objects.
CODECS = {*PACKERS, *WORDS, "shuffle", "crc32", "crc32c", "bytes", "transpose"}


def check_elements(path: Path) -> None:
    """Refuse a MATLAB file (level 5) whose elements are cut short, unpack to more than is read or hold too many cells.

    Raises
    ------
    ValueError
        Naming the size.
    """
    size, most, total = path.stat().st_size, room(path), 0
    with path.open("rb") as file:
        header = file.read(128)
        order = "<" if header[126:128] == b"IM" else ">"
        while file.tell() + 8 <= size:
            kind, count = struct.unpack(f"{order}II", file.read(8))
            begin = file.tell()
            if begin + count > size:
                raise Refused(
                    f"the .mat file is cut short: an element of {count} bytes begins at byte {begin}; {REMEDY}"
                )
            if kind == COMPRESSED:
                unpacked, head, cells = unpacked_size(file, count, most, struct.pack(f"{order}I", MATRIX))
                head = head[8:]
            else:
                unpacked, head, cells = count, b"", 0
                for at in range(0, count, PIECE):
                    piece = file.read(min(PIECE, count - at))
                    head, cells = head or piece[:512], cells + piece.count(struct.pack(f"{order}I", MATRIX))
            total += unpacked
            check_size(total, path, "the .mat file")
            form, name = _class_and_name(head, order)
            if form in (CELL, STRUCT, OBJECT) and cells > MOST_CELLS:
                raise Refused(f"{name} is a cell or structure array of over {MOST_CELLS} cells, which is not read")
            file.seek(begin + count)


def _class_and_name(head: bytes, order: str) -> tuple[int, str]:
    """Class and name of a matrix element from its first bytes."""
    if len(head) < 32:
        return 0, ""
    form = struct.unpack_from(f"{order}I", head, 8)[0] & 0xFF
    dims = struct.unpack_from(f"{order}I", head, 20)[0]
    at = 24 + 8 * math.ceil(dims / 8)
    if at + 8 > len(head):
        return form, ""
    word = struct.unpack_from(f"{order}I", head, at)[0]
    if word >> 16:  # the short form: size and type in four bytes, then the data
        return form, head[at + 4 : at + 4 + min(word >> 16, 4)].decode("latin-1")
    count = struct.unpack_from(f"{order}I", head, at + 4)[0]
    return form, head[at + 8 : at + 8 + count].decode("latin-1")


def check_datasets(file: Any, names: Iterable[str], path: Path) -> None:
    """Refuse an HDF5 file whose datasets are links, lie elsewhere, or declare more than is read.

    Raises
    ------
    ValueError
        Naming the dataset.
    """
    import h5py

    total = 0
    for name in sorted(names):
        link = file.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            raise Refused(f"{name} is a link to another place, which is not followed; {REMEDY} as an array")
        node = file[name]
        if not isinstance(node, h5py.Dataset):
            raise Refused(f"{name} is a group of arrays, and an array is needed")
        if node.shape is None or node.is_virtual or node.external:
            raise Refused(f"{name} is empty or its numbers lie in other files, which are not read")
        words = node.dtype.kind in "OSU"
        if words:
            check_names(node.size, name)
        largest = max(bytes_of(node.shape, node.dtype.itemsize), bytes_of(node.chunks or (), node.dtype.itemsize))
        total += largest
        check_size(total, path, f"{name} (with what is read before it)")
        check_hdf5_chunks(node, name)


def check_store(path: Path, names: Iterable[str]) -> None:
    """Refuse a Zarr store whose arrays are packed by something that is not known to be harmless, too large, or partial.

    Raises
    ------
    ValueError
        Naming the array.
    """
    total = 0
    for name in sorted(names):
        folder = path / name
        told = next((folder / f for f in (".zarray", "zarr.json") if (folder / f).is_file()), None)
        if told is None:
            continue
        about = json.loads(told.read_text(encoding="utf-8"))
        shape = [int(n) for n in about["shape"]]
        chunks, codecs = _packing(about)
        bad = sorted(set(codecs) - CODECS)
        if bad:
            raise Refused(f"{name} is packed by {', '.join(bad)}, which is not read; save it by xarray's to_zarr")
        if len(chunks) != len(shape) or any(c < 1 for c in chunks) or any(n < 0 for n in shape):
            raise Refused(f"{name} has the shape {shape} and chunks of {chunks}; {REMEDY}")
        item = _item_bytes(about)
        total += max(bytes_of(shape, item), bytes_of(chunks, item))
        check_size(total, path, f"{name} (with what is read before it)")
        wanted = math.prod(math.ceil(n / c) for n, c in zip(shape, chunks, strict=True))
        found = [p for p in folder.rglob("*") if p.is_file() and p.name not in (".zarray", ".zattrs", "zarr.json")]
        if len(found) < wanted:
            raise Refused(
                f"{name} lacks {wanted - len(found)} of its {wanted} chunks: the store was half written; {REMEDY}"
            )
        check_zarr_chunks(found, codecs, chunks, item, name)


def _packing(about: dict[str, Any]) -> tuple[list[int], list[str]]:
    """Chunk shape and codecs of an array, as the two versions of the format tell them."""
    if about.get("zarr_format") == 3:
        chunks = about["chunk_grid"]["configuration"]["chunk_shape"]
        return [int(n) for n in chunks], [str(codec["name"]) for codec in about["codecs"]]
    packed = [about.get("compressor"), *(about.get("filters") or ())]
    return [int(n) for n in about["chunks"]], [str(codec["id"]) for codec in packed if codec]


def _item_bytes(about: dict[str, Any]) -> int:
    import numpy as np

    kind = about.get("data_type", about.get("dtype"))
    try:
        return np.dtype(kind).itemsize
    except TypeError:
        return 8
