"""What the label of a channel says: its quantity and its unit."""

import re
from typing import NamedTuple

FORCE, RECEPTANCE, MOBILITY, ACCELERANCE = "force", "receptance", "mobility", "accelerance"
SI = {FORCE: "N", RECEPTANCE: "m", MOBILITY: "m/s", ACCELERANCE: "m/s^2"}
KNOWN = "m, mm, m/s, mm/s, m/s^2, g, mg"  # units of responses, as messages show them
GRAVITY, POUND, INCH = 9.80665, 4.4482216152605, 0.0254  # m/s^2, N, m
_LENGTHS = {
    "m": 1.0, "km": 1e3, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": INCH, "inch": INCH,
    "mil": 1e-3 * INCH, "ft": 12 * INCH,
}  # fmt: skip
_FORCES = {
    "N": 1.0, "daN": 10.0, "kN": 1e3, "MN": 1e6, "mN": 1e-3, "uN": 1e-6, "lbf": POUND, "lb": POUND, "klbf": 1e3 * POUND,
    "kgf": GRAVITY, "kp": GRAVITY, "gf": 1e-3 * GRAVITY,
}  # fmt: skip
_GRAVITIES = {"g": GRAVITY, "gn": GRAVITY, "mg": 1e-3 * GRAVITY, "ug": 1e-6 * GRAVITY}
_PER_TIME = (
    (ACCELERANCE, r"/s2|/s/s|s-2|/sec2|/sec/sec"), (MOBILITY, r"/s|s-1|/sec"), (RECEPTANCE, ""),
)  # fmt: skip
# In these the case of the letters tells milli from mega, and nano from the newton metre.
_CASE_COUNTS = {"mn", "mg", "nm"}
_SIGNS = str.maketrans({"²": "2", "¹": "1", "⁻": "-", "−": "-", "µ": "u", "μ": "u"})
_BY_NAME = (
    (FORCE, r"force|hammer|load ?cell"), (ACCELERANCE, r"acc(el(eration|erometer)?)?"), (MOBILITY, r"vel(ocity)?"),
    (RECEPTANCE, r"disp(lacement)?"),
)  # fmt: skip


class Unit(NamedTuple):
    """The quantity of a unit (force, or the form of an FRF with such a response), and the factor to SI units."""

    kind: str
    factor: float


def unit_of(label: str) -> Unit | None:
    """The unit that a label means, such as ``N``, ``lbf``, ``g``, ``mm/s``, ``m/s2``; None if it is none of these.

    The case of the letters counts only where it decides: ``mN`` is a thousandth of a newton, ``MN`` a million.
    """
    text = re.sub(r"[\s()\[\]*^·]", "", label.translate(_SIGNS))
    if text in _FORCES:
        return Unit(FORCE, _FORCES[text])
    for kind, per_time in _PER_TIME:
        found = re.fullmatch(rf"(\w+?)({per_time})", text, re.IGNORECASE)
        factor = _factor(found[1], _LENGTHS) if found else None
        if factor is not None:
            return Unit(kind, factor)
    for kind, table in ((FORCE, _FORCES), (ACCELERANCE, _GRAVITIES)):
        factor = _factor(text, table)
        if factor is not None:
            return Unit(kind, factor)
    return None


def _factor(text: str, table: dict[str, float]) -> float | None:
    """The entry of a table for a unit, in other letters too where the case does not decide."""
    if text in table or text.lower() in _CASE_COUNTS:
        return table.get(text)
    return next((factor for name, factor in table.items() if name.lower() == text.lower()), None)


def kind_by_name(name: str) -> str | None:
    """The quantity that the name of a channel tells, such as ``force`` of ``hammer 1``; None if it tells none."""
    text = name.lower().replace("_", " ")
    return next((kind for kind, words in _BY_NAME if re.search(rf"\b({words})(\b|\d)", text)), None)
