"""Matrices that finite-element programs write: Abaqus, Ansys, Harwell-Boeing, Matrix Market."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse

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
    text = re.sub(r"^\*.*$", "", path.read_text(encoding="latin-1"), flags=re.MULTILINE)
    words = text.replace(",", " ").replace("D", "E").split()
    first = next((line for line in text.splitlines() if line.strip()), "")
    width = len(first.replace(",", " ").split())
    if width != 5 or len(words) % 5:
        raise ValueError(
            f"lines of {width} numbers; a matrix by Abaqus has node, DoF, node, DoF, value a line "
            "(*MATRIX OUTPUT, FORMAT=MATRIX INPUT)"
        )
    try:
        table = np.array(words, dtype=float).reshape(-1, 5)
    except ValueError as error:
        raise ValueError(f"a line of it holds no number ({error})") from error
    digits = max(sum(c.isdigit() for c in re.split("[eE]", word)[0]) for word in words[4:5000:5])
    points = table[:, :4].astype(int).reshape(-1, 2)
    fixed = {tuple(row[:2].astype(int)) for row in table if row[4] >= FIXED and (row[:2] == row[2:4]).all()}
    dofs = tuple(sorted({(int(a), int(b)) for a, b in points} - fixed))
    at = {dof: k for k, dof in enumerate(dofs)}
    index = np.array([at.get((int(a), int(b)), -1) for a, b in points]).reshape(-1, 2)
    keep = (index >= 0).all(axis=1)
    index, values = index[keep], table[keep, 4]
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
    try:
        A: Any = scipy.io.hb_read(str(path)) if harwell_boeing else scipy.io.mmread(str(path))
    except (ValueError, IndexError, TypeError, StopIteration, KeyError) as error:
        raise ValueError(f"the matrix file is damaged or cut short ({error})") from error
    A = scipy.sparse.csc_matrix(A)
    shape: tuple[int, int] = A.shape  # pyright: ignore[reportAssignmentType]
    if shape[0] != shape[1] or A.dtype.kind == "c":
        raise ValueError(f"its matrix has shape {shape} and type {A.dtype}; it needs square and real")
    coo = A.tocoo()
    one_sided = bool((coo.row > coo.col).any()) != bool((coo.row < coo.col).any())
    names = path.with_suffix(".mapping")
    dofs = (
        _mapping(names, shape[0]) if harwell_boeing and names.is_file() else tuple((k + 1, 0) for k in range(shape[0]))
    )
    return Matrix.of(dofs, coo.row, coo.col, coo.data, 15, mirrored=one_sided)


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

    Raises
    ------
    ValueError
        If that package is not there, or cannot read the file.
    """
    try:
        from ansys.mapdl import reader  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError("an Ansys .full file needs ansys-mapdl-reader: pip install 'modalax[ansys]'") from error
    try:
        file = reader.read_binary(str(path))
        points, K, M = file.load_km(as_sparse=True)
    except Exception as error:
        raise ValueError(f"ansys-mapdl-reader cannot take matrices from it ({error}); give the .full file") from error
    free = np.flatnonzero((K.diagonal() != 0) | (M.diagonal() != 0))
    dofs = tuple((int(node), int(way) + 1) for node, way in np.asarray(points)[free])
    pair = []
    for A in (K, M):
        coo = scipy.sparse.csc_matrix(A)[free][:, free].tocoo()
        pair.append(Matrix.of(dofs, coo.row, coo.col, coo.data, 15, mirrored=True))
    return pair[0], pair[1]
