"""Where the degrees of freedom of a structure are: nodes, lines between them, directions."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.checks import as_double, require_finite
from modalax.data.dofs import direction_vectors, parse_dof
from modalax.data.frf import check_names
from modalax.data.overview import of_geometry


class Geometry(eqx.Module):
    """Nodes of a structure and the lines drawn between them.

    Attributes
    ----------
    xyz
        Position of each node, shape ``(node, 3)`` [m].
    nodes
        Names of the nodes, as they stand in DoF names before the colon.
    lines
        Polylines, each a tuple of node names.
    """

    xyz: Float[Array, "node 3"]
    nodes: tuple[str, ...] = eqx.field(static=True)
    lines: tuple[tuple[str, ...], ...] = eqx.field(static=True)

    def __init__(self, nodes: Sequence[str], xyz: Any, lines: Sequence[Sequence[str]] = ()):
        self.xyz = as_double(xyz, "xyz")
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3:
            raise ValueError(f"xyz has shape {self.xyz.shape}; it needs (node, 3)")
        require_finite(self.xyz, "xyz")
        self.nodes = check_names(nodes, self.xyz.shape[0], "nodes")
        self.lines = tuple(tuple(str(n) for n in line) for line in lines)
        known = set(self.nodes)
        unknown = sorted({n for line in self.lines for n in line} - known)
        if unknown:
            raise ValueError(f"lines go to nodes {', '.join(unknown[:6])}, which have no position")

    def __str__(self) -> str:
        """Number of nodes and lines, and the extent."""
        return of_geometry(self)

    @property
    def segments(self) -> Int[np.ndarray, "segment 2"]:
        """Node indices at both ends of each straight piece of the lines, shape ``(segment, 2)``."""
        at = {name: k for k, name in enumerate(self.nodes)}
        pairs = [(at[a], at[b]) for line in self.lines for a, b in zip(line[:-1], line[1:], strict=True)]
        return np.array(pairs, dtype=int).reshape(-1, 2)

    def index(self, dof: str) -> int:
        """Position in ``nodes`` of the node of a DoF.

        Raises
        ------
        ValueError
            If the node has no position.
        """
        return _indices(self.nodes, [dof])[0]

    def places(self, dofs: Sequence[str]) -> Float[np.ndarray, "dof 3"]:
        """Position of each DoF, shape ``(dof, 3)`` [m]; ``ValueError`` where a node has none."""
        return np.asarray(self.xyz)[_indices(self.nodes, dofs)].reshape(-1, 3)

    def displacements(
        self, dofs: Sequence[str], values: Any
    ) -> tuple[Float[np.ndarray, "node 3"] | Complex[np.ndarray, "node 3"], np.ndarray]:
        """Translation vector of every node from the values at some DoFs, for example a mode shape.

        Parameters
        ----------
        dofs
            DoF names; rotations and names without direction move nothing.
        values
            Value at each DoF, shape ``(dof,)``.

        Returns
        -------
        tuple
            The vectors, shape ``(node, 3)``, zero where nothing is known, and which components are known, a mask of
            the same shape. Where a direction of a node was measured several times, the mean stands.

        Raises
        ------
        ValueError
            If a node has no position, or the numbers of names and values differ.
        """
        values = np.asarray(values)
        if values.shape != (len(dofs),):
            raise ValueError(f"values has shape {values.shape} for {len(dofs)} DoFs; it needs one value for each DoF")
        where = _indices(self.nodes, dofs)
        # A rotation shares its axis with a translation, but moves the node itself nowhere.
        still = [(parse_dof(d).direction or "R").startswith("R") for d in dofs]
        vectors = np.where(np.array(still)[:, None], 0.0, direction_vectors(dofs))
        total = np.zeros((len(self.nodes), 3), dtype=values.dtype if np.iscomplexobj(values) else float)
        count = np.zeros((len(self.nodes), 3))
        np.add.at(total, where, vectors * values[:, None])
        np.add.at(count, where, np.abs(vectors))
        return total / np.maximum(count, 1), count > 0


def _indices(nodes: tuple[str, ...], dofs: Sequence[str]) -> list[int]:
    """Position in ``nodes`` of the node of each DoF; of hundreds in one pass."""
    at = {name: k for k, name in reversed(list(enumerate(nodes)))}
    found = []
    for dof in dofs:
        node = parse_dof(dof).node
        if node not in at:
            raise ValueError(f"DoF {dof!r}: node {node!r} has no position; there are {', '.join(nodes[:8])}, ...")
        found.append(at[node])
    return found
