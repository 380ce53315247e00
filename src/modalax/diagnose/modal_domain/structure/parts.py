r"""Parts that a matrix is made of, each of which may be off by itself: its elements, and local parts of the others.

Beams, bars and springs are read off a matrix (:mod:`modalax.diagnose.modal_domain.structure.elements`), and plates of
four corners (:mod:`modalax.diagnose.modal_domain.structure.four_cornered`). Other elements of more than two nodes, as
of solids, and those of a condensed matrix are not: read pair by pair their parts would give energy away. What such
parts sum to is shared out among the nodes instead.
"""

import itertools

import numpy as np
import scipy.sparse.csgraph

from modalax._numerics.remembered import remembered
from modalax.diagnose.modal_domain.structure.element_masses import mass_parts
from modalax.diagnose.modal_domain.structure.elements import Part, stiffness_parts
from modalax.diagnose.modal_domain.structure.four_cornered import four_cornered
from modalax.diagnose.modal_domain.structure.nodes import NEGLIGIBLE, Nodes

MANY = 7  # coupled nodes, itself among them, beyond which a node's elements cannot be told apart
ROUNDING = 1e-9  # part of a DoF's stiffness or mass that taking elements off it may leave of nothing
GIVEN_AWAY = 1e-6  # energy that a part may give away, relative to what it can store; none but for rounding
NEIGHBOURS, MOST = 8, 400  # nodes about one whose elements it shares, as on a grid; couplings that fits have time for
FEW = 0.5  # share of the nodes that can rest on springs


@remembered(4)  # stiffness and mass, of a simulation and of the one before
def parts_of(A: np.ndarray, nodes: Nodes, mass: bool = False) -> list[Part]:
    """Parts that sum to a stiffness or mass matrix: elements where these can be read off, and local parts of the rest.

    A local part has no ``nodes``: it is no element between any.
    """
    diagonal = np.sqrt(np.maximum(np.abs(np.diag(A)), 1e-300))
    unit = np.abs(A) / diagonal[:, None] / diagonal > NEGLIGIBLE
    joined = np.array([[bool(unit[np.ix_(a, b)].any()) for b in nodes.members] for a in nodes.members])
    count = joined.sum(axis=1)
    crowded = np.flatnonzero(count > MANY) if np.median(count) > MANY else np.zeros(0, int)
    sparse = A.copy()
    for k, j in itertools.permutations(crowded.tolist(), 2):
        sparse[np.ix_(nodes.members[k], nodes.members[j])] = 0.0
    read = [trimmed(p, diagonal) for p in (mass_parts(sparse, nodes) if mass else stiffness_parts(sparse, nodes))]
    sound = [passive(p.matrix, diagonal[p.dofs]) for p in read]
    joined &= ~np.eye(len(joined), dtype=bool)
    wrong = [p.nodes for p, ok in zip(read, sound, strict=True) if len(p.nodes) == 2 and not ok]
    if mass:  # how two beams share a node's mass is not told by the matrix; that is of little weight
        wrong = [(i, j) for i, j in wrong if (joined[i] & joined[j]).sum() > 1]
    meshed = in_one_mesh(joined, {*crowded.tolist(), *itertools.chain(*wrong)})
    if not meshed:
        return read
    known = [p for p, ok in zip(read, sound, strict=True) if ok and not meshed >= set(p.nodes)]
    rest = A - _sum(known, len(A))
    if not passive(rest, diagonal):
        known, rest = [], A
    rest = without_rounding(rest, diagonal)
    springs = [] if mass else supports(rest, nodes)
    rest = without_rounding(rest - _sum(springs, len(A)), diagonal)
    plates = [] if mass else four_cornered(rest, nodes)
    left = without_rounding(rest - _sum(plates, len(A)), diagonal)
    if not passive(left, diagonal):
        plates, left = [], rest
    return known + springs + plates + local_parts(left, nodes)


def _sum(parts: list[Part], size: int) -> np.ndarray:
    """What parts sum to, over all DoFs."""
    return sum((p.full(size) for p in parts), np.zeros((size, size)))


def without_rounding(A: np.ndarray, size: np.ndarray) -> np.ndarray:
    """What is left of a matrix without DoFs at which that is rounding; ``size`` is the root of the whole's diagonal."""
    there = np.abs(np.diag(A)) > ROUNDING * size**2
    return np.where(there[:, None] & there, A, 0.0)


