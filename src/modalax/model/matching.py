"""Measured points matched to the nodes of a model: by name, by a table, or by place, with directions of any kind."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from modalax.data.dofs import DIRECTIONS, direction_vectors, parse_dof
from modalax.data.geometry import Geometry
from modalax.model.overview import of_matched


@dataclass(frozen=True)
class Matched:
    """Measured DoFs seen in a model.

    Attributes
    ----------
    dofs
        Measured DoF names.
    nodes
        Node of the model that each was matched to.
    distance
        Distance between the two, shape ``(dof,)`` [m]; NaN where a place is not known.
    transform
        Motion at the measured DoFs from that of the model's DoFs, shape ``(dof, model dof)``.
    how
        ``name``, ``table`` or ``place``, for each.
    """

    dofs: tuple[str, ...]
    nodes: tuple[str, ...]
    distance: Float[np.ndarray, " dof"]
    transform: Float[np.ndarray, "dof n"]
    how: tuple[str, ...]

    def __str__(self) -> str:
        """A line a DoF."""
        return of_matched(self)

    def seen(self, shapes: Any) -> np.ndarray:
        """Shapes of the model, ``(mode, model dof)``, at the measured DoFs."""
        return np.asarray(shapes) @ self.transform.T

    def report(self) -> list[str]:
        """A line a DoF: what it was matched to, how, and how far away that is."""
        shown = lambda d: "place not known" if np.isnan(d) else f"{1e3 * d:.3g} mm away"
        return [
            f"{dof} -> {node} by {how}, {shown(d)}"
            for dof, node, how, d in zip(self.dofs, self.nodes, self.how, self.distance, strict=True)
        ]


def match(
    dofs: Sequence[str],
    model_dofs: Sequence[str],
    *,
    places: Geometry | None = None,
    model_places: Geometry | None = None,
    table: Mapping[str, str] | None = None,
    directions: Mapping[str, Any] | None = None,
    farthest: float | None = None,
) -> Matched:
    r"""Match measured DoFs to those of a model.

    A DoF whose name the model has is that one, up to its sign. Else its node is looked up in ``table``, or it is the
    nearest node of the model that has translations. It then moves as that node does along its direction ``e``; where
    places are known and the model has the node's rotations, as a point on a rigid arm ``r``,
    :math:`e \cdot (u + \theta \times r)`.

    Parameters
    ----------
    dofs, model_dofs
        Names, such as ``12:+Z``.
    places, model_places
        Nodes of the test and of the model, in one system of coordinates [m].
    table
        Node of the model by measured node.
    directions
        Unit vectors, in the coordinates of the model, of DoFs whose direction is not that of their name: a hammer that
        goes around, a sensor on an inclined face. By DoF name.
    farthest
        Distance beyond which a node is not taken [m].

    Raises
    ------
    ValueError
        If a DoF cannot be matched; the message says which, and how far away the nearest node is.
    """
    table, directions = dict(table or {}), dict(directions or {})
    at = {name: k for k, name in enumerate(model_dofs)}
    nodes = _nodes_of(model_dofs)
    taken = []
    if not len(dofs):
        raise ValueError("no measured DoFs are given to match")
    for dof in dofs:
        own = parse_dof(dof)
        same = [n for n in (own.name, own._replace(sign=-own.sign).name, dof) if n in at]
        if same and dof not in directions and own.node not in table:
            row = np.zeros(len(model_dofs))
            row[at[same[0]]] = own.sign * parse_dof(same[0]).sign
            taken.append((own.node, 0.0, row, "name"))
            continue
        node, way = _node_of(own.node, nodes, places, model_places, table)
        arm = _arm(own.node, node, places, model_places)
        apart = float("nan") if arm is None else float(np.linalg.norm(arm))
        if farthest is not None and apart > farthest:
            raise ValueError(
                f"{dof}: the nearest node {node} is {apart:.3g} m away, farther than {farthest:g} m; check the units "
                "and axes of the measured points, or name the node in a table"
            )
        e = np.asarray(directions[dof], float) if dof in directions else direction_vectors([dof])[0]
        row = _row(dof, nodes[node], e, np.zeros(3) if arm is None else arm, len(model_dofs))
        taken.append((node, apart, row, way))
    found, distance, rows, how = zip(*taken, strict=True)
    return Matched(tuple(dofs), found, np.array(distance), np.array(rows), how)


def _nodes_of(model_dofs: Sequence[str]) -> dict[str, dict[str, tuple[int, int]]]:
    """Position and sign of each direction, by node."""
    nodes: dict[str, dict[str, tuple[int, int]]] = {}
    for k, name in enumerate(model_dofs):
        dof = parse_dof(name)
        if dof.direction is not None:
            nodes.setdefault(dof.node, {})[dof.direction] = k, dof.sign
    return nodes


def _node_of(
    node: str, nodes: Mapping[str, Mapping[str, Any]], places: Geometry | None, model_places: Geometry | None,
    table: Mapping[str, str],
) -> tuple[str, str]:  # fmt: skip
    if node in table:
        if table[node] not in nodes:
            raise ValueError(f"the table matches {node} to {table[node]}, which the model has no directions of")
        return table[node], "table"
    if places is None or model_places is None or node not in places.nodes:
        raise ValueError(
            f"node {node} is neither in the model nor in a table; give the places of the measured points and of the "
            "model's nodes, or a table of nodes"
        )
    some = [n for n in model_places.nodes if n in nodes and set("XYZ") & set(nodes[n])]
    if not some:
        raise ValueError("none of the model's nodes has both a place and a translation")
    where = np.asarray(model_places.xyz)[[model_places.nodes.index(n) for n in some]]
    apart = np.linalg.norm(where - np.asarray(places.xyz)[places.nodes.index(node)], axis=1)
    return some[int(np.argmin(apart))], "place"


def _arm(node: str, other: str, places: Geometry | None, model_places: Geometry | None) -> np.ndarray | None:
    """From a node of the model to the measured point."""
    if places is None or model_places is None or node not in places.nodes or other not in model_places.nodes:
        return None
    return (
        np.asarray(places.xyz)[places.nodes.index(node)] - np.asarray(model_places.xyz)[model_places.nodes.index(other)]
    )


def _row(dof: str, node: Mapping[str, tuple[int, int]], e: np.ndarray, arm: np.ndarray, size: int) -> np.ndarray:
    if e.shape != (3,) or not np.isfinite(e).all() or abs(np.linalg.norm(e) - 1) > 1e-3:
        raise ValueError(f"the direction of {dof} is {e.tolist()}; a unit vector of three components is needed")
    # e . (theta x r) = theta . (r x e)
    wanted = dict(zip(DIRECTIONS, (*e, *np.cross(arm, e)), strict=True))
    lacking = [way for way in "XYZ" if abs(wanted[way]) > 1e-6 and way not in node]
    if lacking:
        raise ValueError(f"{dof} moves along {', '.join(lacking)}, which its node does not have in the model")
    row = np.zeros(size)
    for way, part in wanted.items():
        if way in node:
            row[node[way][0]] = node[way][1] * part
    return row
