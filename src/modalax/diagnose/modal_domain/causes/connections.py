r"""Connections that give way: ends of beams that turn against their node, where the simulation has them rigid.

With :math:`P` an element's stiffness and a spring :math:`k` in place of the rigid connection at DoF d, the end of the
element is condensed out (Monforton and Wu 1963):

.. math:: P - \kappa\,\frac{P e_d\, e_d^T P}{P_{dd}}, \qquad \kappa = \frac{P_{dd}}{P_{dd} + k}

The share :math:`\kappa` of the stiffness is lost, 0 where the connection is rigid and 1 in a hinge. An end that is
clamped is in no matrix; a beam that is alike at both ends has it as far from the middle as its node, and the middle is
where forces do not turn it nor moments move it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.nodes import Nodes, rigid_moves

NEGLIGIBLE = 1e-6  # force, relative to the largest, below which an end holds a DoF by none
TURNS = 3  # axes from here on are rotations


@dataclass(frozen=True)
class FlexibleEnd(Change):
    """A connection of an element to a node, or of a clamped element to ground, that gives way to rotation.

    Its size is the share of the stiffness that is lost, and its scale negative: it can only soften.

    Attributes
    ----------
    own
        Stiffness of the element against rotation of this end, all else held [N m/rad].
    """

    own: float = 1.0

    @property
    def signed(self) -> bool:
        """What is rigid can only give way."""
        return False

    def said(self) -> str:
        """That an end is not rigid, and which."""
        if len(self.where) == 1:
            return f"the element at {self.where[0]} turns against its clamp, which the simulation has as rigid"
        a, b = self.where
        return f"the element from {a} to {b} turns against its node at {a}, where the simulation has it as rigid"

    def variance_beside(self, u: np.ndarray, off: Mapping[str, float]) -> np.ndarray | float:
        r"""An element stiffer by a share :math:`\delta` loses more stiffness, by :math:`\kappa(2-\kappa)\delta`."""
        lost = -self.size(u)
        return np.array([[(lost * (2 - lost) * off["stiffness"] / self.scale) ** 2]])

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Stiffness of the connection."""
        lost = max(-self.size(u), 1e-300)
        std = float(np.sqrt(max(covariance[0, 0], 0.0))) * abs(self.scale)
        value, error = self.own * max(1 / lost - 1, 0.0), self.own * std / lost**2
        return {"rotational_stiffness": {"value": value, "std": error, "unit": "N m/rad"}}


def flexible_ends(parts: list[Part], nodes: Nodes, dofs: tuple[str, ...], c: Coordinates, usual: float) -> list[Change]:
    """Every rotation of an element's end that bends it, told at the rotations of both ends, or at that of the free one.

    Parameters
    ----------
    parts
        Elements over ``dofs``, whose nodes are ``nodes``; those of one or two nodes have ends.
    c
        The simulation in modal coordinates.
    usual
        Share of the stiffness that is lost where something is wrong.
    """
    out, at = [], [c.names.index(name) for name in dofs]
    for part in (p for p in parts if 1 <= len(p.nodes) <= 2):
        for where, v, own in _of_pair(part, nodes) if len(part.nodes) == 2 else _of_root(part, nodes):
            if (np.abs(v) > NEGLIGIBLE * np.abs(v).max()).sum() < 2 + (len(part.nodes) == 2):
                continue  # a spring, as in torsion, is a candidate by itself
            if np.abs(np.outer(v, v) / own - part.matrix).max() < NEGLIGIBLE * np.abs(part.matrix).max():
                continue  # so is an element that is strained in one way only, as a spring at a lever
            factor = np.zeros((len(c.names), 1))
            factor[np.array(at)[part.dofs], 0] = v / np.sqrt(own)
            b = c.everywhere.T @ factor[:, 0]
            out.append(
                FlexibleEnd(
                    "joint_stiffness", tuple(dofs[k] for k in where), -usual, pattern=np.outer(b, b), factor=factor,
                    piece=True, own=own,
                )
            )  # fmt: skip
    return out


def _of_pair(part: Part, nodes: Nodes) -> list[tuple[tuple[int, ...], np.ndarray, float]]:
    """DoFs told, direction over the part's DoFs and own stiffness of each rotation of an element between two nodes."""
    axis, out = nodes.axis[part.dofs], []
    first = np.isin(part.dofs, nodes.members[part.nodes[0]])
    for k in np.flatnonzero(axis >= TURNS):
        other = np.flatnonzero((axis == axis[k]) & (first != first[k]))
        where = (part.dofs[k], *part.dofs[other[:1]])
        out.append((tuple(int(d) for d in where), part.matrix[:, k], float(part.matrix[k, k])))
    return out


def _of_root(part: Part, nodes: Nodes) -> list[tuple[tuple[int, ...], np.ndarray, float]]:
    """The same of the clamped end of an element; nothing where a matrix is that of no beam clamped at a distance."""
    axis, sign, P = nodes.axis[part.dofs], nodes.sign[part.dofs], part.matrix
    turn = axis >= TURNS
    if (axis < 0).any() or turn.all() or not turn.any():
        return []
    moves = rigid_moves(axis, axis)
    straight = np.ix_(~turn, turn)
    P = P * sign[:, None] * sign
    couplings = np.stack([(P[np.ix_(~turn, ~turn)] @ move[straight]).ravel() for move in moves[1:]], axis=1)
    coupling = P[straight].ravel()
    to_node = np.linalg.lstsq(couplings, -coupling, rcond=1e-9)[0]  # from the middle
    if np.linalg.norm(couplings @ to_node + coupling) > NEGLIGIBLE * np.linalg.norm(coupling) or not to_node.any():
        return []
    T = moves[0] + np.tensordot(2 * to_node, moves[1:], 1)  # rigid motion of the node by that of the root
    v, own = sign[:, None] * (P @ T), np.diag(T.T @ P @ T)
    return [((int(part.dofs[k]),), v[:, k], float(own[k])) for k in np.flatnonzero(turn) if own[k] > 0]
