"""Matrices that finite-element programs write: Abaqus, Ansys, Harwell-Boeing, Matrix Market."""

import importlib.util
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from modalax.files.guard import reading
from modalax.files.lines import lines_of, table_of
from modalax.files.matrix_text import read_boeing, read_market
from modalax.files.npz import npz_arrays

LARGEST = 2**31  # number of a node
READER = 2 * 10**9  # bytes that the reader of Ansys files may take beside twice those of the file
SECONDS = 600.0
FIXED = 1e30  # stiffness that stands for a support in Abaqus' matrices
ANSYS = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}


@dataclass(frozen=True)
class Matrix:
    """One matrix between degrees of freedom.

    Attributes
    ----------
    dofs
        Pairs of grid point and component 1 to 6 (0 for a scalar point), ``n`` of them.
    values
        Sparse, shape ``(n, n)``, in the units of the program.
    digits
        Significant digits that the file states of each entry.
    """

    dofs: tuple[tuple[int, int], ...]
    values: Any
    digits: int

    @classmethod
    def of(
        cls, dofs: tuple[tuple[int, int], ...], rows: np.ndarray, columns: np.ndarray, values: np.ndarray, digits: int,
        mirrored: bool,
    ) -> "Matrix":  # fmt: skip
        """Put together from entries; ``mirrored`` where the file holds one triangle of a symmetric matrix."""
        n = len(dofs)
        if not np.isfinite(values).all():
            raise ValueError(f"{int((~np.isfinite(values)).sum())} of its {len(values)} entries are not finite")
        A = scipy.sparse.csc_matrix((values, (rows, columns)), shape=(n, n))
        if mirrored:
            other = A.T.tocsc()
            other.setdiag(0)
            A = A + other
        return cls(dofs, A.tocsc(), digits)

    def on(self, dofs: tuple[tuple[int, int], ...]) -> Any:
        """The same matrix on more degrees of freedom, or in another order; zero where it has none, sparse."""
        at = {dof: k for k, dof in enumerate(dofs)}
        place = np.array([at[dof] for dof in self.dofs])
        entries = self.values.tocoo()
        return scipy.sparse.csc_matrix(
            (entries.data, (place[entries.row], place[entries.col])), shape=(len(dofs), len(dofs))
        )


def read_abaqus(path: Path) -> Matrix:
    """A matrix by Abaqus (``*MATRIX OUTPUT``): lines of node, DoF, node, DoF, value, one triangle or both.

    DoFs that a support holds (stiffness 1e36) are left out.

    Raises
    ------
    ValueError
        If the lines have another form, for example plain rows and columns (``FORMAT=COORDINATE``).
    """
    digits = 0

    def numbers(line: str, place: int) -> list[float]:
        nonlocal digits
        words = line.replace(",", " ").replace("D", "E").split()
        if len(words) != 5:
            raise ValueError(
                f"line {place} has {len(words)} numbers; a matrix by Abaqus has node, DoF, node, DoF, value a line "
                "(*MATRIX OUTPUT, FORMAT=MATRIX INPUT)"
            )
        digits = max(digits, sum(c.isdigit() for c in re.split("[eE]", words[4])[0]))
        try:
            return [float(word) for word in words]
        except ValueError as error:
            raise ValueError(f"line {place} holds what is no number ({error})") from error

    table = table_of(lines_of(path, "*"), numbers, 5)
    whole = (table[:, :4] == np.floor(table[:, :4])) & (np.abs(table[:, :4]) < LARGEST)
    if not whole.all() or not np.isfinite(table).all() or not len(table):
        raise ValueError(f"{len(table)} lines, {int((~whole).any(axis=1).sum())} of them without whole nodes and DoFs")
    points = table[:, :4].astype(int).reshape(-1, 2)
    fixed = {tuple(row[:2].astype(int)) for row in table if row[4] >= FIXED and (row[:2] == row[2:4]).all()}
    dofs = tuple(sorted({(int(a), int(b)) for a, b in points} - fixed))
    at = {dof: k for k, dof in enumerate(dofs)}
    index = np.array([at.get((int(a), int(b)), -1) for a, b in points]).reshape(-1, 2)
    keep = (index >= 0).all(axis=1)
    index, values = index[keep], table[keep, 4]
    if not len(index):
        raise ValueError("holds no entry but those of supports")
    lower, upper = bool((index[:, 0] > index[:, 1]).any()), bool((index[:, 0] < index[:, 1]).any())
    return Matrix.of(dofs, index[:, 0], index[:, 1], values, digits, mirrored=lower != upper)


