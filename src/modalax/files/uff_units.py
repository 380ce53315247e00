"""Units of universal files: data set 164, and the labels of axes where there is none."""

import re
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

STANDARD_GRAVITY = 9.80665  # m/s^2, by definition
POUND_FORCE = 4.4482216152605  # N, by definition
INCH, FOOT = 0.0254, 0.3048  # m, by definition
SI: dict[str, Any] = {
    "type": 164, "units_code": 1, "units_description": "SI: Meter (newton)", "temp_mode": 2, "length": 1.0,
    "force": 1.0, "temp": 1.0, "temp_offset": 273.15,
}  # fmt: skip
ABSCISSAE = {17: "units of time", 19: "rpm", 20: "orders"}  # types of an abscissa that is no frequency [Hz]
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "in": INCH, "ft": FOOT}
_FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": POUND_FORCE, "lb": POUND_FORCE}


class Units(NamedTuple):
    """Size of the units of the file in SI: length [m], force [N]."""

    length: float
    force: float


def units_of(found: Mapping[str, Any]) -> Units:
    """Units of a data set 164, whose factors divide a value of the file to give SI.

    Raises
    ------
    ValueError
        If a factor is not positive.
    """
    length, force = float(found["length"]), float(found["force"])
    if not (0 < length < 1e30 and 0 < force < 1e30):
        raise ValueError(
            f"data set 164 gives the factors {length:g} for length, {force:g} for force; they are positive"
        )
    return Units(1 / length, 1 / force)


def response_scale(found: Mapping[str, Any]) -> float:
    """Factor from the values of an FRF in the file to SI (m, m/s or m/s^2 a newton).

    Data set 164 decides; without one, the axis labels do, where they are known words; otherwise SI is assumed. An
    acceleration labelled ``g`` is always taken in units of standard gravity.
    """
    response, _, over = _plain(found.get("ordinate_axis_units_lab", "")).partition("/n")
    force_word = _plain(found.get("orddenom_axis_units_lab", "")) or ("n" + over if over else "")
    units = found.get("units")
    force = units.force if units else _FORCES.get(force_word, 1.0)
    if response == "g" and found.get("ordinate_spec_data_type") == 12:
        return STANDARD_GRAVITY / force
    length = units.length if units else _LENGTHS.get(response.split("/")[0], 1.0)
    return length / force


def axis_unit(found: Mapping[str, Any]) -> str:
    """Unit of the abscissa by its label; where there is none, nothing for frequencies, else what the abscissa is.

    Data set 164 has no say: it holds no unit of time.
    """
    label = _plain(found.get("abscissa_axis_units_lab", ""))
    return label or ABSCISSAE.get(int(found.get("abscissa_spec_data_type", 0) or 0), "")


def _plain(label: str) -> str:
    """A label without brackets and spaces, in small letters; nothing for NONE."""
    text = re.sub(r"[\s()\[\]]", "", str(label)).lower()
    return "" if text == "none" else text


def is_upside_down(found: Mapping[str, Any]) -> bool:
    """Whether a function is a force (ordinate type 9 or 13) over a motion (8, 11, 12), the inverse of an FRF."""
    over = found.get("orddenom_spec_data_type")
    return found.get("ordinate_spec_data_type") in (9, 13) and over in (8, 11, 12)


def form_of(found: Mapping[str, Any]) -> str | None:
    """Form of an FRF by its ordinate type (8, 11, 12) over a force (13, 9 or not said), else by its labels."""
    if found.get("orddenom_spec_data_type", 0) not in (0, 1, 9, 13):
        return None
    forms = {8: "receptance", 11: "mobility", 12: "accelerance"}
    kind = found.get("ordinate_spec_data_type")
    if kind in forms:
        return forms[kind]
    label = _plain(found.get("ordinate_axis_units_lab", ""))
    words = (
        ("accelerance", r"g(/n)?|.*/s(\^|\*\*)?2(/n)?|.*/s²(/n)?"),
        ("mobility", r".*m/s(/n)?"),
        ("receptance", r"[mc]?m/n"),
    )
    return next((form for form, pattern in words if re.fullmatch(pattern, label)), None)


def tell_other_form(stated: Iterable[str | None], told: str | None) -> None:
    """Warn where FRFs state another form than the one that the user told, which counts more."""
    others = sorted({form for form in stated if form} - {told})
    if told is not None and others:
        warnings.warn(
            f"it states that its FRFs are {', '.join(others)}; they are taken as {told}, as was told, with their "
            "numbers as they are",
            UserWarning,
            stacklevel=7,
        )
