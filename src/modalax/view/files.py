"""What a view reads and writes: selections, modal models, results and reports. Nothing is replaced unless asked."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files import save_modes
from modalax.files.json_text import json_text
from modalax.files.modes import ENDINGS
from modalax.files.write import check_target, write_text
from modalax.model.modal import poles_from
from modalax.view.session import Pick, Session

REPORT, RESULT = ".html", ".json"


def place(folder: Path, name: str, overwrite: bool, inputs: Sequence[Path] = ()) -> Path:
    """The file of a plain name in a folder, if it may be written.

    Raises
    ------
    ValueError
        If the name is none, leads out of the folder or is that of an input, or the file exists.
    """
    if not name or name != Path(name).name or name.startswith("."):
        raise ValueError(f"{name!r} is no plain file name; files are written to {folder}")
    path = folder / name
    if path.exists() and any(p.exists() and path.samefile(p) for p in inputs):
        raise ValueError(f"{name} is read as input, so nothing is written to it; choose another name")
    check_target(path, overwrite, "tick 'replace'")
    return path


def selection_of(session: Session, data: str) -> dict[str, Any]:
    """The picks as plain values, from which :func:`read_selection` makes them again."""
    modes = [
        {
            "name": p.name, "frequency_hz": p.frequency_hz, "damping_ratio": -p.pole.real / abs(p.pole),
            "order": p.order,
        }
        for p in session.state.picks
    ]  # fmt: skip
    return {
        "data": data, "band_hz": list(session.state.band), "method": session.method,
        "highest_order": session.state.order, "modes": modes,
    }  # fmt: skip


def read_selection(path: Path) -> tuple[list[Pick], tuple[float, float] | None, int | None]:
    """Picks of a file of a view, or of ``modalax fit --json``, with its band [Hz] and highest order where it has them.

    Raises
    ------
    ValueError
        If the file holds no modes.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        picks = []
        for mode in found["modes"]:
            pole = complex(poles_from([float(mode["frequency_hz"])], [float(mode["damping_ratio"])])[0])
            if not np.isfinite(pole) or pole.imag <= 0 or pole.real >= 0:
                raise ValueError
            order = mode.get("order")
            picks.append(Pick(pole, None if order is None else int(order), str(mode.get("name", ""))))
        band, order = found.get("band_hz"), found.get("highest_order")
        return picks, None if band is None else (float(band[0]), float(band[1])), None if order is None else int(order)
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(
            f"{path}: holds no selection; it needs modes with frequency_hz and damping_ratio above 0, as a view or "
            "modalax fit --json writes them"
        ) from error


def save(session: Session, what: str, path: Path, overwrite: bool, data: str) -> None:
    """Write ``selection``, ``model``, ``result`` or ``report`` of the picks.

    Raises
    ------
    ValueError
        If nothing is picked, the kind is unknown, or the ending is not one of that kind.
    """
    ending = path.suffix.lower()
    wanted = {"selection": (RESULT,), "model": ENDINGS, "result": (RESULT,), "report": (REPORT,)}
    if what not in wanted:
        raise ValueError(f"{what!r} cannot be saved; there are {', '.join(wanted)}")
    if ending not in wanted[what]:
        raise ValueError(f"{path.name}: a {what} is written to {', '.join(wanted[what])}, not to {ending!r}")
    if what == "selection":
        write_text(path, json_text(selection_of(session, data)), overwrite)
    elif what == "model":
        refined = session.state.refined
        std = (None, None) if refined is None else (refined.frequency_std_hz, refined.damping_std)
        save_modes(
            session.model(), path, frequency_std_hz=std[0], damping_std=std[1], geometry=session.geometry,
            overwrite=overwrite,
        )  # fmt: skip
    elif what == "result":
        write_text(path, json_text(_result(session)), overwrite)
    else:
        from modalax.show.report import fit_report

        write_text(path, fit_report(session.fit(), title=f"Modes of {data}", geometry=session.geometry), overwrite)


def _result(session: Session) -> dict[str, Any]:
    """The answer of a fit, with the names of the picks."""
    answer = session.fit().to_dict()
    for mode in answer["modes"]:
        apart = [abs(p.frequency_hz - mode["frequency_hz"]) for p in session.state.picks]
        mode["name"] = session.state.picks[int(np.argmin(apart))].name
    return answer
