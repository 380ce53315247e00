"""Every cause at every place that the simulation's own topology has."""

import itertools
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import channel_faults
from modalax.diagnose.modal_domain.causes.connections import flexible_ends
from modalax.diagnose.modal_domain.causes.given_elements import softened_elements, springs_within, told_parts
from modalax.diagnose.modal_domain.causes.groups import group_factors, other_than
from modalax.diagnose.modal_domain.causes.supports import sensor_masses, supports_together
from modalax.diagnose.modal_domain.causes.within_elements import PlateElement
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation
from modalax.diagnose.modal_domain.structure.nodes import Nodes, nodes_of
from modalax.diagnose.modal_domain.structure.parts import ends_of, is_spring, parts_of, planes_of
from modalax.diagnose.modal_domain.structure.turns import nodes_at

COUPLED = 1e-6  # size of an element of K, relative to the diagonal, from which two DoFs are coupled
LUMP = 0.3  # usual lumped mass, relative to the modal masses seen from its place
OVERDAMPED = 2.0  # usual relative error of a modal damping ratio that is wrong
JOINT = 0.4  # usual relative error of a joint or element that is wrong
HELD, SUPPORTED = 6, 1e-5  # most DoFs of one support; stiffness, relative to all at the DoF, that rounding may leave
# Chances of places of springs and dampers relative to each other, each shared out among its places
SHARES = {
    "named": 0.4, "spring": 0.3, "element": 0.2, "support": 0.15, "coupled": 0.05, "plane": 0.05, "ground": 0.05,
    "apart": 0.03, "end": 0.1, "supports": 0.1, "some supports": 0.05,
}  # fmt: skip
FEW = 80  # DoFs of which any two may be joined by a spring that the simulation has not; of more, the measured ones
ABSENT = "ground", "apart"  # places where the simulation has no spring that could be off
SENSORS = 0.3  # chance that all sensors have mass, relative to that of one lumped mass anywhere
STILL = 1e-12  # square of a displacement, relative to the largest in the band, below which a DoF does not move
UNLIKELY = 0.05  # weight of a pair of unlike directions, or of a rotation's inertia


def candidates_of(
    simulation: Simulation, c: Coordinates, outputs: tuple[str, ...], inputs: tuple[str, ...],
    pairs: list[tuple[str, str]] | None, highest: float,
) -> list[Change]:  # fmt: skip
    """Causes at their places."""
    dofs, nodes = simulation.dofs, nodes_at(simulation)
    inside = np.flatnonzero((c.frequencies < highest) & (c.frequencies > 0.02 * highest))
    if not len(inside):
        inside = np.arange(min(3, c.size))
    out = []
    own, own_mass, turns = np.diag(c.damping)[inside], _own_mass(simulation, c, inside), nodes.axis > 2
    typical = _typical((c.shapes[:, inside] ** 2).mean(axis=1), turns)
    for k, name in enumerate(dofs):
        b = c.shapes[k]
        mobile = float((b[inside] ** 2).mean())
        if mobile < STILL * float((c.shapes[:, inside] ** 2).max()):
            continue
        weight, usual = UNLIKELY if turns[k] else 1.0, LUMP / max(mobile, typical[k])
        out.append(Change("added_mass", (name,), usual, b, reference=float(own_mass[k]), weight=weight))
    out += _lumps(simulation, c, inside)
    out += _sensor_masses(out, outputs, c)
    apart = next((some for some in (dofs, {*outputs, *inputs}) if len(some) <= FEW), ())
    for where, b, stiffness, weight, there in springs_of(simulation, c, nodes, pairs, highest, apart):
        mobile = b[inside] ** 2
        if mobile.mean() < STILL * float((c.shapes[:, inside] ** 2).max()):
            continue
        out.append(
            Change("joint_stiffness", where, stiffness, b, reference=stiffness / JOINT, weight=weight, absent=not there)
        )
        damping = float((own / np.maximum(mobile, 1e-300)).min())  # that doubles the damping of one mode
        usual = float(own.mean() / mobile.mean())
        out.append(Change("local_damper", where, usual, b, reference=damping, weight=weight))
    parts = _parts(simulation, nodes)
    elements = _elements(simulation, c, nodes, parts)
    groups = group_factors(simulation, c, SHARES["element"] / max(sum(not e.piece for e in elements), 1))
    out = other_than(groups, out + elements) + groups
    shares = SHARES["supports"], SHARES["some supports"]
    out += other_than(groups, supports_together(simulation, c, parts, nodes, JOINT, *shares))
    out += channel_faults(outputs, inputs, highest)
    return out + _damped_modes(c, inside)


