r"""Elements of a finite-element model, read off its stiffness and the places of its nodes.

The block :math:`K_{ab}` between two nodes is that of the elements between them. Elements do not resist a rigid motion,
:math:`K^e_{aa}R_a + K_{ab}R_b = 0` with :math:`R_a, R_b` the rigid motions at the two nodes, so that
:math:`K^e_{aa} = -K_{ab}R_bR_a^+`. What remains of a node's own block is its support. Beams, rods, springs and rigid
arms between two nodes come out exactly, and their sum is free of the rounding that a file's digits put on rigid
motions; plates and solids, whose nodes act on each other three and more at a time, do not part in this way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from modalax._numerics.checks import as_double

COUPLED = 1e-9  # size of an entry of K, scaled to a diagonal of one, from which two nodes are coupled
EXACT = 1e-6  # relative error up to which a part is symmetric, not negative and free of force in rigid motions
MOST_VALUES = 20_000_000  # numbers that the factors of all elements may hold


@dataclass(frozen=True)
class Element:
    """Stiffness between two nodes, or the support of one: ``matrix`` over the DoFs ``dofs``."""

    nodes: tuple[int, ...]
    dofs: Int[np.ndarray, " d"]
    matrix: Float[np.ndarray, "d d"]


def elements_of(
    K: Float[np.ndarray, "n n"], node: Int[np.ndarray, " n"], rigid: Float[np.ndarray, "n 6"]
) -> list[Element] | None:
    """Elements that sum to K; None where it does not part into elements of two nodes and supports of one.

    Parameters
    ----------
    node
        Which node each DoF belongs to.
    rigid
        The six rigid-body motions, see :func:`modalax.model.condense.rigid_motions`.
    """
    members = {int(p): np.flatnonzero(node == p) for p in dict.fromkeys(node.tolist())}
    size = np.sqrt(np.maximum(np.diag(K), 0.0))
    size = np.where(size > 0, size, 1.0)
    scaled = np.abs(K) / np.outer(size, size) > COUPLED
    rest, found = np.array(K, float), []
    for a, b in _coupled(scaled, node):
        ends = members[a], members[b]
        block = K[np.ix_(*ends)]
        own = [-c @ rigid[y] @ np.linalg.pinv(rigid[x]) for c, x, y in ((block, *ends), (block.T, *ends[::-1]))]
        matrix = np.block([[own[0], block], [block.T, own[1]]])
        dofs = np.concatenate(ends)
        if not _sound(matrix / np.outer(size[dofs], size[dofs]), rigid[dofs] * size[dofs, None]):
            return None
        matrix = (matrix + matrix.T) / 2
        rest[np.ix_(dofs, dofs)] -= matrix
        found.append(Element((a, b), dofs, matrix))
    for a, dofs in members.items():
        matrix = rest[np.ix_(dofs, dofs)]
        scale = matrix / np.outer(size[dofs], size[dofs])
        if np.abs(scale).max() < EXACT:
            continue
        if np.linalg.eigvalsh((scale + scale.T) / 2)[0] < -EXACT:
            return None
        found.append(Element((a,), dofs, (matrix + matrix.T) / 2))
    return found


def _coupled(scaled: np.ndarray, node: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of nodes that the stiffness couples, each once."""
    i, j = np.nonzero(np.triu(scaled, 1))
    pairs = np.unique(np.sort(np.stack([node[i], node[j]], axis=1), axis=1), axis=0)
    return [(int(a), int(b)) for a, b in pairs if a != b]


def _sound(matrix: np.ndarray, rigid: np.ndarray) -> bool:
    """Whether a part is symmetric, not negative, and gives no force in rigid motions; all in units of the diagonal."""
    large = np.abs(matrix).max()
    force = np.abs(matrix @ rigid).max() <= EXACT * (np.abs(matrix) @ np.abs(rigid)).max()
    symmetric = np.abs(matrix - matrix.T).max() <= EXACT * large
    return bool(force and symmetric and np.linalg.eigvalsh((matrix + matrix.T) / 2)[0] >= -EXACT * large)


def factor_of(matrix: Float[np.ndarray, "d d"], columns: int = 6) -> Float[np.ndarray, "d r"]:
    """F with ``F F'`` the leading part of a symmetric matrix that is not negative, ``columns`` wide (zeros behind)."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    size = np.where(size > 0, size, 1.0)
    value, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    root = size[:, None] * vectors[:, ::-1] * np.sqrt(np.maximum(value[::-1], 0.0))
    out = np.zeros((len(matrix), columns))
    out[:, : min(columns, len(matrix))] = root[:, :columns]
    return out


class Elements(eqx.Module):
    r"""Elements of a structure and lumps of its mass: :math:`K = \sum_e F_eF_e^T` and :math:`M = \sum_p G_pG_p^T`.

    Attributes
    ----------
    stiffness, mass
        Factors F and G over DoFs, shapes ``(e, n, r)`` and ``(p, n, r)``.
    places
        Two DoFs that each element of stiffness couples; the same DoF twice for a support.
    dofs
        Names of these DoFs, where they are more than those of the structure: also those that follow it statically, by
        other ratios once an element is softer. ``()`` where they are those of the structure.
    """

    stiffness: Float[Array, "e n r"]
    mass: Float[Array, "p n r"]
    places: tuple[tuple[str, str], ...] = eqx.field(static=True)
    dofs: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, stiffness: Any, mass: Any, places: Sequence[Sequence[str]], dofs: Sequence[str] = ()):
        self.stiffness, self.mass = as_double(stiffness, "stiffness"), as_double(mass, "mass")
        self.places = tuple((str(a), str(b)) for a, b in places)
        if self.stiffness.ndim != 3 or self.mass.ndim != 3 or self.stiffness.shape[1] != self.mass.shape[1]:
            raise ValueError(
                f"the elements' factors have shapes {self.stiffness.shape} (stiffness) and {self.mass.shape} (mass); "
                "they need (element, DoF, column) with one number of DoFs"
            )
        if len(self.places) != len(self.stiffness):
            raise ValueError(f"{len(self.places)} places for {len(self.stiffness)} elements; each needs one")
        self.dofs = tuple(str(name) for name in dofs)
        if self.dofs and len(set(self.dofs)) != self.stiffness.shape[1]:
            raise ValueError(
                f"the elements are over {self.stiffness.shape[1]} DoFs, of which {len(set(self.dofs))} are named"
            )

    def check_of(self, dofs: Sequence[str]) -> None:
        """Raise ``ValueError`` unless these are the elements of a structure with these DoFs."""
        if not self.dofs and self.stiffness.shape[1] != len(dofs):
            raise ValueError(f"the elements are over {self.stiffness.shape[1]} DoFs, the structure has {len(dofs)}")
        strange = [name for name in dofs if name not in self.dofs] if self.dofs else []
        if strange:
            raise ValueError(f"the elements know no DoF {strange[0]} of the structure")
