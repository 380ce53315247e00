"""What a gain may come from: a unit that was taken for another, or a sensor that points the other way."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

# Units that are taken for each other, and how many of the second are one of the first
TAKEN = (
    ("g and m/s^2", 9.80665), ("lbf and N", 4.4482216152605), ("m and mm, or kN and N", 1000.0), ("inch and mm", 25.4),
    ("m and inch", 1 / 0.0254), ("m and foot", 1 / 0.3048), ("kgf and lbf", 2.20462262), ("Hz and rad/s", 2 * math.pi),
    ("amplitude and rms", math.sqrt(2)), ("amplitude and peak to peak", 2.0),
)  # fmt: skip
NEAR = 0.02  # relative: a calibration is as good as that
NOTHING = 4.0  # standard deviations within which a factor is none
LARGE = 0.25  # relative error from which on a gain is hardly one of calibration


def gains_said(causes: Iterable[Mapping[str, Any]]) -> list[str]:
    """One sentence for each large gain among causes as told in an answer: its factor, and what may have made it."""
    out = []
    for cause in causes:
        if cause["name"] not in ("channel_gain", "force_gain"):
            continue
        gain = cause["parameters"]["gain"]
        factor, std = 1 + float(gain["value"]), float(gain["std"] or 0.0)
        if abs(factor - 1) < LARGE:
            continue
        what = f"measured FRFs of {cause['where'][0]}" if cause["where"] else "all measured FRFs"
        if abs(factor) < NOTHING * std:
            out.append(f"{what} hold nothing of what was expected: a dead sensor, or a cable that is off?")
            continue
        turned = "turned in sign and " if factor < 0 else ""
        out.append(f"{what} are {turned}{abs(factor):.4g} times what was expected{_source(factor)}")
    return out


def _source(factor: float) -> str:
    """What a factor may come from."""
    size = abs(math.log(max(abs(factor), 1e-300)))
    if size < NEAR:
        return ": a sensor, or the force, points the other way" if factor < 0 else ""
    near = [(abs(size - math.log(ratio)), name) for name, ratio in TAKEN]
    miss, name = min(near)
    return f": was one unit taken for another ({name})?" if miss < NEAR else ""
