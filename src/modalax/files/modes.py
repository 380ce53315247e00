"""Writing modes: CSV with a row for each mode, universal files (55) or ``.npz``."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from modalax.data.geometry import Geometry
from modalax.files.load_save import save
from modalax.files.write import write_text
from modalax.model.modal import ModalModel

ENDINGS = (".csv", ".uff", ".unv", ".npz")
HEAD = ("mode", "frequency_hz", "frequency_std_hz", "damping_ratio", "damping_ratio_std")


def check_modes_file(path: Path) -> None:
    """Refuse a file name with another ending than those of files with modes; ``ValueError`` lists them."""
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: modes are written to {', '.join(ENDINGS)}, not to {path.suffix!r}")


def save_modes(
    model: ModalModel,
    path: Path | str,
    *,
    frequency_std_hz: Any = None,
    damping_std: Any = None,
    geometry: Geometry | None = None,
    overwrite: bool = False,
) -> None:
    """Write modes, the ending of ``path`` says how: ``.csv`` (frequencies, dampings, shapes), ``.uff`` or ``.npz``.

    Shapes are scaled so that the largest component is 1. Where there are more inputs than outputs (a roving hammer)
    they are the shapes over the inputs.

    Parameters
    ----------
    model
        The modes.
    path
        The file.
    frequency_std_hz, damping_std
        Standard deviations, shape ``(n,)`` [Hz] and [-], for CSV; empty cells where there are none.
    geometry
        Nodes and lines to go with them into a universal file.
    overwrite
        Whether a file of that name may be replaced.

    Raises
    ------
    ValueError
        If the file exists and ``overwrite`` is False, or its ending is of no kind that holds modes.
    """
    path = Path(path)
    check_modes_file(path)
    if path.suffix.lower() == ".npz":
        save(model, path, overwrite)
    elif path.suffix.lower() == ".csv":
        write_text(path, modes_as_text(model, frequency_std_hz, damping_std), overwrite)
    else:
        along = model if len(model.outputs) >= len(model.inputs) else model.transpose()
        save(along.normalised(), path, overwrite, geometry=geometry)


def modes_as_text(model: ModalModel, frequency_std_hz: Any = None, damping_std: Any = None) -> str:
    """Modes as CSV: a header, then a row for each mode, with the real and imaginary part of the shape at each DoF."""
    along = (model if len(model.outputs) >= len(model.inputs) else model.transpose()).normalised()
    blank = np.full(len(model.poles), np.nan)
    std = [blank if s is None else np.asarray(s, dtype=float) for s in (frequency_std_hz, damping_std)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*HEAD, *(f"{part} {name}" for name in along.outputs for part in ("re", "im"))])
    shown = lambda v: f"{float(v):.10g}" if np.isfinite(v) else ""
    for r, shape in enumerate(np.asarray(along.shapes)):
        numbers = (along.frequency_hz[r], std[0][r], along.damping_ratio[r], std[1][r])
        parts = [p for value in shape for p in (value.real, value.imag)]
        writer.writerow([r + 1, *(shown(v) for v in (*numbers, *parts))])
    return text.getvalue()
