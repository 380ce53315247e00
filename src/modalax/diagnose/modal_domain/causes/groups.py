"""Groups of elements that share a wrong parameter, as causes in the modal domain."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.causes.groups import ElementGroup, ElementGroupMass
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.modes_only import Simulation
from modalax.model.elements import factor_of

SAME = 1 - 1e-9  # cosine between the changes of two causes from which they are one
USUAL = 0.3  # usual relative error of a parameter that is wrong


@dataclass(frozen=True)
class GroupFactor(Change):
    """A parameter of a group, wrong by a factor: the simulation's value times it is right.

    Attributes
    ----------
    chance
        Of all groups together, relative to other kinds.
    """

    chance: float = 1.0

    @property
    def rarity(self) -> float:
        """Chance of its kind before the data, relative to other kinds."""
        return self.chance

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The factor."""
        cause = ElementGroup() if self.kind == "K" else ElementGroupMass()
        std = float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale
        return {cause.parameters[0].name: {"value": 1 + self.size(u), "std": std, "unit": "-"}}


def group_factors(simulation: Simulation, c: Coordinates, chance: float = 1.0) -> list[Change]:
    """Stiffness and mass of each group that the simulation names, each with a chance of its own before the data.

    A group is about as likely to be wrong as an element by itself.
    """
    if simulation.groups is None:
        return []
    g, reduced = simulation.groups, simulation.elements is not None and bool(simulation.elements.dofs)
    found: list[Change] = []
    for slug, every in ((ElementGroup.slug, g.stiffness), (ElementGroupMass.slug, g.mass)):
        for name, own in zip(g.names, np.asarray(every), strict=True):
            if not own.any():
                continue
            A = own if len(own) == len(c.names) else _among(own, simulation.dofs, c.names)
            pattern = c.everywhere.T @ A @ c.everywhere
            factor = _factor(A) if reduced else None
            pattern = (pattern + pattern.T) / 2
            whole = min(chance * len(g.names), 1.0)
            found.append(GroupFactor(slug, (name,), USUAL, pattern=pattern, factor=factor, chance=whole))
    return found


def other_than(groups: list[Change], causes: list[Change]) -> list[Change]:
    """The causes that do more or less than a group: an element that is a group by itself is told by its name alone."""
    for group in groups:
        assert group.pattern is not None
        A = group.pattern / np.linalg.norm(group.pattern)
        causes = [c for c in causes if c.kind != group.kind or _likeness(A, c) < SAME]
    return causes


def _likeness(A: np.ndarray, cause: Change) -> float:
    """Cosine of the angle between a matrix of unit size and the change that a cause makes."""
    if cause.pattern is not None:
        return float(abs(np.sum(A * cause.pattern)) / max(np.linalg.norm(cause.pattern), 1e-300))
    b = cause.direction
    return 0.0 if b is None else float(abs(b @ A @ b) / max(b @ b, 1e-300))


def _factor(A: np.ndarray) -> np.ndarray:
    """F with ``F F'`` a matrix that is not negative and zero at most DoFs."""
    at = np.flatnonzero(A.any(axis=0))
    out = np.zeros((len(A), len(at)))
    out[at] = factor_of(A[np.ix_(at, at)], len(at))
    return out


def _among(A: np.ndarray, dofs: tuple[str, ...], names: tuple[str, ...]) -> np.ndarray:
    """A matrix over some DoFs, over all of ``names``."""
    at = [names.index(name) for name in dofs]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(at, at)] = A
    return out
