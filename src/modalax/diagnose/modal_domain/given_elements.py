"""Elements that a finite-element model tells, as patterns of change and as causes."""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.model import Structure


def stiffness_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """Change of each element's stiffness by the whole, in modal coordinates ``(e, n, n)``; None if none are told."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.stiffness), c)


def mass_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """The same of each lump of mass."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.mass), c)


def _patterns(factors: np.ndarray, c: Coordinates) -> np.ndarray:
    inner = np.einsum("enr,nk->erk", factors, c.shapes, optimize=True)
    return np.matmul(inner.transpose(0, 2, 1), inner)


def softened_elements(simulation: Structure, c: Coordinates, usual: float) -> list[Change]:
    """Whole elements softer or stiffer; ``usual`` is the relative error of one that is wrong.

    The strength is the change of the stiffness between the two DoFs that the element is told at.
    """
    if simulation.elements is None:
        return []
    factors = np.asarray(simulation.elements.stiffness)
    out = []
    for place, F, pattern in zip(simulation.elements.places, factors, _patterns(factors, c), strict=True):
        at = [simulation.dofs.index(name) for name in place if name in simulation.dofs]
        stiffness = float(abs(F[at[0]] @ F[at[-1]])) if at else 0.0
        where = place if place[0] != place[1] else place[:1]
        out.append(Change("joint_stiffness", where, usual, pattern=pattern, reference=stiffness))
    return out
