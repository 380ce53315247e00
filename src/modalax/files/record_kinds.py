"""Detection of the kind of a file of time records from its content."""

from pathlib import Path

from modalax.files.sniff import is_universal

KINDS = "UFF 58 time data, MATLAB .mat, NumPy .npy or .npz, CSV, WAV or HDF5"
_MAGIC = (
    (b"PK\x03\x04", "npz"), (b"\x93NUMPY", "npy"), (b"MATLAB 5.0 MAT-file", "mat"), (b"MATLAB 7.3 MAT-file", "hdf5"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"), (b"RIFF", "wav"), (b"RIFX", "wav"), (b"RF64", "wav"),
)  # fmt: skip


def kind_of(path: Path) -> str:
    """Kind of a file of records: ``uff``, ``mat``, ``hdf5``, ``npy``, ``npz``, ``wav`` or ``text``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is empty or of no kind that can be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise ValueError(f"{path}: not a file; time records are read from {KINDS}")
    with path.open("rb") as file:
        head = file.read(4096)
    if not head.strip():
        raise ValueError(f"{path}: the file is empty; time records are read from {KINDS}")
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if is_universal([line for line in head.splitlines() if line.strip()]):
        return "uff"
    if b"\x00" in head:
        raise ValueError(f"{path}: neither of {KINDS}; the file begins with {head[:16]!r}")
    return "text"
