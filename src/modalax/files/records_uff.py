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
from modalax.files.uff_units import Units

_MEASURED = {8: ("m", "length"), 11: ("m/s", "length"), 12: ("m/s^2", "length"), 13: ("N", "force"), 9: ("N", "force")}
TIME_RESPONSE = 1


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
    steps = [_step(s) for s in time]
    if fs is None and (min(steps) <= 0 or not np.allclose(steps, steps[0], rtol=1e-4)):
        raise ValueError(f"its records have steps of {min(steps):g} to {max(steps):g} s; one rate is needed (fs)")
    names = _names(time)
    segments = max(names.count(name) for name in set(names))
    order = list(dict.fromkeys(names))
    if any(names.count(name) != segments for name in order):
        uneven = ", ".join(f"{name} {names.count(name)}" for name in order)
        raise ValueError(f"its channels stand unequally often ({uneven}); each needs as many records as the others")
    lengths = [int(s["num_pts"]) for s in time]
    if len(set(lengths)) > 1:
        warnings.warn(
            f"its records have {min(lengths)} to {max(lengths)} samples; all are cut to {min(lengths)}", stacklevel=2
        )
    shortest = min(lengths)
    groups = {name: [s for s, n in zip(time, names, strict=True) if n == name] for name in order}
    data, units = [], []
    for name in order:
        unit, factor = _unit(groups[name][0])
        data.append(np.stack([factor * np.real(np.asarray(s["data"]))[:shortest] for s in groups[name]]))
        units.append(unit)
    rate = fs if fs is not None else 1 / steps[0]
    # written to six digits, a step gives a rate that is nearly whole
    whole = round(rate)
    rate = float(whole) if fs is None and whole and abs(rate / whole - 1) < 1e-5 else float(rate)
    return Recording(np.stack(data, axis=-1), rate, tuple(order), tuple(units), tuple(range(1, len(order) + 1)))


def _step(found: Mapping[str, Any]) -> float:
    if found.get("abscissa_inc"):
        return float(found["abscissa_inc"])
    x = np.asarray(found["x"])
    return float(np.mean(np.diff(x))) if len(x) > 1 else 0.0


def _names(sets: list[Mapping[str, Any]]) -> list[str]:
    """Names by node and direction; by identification lines where node or direction say nothing or repeat wrongly."""
    # some programs write node and direction into the name of the entity as well: 1+Z:1:+Z
    names = [re.sub(r"^(\d+)([+-]\w+):\1:\2$", r"\1:\2", f.output) for f in functions_of(sets)]
    titles = [re.sub(r"\s+", " ", str(s.get("id1", ""))).strip() for s in sets]
    kinds = [s.get("ordinate_spec_data_type") for s in sets]
    told = [
        f"{name} {title}".strip() if name in ("0", "") or _mixed(k, names, titles, kinds) else name
        for k, (name, title) in enumerate(zip(names, titles, strict=True))
    ]
    return [t if t not in ("0", "NONE") else f"channel {k + 1}" for k, t in enumerate(told)]


def _mixed(k: int, names: list[str], titles: list[str], kinds: list[Any]) -> bool:
    """Whether records at the same DoF differ in quantity or name, so that they are channels and not repeats."""
    same = [j for j, name in enumerate(names) if name == names[k]]
    return len({(titles[j], kinds[j]) for j in same}) == len(same) > 1


def _unit(found: Mapping[str, Any]) -> tuple[str, float]:
    """Unit and factor: by data set 164 for the type that the set states, else by its label."""
    label = str(found.get("ordinate_axis_units_lab", "")).strip()
    label = "" if label.upper() == "NONE" else label
    known = unit_of(label) if label else None
    stated = _MEASURED.get(int(found.get("ordinate_spec_data_type", 0) or 0))
    units: Units | None = found.get("units")
    if stated is not None and units is not None and not (known is not None and label.lower() == "g"):
        return stated[0], getattr(units, stated[1])
    if known is not None and stated is not None and (SI[known.kind] != stated[0]):
        warnings.warn(f"a record is stated as {stated[0]} and labelled {label!r}; the label counts", stacklevel=2)
    if known is None and stated is not None:
        what = "force" if stated[0] == SI[FORCE] else "response"
        warnings.warn(f"a {what} has no known unit (label {label!r}): taken as {stated[0]}", stacklevel=2)
        return stated[0], 1.0
    return label, 1.0
