"""Simulations from finite-element programs: matrices or modes in SI units, with DoFs named by grid point and direction.

Nastran (DMIG punch, eigenvectors, decks for geometry), Abaqus ``.mtx``, Ansys ``.full``, Harwell-Boeing, Matrix Market.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from modalax.data.geometry import Geometry
from modalax.files.guard import reading
from modalax.files.matrices import Matrix
from modalax.files.matrix_files import kind_of, matrices_of
from modalax.files.messages import about
from modalax.files.nastran import Grid, read_grids, read_lines, read_punched_modes
from modalax.files.nastran_groups import Pair, groups_of, read_groups
from modalax.model.assembly import modal_damping
from modalax.model.component_modes import reduce_to_points
from modalax.model.condense import Condensed, condense, node_pairs, rigid_motions
from modalax.model.elements import MOST_VALUES, Element, Elements, elements_of, factor_of
from modalax.model.modal import ModalModel
from modalax.model.structure import Structure

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
# Length [m] and force [N] of the systems of units in use; time is in seconds, and mass follows.
UNITS = {
    "m-N": (1.0, 1.0), "mm-N": (1e-3, 1.0), "cm-N": (1e-2, 1.0), "in-lbf": (0.0254, 4.4482216152605),
    "ft-lbf": (0.3048, 4.4482216152605), "m-kgf": (1.0, 9.80665), "mm-kgf": (1e-3, 9.80665),
}  # fmt: skip
DENSE = 3000  # DoFs up to which matrices are condensed as they are
DOUBLE = 15  # significant digits of a number in double precision
UNDAMPED = "no damping in the file and none given: all modes are undamped, and a diagnosis takes what is measured"
FEW = 300  # DoFs from which a model is reduced to those named, where some are named and it does not part into elements
RIGID = 1e-4  # part of the first elastic eigenvalue below which a mode of a file counts as rigid


@dataclass(frozen=True)
class Imported:
    """A simulation from a finite-element program.

    Attributes
    ----------
    simulation
        Matrices, or a modal model where the file holds modes.
    notes
        What was found, checked and assumed, a sentence each.
    mass
        Total mass along each axis that the matrices tell, by ``X``, ``Y``, ``Z`` [kg]; empty for modes.
    geometry
        Grid points [m] and the elements between them; None without a deck.
    """

    simulation: Structure | ModalModel
    notes: tuple[str, ...]
    mass: dict[str, float] = field(default_factory=dict)
    geometry: Geometry | None = None


def import_finite_elements(
    path: Path,
    *,
    mass: Path | None = None,
    damping: Path | None = None,
    grids: Path | None = None,
    units: str = "m-N",
    damping_ratio: float | None = None,
    up_to_hz: float | None = None,
    keep: Sequence[str] = (),
    matrices: tuple[str, str] | None = None,
    groups: bool = False,
) -> Imported:
    r"""Read stiffness and mass, or modes, that a finite-element program wrote.

    Parameters
    ----------
    path
        Nastran punch file or deck with DMIG matrices or eigenvectors, Ansys ``.full``, or the stiffness in a file of
        its own: Abaqus ``.mtx``, Matrix Market, Harwell-Boeing.
    mass, damping
        Files of the mass and, if there is one, the viscous damping, where each matrix has its own.
    grids
        Nastran deck with the grid points: turns local displacement axes to the basic ones, gives the geometry and
        checks that rigid-body motions cost no force.
    units
        ``m-N``, ``mm-N``, ``in-lbf`` and so on (:data:`UNITS`); the program's mass follows from force and length.
    damping_ratio
        Damping ratio of all modes, where the program tells none; 0 if None.
    up_to_hz
        Highest frequency of interest [Hz], see :func:`modalax.model.condense.condense`.
    keep
        DoFs, such as ``101:+Z`` or the pattern ``*:+Z``, that are not condensed, whatever their mass: those measured.
        A model of more than :data:`FEW` DoFs is reduced to them and to as many others as its dynamics need, by
        :func:`modalax.model.component_modes.reduce_to_points`, where it does not part into elements.
    matrices
        Names of stiffness and mass in a punch file that holds more than one of each.
    groups
        Whether elements of one property or material of the deck make groups, whose parameters a diagnosis then tells.

    Raises
    ------
    ValueError
        If the file cannot be used, the units are not known, or a DoF named does not exist.
    """
    if units not in UNITS:
        raise ValueError(f"units are {units!r}; known are {', '.join(UNITS)}")
    scale = UNITS[units]
    for other in (mass, damping, grids):
        if other is not None and not Path(other).is_file():
            raise ValueError(f"{other} is no file")
    if groups and grids is None:
        raise ValueError("groups of elements are read from a Nastran deck; give it (grids=, --grids)")
    deck, named = None, {}
    if grids is not None:
        with about(grids), reading("the deck", ValueError):
            deck, named = read_grids(grids), read_groups(grids) if groups else {}
    kind = kind_of(path)
    with reading(f"the file ({kind})", ValueError):
        if kind == "modes":
            return _modes(path, deck, scale, damping_ratio)
        K, M, C, notes = matrices_of(path, kind, mass, damping, matrices)
        return _Import(K, M, C, deck, scale, notes, named).finished(grids, units, damping_ratio, up_to_hz, keep)


def dof_name(point: int, component: int) -> str:
    """``101:+Z`` for component 3 of grid point 101; the point alone for a scalar point (component 0)."""
    return f"{point}:+{DIRECTIONS[component - 1]}" if component else str(point)


class _Import:
    """Matrices of one model on their way to a simulation in SI units."""

    def __init__(
        self, K: Matrix, M: Matrix, C: Matrix | None, deck: dict[int, Grid] | None, scale: tuple[float, float],
        notes: list[str], named: dict[str, set[Pair]],
    ):  # fmt: skip
        self.dofs = tuple(sorted({*K.dofs, *M.dofs}))
        self.digits, self.deck, self.notes = K.digits, deck, notes
        self.named = named
        length, force = scale
        self.length = length
        self.rotation = np.array([component > 3 for _, component in self.dofs])
        unit = scipy.sparse.diags(np.where(self.rotation, 1.0, 1 / length) * np.sqrt(force * length))
        turn = unit @ self._to_basic()
        self.K, self.M = (turn @ A.on(self.dofs) @ turn.T for A in (K, M))
        self.C = None if C is None else turn @ C.on(self.dofs) @ turn.T
        self.names = [dof_name(*dof) for dof in self.dofs]

    def _to_basic(self) -> Any:
        """Turns local displacement axes to the basic ones, where a grid point has all three directions."""
        at = {dof: k for k, dof in enumerate(self.dofs)}
        T = scipy.sparse.lil_matrix(scipy.sparse.eye(len(self.dofs)))
        left = []
        for point in sorted({p for p, component in self.dofs if component}) if self.deck else []:
            grid = self.deck.get(point) if self.deck else None
            if grid is None or np.allclose(grid.axes, np.eye(3)):
                continue
            for first in (1, 4):
                rows = [at[point, first + k] for k in range(3) if (point, first + k) in at]
                if len(rows) == 3:
                    T[np.ix_(rows, rows)] = grid.axes.T
                elif rows:
                    left.append(point)
        if left:
            self.notes.append(
                f"{len(left)} grid points keep local axes, since not all of their directions are in the matrices "
                f"({', '.join(map(str, left[:5]))}{', ...' if len(left) > 5 else ''})"
            )
        return T.tocsc()

    def finished(
        self, grids: Path | None, units: str, damping_ratio: float | None, up_to_hz: float | None, keep: Sequence[str]
    ) -> Imported:
        keep = self._named(keep)
        total = self._mass()
        told = ", ".join(f"{value:.6g} kg along {way}" for way, value in total.items())
        self.notes.append(f"units {units}: total mass {told}" if told else f"units {units}")
        geometry = None
        if self.deck is not None and grids is not None:
            geometry = self._geometry(read_lines(grids))
            self.notes.append(self._rigid_check())
        if self.C is None:
            zeta = 0.0 if damping_ratio is None else damping_ratio
            self.notes.append(
                UNDAMPED
                if damping_ratio is None else f"damping ratio of all modes {100 * zeta:g} %, as given"
            )  # fmt: skip
        simulation = self._condensed(damping_ratio, up_to_hz, keep)
        return Imported(simulation, tuple(self.notes), total, geometry)

    def _named(self, patterns: Sequence[str]) -> list[str]:
        """DoFs that match one of the patterns."""
        found: dict[str, None] = {}
        for pattern in patterns:
            names = [name for name in self.names if fnmatchcase(name, pattern)]
            if not names:
                raise ValueError(f"no DoF named {pattern!r}; they are called like {', '.join(self.names[:4])}")
            found.update(dict.fromkeys(names))
        return list(found)

    def _condensed(self, damping_ratio: float | None, up_to_hz: float | None, keep: Sequence[str]) -> Structure:
        small, digits, parts = self._small([self.names.index(n) for n in keep], up_to_hz)
        self._tell(small, digits)
        names = [self.names[k] for k in np.flatnonzero(small.kept)]
        points = [str(p) for p, _ in self.dofs]
        ways = [DIRECTIONS[component - 1] if component else "" for _, component in self.dofs]
        joined = node_pairs(self.K, points, ways, small.kept)
        pairs = [(self.names[a], self.names[b]) for a, b in joined] or None  # none: anywhere
        C = np.zeros_like(small.K) if self.C is None else small.motion.T @ (self.C @ small.motion)
        elements = None if parts is None else self._kept_elements(parts, small)
        motion = None if elements is not None else np.asarray(small.motion)
        groups = groups_of(self.named, parts or (), len(self.dofs), motion)
        if groups is not None:
            self.notes.append(f"groups of elements by property and material: {', '.join(groups.names)}")
        structure = Structure(small.M, C, small.K, names, pairs=pairs, elements=elements, groups=groups)
        if self.C is None and damping_ratio:
            structure = modal_damping(structure, damping_ratio)
        return structure

    def _small(self, keep: list[int], up_to_hz: float | None) -> tuple[Condensed, int, list[Element] | None]:
        """Condensed matrices, the digits of the stiffness that they are made of, and its elements if it parts."""
        size, parts = len(self.dofs), None
        if size <= DENSE:
            K = self.K.toarray()
            parts = self._elements(K)
            if parts is not None:
                K = sum((_placed(p, size) for p in parts), np.zeros_like(K))
                return condense(self.M.toarray(), K, up_to_hz=up_to_hz, digits=DOUBLE, keep=keep), DOUBLE, parts
            if not FEW < size > len(keep) > 0:
                return (
                    condense(self.M.toarray(), K, up_to_hz=up_to_hz, digits=self.digits, keep=keep),
                    self.digits,
                    None,
                )
        elif not 0 < len(keep) < DENSE:
            raise ValueError(
                f"the model has {size} DoFs, too many to keep as matrices; name those that are measured or hold joints "
                f"(keep=, --keep), and it is reduced to them; {len(keep)} are named, at most {DENSE} can be"
            )
        return reduce_to_points(self.M, self.K, keep, up_to_hz=up_to_hz, digits=self.digits), self.digits, None

    def _elements(self, K: np.ndarray) -> list[Element] | None:
        """The model's elements where it is free or supported and made of beams, rods and springs; else None."""
        if self.deck is None or any(p not in self.deck for p, _ in self.dofs):
            return None
        parts = elements_of(K, np.array([p for p, _ in self.dofs]), self._rigid())
        if parts is None:
            return None
        supports = sum(len(p.nodes) == 1 for p in parts)
        self.notes.append(
            f"the stiffness parts into {len(parts) - supports} elements between two grid points"
            + (f" and {supports} supports" if supports else "")
            + "; their sum, free of the file's rounding, is used"
        )
        return parts

    def _kept_elements(self, parts: Sequence[Element], small: Condensed) -> Elements | None:
        """Elements and lumps of mass over all DoFs, also those that follow; None where the mass couples nodes."""
        M, kept, size = self.M.toarray(), small.kept, len(self.dofs)
        points = np.array([p for p, _ in self.dofs])
        lumps = [np.flatnonzero(points == p) for p in dict.fromkeys(points.tolist())]
        lumped = [d for d in lumps if M[np.ix_(d, d)].any()]
        own = points[:, None] == points
        if np.abs(np.where(own, 0.0, M)).max(initial=0.0) > 1e-9 * np.abs(M).max():
            return None
        if (len(parts) + len(lumped)) * size * 6 > MOST_VALUES:
            return None
        stiffness, mass = np.zeros((len(parts), size, 6)), np.zeros((len(lumped), size, 6))
        for out, part in zip(stiffness, parts, strict=True):
            out[part.dofs] = factor_of(part.matrix)
        for out, d in zip(mass, lumped, strict=True):
            out[d] = factor_of(M[np.ix_(d, d)])
        return Elements(stiffness, mass, [self._place(p, kept) for p in parts], self.names)

    def _place(self, part: Element, kept: np.ndarray) -> tuple[str, str]:
        """The two DoFs that an element couples most, of one direction and kept if it can be."""
        points = np.array([self.dofs[d][0] for d in part.dofs])
        ways = np.array([self.dofs[d][1] for d in part.dofs])
        size = np.sqrt(np.maximum(np.diag(part.matrix), 1e-300))
        worth = np.abs(part.matrix) / np.outer(size, size)
        worth = worth * (1.0 + 10.0 * (ways[:, None] == ways)) * np.where(np.outer(*2 * [kept[part.dofs]]), 100.0, 1.0)
        if len(part.nodes) == 2:
            worth = np.where(points[:, None] != points, worth, -1.0)
        a, b = np.unravel_index(int(np.argmax(worth)), worth.shape)
        first, second = sorted((int(part.dofs[a]), int(part.dofs[b])))
        return self.names[first], self.names[second]

    def _tell(self, small: Condensed, digits: int) -> None:
        hertz = lambda square: np.sqrt(np.abs(square)) / (2 * np.pi)
        elastic = small.eigenvalue[small.rigid :]
        self.notes.append(
            f"{small.rigid} rigid-body modes (by the matrices at up to {hertz(small.rigid_eigenvalue):.3g} Hz, which "
            f"their {digits} digits allow: {hertz(small.rounding):.3g} Hz), {len(elastic)} elastic modes from "
            f"{hertz(elastic[0]):.6g} to {hertz(elastic[-1]):.6g} Hz"
        )
        worst = float((small.deviation[small.rigid :] / (2 * elastic)).max())
        if worst > 1e-6:
            self.notes.append(
                f"the digits of the file leave the elastic frequencies uncertain by up to {100 * worst:.2g} %"
            )
        if not small.kept.all():
            how = "" if small.dynamic else " statically (little or no mass)"
            self.notes.append(
                f"{int((~small.kept).sum())} of {len(small.kept)} DoFs follow the others{how}; frequencies change by "
                f"at most {100 * small.change:.2g} %"
            )

    def _mass(self) -> dict[str, float]:
        """Mass that a unit translation of all points moves, by axis."""
        out: dict[str, float] = {}
        for k, way in enumerate("XYZ"):
            r = np.array([float(component == k + 1) for _, component in self.dofs])
            if r.any():
                out[way] = float(r @ (self.M @ r))
        return out

    def _rigid_check(self) -> str:
        points = [self.deck[p] if self.deck and p in self.deck else None for p, _ in self.dofs]
        missing = sorted({p for (p, _), grid in zip(self.dofs, points, strict=True) if grid is None})
        if missing:
            return (
                f"{len(missing)} points of the matrices are not in the deck (such as {missing[0]}); no rigid-body check"
            )
        R = self._rigid()
        force, size = np.abs(self.K @ R).max(), (abs(self.K) @ np.abs(R)).max()
        if force < 1e-6 * size:
            return f"rigid-body motions by the geometry cost no force (to {force / size:.1g}): the model is free"
        return f"rigid-body motions by the geometry cost force ({force / size:.1g} of what cancels): it is supported"

    def _rigid(self) -> np.ndarray:
        """Rigid-body motions about the origin; every point is in the deck."""
        assert self.deck is not None
        xyz = np.array([self.deck[p].xyz * self.length for p, _ in self.dofs])
        axes = np.eye(3)[[max(component - 1, 0) % 3 for _, component in self.dofs]]
        return rigid_motions(xyz, axes, self.rotation)

    def _geometry(self, elements: list[tuple[int, ...]]) -> Geometry:
        assert self.deck is not None
        return geometry_of(self.deck, elements, self.length)