def in_one_mesh(joined: np.ndarray, some: set[int]) -> set[int]:
    """All nodes that elements of three nodes or more may share with ``some``: three nodes that are joined in a ring."""
    found, todo = set(some), list(some)
    while todo:
        k = todo.pop()
        ring = set(np.flatnonzero(joined[k] & (joined & joined[k]).any(axis=1)).tolist()) - found
        found |= ring
        todo += ring
    return found


def trimmed(p: Part, diagonal: np.ndarray) -> Part:
    """A part without the DoFs of its nodes that it does not hold; ``diagonal`` is the root of that of all parts."""
    size = np.sqrt(np.maximum(np.diag(p.matrix), 0.0)) / diagonal[p.dofs]
    held = size > NEGLIGIBLE * size.max(initial=0.0)
    return Part(p.nodes, p.dofs[held], p.matrix[np.ix_(held, held)]) if held.any() else p


def planes_of(p: Part, nodes: Nodes) -> list[Part]:
    """Pieces of an element that have nothing to do with each other, as bending in two planes; none if it is one piece.

    Springs from DoF to DoF, as an axial force or torque makes, are places of their own; bending beside one is a piece,
    and so is each of several springs that act on a body at levers.
    """
    every = apart(p, nodes)
    return [q for q in every if len(q.dofs) > 2] if len(every) > 1 else []


def levers_of(p: Part, nodes: Nodes) -> list[Part]:
    r"""Springs between a point and a body, each in a direction of the point's own DoFs; none if an element is no such.

    Where the point's stiffness is diagonal, its columns show the levers: :math:`K_e=\sum_d k_d v_d v_d^T` with
    :math:`k_d v_d` the column of DoF d.
    """
    size = np.sqrt(np.maximum(np.diag(p.matrix), 1e-300))
    unit, first = p.matrix / size[:, None] / size, np.isin(p.dofs, nodes.members[p.nodes[0]])
    for point in (first, ~first):
        columns, count = unit[:, point], int(np.count_nonzero(point))
        if count < 2 or np.abs(columns[point] - np.eye(count)).max() > NEGLIGIBLE:
            continue
        if np.abs(columns @ columns.T - unit).max() < NEGLIGIBLE:
            held = [np.flatnonzero(np.abs(v) > NEGLIGIBLE) for v in columns.T]
            each = zip(held, (columns * size[:, None]).T, strict=True)
            return [Part(p.nodes, p.dofs[k], np.outer(v[k], v[k])) for k, v in each]
    return []


def apart(p: Part, nodes: Nodes, mass: bool = False) -> list[Part]:
    """Pieces of an element that may each be off by itself: bending and twisting, as each other quantity of a section.

    So may springs at levers (:func:`levers_of`). A node's mass is one in all directions, and its inertia another. What
    is shared out about a node is one.
    """
    if not p.nodes:
        return [p]
    every = _pieces(p)
    if mass:
        moves = nodes.axis[p.dofs] < 3
        one = [k for k in every if moves[k].any()]
        every = [k for k in every if not moves[k].any()] + ([np.sort(np.concatenate(one))] if one else [])
    each = [p] if len(every) < 2 else [Part(p.nodes, p.dofs[k], p.matrix[np.ix_(k, k)]) for k in every]
    return each if mass or len(p.nodes) != 2 else [q for piece in each for q in levers_of(piece, nodes) or [piece]]


def is_spring(p: Part) -> bool:
    """Whether an element can be strained in one way only."""
    return bool(np.abs(_coupling(p) - 1).max() < NEGLIGIBLE)


def ends_of(p: Part, nodes: Nodes) -> tuple[int, ...]:
    """The two DoFs of one direction that the largest piece of an element couples most, displacements before rotations.

    Empty where it couples none between its two nodes, or the first and the last of several, which are opposite corners.
    """
    unit, axis = _coupling(p), nodes.axis[p.dofs]
    main, first = max(_pieces(p), key=len), np.isin(p.dofs, nodes.members[p.nodes[0]])
    last = ~first if len(p.nodes) == 2 else np.isin(p.dofs, nodes.members[p.nodes[-1]])
    alike = (axis[:, None] == axis) & first[:, None] & last
    unit[~np.isin(np.arange(len(axis)), main)] *= NEGLIGIBLE
    unit[axis > 2] *= NEGLIGIBLE
    i, j = np.unravel_index(np.argmax(np.where(alike, unit, -1.0)), unit.shape)
    return (int(p.dofs[i]), int(p.dofs[j])) if alike.any() else ()


