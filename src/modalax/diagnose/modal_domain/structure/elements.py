r"""Elements of a simulation, read off its matrices.

The block :math:`K_{ij}` between two nodes is the sum of the off-diagonal blocks of the elements between them. As these
elements do not resist a rigid motion, :math:`K^e_{ii} = -K_{ij} T(r)`, ``T`` the rigid motion of node j that goes
with that of node i at a distance ``r``; and ``r`` follows from the symmetry of :math:`K^e_{ii}`. The rest of
the diagonal is the support of each node. No coordinates are needed; beams, trusses and springs come out exactly.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.structure.nodes import NEGLIGIBLE, Nodes, rigid_moves

TURNING = 1e-6  # force, relative to that of its end, below which an element may turn


@dataclass(frozen=True)
class Part:
    """A contribution to a matrix; ``nodes`` are one or two, ``matrix`` has their DoFs ``dofs``."""

    nodes: tuple[int, ...]
    dofs: np.ndarray
    matrix: np.ndarray

    def full(self, size: int) -> np.ndarray:
        """Over all DoFs."""
        out = np.zeros((size, size))
        out[np.ix_(self.dofs, self.dofs)] = self.matrix
        return out


def stiffness_parts(K: np.ndarray, nodes: Nodes) -> list[Part]:
    """Parts that sum to a symmetric matrix: one for each pair of coupled nodes and each supported node."""
    parts, rest, held = [], K.copy(), []
    diagonal = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    hinges = nodes.hinges(K)
    for (i, j), a, b in _between(K, nodes, hinges):
        block = rest[np.ix_(a, b)]
        if (np.abs(block) / diagonal[a][:, None] / diagonal[b]).max() < NEGLIGIBLE or len(set(a) & set(b)):
            continue
        signs = nodes.sign[a][:, None] * nodes.sign[b]
        own_a, own_b = _ends(block * signs, nodes.axis[a], nodes.axis[b], diagonal[a], diagonal[b])
        own_a, own_b = (own * nodes.sign[x][:, None] * nodes.sign[x] for own, x in ((own_a, a), (own_b, b)))
        matrix = np.block([[own_a, block], [block.T, own_b]])
        dofs = np.concatenate([a, b])
        at_bearing = () if hinges else nodes.held_more(i, j)
        if at_bearing and (np.linalg.eigvalsh(matrix / diagonal[dofs][:, None] / diagonal[dofs])[0] < -TURNING):
            held.append((at_bearing, (i, j), matrix))
            continue
        rest[np.ix_(dofs, dofs)] -= matrix
        parts += _springs_of((i, j), dofs, matrix) or [Part((i, j), dofs, matrix)]
    for (i, j), matrix in _on_bearings(rest, nodes, held, diagonal):
        dofs = np.concatenate([nodes.members[i], nodes.members[j]])
        rest[np.ix_(dofs, dofs)] -= matrix
        parts.append(Part((i, j), dofs, matrix))
    for i, a in enumerate(nodes.members):
        block = rest[np.ix_(a, a)]
        if (np.abs(block) / diagonal[a][:, None] / diagonal[a]).max() > NEGLIGIBLE:
            parts += _mounts_of(i, a, block, diagonal[a]) or [Part((i,), a, (block + block.T) / 2)]
    return parts


def _between(
    K: np.ndarray, nodes: Nodes, hinges: dict[int, int]
) -> Iterator[tuple[tuple[int, int], np.ndarray, np.ndarray]]:  # fmt: skip
    """Every two nodes that an element may join, and the DoFs at which it holds either.

    Elements that end at a hinge come first: they take with them what seems to go from its host.
    """

    def ends_of(i: int, j: int) -> np.ndarray:
        """DoFs of node i as an element to node j sees them."""
        mine = nodes.members[i]
        if i not in hinges:
            return mine
        host = nodes.members[hinges[i]]
        return mine if hinges[i] == j else np.concatenate([host[nodes.axis[host] < 3], mine])

    pairs = [(i, j) for i in range(len(nodes.members)) for j in range(i)]
    for i, j in sorted(pairs, key=lambda p: not (p[0] in hinges or p[1] in hinges)):
        a, b = ends_of(i, j), ends_of(j, i)
        if hinges.get(i) == j or hinges.get(j) == i:
            a, b = (x[nodes.axis[x] > 2] for x in (nodes.members[i], nodes.members[j]))
        alone = i in hinges and not _joined(K, nodes.members[i], b)
        if not (alone or (j in hinges and not _joined(K, nodes.members[j], a))):
            yield (i, j), a, b


def _on_bearings(
    rest: np.ndarray, nodes: Nodes, held: list[tuple[tuple[int, int], tuple[int, int], np.ndarray]], size: np.ndarray
) -> Iterator[tuple[tuple[int, int], np.ndarray]]:  # fmt: skip
    """Elements from a node to one on a bearing, and as they were read before where it does not tell what they are.

    Parameters
    ----------
    rest
        What is left of the stiffness, less by each element as they are taken.
    held
        Pairs of nodes, that on the bearing last; the same in the order of the element as read before, and that.
    size
        Root of the diagonal of all stiffness.
    """
    pairs = [pair for pair, _, _ in held]
    for (i, j), before, matrix in held:
        others = [sum(k in pair for pair in pairs) > 1 for k in (i, j)]
        found = None if others[0] else _on_bearing(rest, nodes, i, j, size, alone=not others[1])
        yield ((i, j), found) if found is not None else (before, matrix)


def _on_bearing(
    rest: np.ndarray, nodes: Nodes, i: int, j: int, size: np.ndarray, alone: bool
) -> np.ndarray | None:  # fmt: skip
    r"""An element from node i to j, which a bearing holds: it does resist being moved across that.

    It does not resist moving with node j, :math:`K_{ii} T(r) = -K_{ij}`; :math:`K_{ii}` is what all others leave at
    node i, and :math:`K_{jj} = -K_{ji} T(r)`. Where the ground holds node i as well, all that is left is this element's
    if no other ends at j; else None.
    """
    a, b = nodes.members[i], nodes.members[j]
    own, block = rest[np.ix_(a, a)], rest[np.ix_(a, b)]
    scale, signed = size[a][:, None], block * nodes.sign[a][:, None] * nodes.sign[b]
    moves = rigid_moves(nodes.axis[b], nodes.axis[a])
    made = np.einsum("xy,ryz->rxz", own * nodes.sign[a][:, None] * nodes.sign[a] / scale, moves)
    aim, ways = (made[0] + signed / scale).ravel(), made[1:].reshape(3, -1).T
    weight = np.maximum(np.linalg.norm(ways, axis=0), 1e-300)
    r = np.linalg.lstsq(ways / weight, -aim, rcond=1e-9)[0] / weight
    if np.linalg.norm(ways @ r + aim) < TURNING * np.linalg.norm(block / scale):
        end = -signed.T @ (moves[0] + np.tensordot(r, moves[1:], 1))
        return np.block([[own, block], [block.T, (end + end.T) / 2 * nodes.sign[b][:, None] * nodes.sign[b]]])
    return np.block([[own, block], [block.T, rest[np.ix_(b, b)]]]) if alone else None


def _mounts_of(node: int, dofs: np.ndarray, matrix: np.ndarray, size: np.ndarray) -> list[Part]:
    """One part for each spring where a node is held by springs to ground in its own directions only; else none."""
    unit = np.abs(matrix) / size[:, None] / size
    if (unit - np.diag(np.diag(unit))).max() > NEGLIGIBLE or (np.diag(matrix) < 0).any():
        return []
    return [Part((node,), dofs[[k]], matrix[[k]][:, [k]]) for k in np.flatnonzero(np.diag(unit) > NEGLIGIBLE)]


def _joined(K: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    return bool((np.abs(K[np.ix_(a, b)]) / size[a][:, None] / size[b]).max(initial=0.0) > NEGLIGIBLE)


def _springs_of(nodes: tuple[int, int], dofs: np.ndarray, matrix: np.ndarray) -> list[Part]:
    """One part for each spring where two nodes are joined only by springs from DoF to DoF; else none."""
    half = len(dofs) // 2
    block = -matrix[:half, half:] if len(dofs) == 2 * half else np.zeros((0, 0))
    size = np.abs(matrix).max()
    alike = block.size and np.abs(block - np.diag(np.diag(block))).max() < NEGLIGIBLE * size
    if not alike or np.abs(matrix[:half, :half] - block).max() > NEGLIGIBLE * size:
        return []
    unit = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return [
        Part(nodes, dofs[[k, half + k]], block[k, k] * unit)
        for k in range(half)
        if abs(block[k, k]) > NEGLIGIBLE * size
    ]


def _ends(
    block: np.ndarray, a: np.ndarray, b: np.ndarray, size_a: np.ndarray, size_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Diagonal blocks of what couples two nodes by ``block`` and does not resist rigid motion.

    A point that moves in one direction, which its name does not tell, is joined to a node by a rod or spring: the force
    that its displacement makes there is along that direction, and its length is the stiffness.
    """
    for k, rows in ((0, block), (1, block.T)):
        mine, other = (a, b)[:: 1 - 2 * k]
        stiffness = float(np.linalg.norm(rows[0, other < 3])) if mine.tolist() == [-1] and (other >= 0).all() else 0.0
        if stiffness > 0:
            point, node = np.array([[stiffness]]), np.outer(rows[0], rows[0]) / stiffness
            return (node, point) if k else (point, node)
    if (a < 0).any() or (b < 0).any():
        return -np.diag(block.sum(axis=1)), -np.diag(block.sum(axis=0))
    forth, back = rigid_moves(a, b), rigid_moves(b, a)
    back[1:] *= -1
    at_a = -np.einsum("xy,ryz->rxz", block, forth) / size_a[:, None] / size_a
    at_b = -np.einsum("xy,rxz->ryz", block, back) / size_b[:, None] / size_b
    skew = [np.concatenate([(m - m.T).ravel() for m in (p, q)]) for p, q in zip(at_a, at_b, strict=True)]
    system = np.stack(skew[1:], axis=1)
    weight = np.maximum(np.linalg.norm(system, axis=0), 1e-300)
    r = np.linalg.lstsq(system / weight, -skew[0], rcond=1e-9)[0] / weight
    own_a = (at_a[0] + np.tensordot(r, at_a[1:], 1)) * size_a[:, None] * size_a
    own_b = (at_b[0] + np.tensordot(r, at_b[1:], 1)) * size_b[:, None] * size_b
    return (own_a + own_a.T) / 2, (own_b + own_b.T) / 2
