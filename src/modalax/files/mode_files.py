"""Tables of measured modes from files: modal models, universal files (55, 2414) and CSV."""

import csv
import os
import re
import zipfile
from pathlib import Path

import numpy as np

from modalax.files.arrays import EXTENDED
from modalax.files.guard import MOST_NAMES, Refused, reading
from modalax.files.lines import lines_of
from modalax.files.load_save import as_path, load
from modalax.files.messages import about
from modalax.files.sniff import sniff
from modalax.files.uff import load_modes, set_types
from modalax.model.modal import ModalModel
from modalax.model.mode_table import ModeTable

PART = re.compile(r"(re|im)\s+(.+)")
HEADINGS = "mode, frequency_hz, damping_ratio, then 're NAME' and, where shapes are complex, 'im NAME' of each DoF"


def load_mode_table(path: str | os.PathLike[str]) -> ModeTable:
    """Read measured modes: a modal model (``.npz``, ``.mat``), shapes of a universal file, or a CSV table.

    A CSV table has the columns ``mode``, ``frequency_hz``, ``damping_ratio`` (may be empty), if known
    ``frequency_std_hz`` and ``damping_ratio_std``, and ``re NAME``, ``im NAME`` of each DoF, as ``modalax fit --modes``
    writes it.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file, or it holds no modes.
    """
    path = as_path(path)
    kind = sniff(path)
    with about(path):
        if kind == "modes":
            return _from_csv(path)
        if kind == "uff":
            found = load_modes(path)
            frequency = np.abs(found.poles) / (2 * np.pi)
            return ModeTable.of(frequency, -found.poles.real / np.abs(found.poles), found.shapes, found.dofs)
        model = load(path)
        if not isinstance(model, ModalModel):
            raise ValueError(f"holds a {type(model).__name__}; measured modes are needed here")
        return ModeTable.of_model(model)


def holds_modes_alone(path: Path) -> bool:
    """Whether a file holds modes and no FRFs: a table of modes, a modal model, shapes of a universal file."""
    kind = sniff(path)
    if kind == "uff":
        with about(path):
            kinds = [int(t) for t in set_types(path)]
        return 58 not in kinds and bool({55, 2414} & set(kinds))
    if kind == "npz":
        with about(path), reading("the .npz archive"), zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
        return "shapes" in names and not {"H", "M", EXTENDED} & names
    return kind == "modes"


def _from_csv(path: Path) -> ModeTable:
    rows = lines_of(path, "#")
    titles = [h.strip() for h in next(csv.reader([next(rows)[1]]))]
    heads = [h if PART.fullmatch(h) else h.lower() for h in titles]
    if len(heads) > 2 * MOST_NAMES or len(set(heads)) < len(heads):
        raise Refused(f"has {len(heads)} columns, {len(set(heads))} of them of different names")
    parts = [(m[1], m[2].strip()) for m in map(PART.fullmatch, heads) if m]
    dofs = [name for part, name in parts if part == "re"]
    if "frequency_hz" not in heads or not dofs:
        raise ValueError(f"has the columns {', '.join(heads[:6])}; a table of modes has {HEADINGS}")
    table = []
    for number, line in rows:
        cells = next(csv.reader([line]))
        if len(cells) != len(heads):
            raise ValueError(f"line {number} has {len(cells)} columns, the header {len(heads)}")
        try:
            table.append([float(c) if c.strip() else np.nan for c in cells])
        except ValueError as error:
            raise ValueError(f"line {number} holds what is no number ({error})") from error
    numbers = np.array(table, dtype=float).reshape(-1, len(heads))
    column = lambda name: numbers[:, heads.index(name)] if name in heads else np.full(len(numbers), np.nan)
    imaginary = [column(f"im {n}") if f"im {n}" in heads else np.zeros(len(numbers)) for n in dofs]
    shapes = np.stack([column(f"re {n}") for n in dofs], axis=1) + 1j * np.stack(imaginary, axis=1)
    frequency, zeta = column("frequency_hz"), column("damping_ratio")
    with np.errstate(divide="ignore", invalid="ignore"):
        stds = column("frequency_std_hz") / frequency, column("damping_ratio_std") / zeta
    return ModeTable.of(frequency, zeta, shapes, dofs, *stds)