def _coupling(p: Part) -> np.ndarray:
    """Couplings of an element's DoFs relative to its diagonal."""
    size = np.sqrt(np.maximum(np.diag(p.matrix), 1e-300))
    return np.abs(p.matrix) / size[:, None] / size


def _pieces(p: Part) -> list[np.ndarray]:
    """Which of an element's DoFs have to do with each other."""
    count, piece = scipy.sparse.csgraph.connected_components(_coupling(p) > NEGLIGIBLE, directed=False)
    return [np.flatnonzero(piece == k) for k in range(count)]


def passive(A: np.ndarray, size: np.ndarray) -> bool:
    """Whether a symmetric matrix gives no energy away; ``size`` is what its DoFs are measured by."""
    values = np.linalg.eigvalsh(A / size[:, None] / size)
    return bool(values[0] > -GIVEN_AWAY * max(values[-1], 1e-300))


def supports(K: np.ndarray, nodes: Nodes) -> list[Part]:
    """Springs to ground under single displacements: the forces that hold a structure moved along as a whole.

    Forces at most nodes, or at other DoFs than those moved, are not those of a few springs.
    """
    size, found = np.maximum(np.diag(K), 1e-300), []
    for axis in range(3):
        along = np.where(nodes.axis == axis, nodes.sign, 0.0)
        force = K @ along
        held = np.flatnonzero(np.abs(force) > GIVEN_AWAY * size)
        if (nodes.axis[held] == axis).all() and 0 < len(held) <= FEW * len(nodes.members):
            found += [(int(k), float(force[k] * nodes.sign[k])) for k in held]
    rest = K.copy()
    for k, stiffness in found:
        rest[k, k] -= stiffness
    if not passive(rest, np.sqrt(size)) or any(stiffness < 0 for _, stiffness in found):
        return []
    node = {int(k): j for j, members in enumerate(nodes.members) for k in members}
    return [Part((node[k],), np.array([k]), np.array([[stiffness]])) for k, stiffness in found]


def coupled_rows(parts: list[Part]) -> list[tuple[np.ndarray, np.ndarray]]:
    r"""Rows :math:`F_a`, :math:`F_b` of neighbouring local parts, each of shape ``(n,)``, those coupled most first.

    Of :math:`A = F^TF` elements that are off make :math:`F^T(I+\epsilon Z)F` (Soize 2000), with ``Z`` as local as they
    are: on its diagonal, which is the parts themselves, and between neighbours, :math:`F_a^T F_b + F_b^T F_a`.
    """
    local = [p.matrix for p in parts if not p.nodes]
    if not local:
        return []
    size = np.sqrt(np.maximum(np.diag(sum(local)), 1e-300))
    rows, node = [], []
    for k, P in enumerate(local):
        values, vectors = np.linalg.eigh(P / size[:, None] / size)
        some = values > GIVEN_AWAY * values[-1]
        rows.append((vectors[:, some] * np.sqrt(values[some])).T)
        node += [k] * int(some.sum())
    F, of = np.concatenate(rows), np.array(node)
    coupling = np.abs(F @ F.T) * (of[:, None] != of)
    nearest = np.argsort(-coupling, axis=1)[:, :NEIGHBOURS]
    pairs = {(min(a, b), max(a, b)) for a, some in enumerate(nearest.tolist()) for b in some if of[a] != of[b]}
    strongest = sorted(pairs, key=lambda pair: -coupling[pair])[:MOST]
    return [(F[a] * size, F[b] * size) for a, b in strongest]


def local_parts(A: np.ndarray, nodes: Nodes) -> list[Part]:
    r"""Parts of a matrix whose elements cannot be read off it, one for each node.

    :math:`A = F^T F` with ``F`` the symmetric root, whose rows are local: of a plate, its curvature about a point. The
    rows :math:`F_k` of one node make a part :math:`F_k^T F_k`, as free of stiffness against rigid motions as the whole.
    """
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    there = np.diag(A) > 0
    values, vectors = np.linalg.eigh(A / size[:, None] / size)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * size
    every = np.arange(len(A))
    rows = [root[m[there[m]]] for m in nodes.members]
    return [Part((), every, F.T @ F) for F in rows if len(F) and np.abs(F).max() > 0]
