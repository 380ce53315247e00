"""Modes of a simulation or of an earlier test, seen beside those picked: cross-MAC, pairs, shapes overlaid."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modalax.data.dofs import parse_dof
from modalax.files import load, load_mode_table
from modalax.files.mode_files import holds_modes_alone
from modalax.model.correlation import Correlation, correlate
from modalax.model.indicators import msf
from modalax.model.mode_table import ModeTable
from modalax.model.structure import Structure, real_modes


@dataclass(frozen=True)
class Beside:
    """Modes to compare with.

    Attributes
    ----------
    label
        Name of the file they came from.
    table
        Their frequencies and shapes.
    """

    label: str
    table: ModeTable

    def near(self, dofs: Sequence[str], band: tuple[float, float]) -> tuple[list[int], ModeTable]:
        """Which of some DoFs these modes have, and the modes around a band at these DoFs.

        Raises
        ------
        ValueError
            If no DoF, or no frequency, is common to both.
        """
        have = {parse_dof(name): k for k, name in enumerate(self.table.dofs)}
        found = []
        for k, name in enumerate(dofs):
            dof = parse_dof(name)
            for sign in (1, -1):
                other = have.get(dof._replace(sign=sign * dof.sign))
                if other is not None:
                    found.append((k, other, sign))
                    break
        if not found:
            raise ValueError(
                f"{self.label} has none of the measured DoFs {', '.join(list(dofs)[:3])}, ...; its DoFs are "
                f"{', '.join(self.table.dofs[:3])}, ..."
            )
        f = self.table.frequency_hz
        lower, upper = 0.5 * band[0], 1.5 * band[1]
        which = np.flatnonzero((f >= lower) & (f <= upper))
        shapes = self.table.shapes[which][:, [o for _, o, _ in found]] * [s for _, _, s in found]
        which = which[np.abs(shapes).max(axis=1, initial=0.0) > 0]
        if not len(which):
            raise ValueError(f"{self.label} has no modes between {lower:g} and {upper:g} Hz")
        shapes = self.table.shapes[which][:, [o for _, o, _ in found]] * [s for _, _, s in found]
        names = [dofs[k] for k, _, _ in found]
        return [k for k, _, _ in found], ModeTable.of(f[which], self.table.damping_ratio[which], shapes, names)


def read_beside(path: str | os.PathLike[str]) -> Beside:
    """Read matrices (their undamped modes are taken), a modal model, a table of modes, or a result of a fit (JSON).

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it holds neither.
    """
    path = Path(os.fspath(path))
    if path.suffix.lower() == ".json":
        return Beside(path.name, _of_result(path))
    if holds_modes_alone(path):
        return Beside(path.name, load_mode_table(path))
    found = load(path)
    if not isinstance(found, Structure):
        return Beside(path.name, load_mode_table(path))
    try:
        square, phi, free = real_modes(np.asarray(found.M), np.asarray(found.K))
    except np.linalg.LinAlgError as error:
        raise ValueError(f"{path}: its mass matrix has no inverse, so that it has no modes to compare") from error
    keep = ~free & (square > 0)
    f = np.sqrt(square[keep]) / (2 * np.pi)
    return Beside(path.name, ModeTable.of(f, np.nan, phi[:, keep].T, found.dofs))


def _of_result(path: Path) -> ModeTable:
    """Modes of a result of ``modalax fit --json`` or of a view, at the outputs or, where they are more, the inputs."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        turned = len(found["inputs"]) > len(found["outputs"])
        modes, side = found["modes"], "participation" if turned else "shape"
        frequency, damping = ([float(mode[key]) for mode in modes] for key in ("frequency_hz", "damping_ratio"))
        shapes = np.array([mode[side] for mode in modes], float) @ [1, 1j]
        return ModeTable.of(frequency, damping, shapes, found["inputs"] if turned else found["outputs"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: holds no result with modes and shapes, as modalax fit --json writes it") from error


@dataclass(frozen=True)
class Comparison:
    """Picked modes beside others: how alike they are, and the shapes of the partners, scaled to lie on those picked.

    Attributes
    ----------
    correlation
        MAC and pairs.
    frequency_hz
        Of the modes beside, shape ``(m,)`` [Hz].
    columns
        DoFs, by index, that both have.
    partners
        Shape of each picked mode's partner at these DoFs, shape ``(n, dof)``; NaN where it has none.
    """

    correlation: Correlation
    frequency_hz: np.ndarray
    columns: list[int]
    partners: np.ndarray


def compare(
    beside: Beside, frequency_hz: np.ndarray, shapes: np.ndarray, dofs: Sequence[str], band: tuple[float, float]
) -> Comparison:
    """Compare picked modes, shapes ``(n,)`` and ``(n, dof)``, with others.

    Raises
    ------
    ValueError
        If nothing is common to both.
    """
    columns, table = beside.near(dofs, band)
    own = shapes[:, columns]
    # A shape that is zero at all common DoFs is like nothing, but a table takes no zero shape.
    own = np.where(np.abs(own).max(axis=1, keepdims=True) > 0, own, 1e-300)
    picked = ModeTable.of(frequency_hz, np.nan, own, table.dofs)
    found = correlate(picked, table.frequency_hz, table.shapes)
    partners = np.full(own.shape, np.nan + 0j)
    for k in np.flatnonzero(found.pairs >= 0):
        other = table.shapes[found.pairs[k]]
        partners[k] = other * complex(np.asarray(msf(own[k][None], other[None]))[0])
    return Comparison(found, table.frequency_hz, columns, partners)
