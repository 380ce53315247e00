"""Causes of one size at several places, told one by one: masses under all sensors, or supports wrong together."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.decision.beyond import Names
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.modes_only import Simulation
from modalax.diagnose.modal_domain.structure.nodes import Nodes, nodes_of


@dataclass(frozen=True)
class Together(Change):
    """One change at each of the places ``where``.

    Attributes
    ----------
    each
        Name and unit of what is told at each place, and how much of it there is for a size of one.
    """

    each: tuple[tuple[str, str, float], ...] = ()

    @property
    def told_as(self) -> Names:
        """Each place by itself."""
        return tuple((self.slug, (where,)) for where in self.where)

    def told_each(self, u: np.ndarray, covariance: np.ndarray) -> list[dict[str, Any]]:
        """The change at each place."""
        std, out = float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale, []
        for where, (name, unit, one) in zip(self.where, self.each, strict=True):
            value = {"value": self.size(u) * one, "std": std * abs(one), "unit": unit}
            out.append({"name": self.slug, "where": [where], "parameters": {name: value}})
        return out


class SensorMasses(Together):
    """As much mass under every sensor: all stay in place while all are measured, and the simulation has none."""

    def said(self) -> str:
        """That it is as if all sensors had mass."""
        return "there is as much mass under every sensor, as that of sensors which the simulation lacks"


def sensor_masses(outputs: Sequence[str], c: Coordinates, usual: float, weight: float) -> list[Change]:
    """The mass of all sensors as one cause, moving with all displacements of their nodes; none of fewer than two.

    Parameters
    ----------
    usual
        Mass of one [kg] that is usual where there is one.
    weight
        Weight among the places of added masses.
    """
    nodes = nodes_of(c.names)
    at = [c.names.index(name) for name in outputs]
    first: dict[int, str] = {}
    for k in at:
        if nodes.axis[k] < 3:
            first.setdefault(int(nodes.of_dofs[k]), c.names[k])
    if len(first) < 2:
        return []
    moved = [int(k) for node in first for k in nodes.members[node] if nodes.axis[k] < 3]
    factor = np.eye(len(c.names))[:, moved]
    pattern = c.everywhere[moved].T @ c.everywhere[moved]
    where = tuple(first.values())
    each = (("mass", "kg", 1.0),) * len(where)
    return [SensorMasses("added_mass", where, usual, pattern=pattern, factor=factor, weight=weight, each=each)]


HOLDING = 0.5  # share of the nodes that supports hold, beyond which they are no supports
FEW = 4  # supports of which any two or more may be wrong together; of more, all, or all but one


class Supports(Together):
    """Supports softer or stiffer by one factor."""

    def said(self) -> str:
        """That they are wrong together."""
        return f"the supports at {', '.join(map(str, self.where))} are off by one and the same factor"


@dataclass(frozen=True)
class _Support:
    """One support: its node, where and as what it is told, and ``F`` of its ``F F'``, shape ``(n, r)``."""

    node: int
    dof: str
    told: tuple[str, str, float]
    factor: np.ndarray


def supports_together(
    simulation: Simulation, c: Coordinates, parts: list[Part], nodes: Nodes, usual: float, all_share: float,
    some_share: float,
) -> list[Change]:  # fmt: skip
    """Supports off by one factor, as causes: all of them, or some.

    Parameters
    ----------
    simulation, c
        Simulation, and its modal coordinates.
    parts, nodes
        Of its stiffness matrix, and the nodes of its DoFs.
    usual
        Relative error of supports that are wrong.
    all_share, some_share
        Share of all together, and of some together, among the places of springs before the data.
    """
    told, n = simulation.elements, len(nodes.axis)
    if told is not None and told.dofs:  # of DoFs that follow others, too
        every = nodes_of(c.names)
        factors = [F for F in np.asarray(told.stiffness) if len(set(every.of_dofs[F.any(axis=1)].tolist())) == 1]
        each = [_support(F, every, c.names) for F in factors]
        seen = c.everywhere
    else:
        each = [s for p in parts if len(p.nodes) == 1 for s in _springs(p, n, nodes, simulation.dofs)]
        factors, seen = [], c.shapes
    nodes_held = [s.node for s in each]
    held = sorted(set(nodes_held))
    if len(each) < 2 or len(held) > HOLDING * len(nodes.members):
        return []
    counts = range(2, len(held)) if len(held) <= FEW else (len(held) - 1,)
    some = [{k} for k in held if nodes_held.count(k) > 1 and len(held) > 1]  # one, in all its directions
    some += [set(which) for count in counts for which in itertools.combinations(held, count)]
    out: list[Change] = []
    for which in (set(held), *some):
        of = [s for s in each if s.node in which]
        F = np.hstack([s.factor for s in of])
        inner = seen.T @ F
        out.append(
            Supports(
                "joint_stiffness", tuple(s.dof for s in of), usual, pattern=inner @ inner.T,
                factor=F if factors else None, weight=all_share if len(which) == len(held) else some_share / len(some),
                each=tuple(s.told for s in of),
            )
        )  # fmt: skip
    return out


def _springs(p: Part, n: int, nodes: Nodes, names: tuple[str, ...]) -> list[_Support]:
    """The springs that a part of one node is; one support if it is more."""
    own = np.diag(p.matrix)
    alone = not (p.matrix - np.diag(own)).any()
    pieces = [np.array([j]) for j in range(len(own))] if alone else [np.arange(len(own))]
    out = []
    for at in pieces:
        value, vectors = np.linalg.eigh(p.matrix[np.ix_(at, at)])
        F = np.zeros((n, len(at)))
        F[p.dofs[at]] = vectors * np.sqrt(np.maximum(value, 0.0))
        out.append(_support(F, nodes, names))
    return out


def _support(F: np.ndarray, nodes: Nodes, names: tuple[str, ...]) -> _Support:
    """A support, told at the displacement that it holds most, or else at a rotation."""
    held, at = (F**2).sum(axis=1), np.flatnonzero(F.any(axis=1))
    straight = at[nodes.axis[at] < 3]
    k = max(straight if len(straight) else at, key=lambda j: held[j])
    told = ("stiffness", "N/m", float(held[k])) if len(at) == 1 else ("relative_change", "-", 1.0)
    return _Support(int(nodes.of_dofs[k]), names[k], told, F)
