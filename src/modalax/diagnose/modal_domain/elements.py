r"""Elements of a simulation, read off its matrices.

The block :math:`K_{ij}` between two nodes is the sum of the off-diagonal blocks of the elements between them. As these
elements do not resist a rigid motion, :math:`K^e_{ii} = -K_{ij} T(r)`, ``T`` the rigid motion of node j that goes
with that of node i at a distance ``r``; and ``r`` follows from the symmetry of :math:`K^e_{ii}`. The rest of
the diagonal is the support of each node. No coordinates are needed; beams, trusses and springs come out exactly.
"""

import re
from dataclasses import dataclass

import numpy as np

from modalax.data.dofs import parse_dof
from modalax.diagnose.modal_domain.turns import directions_of, rotations_of

NEGLIGIBLE = 1e-7  # size of a coupling, relative to the diagonal, below which there is none
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
# Names such as 12z, n3_ry or 12.RX, besides those written 12:+Z
_SHORT = re.compile(r"(?P<node>.*?[^A-Za-z]|[A-Za-z]+?)[_.\- ]?(?P<direction>[rR]?[xyzXYZ])")
_AHEAD = re.compile(r"u?(?P<turn>r|rot)?(?P<along>[xyz])[_.\- ]?(?P<node>\d+)", re.IGNORECASE)  # z12, rotx_3, ux4


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


@dataclass(frozen=True)
class Nodes:
    """Which DoFs belong to one node; ``axis`` is 0 to 2 for displacements, 3 to 5 for rotations, -1 if unknown."""

    members: list[np.ndarray]
    axis: np.ndarray
    sign: np.ndarray

    @property
    def of_dofs(self) -> np.ndarray:
        """Number of the node of each DoF, shape ``(n,)``."""
        out = np.zeros(len(self.axis), int)
        for k, members in enumerate(self.members):
            out[members] = k
        return out

    def hinges(self, K: np.ndarray) -> dict[int, int]:
        """Nodes with rotations alone, and the node whose displacements each shares.

        It is the one whose displacements, and not its rotations, go with all that the rotations are coupled to.
        """
        size = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
        unit = np.abs(K) / size[:, None] / size > NEGLIGIBLE
        joined = lambda a, b: bool(len(a) and len(b) and unit[np.ix_(a, b)].any())
        moves = [m[(self.axis[m] >= 0) & (self.axis[m] < 3)] for m in self.members]
        turns = [m[self.axis[m] > 2] for m in self.members]
        out = {}
        for b in range(len(self.members)):
            if len(moves[b]) or not len(turns[b]):
                continue
            near = [k for k in range(len(self.members)) if k != b and joined(self.members[k], turns[b])]
            for a in near:
                others = [c for c in near if c != a and len(moves[c])]
                if (
                    others
                    and joined(turns[a], turns[b])
                    and all(joined(moves[a], self.members[c]) and not joined(turns[a], self.members[c]) for c in others)
                ):
                    out[b] = a
                    break
        return out


def nodes_of(dofs: tuple[str, ...], K: np.ndarray | None = None) -> Nodes:
    """Nodes by the names of their DoFs, those of each in the order of its directions, whatever that of the names.

    Where names do not show the node, every DoF is a node of its own, but for rotations that a stiffness matrix shows.
    """
    found: dict[object, list[int]] = {}
    axis, sign = np.full(len(dofs), -1), np.ones(len(dofs))
    for k, (node, direction, way) in enumerate(_read(dofs)):
        if direction in AXES:
            axis[k] = AXES.index(direction)
        sign[k] = way
        found.setdefault((node,) if axis[k] >= 0 else dofs[k], []).append(k)
    told = None if K is None or (axis >= 0).all() else directions_of(dofs, axis, K)
    if told is not None:
        members, axis = (
            [[k for k, own in enumerate(told[0]) if own == node] for node in dict.fromkeys(told[0])],
            told[1],
        )
        return Nodes([np.array(sorted(v, key=lambda k: axis[k])) for v in members], axis, sign)
    if K is not None and (axis < 0).all():
        return _turning(rotations_of(K), Nodes([np.array(v) for v in found.values()], axis, sign))
    return Nodes([np.array(sorted(v, key=lambda k: axis[k])) for v in found.values()], axis, sign)


def _turning(rotations: dict[int, int], plain: Nodes) -> Nodes:
    """Nodes of displacements along one axis, with the rotations that turn with them, one about each other axis."""
    bodies: dict[int, list[int]] = {}
    for turn, moves in rotations.items():
        bodies.setdefault(moves, []).append(turn)
    if not bodies or any(len(turns) > 2 for turns in bodies.values()):
        return plain
    axis = np.full(len(plain.axis), 2)
    for turns in bodies.values():
        axis[turns] = (4,) if len(turns) == 1 else (3, 4)
    moves = [k for k in range(len(axis)) if k not in rotations]
    return Nodes([np.array([k, *bodies.get(k, ())]) for k in moves], axis, plain.sign)


