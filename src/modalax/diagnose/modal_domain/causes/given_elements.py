"""Elements that a finite-element model tells, as patterns of change and as causes."""

import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.modes_only import Simulation
from modalax.diagnose.modal_domain.structure.nodes import Nodes, nodes_of
from modalax.diagnose.modal_domain.structure.parts import ends_of, is_spring, planes_of
from modalax.model import Structure
from modalax.model.condense import follow

RANK = 1e-5  # force in one motion, relative to the largest, below which an element has none
OUTSIDE = 1e-6  # part of a direction, relative to the whole, that an element may have no force along


def stiffness_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """Change of each element's stiffness by the whole, in modal coordinates ``(e, n, n)``; None if none are told."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.stiffness), c)


def mass_patterns(simulation: Structure, c: Coordinates) -> np.ndarray | None:
    """The same of each lump of mass."""
    return None if simulation.elements is None else _patterns(np.asarray(simulation.elements.mass), c)


def _patterns(factors: np.ndarray, c: Coordinates) -> np.ndarray:
    inner = np.einsum("enr,nk->erk", factors, c.everywhere, optimize=True)
    return np.matmul(inner.transpose(0, 2, 1), inner)


def told_parts(simulation: Structure, nodes: Nodes) -> list[Part]:
    """Elements that are told, over the simulation's DoFs; without those of which one end follows other nodes."""
    told, node = simulation.elements, nodes.of_dofs
    assert told is not None
    names, out = told.dofs or simulation.dofs, []
    rows = [names.index(name) for name in simulation.dofs]
    for place, F in zip(told.places, np.asarray(told.stiffness)[:, rows], strict=True):
        dofs = np.flatnonzero(F.any(axis=1))
        ends = tuple(dict.fromkeys(node[dofs].tolist()))
        if len(ends) == len(set(place)):
            out.append(Part(ends, dofs, F[dofs] @ F[dofs].T))
    return out


def springs_within(simulation: Structure, nodes: Nodes) -> dict[frozenset[int], float]:
    r"""Pairs of DoFs of one direction between which elements that are told are a spring, with its stiffness [N/m].

    The stiffest spring :math:`k\,bb^T` that an element :math:`K_e` holds between them is :math:`1/(b^TK_e^+b)`: what it
    resists ``b`` with where it is free otherwise. An entry of :math:`K_e`, in which bending and twisting may cancel, is
    none. There is no such spring where ``b`` is no combination of its forces, as between two ends of a beam across it:
    that would resist its rigid rotation. Nor is there one where a matrix couples DoFs only since others were condensed.
    """
    told, out = simulation.elements, {}
    assert told is not None
    names = told.dofs or simulation.dofs
    at = {names.index(name): k for k, name in enumerate(simulation.dofs)}
    node = {int(k): j for j, members in enumerate(nodes.members) for k in members}
    for F in np.asarray(told.stiffness):
        rows = np.flatnonzero(F.any(axis=1))
        size = np.linalg.norm(F[rows], axis=1)
        W, strength, _ = np.linalg.svd(F[rows] / size[:, None], full_matrices=False)
        W, strength = W[:, strength > RANK * strength[0]], strength[strength > RANK * strength[0]]
        kept = [(j, at[row]) for j, row in enumerate(rows.tolist()) if row in at]
        for (i, a), (j, b) in itertools.combinations(kept, 2):
            if node[a] == node[b] or nodes.axis[a] != nodes.axis[b]:
                continue
            d = np.zeros(len(rows))
            d[i], d[j] = 1 / size[i], -1 / size[j]
            inside = W.T @ d
            if np.linalg.norm(d - W @ inside) < OUTSIDE * np.linalg.norm(d):
                pair = frozenset((a, b))
                out[pair] = out.get(pair, 0.0) + float(1 / ((inside / strength) ** 2).sum())
    return out


def softened_elements(simulation: Simulation, c: Coordinates, usual: float) -> list[Change]:
    """Whole elements softer or stiffer, and each plane in which one bends by itself.

    ``usual`` is the relative error of one that is wrong. The strength is the change of the stiffness between the two
    DoFs that the element is told at.
    """
    if simulation.elements is None:
        return []
    factors, nodes, out = np.asarray(simulation.elements.stiffness), nodes_of(c.names), []
    node = nodes.of_dofs
    for place, F, pattern in zip(simulation.elements.places, factors, _patterns(factors, c), strict=True):
        at = [c.names.index(name) for name in place if name in c.names]
        stiffness = float(abs(F[at[0]] @ F[at[-1]])) if at else 0.0
        where = place if place[0] != place[1] else place[:1]
        whole = Change("joint_stiffness", where, usual, pattern=pattern, factor=F, reference=stiffness)
        out.append(whole)
        for ends, G, spring in _planes(F, nodes, node):
            where, stiffness = tuple(c.names[k] for k in ends), float(abs(G[ends[0]] @ G[ends[-1]]))
            plane = replace(whole, where=where, factor=G, reference=stiffness, piece=not spring)
            out.append(replace(plane, pattern=_patterns(G[None], c)[0]))
    return out


def _planes(F: np.ndarray, nodes: Nodes, node: np.ndarray) -> list[tuple[tuple[int, ...], np.ndarray, bool]]:
    """Ends and factor ``(n, r)`` of each piece of an element between two nodes, and whether that is a spring.

    ``node`` is that of each DoF, shape ``(n,)``.
    """
    dofs = np.flatnonzero(F.any(axis=1))
    between = tuple(dict.fromkeys(node[dofs].tolist()))
    if len(between) != 2:
        return []
    out = []
    for p in planes_of(Part(between, dofs, F[dofs] @ F[dofs].T), nodes):
        values, vectors = np.linalg.eigh(p.matrix)
        G, ends = np.zeros((len(F), len(p.dofs))), ends_of(p, nodes)
        G[p.dofs] = vectors * np.sqrt(np.maximum(values, 0.0))
        out += [(ends, G, is_spring(p))] if ends else []
    return out


def changed_by_elements(
    simulation: Structure, sizes: dict[str, np.ndarray], causes: Iterable[tuple[Change, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of stiffness and mass ``(n, n)`` by relative sizes of all elements and by causes that have a factor.

    DoFs that follow the others statically follow them by other ratios than before.
    """
    told = simulation.elements
    assert told is not None
    kept = np.isin(told.dofs, simulation.dofs)
    order = np.argsort([simulation.dofs.index(str(name)) for name in np.array(told.dofs)[kept]])
    factors = {"stiffness": np.asarray(told.stiffness), "mass": np.asarray(told.mass)}
    before = {name: np.einsum("enr,emr->nm", F, F, optimize=True) for name, F in factors.items()}
    after = {
        name: whole + np.einsum("e,enr,emr->nm", sizes[name], factors[name], factors[name], optimize=True)
        for name, whole in before.items()
    }
    for cause, u in causes:
        after["mass" if cause.kind == "M" else "stiffness"] += cause.over_dofs(u)
    out = {name: np.zeros_like(np.asarray(simulation.K)) for name in before}
    for sign, matrices in ((1.0, after), (-1.0, before)):
        T = follow(matrices["stiffness"], kept)
        for name, whole in matrices.items():
            out[name] += sign * (T.T @ whole @ T)[np.ix_(order, order)]
    return out["stiffness"], out["mass"]