def read_plain(path: Path, harwell_boeing: bool = False) -> Matrix:
    """A matrix in Matrix Market or Harwell-Boeing form.

    Its DoFs are points 1 to n, unless the ``.mapping`` that Ansys writes beside the second kind names them.

    Raises
    ------
    ValueError
        If it is not square or not real.
    """
    with reading("the file of a matrix"):
        found = (read_boeing if harwell_boeing else read_market)(path)
    names = path.with_suffix(".mapping")
    named = harwell_boeing and names.is_file()
    dofs = _mapping(names, found.size) if named else tuple((k + 1, 0) for k in range(found.size))
    return Matrix.of(dofs, found.rows, found.columns, found.values, 15, mirrored=found.mirrored)


def _mapping(path: Path, n: int) -> tuple[tuple[int, int], ...]:
    """Nodes and components that Ansys writes beside a Harwell-Boeing file: equation, node, DoF by line."""
    found = {}
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        if len(words) == 3 and words[0].isdigit() and words[2].upper() in ANSYS:
            found[int(words[0])] = int(words[1]), ANSYS[words[2].upper()]
    if sorted(found) != list(range(1, n + 1)):
        raise ValueError(f"{path.name} names {len(found)} equations; the matrix has {n}")
    return tuple(found[k] for k in range(1, n + 1))


def read_ansys(path: Path) -> tuple[Matrix, Matrix]:
    """Stiffness and mass of an Ansys ``.full`` file, by ansys-mapdl-reader; constrained DoFs are left out.

    That package ends the process it runs in on some damaged files, so it has one of its own.

    Raises
    ------
    ValueError
        If that package is not there, or cannot read the file.
    """
    if not _is_installed("ansys.mapdl.reader"):
        raise ValueError("an Ansys .full file needs ansys-mapdl-reader: pip install 'modalax[ansys]'")
    with tempfile.TemporaryDirectory() as folder, reading("the .full file", ValueError):
        out = Path(folder) / "matrices.npz"
        most = 2 * path.stat().st_size + READER
        command = [sys.executable, "-c", ANSYS_READER, str(path), str(out), str(most)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=SECONDS)
        if done.returncode:
            why = (done.stderr.strip().splitlines() or [f"ended by status {done.returncode}"])[-1][:300]
            raise ValueError(f"ansys-mapdl-reader cannot take matrices from it ({why}); give the .full file")
        found = npz_arrays(out, every=True)
    n, pair = len(found["points"]), []
    stored = {
        name: scipy.sparse.csc_matrix((found[f"{name}_data"], (found[f"{name}_row"], found[f"{name}_col"])), (n, n))
        for name in "KM"
    }
    free = np.flatnonzero((stored["K"].diagonal() != 0) | (stored["M"].diagonal() != 0))
    dofs = tuple((int(node), int(way) + 1) for node, way in found["points"][free])
    for A in stored.values():
        coo = A[free][:, free].tocoo()
        pair.append(Matrix.of(dofs, coo.row, coo.col, coo.data, 15, mirrored=True))
    return pair[0], pair[1]


def _is_installed(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


ANSYS_READER = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (int(sys.argv[3]),) * 2)
except ImportError:
    pass
import numpy as np
from ansys.mapdl import reader
points, K, M = reader.read_binary(sys.argv[1]).load_km(as_sparse=True)
arrays = {"points": np.asarray(points)}
for name, A in (("K", K), ("M", M)):
    A = A.tocoo()
    arrays |= {name + "_data": A.data, name + "_row": A.row, name + "_col": A.col}
np.savez(sys.argv[2], **arrays)
"""
