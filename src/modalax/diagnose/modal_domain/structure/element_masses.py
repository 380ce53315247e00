r"""Masses of a simulation's elements, read off its mass matrix.

The block :math:`M_{ij}` between two nodes is that of the elements between them; what these have at node i itself is a
fixed function of it, the same for all elements of one kind (of beams with cubic shapes, of bars and shafts with linear
ones):

.. math::
   M^e_{ii} = \begin{pmatrix} a_1\,\mathrm{tr}(T)\,I + a_2 T & b\,B \\ b\,B^T & c_1 |R| + c_2 R\end{pmatrix},

``T``, ``B`` and ``R`` the parts of :math:`M_{ij}` between displacements, between displacement and rotation, and between
rotations. The five factors are those of consistent masses of beams, bars and shafts (Archer 1963), where these leave
nothing at some nodes, or else those with which the elements leave least; where they leave something, there is a lump,
or an element that ends at a clamp.
"""

import math
from collections.abc import Iterator

import numpy as np

from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.nodes import NEGLIGIBLE, Nodes

# Of a beam's mass between its ends, in displacement along and across it and in rotation: what is at one end over that
LINEAR, CUBIC, TURNED, TURNING = 1 / 3 / (1 / 6), 156 / 54, -22 / 13, 4 / 3
ALONG_TO_ACROSS = 70 / 54  # mass between the ends along a beam, relative to that across it
ROUNDS = 30  # of the least sum of sizes of what is left, by reweighting (Weiszfeld 1937)
BEAMS = 1e-6  # the same, below which a node's mass is that of its beams
FEWEST = 2  # nodes that show that a mass is that of beams
EXACT = 1e-9  # part of a node's mass below which what is left counts as nothing in that
ROUNDING = 1e-9  # share of a mass that is none
LACKING = 0.1  # share of its mass in any motion that a node may lack, where elements of two kinds meet


def mass_parts(M: np.ndarray, nodes: Nodes) -> list[Part]:
    """Parts that sum to a mass matrix: one for each pair of coupled nodes, and the rest of each node.

    Elements for which no such function is found share what the others leave at a node as they couple it to others, up
    to what each has at its other end.
    """
    size = np.sqrt(np.maximum(np.abs(np.diag(M)), 1e-300))
    unit = np.abs(M) / size[:, None] / size > NEGLIGIBLE
    members = nodes.members
    pairs = [(i, j) for i in range(len(members)) for j in range(i) if unit[np.ix_(members[i], members[j])].any()]
    alike = [(i, j) for i, j in pairs if np.array_equal(nodes.axis[members[i]], nodes.axis[members[j]])]
    parts, rest = _by_function(M, nodes, size, alike)
    known = {p.nodes for p in parts}
    return parts + _shared_out(rest, nodes, size, [pair for pair in pairs if pair not in known])


def _by_function(
    M: np.ndarray, nodes: Nodes, size: np.ndarray, pairs: list[tuple[int, int]]
) -> tuple[list[Part], np.ndarray]:
    """Elements between nodes of the same DoFs, as far as they leave no node with less than nothing; and what is left.

    ``size`` is the root of the diagonal of ``M``.
    """
    members = nodes.members
    shapes = {(i, j): (_own(M, nodes, i, j), _own(M, nodes, j, i)) for i, j in pairs}
    total = [np.zeros((5, len(m), len(m))) for m in members]
    for (i, j), (at_i, at_j) in shapes.items():
        total[i] += at_i
        total[j] += at_j
    scale = [size[m][:, None] * size[m] for m in members]
    columns = [(t / s).reshape(5, -1).T for t, s in zip(total, scale, strict=True)]
    target = [(M[np.ix_(m, m)] / s).ravel() for m, s in zip(members, scale, strict=True)]
    factors = _of_kinds(columns, target, nodes)
    if factors is None:
        factors = _least(columns, target) if pairs else np.zeros(5)
    lacking = [
        bool(np.linalg.eigvalsh((y - x @ factors).reshape(len(m), len(m)))[0] < -LACKING)
        for x, y, m in zip(columns, target, members, strict=True)
    ]
    parts, rest = [], M.copy()
    for (i, j), ends in shapes.items():
        if lacking[i] or lacking[j]:
            continue
        own_i, own_j = (np.tensordot(factors, end, 1) for end in ends)
        block, dofs = M[np.ix_(members[i], members[j])], np.concatenate([members[i], members[j]])
        parts.append(Part((i, j), dofs, np.block([[own_i, block], [block.T, own_j]])))
        rest[np.ix_(dofs, dofs)] -= parts[-1].matrix
    return parts, rest


