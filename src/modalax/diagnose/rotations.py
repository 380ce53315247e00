"""Units of what is told at rotations: moments over angles in the place of forces over displacements."""

from typing import Any

from modalax.data.dofs import parse_dof

UNITS = {
    "kg": "kg m^2", "m": "rad", "N": "N m", "N/m": "N m/rad", "N/m^3": "N m/rad^3", "N s/m": "N m s/rad",
    "N s^2/m^2": "N m s^2/rad^2", "N s^a/m": "N m s^a/rad",
}  # fmt: skip


def turns(name: str) -> bool:
    """Whether a degree of freedom is a rotation, by its name."""
    direction = parse_dof(name).direction
    return direction is not None and direction.startswith("R")


def in_own_units(causes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Causes as told, in the units of a rotation where all their places are rotations: 1 N m/rad, not 1 N/m."""
    out = []
    for cause in causes:
        where = cause["where"]
        if where and all(isinstance(name, str) and turns(name) for name in where):
            told = {
                name: {**p, "unit": UNITS.get(p["unit"], p["unit"])} for name, p in cause["parameters"].items()
            }  # fmt: skip
            cause = {**cause, "parameters": told}
        out.append(cause)
    return out
