r"""Elements of four nodes, as of plates and shells, read off a stiffness matrix.

Two opposite corners belong to one element only, so that their block shows its size. An element does not resist a rigid
motion, :math:`K_e R_e = 0`, where ``R`` follows from what the rows of free nodes do not resist. By these alone the
elements are known but for a beam along each edge that two of them share: it may belong to either. That is settled where
elements of one shape differ by a factor only, as those of a plate of one material whatever its thickness,
:math:`K_e = t_e N S N^T` with :math:`N` across ``R_e``: least squares finds one ``S`` a shape.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np

from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.nodes import NEGLIGIBLE, Nodes, rigid_moves

ALIKE = 1e-6  # relative difference of what elements of one shape have in common, and of what they leave of the matrix
ORDERED = 1e-4  # distance of two corners along an axis, relative to the element's size, from which that orders them
MOST, MOST_VALUES = 12, 20_000_000  # shapes of elements, and numbers of the least-squares problem, that are tried
FEWEST = 3  # DoFs of a node whose rotations show where others are
OPPOSITE = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))  # ways to pair four corners


@dataclass
class _Shape:
    """Elements that differ by a factor only.

    Attributes
    ----------
    corners
        Positions of the corners from the first, shape ``(4, 3)``.
    opposite
        The two pairs of corners that are furthest apart.
    axis, scale
        Direction of each DoF, and what it is measured by, shape ``(d,)``.
    across
        Basis of what is no rigid motion, shape ``(d, s)``.
    blocks
        What the first element has between opposite corners.
    nodes, dofs, factors
        Of each element: its nodes, opposite ones first and last, its DoFs and how many times the first it is.
    """

    corners: np.ndarray
    opposite: tuple[tuple[int, int], ...]
    axis: np.ndarray
    scale: np.ndarray
    across: np.ndarray
    blocks: np.ndarray
    nodes: list[tuple[int, ...]] = field(default_factory=list)
    dofs: list[np.ndarray] = field(default_factory=list)
    factors: list[float] = field(default_factory=list)

    @property
    def width(self) -> int:
        """Number of ways in which an element can be strained."""
        return self.across.shape[1]


def four_cornered(K: np.ndarray, nodes: Nodes) -> list[Part]:
    """Elements of four nodes of which a stiffness matrix ``(n, n)`` is made; none where such do not explain it.

    Nodes that are held, and those next to nodes that the matrix does not have any more, may have more than these.
    """
    there = np.diag(K) > 0
    scale = np.sqrt(np.where(there, np.diag(K), 1.0))
    signed = K * np.outer(nodes.sign, nodes.sign)
    unit = np.where(np.outer(there, there), signed / np.outer(scale, scale), 0.0)
    members = [m[there[m]] for m in nodes.members]
    cliques = _cliques(unit, members)
    meshed = set(itertools.chain(*cliques))
    free = [k for k in _free(unit, members, nodes.axis, scale) if k in meshed]
    position = _positions(unit, members, nodes.axis, free, scale) if free else None
    if position is None:
        return []
    shapes: list[_Shape] = []
    for clique in cliques:
        _put(shapes, clique, signed, members, nodes.axis, position, scale)
        if len(shapes) > MOST:
            return []
    parts = _solved(shapes, unit, scale, np.isin(np.arange(len(K)), np.concatenate([members[k] for k in free])))
    signs = (nodes.sign[p.dofs] for p in parts)
    return [Part(p.nodes, p.dofs, p.matrix * np.outer(sign, sign)) for p, sign in zip(parts, signs, strict=True)]


def _cliques(unit: np.ndarray, members: list[np.ndarray]) -> list[tuple[int, ...]]:
    """Four nodes, each coupled to the three others, of which two have no other such neighbours in common."""
    large = [k for k, m in enumerate(members) if len(m) >= FEWEST]
    coupled = np.abs(unit) > NEGLIGIBLE
    joined = {k: {j for j in large if coupled[np.ix_(members[k], members[j])].any()} - {k} for k in large}
    found = set()
    for i in large:
        for j in joined[i]:
            common = joined[i] & joined[j]
            if len(common) == 2 and min(common) in joined[max(common)]:
                found.add(tuple(sorted((i, j, *common))))
    return sorted(found)


def _free(unit: np.ndarray, members: list[np.ndarray], axis: np.ndarray, scale: np.ndarray) -> list[int]:
    """Nodes that resist no displacement of all together."""
    moved = np.stack([np.where(axis == k, scale, 0.0) for k in range(3)], axis=1)
    force = np.abs(unit @ moved) > ALIKE * (np.abs(unit) @ moved)
    return [k for k, m in enumerate(members) if len(m) and not force[m].any()]


def _positions(
    unit: np.ndarray, members: list[np.ndarray], axis: np.ndarray, free: list[int], scale: np.ndarray
) -> np.ndarray | None:  # fmt: skip
    r"""Positions of the nodes ``(node, 3)``; None where free nodes resist a rotation of all together about them.

    They do not where :math:`\sum_b K_{ab} R(p_b - p_a) = 0`, linear in the positions.
    """
    system, aim = [], []
    for a in free:
        mine = members[a]
        rows, still = np.zeros((len(members), 3, len(mine), len(mine))), np.zeros((len(mine), len(mine)))
        near = np.abs(unit[mine]).max(axis=0)
        for b in (k for k, m in enumerate(members) if near[m].max(initial=0.0) > 0):
            block = unit[np.ix_(mine, members[b])] * scale[members[b]]
            moves = block @ rigid_moves(axis[mine], axis[members[b]]) / scale[mine]
            still += moves[0]
            rows[b] += moves[1:]
            rows[a] -= moves[1:]
        system.append(rows.reshape(len(members) * 3, -1).T)
        aim.append(still.ravel())
    A, y = np.concatenate(system), np.concatenate(aim)
    found = np.linalg.lstsq(A, -y, rcond=1e-10)[0]
    return found.reshape(-1, 3) if np.linalg.norm(A @ found + y) <= ALIKE * max(np.linalg.norm(y), 1.0) else None


def _put(
    shapes: list[_Shape], clique: tuple[int, ...], K: np.ndarray, members: list[np.ndarray], axis: np.ndarray,
    position: np.ndarray, scale: np.ndarray,
) -> None:  # fmt: skip
    """Put an element to those of its shape, or begin a new one."""
    extent = np.ptp(position[list(clique)], axis=0).max()
    order = np.lexsort(np.round(position[list(clique)] / (ORDERED * extent))[:, ::-1].T)
    at = [clique[k] for k in order]
    corners, dofs = position[at] - position[at[0]], np.concatenate([members[k] for k in at])
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1)
    opposite = max(OPPOSITE, key=lambda pairs: sum(apart[pair] for pair in pairs))
    for shape in shapes:
        alike = opposite == shape.opposite and len(dofs) == len(shape.axis) and (axis[dofs] == shape.axis).all()
        if not alike or np.abs(corners - shape.corners).max() > ALIKE * extent:
            continue
        blocks = _blocks(K, dofs, [members[k] for k in at], opposite, shape.scale)
        factor = float(shape.blocks @ blocks / (shape.blocks @ shape.blocks))
        if factor > 0 and np.abs(blocks - factor * shape.blocks).max() < ALIKE * np.abs(blocks).max():
            break
    else:
        rigid = np.concatenate([_turned(r, axis[members[k]]) for k, r in zip(at, corners, strict=True)])
        left, strength, _ = np.linalg.svd(rigid * scale[dofs][:, None])
        across = left[:, np.count_nonzero(strength > ALIKE * strength[0]) :]
        blocks = _blocks(K, dofs, [members[k] for k in at], opposite, scale[dofs])
        shape, factor = _Shape(corners, opposite, axis[dofs], scale[dofs], across, blocks), 1.0
        shapes.append(shape)
    (first, last), others = opposite
    shape.nodes.append(tuple(at[k] for k in (first, *others, last)))
    shape.dofs.append(dofs)
    shape.factors.append(factor)


def _turned(r: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The six rigid motions about the origin at a node at ``r``, shape ``(len(axis), 6)``."""
    moves = rigid_moves(np.arange(6), axis)
    return moves[0] + np.tensordot(r, moves[1:], 1)