def _least(columns: list[np.ndarray], target: list[np.ndarray]) -> np.ndarray:
    """Factors with which elements leave least, in sum over the nodes."""
    weight, factors = np.ones(len(columns)), np.zeros(5)
    for _ in range(ROUNDS):
        A, b = (np.concatenate([w * x for w, x in zip(weight, some, strict=True)]) for some in (columns, target))
        factors = np.linalg.lstsq(A, b, rcond=1e-9)[0]
        left = [np.linalg.norm(y - x @ factors) for x, y in zip(columns, target, strict=True)]
        weight = 1 / np.sqrt(np.maximum(left, EXACT))
    return factors


def _of_kinds(columns: list[np.ndarray], target: list[np.ndarray], nodes: Nodes) -> np.ndarray | None:
    """Factors of elements with linear or cubic shapes, where they leave no node with less than nothing; else None.

    At some nodes they leave nothing at all, which no others do.
    """
    for factors in _kinds(len({int(axis) for axis in nodes.axis if 0 <= axis < 3})):
        left = [y - x @ factors for x, y in zip(columns, target, strict=True) if x.any()]
        least = [float(np.linalg.eigvalsh(a.reshape(2 * (math.isqrt(len(a)),)))[0]) for a in left]
        if min(least, default=-1.0) > -BEAMS and sum(np.abs(a).max() < BEAMS for a in left) >= min(FEWEST, len(left)):
            return factors
    return None


def _kinds(directions: int) -> Iterator[np.ndarray]:
    """Factors of beams that bend across all directions but that along them, or across all; and of bars and shafts."""
    for across, along in ((directions - 1, True), (directions, False)):
        if 0 < across < 3:
            trace = ALONG_TO_ACROSS * along + across
            slope = (LINEAR * ALONG_TO_ACROSS - CUBIC) / (ALONG_TO_ACROSS - 1) if along else 0.0
            yield np.array([(CUBIC - slope) / trace, slope, TURNED, TURNING, 0.0])
    yield np.array([0.0, LINEAR, 0.0, 0.0, LINEAR])


def _own(M: np.ndarray, nodes: Nodes, i: int, j: int) -> np.ndarray:
    """The five matrices that make what an element between two nodes has at node i, shape ``(5, n, n)``."""
    a, b = nodes.members[i], nodes.members[j]
    signs = nodes.sign[a][:, None] * nodes.sign[a]
    block = M[np.ix_(a, b)] * nodes.sign[a][:, None] * nodes.sign[b]
    turns = nodes.axis[a] > 2
    moves = ~turns
    T, R = (np.where(np.outer(some, some), (block + block.T) / 2, 0.0) for some in (moves, turns))
    between = np.where(np.outer(moves, turns), block, 0.0)
    values, vectors = np.linalg.eigh(R)
    return signs * np.stack(
        [np.trace(T) * np.diag(moves.astype(float)), T, between + between.T, (vectors * np.abs(values)) @ vectors.T, R]
    )


def _shared_out(M: np.ndarray, nodes: Nodes, size: np.ndarray, pairs: list[tuple[int, int]]) -> list[Part]:
    """Elements between pairs of nodes that share the mass of each node, and what is left of that.

    A node next to a clamp, or with a lump on it, has more than its elements have at their other ends. ``size`` is the
    root of the diagonal of all mass.
    """
    count = len(nodes.members)
    straight = [m[nodes.axis[m] < 3] for m in nodes.members]
    straight = [few if len(few) else m for few, m in zip(straight, nodes.members, strict=True)]
    coupling = np.zeros((count, count))
    for i, j in pairs:
        strength = np.linalg.norm(M[np.ix_(straight[i], straight[j])])
        strength = strength or np.linalg.norm(M[np.ix_(nodes.members[i], nodes.members[j])])
        coupling[i, j] = coupling[j, i] = strength
    share = coupling / np.maximum(coupling.sum(axis=1, keepdims=True), 1e-300)
    diagonal = np.where(np.diag(M) > ROUNDING * size**2, np.diag(M), 0.0)  # elsewhere nothing is left but rounding
    own = np.array([diagonal[a].mean() for a in straight])
    left, parts = np.ones(count), []
    for i, j in pairs:
        ends = np.array([share[i, j] * own[i], share[j, i] * own[j]])
        part = np.array([share[i, j], share[j, i]])
        if not nodes.held_more(i, j):  # else they have no mass that compares
            part = part * min(ends) / np.maximum(ends, 1e-300)
        a, b = nodes.members[i], nodes.members[j]
        block = M[np.ix_(a, b)]
        matrix = np.block([[part[0] * M[np.ix_(a, a)], block], [block.T, part[1] * M[np.ix_(b, b)]]])
        parts.append(Part((i, j), np.concatenate([a, b]), matrix))
        left[[i, j]] -= part
    for i, a in enumerate(nodes.members):
        there = np.diag(M)[a] > ROUNDING * size[a] ** 2
        if left[i] > ROUNDING and there.any():
            parts.append(Part((i,), a, left[i] * M[np.ix_(a, a)]))
    return parts