def _read(dofs: tuple[str, ...]) -> list[tuple[str, str | None, int]]:
    """Node, direction and sign of each name.

    Letters alone, and letters before a number, may also count points; they are directions where that shows: where a
    body turns, and where one number has several directions. The last letter of a word, as of ``body``, is one where
    all names end in one, or the rest of that word ends in several.
    """
    names = [name.strip() for name in dofs]
    alone = any(name.upper() in AXES[3:] for name in names)
    ahead = [_AHEAD.fullmatch(name) for name in names]
    numbered = [(m["node"], f"{'R' * bool(m['turn'])}{m['along'].upper()}") for m in ahead if m is not None]
    many = len({node for node, _ in numbered}) < len(set(numbered))
    behind = [_SHORT.fullmatch(name) for name in names]
    words = [m["node"] for m in behind if m is not None and m["node"].isalpha()]
    found: list[tuple[str, str | None, int]] = []
    for name, first, last in zip(names, ahead, behind, strict=True):
        node, direction, way = parse_dof(name)
        if last is not None and words.count(last["node"]) == 1 and None in behind:
            last = None
        if direction is not None:
            found.append((node, direction, way))
        elif alone and name.upper() in AXES:
            found.append(("", name.upper(), 1))
        elif first is not None and many:
            found.append((first["node"], f"{'R' * bool(first['turn'])}{first['along'].upper()}", 1))
        elif last is not None:
            found.append((last["node"].rstrip("_.- "), last["direction"].upper(), 1))
        else:
            found.append((name, None, 1))
    return found


def rigid_moves(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rigid motion at axes ``b`` of a node by that at axes ``a`` of another: constant, and by each component of r."""
    out = np.zeros((4, len(b), len(a)))
    out[0] = (b[:, None] == a) & (b[:, None] >= 0)
    # displacement of j = displacement of i + rotation x r
    for axis, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        for row, col, r, sign in ((first, axis, second, -1.0), (second, axis, first, 1.0)):
            out[1 + r] += sign * np.outer(b == row, a == 3 + col)
    return out


def stiffness_parts(K: np.ndarray, nodes: Nodes) -> list[Part]:
    """Parts that sum to a symmetric matrix: one for each pair of coupled nodes and each supported node."""
    parts, rest = [], K.copy()
    diagonal = np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300))
    hinges = nodes.hinges(K)

    def ends_of(i: int, j: int) -> np.ndarray:
        """DoFs of node i as an element to node j sees them."""
        mine = nodes.members[i]
        if i not in hinges:
            return mine
        host = nodes.members[hinges[i]]
        return mine if hinges[i] == j else np.concatenate([host[nodes.axis[host] < 3], mine])

    # elements that end at a hinge first: they take with them what seems to go from its host
    pairs = [(i, j) for i in range(len(nodes.members)) for j in range(i)]
    for i, j in sorted(pairs, key=lambda p: not (p[0] in hinges or p[1] in hinges)):
        a, b = ends_of(i, j), ends_of(j, i)
        if hinges.get(i) == j or hinges.get(j) == i:
            a, b = (x[nodes.axis[x] > 2] for x in (nodes.members[i], nodes.members[j]))
        alone = i in hinges and not _joined(K, nodes.members[i], b)
        if alone or (j in hinges and not _joined(K, nodes.members[j], a)):
            continue
        block = rest[np.ix_(a, b)]
        if (np.abs(block) / diagonal[a][:, None] / diagonal[b]).max() < NEGLIGIBLE or len(set(a) & set(b)):
            continue
        signs = nodes.sign[a][:, None] * nodes.sign[b]
        own_a, own_b = _ends(block * signs, nodes.axis[a], nodes.axis[b], diagonal[a], diagonal[b])
        own_a, own_b = (own * nodes.sign[x][:, None] * nodes.sign[x] for own, x in ((own_a, a), (own_b, b)))
        matrix = np.block([[own_a, block], [block.T, own_b]])
        dofs = np.concatenate([a, b])
        rest[np.ix_(dofs, dofs)] -= matrix
        parts += _springs_of((i, j), dofs, matrix) or [Part((i, j), dofs, matrix)]
    for i, a in enumerate(nodes.members):
        block = rest[np.ix_(a, a)]
        if (np.abs(block) / diagonal[a][:, None] / diagonal[a]).max() > NEGLIGIBLE:
            parts += _mounts_of(i, a, block, diagonal[a]) or [Part((i,), a, (block + block.T) / 2)]
    return parts


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
