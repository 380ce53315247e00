"""Units of what is told at rotations: moments over angles in the place of forces over displacements."""

from collections.abc import Collection
from typing import Any

import numpy as np

from modalax.data.dofs import parse_dof
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.turns import nodes_in
from modalax.model import Structure

UNITS = {
    "kg": "kg m^2", "m": "rad", "N": "N m", "N/m": "N m/rad", "N/m^3": "N m/rad^3", "N s/m": "N m s/rad",
    "N s^2/m^2": "N m s^2/rad^2", "N s^a/m": "N m s^a/rad",
}  # fmt: skip


def turns(name: str) -> bool:
    """Whether a degree of freedom is a rotation, by its name."""
    direction = parse_dof(name).direction
    return direction is not None and direction.startswith("R")


def rotations_in(simulation: object) -> frozenset[str]:
    """Degrees of freedom of a structure that are rotations though their names do not tell, by its stiffness."""
    if not isinstance(simulation, Structure):
        return frozenset()
    axis = nodes_of(simulation.dofs).axis
    if (axis < 0).any():  # else the stiffness tells at most about which axis a rotation is
        axis = nodes_in(simulation.dofs, np.asarray(simulation.K)).axis
    return frozenset(name for name, one in zip(simulation.dofs, axis.tolist(), strict=True) if one > 2)


def in_own_units(causes: list[dict[str, Any]], rotations: Collection[str] = ()) -> list[dict[str, Any]]:
    """Causes as told, in the units of a rotation where all their places are rotations: 1 N m/rad, not 1 N/m.

    Parameters
    ----------
    rotations
        Places that are rotations though their names do not tell.
    """
    out = []
    for cause in causes:
        where = cause["where"]
        if where and all(isinstance(name, str) and (name in rotations or turns(name)) for name in where):
            told = {
                name: {**p, "unit": UNITS.get(p["unit"], p["unit"])} for name, p in cause["parameters"].items()
            }  # fmt: skip
            cause = {**cause, "parameters": told}
        out.append(cause)
    return out
