"""Time records of universal files: data sets 58 of function type 1."""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modalax.data.recording import FORCE, SI, Recording, unit_of
from modalax.files.uff import read_sets
from modalax.files.uff_functions import functions_of
from modalax.files.uff_index import index_of
from modalax.files.uff_units import Units
from modalax.files.units import TIMES, plain

_MEASURED = {8: ("m", "length"), 11: ("m/s", "length"), 12: ("m/s^2", "length"), 13: ("N", "force"), 9: ("N", "force")}
TIME_RESPONSE, FRF = 1, 4  # types of functions


def read_uff_records(path: Path, fs: float | None) -> Recording:
    """The time records of a universal file; a DoF that occurs several times makes several segments.

    Raises
    ------
    ValueError
        If it holds none, or their rates or lengths differ.
    """
    sets = [s for s in read_sets(path) if s["type"] == 58]
    time = [s for s in sets if s["func_type"] == TIME_RESPONSE]
    if not time:
        held = ", ".join(sorted({f.title for f in functions_of(sets)})) or "no functions"
        raise ValueError(f"holds {held}; time records (data set 58, function type 1) are needed here")
    steps = _steps(time)
    if fs is None and (min(steps) <= 0 or not np.allclose(steps, steps[0], rtol=1e-4)):
        raise ValueError(f"its records have steps of {min(steps):g} to {max(steps):g} s; one rate is needed (fs)")
    # A force and a motion at one DoF, the drive point, are two channels of one name.
    channels = list(zip(_names(time), map(_quantity, time), strict=True))
    order = list(dict.fromkeys(channels))
    segments = max(map(channels.count, order))
    if any(channels.count(channel) != segments for channel in order):
        uneven = ", ".join(f"{name} [{unit or '?'}] {channels.count((name, unit))}" for name, unit in order)
        raise ValueError(f"its channels stand unequally often ({uneven}); each needs as many records as the others")
    lengths = [int(s["num_pts"]) for s in time]
    if len(set(lengths)) > 1:
        warnings.warn(
            f"its records have {min(lengths)} to {max(lengths)} samples; all are cut to {min(lengths)}", stacklevel=2
        )
    shortest = min(lengths)
    data, units = [], []
    for channel in order:
        records = [s for s, c in zip(time, channels, strict=True) if c == channel]
        unit, factor = _unit(records[0])
        data.append(np.stack([factor * np.real(np.asarray(s["data"]))[:shortest] for s in records]))
        units.append(unit)
    rate = fs if fs is not None else 1 / steps[0]
    # written to six digits, a step gives a rate that is nearly whole
    whole = round(rate)
    rate = float(whole) if fs is None and whole and abs(rate / whole - 1) < 1e-5 else float(rate)
    names = tuple(name for name, _ in order)
    return Recording(np.stack(data, axis=-1), rate, names, tuple(units), tuple(range(1, len(order) + 1)))


def holds_records_alone(path: Path) -> bool:
    """Whether a universal file holds time records and no FRFs, by the headers of its functions (58)."""
    try:
        kinds = {entry.header[5][:5].strip() for entry in index_of(path) if len(entry.header) > 5}
    except ValueError:
        return False
    return str(TIME_RESPONSE) in kinds and str(FRF) not in kinds


def _steps(sets: list[Mapping[str, Any]]) -> list[float]:
    """Time from sample to sample [s] of each record, by the label of its time axis; one not known is told."""
    labels = [plain(s.get("abscissa_axis_units_lab", "")) for s in sets]
    unknown = sorted(set(labels) - {*TIMES, "", "none"})
    if unknown:
        warnings.warn(f"its time axis is in {', '.join(unknown)}, which is not known: taken as s", stacklevel=3)
    return [TIMES.get(label, 1.0) * _spacing(s) for label, s in zip(labels, sets, strict=True)]


def _spacing(found: Mapping[str, Any]) -> float:
    if found.get("abscissa_inc"):
        return float(found["abscissa_inc"])
    x = np.asarray(found["x"])
    return float(np.mean(np.diff(x))) if len(x) > 1 else 0.0


def _names(sets: list[Mapping[str, Any]]) -> list[str]:
    """Names by node and direction; by identification lines where node or direction say nothing or repeat wrongly."""
    # some programs write node and direction into the name of the entity as well: 1+Z:1:+Z
    names = [re.sub(r"^(\d+)([+-]\w+):\1:\2$", r"\1:\2", f.output) for f in functions_of(sets)]
    titles = [re.sub(r"\s+", " ", str(s.get("id1", ""))).strip() for s in sets]
    quantities = [_quantity(s) for s in sets]
    told = [
        f"{name} {title}".strip() if name in ("0", "") or _mixed(k, names, titles, quantities) else name
        for k, (name, title) in enumerate(zip(names, titles, strict=True))
    ]
    return [t if t not in ("0", "NONE") else f"channel {k + 1}" for k, t in enumerate(told)]


def _mixed(k: int, names: list[str], titles: list[str], quantities: list[str]) -> bool:
    """Whether records of one quantity at one DoF all differ in their titles, so that they are channels, not repeats."""
    same = [j for j in range(len(names)) if (names[j], quantities[j]) == (names[k], quantities[k])]
    return len({titles[j] for j in same}) == len(same) > 1


def _quantity(found: Mapping[str, Any]) -> str:
    """What a record is of, as its unit in SI: told as :func:`_unit` does, by the type that it states or its label."""
    known, stated = unit_of(str(found.get("ordinate_axis_units_lab", ""))), _stated(found)[0]
    return stated if known is None or stated and found.get("units") is not None else SI[known.kind]


def _stated(found: Mapping[str, Any]) -> tuple[str, str]:
    """Unit in SI of the type that a record states, and which of data set 164 is its; empty if it states none."""
    return _MEASURED.get(int(found.get("ordinate_spec_data_type", 0) or 0), ("", ""))


def _unit(found: Mapping[str, Any]) -> tuple[str, float]:
    """Unit and factor: by data set 164 for the type that the set states, else by its label."""
    label = str(found.get("ordinate_axis_units_lab", "")).strip()
    label = "" if label.upper() == "NONE" else label
    known = unit_of(label) if label else None
    stated = _stated(found)
    units: Units | None = found.get("units")
    if stated[0] and units is not None and not (known is not None and label.lower() == "g"):
        return stated[0], getattr(units, stated[1])
    if known is not None and stated[0] not in ("", SI[known.kind]):
        warnings.warn(f"a record is stated as {stated[0]} and labelled {label!r}; the label counts", stacklevel=2)
    if known is None and stated[0]:
        what = "force" if stated[0] == SI[FORCE] else "response"
        warnings.warn(f"a {what} has no known unit (label {label!r}): taken as {stated[0]}", stacklevel=2)
        return stated[0], 1.0
    return label, 1.0