def _typical(mobile: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Median over all displacements, or all rotations, of how much they move: a mass is of the size of the structure's.

    Where a DoF hardly moves in the band, the modal masses seen from it say nothing of what may sit there.
    """
    medians = [float(np.median(mobile[turns == kind])) if (turns == kind).any() else 0.0 for kind in (False, True)]
    return np.where(turns, medians[1], medians[0])


def _own_mass(simulation: Simulation, c: Coordinates, inside: np.ndarray) -> np.ndarray:
    """Mass that the simulation has at each DoF; of modes alone the least modal mass as seen from there."""
    if isinstance(simulation, ModesOnly):
        return 1 / np.maximum((c.shapes[:, inside] ** 2).max(axis=1), 1e-300)
    return np.diag(np.asarray(simulation.M))


def _lumps(simulation: Simulation, c: Coordinates, inside: np.ndarray) -> list[Change]:
    """Masses that move with all displacements of a node, each told at the DoF where it moves most.

    Also of a node that follows others statically: what is rigidly tied to them may still be heavier.
    """
    nodes, mobile = nodes_of(c.names), (c.everywhere[:, inside] ** 2).mean(axis=1)
    own = dict(zip(simulation.dofs, _own_mass(simulation, c, inside).tolist(), strict=True))
    typical, out = _typical(mobile, nodes.axis > 2), []
    each = np.min if isinstance(simulation, ModesOnly) else np.mean
    for node in nodes.members:
        at = node[(nodes.axis[node] >= 0) & (nodes.axis[node] < 3) & (mobile[node] > STILL * mobile.max())]
        if len(at) < 2:
            continue
        place = (c.names[at[np.argmax(mobile[at])]],)
        pattern = c.everywhere[at].T @ c.everywhere[at]
        usual = LUMP / max(float(mobile[at].sum()), float(typical[at[0]]))
        there = [own[c.names[k]] for k in at if c.names[k] in own]
        out.append(
            Change("added_mass", place, usual, pattern=pattern, factor=np.eye(len(c.names))[:, at],
                   reference=float(each(there or [0.0])))
        )  # fmt: skip
    return out


def _sensor_masses(masses: list[Change], outputs: tuple[str, ...], c: Coordinates) -> list[Change]:
    """The mass of all sensors, together as usual as one lumped mass."""
    if not masses:
        return []
    usual, every = float(np.median([m.scale for m in masses])), sum(m.weight for m in masses)
    return sensor_masses(outputs, c, usual / len(outputs), SENSORS * every)


def _damped_modes(c: Coordinates, inside: np.ndarray) -> list[Change]:
    """Damping of one mode by itself; sizes are relative to what the simulation has."""
    out = []
    for r in inside:
        pattern = np.zeros((c.size, c.size))
        pattern[r, r] = c.damping[r, r]
        out.append(Change("modal_damping", (int(r) + 1,), OVERDAMPED, pattern=pattern, reference=1.0))
    return out


def _parts(simulation: Simulation, nodes: Nodes) -> list[Part]:
    """Elements that are told, or else those of its stiffness matrix; none of modes alone."""
    if isinstance(simulation, ModesOnly):
        return []
    told = simulation.elements is not None
    return told_parts(simulation, nodes) if told else parts_of(np.asarray(simulation.K), nodes)


def _elements(simulation: Simulation, c: Coordinates, nodes: Nodes, parts: list[Part]) -> list[Change]:
    """Whole elements softer or stiffer, and planes in which they bend; told at the pair of DoFs that they couple most.

    An element that holds one node is told at one DoF.
    """
    size = np.sqrt(np.maximum(_stiffness(simulation), 1e-300))
    out = softened_elements(simulation, c, JOINT)
    ends = flexible_ends(parts, nodes, simulation.dofs, c, JOINT)
    parts = parts if not out else []
    for part in (p for p in parts if len(p.nodes) > 1 and len(p.dofs) > 2):
        for p in (part, *planes_of(part, nodes)):
            two = ends_of(p, nodes)
            where = tuple(simulation.dofs[k] for k in two)
            pattern = c.shapes[p.dofs].T @ p.matrix @ c.shapes[p.dofs]
            if where and len(p.nodes) > 2:
                alike = p.dofs[nodes.axis[p.dofs] == nodes.axis[two[0]]]
                corners = tuple(simulation.dofs[k] for k in alike)
                out.append(PlateElement("joint_stiffness", where, JOINT, pattern=pattern, corners=corners))
            elif where:
                out.append(
                    Change("joint_stiffness", where, JOINT, pattern=pattern, piece=p is not part and not is_spring(p))
                )
    for part in (p for p in parts if len(p.nodes) == 1 and len(p.dofs) > 1):
        own = np.diag(part.matrix)
        if np.abs(part.matrix - np.diag(own)).max() < COUPLED * np.abs(own).max():  # springs, each by itself
            continue
        straight = (nodes.axis[part.dofs] < 3) if (nodes.axis[part.dofs] < 3).any() else np.ones(len(own), bool)
        k = part.dofs[np.argmax(np.where(straight, own / size[part.dofs] ** 2, -np.inf))]
        pattern = c.shapes[part.dofs].T @ part.matrix @ c.shapes[part.dofs]
        out.append(Change("joint_stiffness", (simulation.dofs[k],), JOINT, pattern=pattern))
    pieces = sum(e.piece for e in out)
    shares = {False: SHARES["element"] / max(len(out) - pieces, 1), True: SHARES["plane"] / max(pieces, 1)}
    return [replace(e, weight=shares[e.piece]) for e in out] + [
        replace(e, weight=SHARES["end"] / len(ends)) for e in ends
    ]


def springs_of(
    simulation: Simulation, c: Coordinates, nodes: Nodes, pairs: list[tuple[str, str]] | None, highest: float,
    apart: Collection[str] = (),
) -> list[tuple[tuple[str, ...], np.ndarray, float, float, bool]]:  # fmt: skip
    """Place, direction, usual change of stiffness and weight of springs, and whether the simulation has one there.

    Likeliest are the pairs that the simulation names and its own springs and supports, then other coupled DoFs and
    each DoF to ground, and last any two displacements of one direction, of those in ``apart``, that nothing joins.
    Where elements are told they tell where the simulation has springs, and how stiff.
    Modes alone do not tell whether there is one: it may be anywhere, and is compared with what makes the modes.
    Where the simulation has no spring, as between two points of a plate, its size is compared with what holds the DoFs,
    and the usual one is small enough to move modes by as much as a wrong one does.
    """
    inside = np.flatnonzero((c.frequencies < highest) & (c.frequencies > 0.02 * highest))
    dofs, size = simulation.dofs, _stiffness(simulation)
    asked = {frozenset(dofs.index(name) for name in p) for p in pairs or () if set(p) <= set(dofs)}
    parts = _parts(simulation, nodes)
    anywhere = isinstance(simulation, ModesOnly)
    if isinstance(simulation, ModesOnly):
        within: dict[frozenset[int], float] = {}
    elif simulation.elements is None:
        within = read_within(np.asarray(simulation.K), parts, asked)
    else:
        within = springs_within(simulation, nodes)
        joined = _joined(parts, nodes)
        asked = asked - joined if asked >= joined else asked  # to name all that elements join is to name none
    own = {frozenset(p.dofs.tolist()) for p in parts if len(p.nodes) == 2 and len(p.dofs) == 2}
    supports = [p for p in parts if len(p.nodes) == 1 and len(p.dofs) <= HELD]
    held = {int(k): p.matrix[j, j] for p in supports for j, k in enumerate(p.dofs)}
    groups: dict[str, list] = {key: [] for key in SHARES}
    some = [k for k, name in enumerate(dofs) if not anywhere or name in apart]
    for a, b in itertools.combinations(some, 2):
        pair = frozenset((a, b))
        key = "named" if pair in asked else "spring" if pair in own else "coupled" if pair in within else "apart"
        alike = nodes.axis[a] == nodes.axis[b]
        if key == "coupled" and not alike:
            continue
        free = nodes.axis[a] < 3 or anywhere  # what bends between two nodes shows as a spring between their rotations
        if key == "apart" and not (alike and free and dofs[a] in apart and dofs[b] in apart):
            continue
        stiffness = within[pair] if pair in within else float(min(size[a], size[b]))
        groups[key].append(((dofs[a], dofs[b]), c.shapes[a] - c.shapes[b], JOINT * stiffness, 1.0, pair in within))
    for a, name in enumerate(dofs):
        supported = held.get(a, 0.0) > SUPPORTED * size[a]
        entry = (name,), c.shapes[a], JOINT * (held[a] if supported else size[a])
        likely = UNLIKELY if nodes.axis[a] > 2 else 1.0
        groups["support" if supported else "ground"].append((*entry, likely, supported))
    out = []
    for key, group in groups.items():
        total = sum(g[3] for g in group)
        if key in ABSENT:
            group = [(where, b, min(k, JOINT * _felt(c, b, inside)), *rest) for where, b, k, *rest in group]
        out += [(where, b, float(k), SHARES[key] * w / total, there or anywhere) for where, b, k, w, there in group]
    return out


def _stiffness(simulation: Simulation) -> np.ndarray:
    """What holds each DoF by itself; infinite where the simulation does not tell."""
    return np.full(len(simulation.dofs), np.inf) if isinstance(simulation, ModesOnly) else np.diag(simulation.K)


def read_within(K: np.ndarray, parts: list[Part], asked: set[frozenset[int]]) -> dict[frozenset[int], float]:
    """Pairs of DoFs that a matrix couples, with the stiffness there: the entry itself where parts can be read off.

    Two DoFs with no third that is coupled to both can only be joined by a spring, whatever else cannot be read off.
    """
    size = np.sqrt(np.maximum(np.diag(K), 1e-300))
    unit = np.abs(K) / size[:, None] / size
    read = {frozenset(pair) for p in parts if p.nodes for pair in itertools.combinations(p.dofs.tolist(), 2)}
    joined, out = unit >= COUPLED, {}
    np.fill_diagonal(joined, False)
    for a, b in np.argwhere(np.triu(joined)).tolist():
        pair = frozenset((a, b))
        alone = K[a, b] < 0 and not (joined[a] & joined[b]).any()
        told = unit[a, b] > 1e-3 and (pair in asked or pair in read) or alone
        out[pair] = float(abs(K[a, b]) if told else min(K[a, a], K[b, b]))
    return out


def _joined(parts: list[Part], nodes: Nodes) -> set[frozenset[int]]:
    """Pairs of DoFs of one direction that elements join."""
    pairs = (pair for p in parts for pair in itertools.combinations(p.dofs.tolist(), 2))
    return {frozenset(pair) for pair in pairs if nodes.axis[pair[0]] == nodes.axis[pair[1]]}


def _felt(c: Coordinates, b: np.ndarray, inside: np.ndarray) -> float:
    """Stiffness that doubles that of the mode of the band which feels it most; infinite where none does."""
    if not len(inside):
        return np.inf
    return float((c.frequencies[inside] ** 2 / np.maximum(b[inside] ** 2, 1e-300)).min())
