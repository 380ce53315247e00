"""Detection of the kind of a file from its content; the ending alone is not trusted."""

import codecs
import re
from collections.abc import Sequence
from pathlib import Path

KINDS = "UFF (ASCII or binary), NumPy .npz, MATLAB .mat, NetCDF, Zarr or CSV"
FINITE_ELEMENTS = (
    ".pch",
    ".pch1",
    ".bdf",
    ".dat",
    ".nas",
    ".mtx",
    ".full",
    ".hb",
    ".rb",
    ".mm",
    ".f06",
    ".op2",
    ".rst",
)
WRITTEN = {
    ".npz": "npz", ".uff": "uff", ".unv": "uff", ".uf": "uff", ".mat": "mat", ".nc": "netcdf", ".zarr": "zarr",
}  # fmt: skip
_MAGIC = (
    (b"PK\x03\x04", "npz"),
    (b"PK\x05\x06", "npz"),
    (b"\x93NUMPY", "npy"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"MATLAB 7.3 MAT-file", "mat73"),
    (b"\x89HDF\r\n\x1a\n", "netcdf"),
    (b"CDF\x01", "netcdf"),
    (b"CDF\x02", "netcdf"),
)
COMMENTS, PREAMBLE = "#%", 40  # signs that begin a comment in a table, and most lines of text before its header
WORKBOOK = b"[Content_Types].xml"  # first file in an archive of Excel
FREQUENCY = re.compile(r"f|freq|frequency|frequenz", re.IGNORECASE)
PARTS = re.compile(
    r"(?<![a-z])(re|im|real|imag|imaginary|mag|magnitude|abs|amp|amplitude|phase|phi|arg|angle)(?![a-z])", re.IGNORECASE
)
NUMBERS = re.compile(r"[-+\d.eE,;\s]+")
MODES = re.compile(rb'"?mode"?\s*,.*frequency_hz', re.IGNORECASE)
OPENING, DATA_SET = b"    -1", re.compile(rb"(?=[ \d]{6}(b .*|\s*)$) *\d")  # the lines that begin a data set
_STORE = ("zarr.json", ".zgroup", ".zmetadata")


def sniff(path: Path) -> str:
    """Kind of the file: ``npz``, ``uff``, ``mat``, ``mat73``, ``netcdf``, ``zarr``, ``table``, ``modes`` or ``fe``.

    ``table`` is of FRFs in columns, ``modes`` of modes by row, ``fe`` of a finite-element program.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the content is of no kind that can be read; the message says how it begins.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        if is_zarr(path):
            return "zarr"
        raise ValueError(f"{path}: a folder that is not a Zarr store; give a file ({KINDS})")
    if not path.is_file():
        raise ValueError(f"{path}: neither a file nor a folder (a device or a pipe); give a file ({KINDS})")
    with path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise ValueError(f"{path}: the file is empty (0 bytes); needed is {KINDS}")
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            if kind == "npy":
                raise ValueError(
                    f"{path}: one NumPy array (.npy), which names neither its axes nor its frequencies; "
                    "save an .npz with freq, H, form, outputs and inputs; of time records modalax frf makes FRFs"
                )
            if kind == "npz" and WORKBOOK in head:
                raise ValueError(f"{path}: an Excel workbook, which is not read; save its sheet as CSV")
            return kind
    head = (
        head.decode("utf-16", errors="ignore").encode()
        if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        else head
    )
    lines = [line for line in head.splitlines() if line.strip()]
    return _text_kind(path, lines[0] if lines else b"", lines)


def _text_kind(path: Path, first: bytes, lines: list[bytes]) -> str:
    """Kind of a text file, by its first line or, for those of finite-element programs, its ending."""
    if is_universal(lines):
        return "uff"
    if path.suffix.lower() in FINITE_ELEMENTS or first.startswith((b"DMIG", b"%%MatrixMarket")):
        return "fe"
    if MODES.match(next((line for line in lines if not line.startswith(b"#")), b"")):
        return "modes"
    plain = [text for line in lines if not (text := _text(line)).lstrip().startswith(tuple(COMMENTS))][: PREAMBLE + 1]
    if plain and looks_like_table(plain[0]) or any(looks_like_header(line) for line in plain):
        return "table"
    if plain and NUMBERS.fullmatch(plain[-1] if len(plain) == 1 else plain[-2]):
        raise ValueError(
            f"{path}: columns of numbers; a header above them names those of FRFs (freq, re, im, ...), and of time "
            f"records modalax frf makes FRFs; the file begins with {_shown(first)}"
        )
    raise ValueError(f"{path}: neither of {KINDS}; the file begins with {_shown(first)}")


def is_universal(lines: Sequence[bytes]) -> bool:
    """Whether lines, none of them empty, are of a universal file: ``-1`` first, or a data set below other text."""
    pairs = zip(lines, lines[1:], strict=False)
    below = any(line.rstrip() == OPENING and DATA_SET.match(kind) for line, kind in pairs)
    return below or len(lines) > 0 and lines[0].strip() == b"-1"


def _text(line: bytes) -> str:
    return line.decode("utf-8", errors="replace").strip().strip("\ufeff")


def looks_like_table(line: str) -> bool:
    """Whether the first word of a line is a frequency, as in the header of a table of FRFs."""
    text = line.strip().strip("\ufeff").strip('"')
    return bool(FREQUENCY.fullmatch(re.split(r"[\s\[(,;_/]", text)[0]))


def looks_like_header(line: str) -> bool:
    """Whether a line names a column of frequencies and further ones, of parts of FRFs or of what cannot be read."""
    return looks_like_table(line) and bool(PARTS.search(line))


def is_zarr(folder: Path, alone: bool = False) -> bool:
    """Whether a folder is a Zarr store; with ``alone`` one that holds nothing else beside its arrays and groups."""
    if not any((folder / name).is_file() for name in _STORE):
        return False
    return not alone or all(
        p.name in (*_STORE, ".zattrs")
        if p.is_file() or p.is_symlink()
        else any((p / name).is_file() for name in ("zarr.json", ".zarray", ".zgroup"))
        for p in folder.iterdir()
    )


def _shown(line: bytes) -> str:
    return repr(line[:40].decode("latin-1") + ("..." if len(line) > 40 else ""))


def kind_to_write(path: Path) -> str:
    """Kind of file that the ending of ``path`` asks for.

    Raises
    ------
    ValueError
        If the ending is not known; the message lists those that are.
    """
    kind = WRITTEN.get(path.suffix.lower())
    if kind is None:
        raise ValueError(f"{path}: ending {path.suffix!r} is not one that can be written; use {', '.join(WRITTEN)}")
    return kind
