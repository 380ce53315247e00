"""Elements that a finite-element model tells, as patterns of change and as causes."""

from collections.abc import Iterable

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.model import Structure
from modalax.model.condense import follow


def stiffness_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """Change of each element's stiffness by the whole, in modal coordinates ``(e, n, n)``; None if none are told."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.stiffness), c)


def mass_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """The same of each lump of mass."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.mass), c)


def _patterns(factors: np.ndarray, c: Coordinates) -> np.ndarray:
    inner = np.einsum("enr,nk->erk", factors, c.everywhere, optimize=True)
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
        at = [c.names.index(name) for name in place if name in c.names]
        stiffness = float(abs(F[at[0]] @ F[at[-1]])) if at else 0.0
        where = place if place[0] != place[1] else place[:1]
        out.append(Change("joint_stiffness", where, usual, pattern=pattern, factor=F, reference=stiffness))
    return out


def changed_by_elements(
    simulation: Structure, sizes: dict[str, np.ndarray], causes: Iterable[tuple[Change, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of stiffness and mass ``(n, n)`` by relative sizes of all elements and by causes that have a factor.

    DoFs that follow the others statically follow them by other ratios than before.
    """
    told = simulation.elements
    assert told is not None
    kept = np.isin(told.dofs, simulation.dofs)
    order = np.argsort([simulation.dofs.index(str(name)) for name in np.array(told.dofs)[kept]])
    factors = {"stiffness": np.asarray(told.stiffness), "mass": np.asarray(told.mass)}
    before = {name: np.einsum("enr,emr->nm", F, F, optimize=True) for name, F in factors.items()}
    after = {
        name: whole + np.einsum("e,enr,emr->nm", sizes[name], factors[name], factors[name], optimize=True)
        for name, whole in before.items()
    }
    for cause, u in causes:
        assert cause.factor is not None
        after["mass" if cause.kind == "M" else "stiffness"] += cause.scale * u * cause.factor @ cause.factor.T
    out = {name: np.zeros_like(np.asarray(simulation.K)) for name in before}
    for sign, matrices in ((1.0, after), (-1.0, before)):
        T = follow(matrices["stiffness"], kept)
        for name, whole in matrices.items():
            out[name] += sign * (T.T @ whole @ T)[np.ix_(order, order)]
    return out["stiffness"], out["mass"]
