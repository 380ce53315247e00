"""Units written as text, converted to Hz, N and m."""

import math
import re

from modalax.files.uff_units import FOOT, INCH, POUND_FORCE, STANDARD_GRAVITY

TURN, MINUTE = 2 * math.pi, 60.0  # rad, s
FREQUENCIES = {
    "hz": 1.0, "hertz": 1.0, "1/s": 1.0, "s-1": 1.0, "khz": 1e3, "rad/s": 1 / TURN, "rad/sec": 1 / TURN,
    "rads-1": 1 / TURN, "rpm": 1 / MINUTE, "cpm": 1 / MINUTE, "1/min": 1 / MINUTE,
    "min-1": 1 / MINUTE,
}  # fmt: skip
TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": MINUTE}
FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": POUND_FORCE, "lb": POUND_FORCE}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "in": INCH, "ft": FOOT}
RATES = {"": "receptance", "/s": "mobility", "s-1": "mobility", "/s2": "accelerance", "s-2": "accelerance"}
WHOLE = {"1/kg": "accelerance", "kg-1": "accelerance", "s/kg": "mobility", "s2/kg": "receptance"}


def frequency_factor(unit: str) -> float:
    """Size of one ``unit`` in Hz; ``ValueError`` lists the known units."""
    return _known(unit, FREQUENCIES, "frequencies", "Hz, kHz, rad/s, rpm")


def force_factor(unit: str) -> float:
    """Size of one ``unit`` in N; ``ValueError`` lists the known units."""
    return _known(unit, FORCES, "forces", "N, kN, lbf")


def _known(unit: str, table: dict[str, float], what: str, shown: str) -> float:
    # A capital M before N is mega, which no test needs and which would read as milli.
    word = "" if str(unit).strip() == "MN" else plain(unit)
    if word not in table:
        raise ValueError(f"the unit of {what} is {unit!r}; known are {shown}")
    return table[word]


def plain(text: str) -> str:
    """A unit in small letters, without brackets, spaces, signs of powers and products."""
    return re.sub(r"[\s()\[\]^*·]", "", str(text).replace("²", "2").replace("−", "-").replace("⁻¹", "-1")).lower()


def response_unit(unit: str) -> tuple[str, float]:
    """Form and factor to SI of the unit of an FRF, such as ``m/N``, ``(mm/s)/N``, ``g/N`` or ``m s-2 N-1``.

    Raises
    ------
    ValueError
        If it is none; the message shows how units are written.
    """
    word = plain(unit)
    if word in WHOLE:
        return WHOLE[word], 1.0
    response, force = re.sub(r"(?<=.)n-1$", "/n", word).rpartition("/")[::2]
    if force in FORCES and "MN" not in str(unit):
        if response in ("g", "gn"):
            return "accelerance", STANDARD_GRAVITY / FORCES[force]
        for length in sorted(LENGTHS, key=len, reverse=True):
            if response.startswith(length) and response[len(length) :] in RATES:
                return RATES[response[len(length) :]], LENGTHS[length] / FORCES[force]
    raise ValueError(f"the unit of the FRFs is {unit!r}; it is written as m/N, (m/s)/N, (m/s^2)/N, mm/N, g/N or g/lbf")