def _placed(part: Element, size: int) -> np.ndarray:
    """A part over all DoFs."""
    out = np.zeros((size, size))
    out[np.ix_(part.dofs, part.dofs)] = part.matrix
    return out


def geometry_of(deck: dict[int, Grid], elements: Sequence[tuple[int, ...]], length: float) -> Geometry:
    """Grid points of a deck and the lines of its elements; ``length`` is the deck's unit [m]."""
    lines = [tuple(map(str, line)) for line in elements if all(p in deck for p in line)]
    return Geometry([str(p) for p in deck], np.array([grid.xyz for grid in deck.values()]) * length, lines)


def _modes(
    path: Path, deck: dict[int, Grid] | None, scale: tuple[float, float], damping_ratio: float | None
) -> Imported:
    """Mass-normalised modes as a modal model: residues of the elastic ones, a lower residual term of the rigid ones."""
    square, dofs, phi = read_punched_modes(path)
    length, force = scale
    rotation = np.array([component > 3 for _, component in dofs])
    phi = phi * np.where(rotation, 1.0, length) / np.sqrt(force * length)
    notes = [f"{len(square)} modes at {len(dofs)} DoFs, taken as normalised to unit modal mass (NORM MASS)"]
    if deck is not None:
        phi = _turned(phi, dofs, deck)
    elastic = square[square > 0]
    rigid = square < RIGID * np.median(elastic) * (elastic.size > 0)
    if rigid.any():
        notes.append(f"{int(rigid.sum())} rigid-body modes make the lower residual term")
    if damping_ratio is None:
        notes.append(UNDAMPED)
    notes.append("modes that were not punched are missing: there is no static correction")
    names = [dof_name(*dof) for dof in dofs]
    frequency = np.sqrt(square[~rigid]) / (2 * np.pi)
    model = ModalModel.from_real_modes(
        frequency, np.full(len(frequency), damping_ratio or 0.0), phi[~rigid], np.ones(len(frequency)), names
    )
    geometry = None if deck is None else geometry_of(deck, [], length)
    return Imported(model.replace(lower=phi[rigid].T @ phi[rigid]), tuple(notes), {}, geometry)


def _turned(phi: np.ndarray, dofs: tuple[tuple[int, int], ...], deck: dict[int, Grid]) -> np.ndarray:
    at, phi = {dof: k for k, dof in enumerate(dofs)}, phi.copy()
    for point in sorted({p for p, _ in dofs} & set(deck)):
        for first in (1, 4):
            columns = [at[point, first + k] for k in range(3) if (point, first + k) in at]
            if len(columns) == 3:
                phi[:, columns] = phi[:, columns] @ deck[point].axes
    return phi