def _blocks(
    K: np.ndarray, dofs: np.ndarray, members: list[np.ndarray], opposite: tuple[tuple[int, int], ...], scale: np.ndarray
) -> np.ndarray:  # fmt: skip
    """All values of the blocks between opposite corners of an element, over the scale of its DoFs."""
    unit = K[np.ix_(dofs, dofs)] / np.outer(scale, scale)
    at = [np.isin(dofs, m) for m in members]
    return np.concatenate([unit[np.ix_(at[i], at[j])].ravel() for i, j in opposite])


def _solved(shapes: list[_Shape], unit: np.ndarray, scale: np.ndarray, free: np.ndarray) -> list[Part]:
    """All elements, by what they sum to wherever a free DoF moves or is acted on; none if they do not."""
    known = np.triu(free[:, None] | free)
    sizes = [shape.width * (shape.width + 1) // 2 for shape in shapes]
    if sum(sizes) * np.count_nonzero(known) > MOST_VALUES:
        return []
    number = np.full(unit.shape, -1)
    number[known] = np.arange(np.count_nonzero(known))
    A, y = np.hstack([_columns(shape, number, scale) for shape in shapes]), unit[known]
    acts = np.abs(A).max(axis=1) > 0
    found = np.linalg.lstsq(A[acts], y[acts], rcond=1e-10)[0]
    if np.abs(A[acts] @ found - y[acts]).max() > ALIKE:
        return []
    parts = []
    for shape, values in zip(shapes, np.split(found, np.cumsum(sizes)[:-1]), strict=True):
        S = np.zeros((shape.width, shape.width))
        S[np.triu_indices(shape.width)] = values
        strengths, ways = np.linalg.eigh((S + S.T) / 2)
        if strengths[0] < -ALIKE * strengths[-1]:
            return []
        root = shape.scale[:, None] * (shape.across @ ways) * np.sqrt(np.maximum(strengths, 0.0))
        each = zip(shape.nodes, shape.dofs, shape.factors, strict=True)
        parts += [Part(nodes, dofs, factor * root @ root.T) for nodes, dofs, factor in each]
    return parts


def _columns(shape: _Shape, number: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """What each value of ``S`` adds to the entries that are numbered, shape ``(entry, value)``."""
    i, j = np.triu_indices(shape.width)
    N = shape.across * shape.scale[:, None]
    each = N[:, None, i] * N[None, :, j]
    each = (each + each.transpose(1, 0, 2)) / 2
    out = np.zeros((number.max() + 1, len(i)))
    for dofs, factor in zip(shape.dofs, shape.factors, strict=True):
        rows = number[np.ix_(dofs, dofs)]
        np.add.at(out, rows[rows >= 0], factor * (each / np.outer(scale[dofs], scale[dofs])[..., None])[rows >= 0])
    return out
