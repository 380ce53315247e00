"""Every cause at every place that the simulation's own topology has."""

import itertools

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.elements import Nodes, nodes_of
from modalax.model import Structure

COUPLED = 1e-6  # size of an element of K, relative to the diagonal, from which two DoFs are coupled
GAIN, DELAY = 0.3, 3e-2  # usual error of a channel's gain; of a delay, as phase at the highest mode over pi
LUMP = 0.3  # usual lumped mass, relative to the modal masses seen from its place
UNLIKELY = 0.05  # weight of a pair of unlike directions, or of a rotation's inertia


def candidates_of(
    simulation: Structure, c: Coordinates, outputs: tuple[str, ...], inputs: tuple[str, ...],
    pairs: list[tuple[str, str]] | None, highest: float,
) -> list[Change]:  # fmt: skip
    """Causes at their places."""
    dofs, nodes = simulation.dofs, nodes_of(simulation.dofs)
    inside = np.flatnonzero((c.frequencies < highest) & (c.frequencies > 0.02 * highest))
    if not len(inside):
        inside = np.arange(min(3, c.size))
    out = []
    own = np.diag(c.damping)[inside]
    for k, name in enumerate(dofs):
        b = c.shapes[k]
        mobile = float((b[inside] ** 2).mean())
        if mobile < 1e-12 * float((c.shapes[:, inside] ** 2).max()):
            continue
        turning = nodes.axis[k] > 2
        out.append(Change("added_mass", (name,), LUMP / mobile, b, weight=UNLIKELY if turning else 1.0))
    for where, b, stiffness, weight in _springs(simulation, c, nodes, pairs):
        mobile = float((b[inside] ** 2).mean())
        if mobile < 1e-12 * float((c.shapes[:, inside] ** 2).max()):
            continue
        out.append(Change("joint_stiffness", where, stiffness, b, weight=weight))
        out.append(Change("local_damper", where, float(own.mean()) / mobile, b, weight=weight))
    out += [Change("channel_gain", (n,), GAIN, channel=(0, k)) for k, n in enumerate(outputs)]
    out += [Change("channel_sign", (n,), channel=(0, k)) for k, n in enumerate(outputs)]
    out += [Change("force_gain", (n,), GAIN, channel=(1, k)) for k, n in enumerate(inputs)]
    out += [
        Change("channel_swap", (outputs[a], outputs[b]), channel=(a, b))
        for a, b in itertools.combinations(range(len(outputs)), 2)
    ]
    out += [Change("time_delay", (n,), DELAY * np.pi / highest, channel=(0, k)) for k, n in enumerate(outputs)]
    return out


def _springs(
    simulation: Structure, c: Coordinates, nodes: Nodes, pairs: list[tuple[str, str]] | None
) -> list[tuple[tuple[str, ...], np.ndarray, float, float]]:
    """Place, direction, usual stiffness and weight of springs: named pairs, coupled DoFs, and each DoF to ground."""
    K, dofs = np.asarray(simulation.K), simulation.dofs
    size = np.sqrt(np.maximum(np.diag(K), 1e-300))
    unit = np.abs(K) / size[:, None] / size
    asked = {frozenset(p) for p in pairs or ()}
    named, coupled, ground = [], [], []
    for a, b in itertools.combinations(range(len(dofs)), 2):
        mine = frozenset((dofs[a], dofs[b])) in asked
        if not mine and unit[a, b] < COUPLED:
            continue
        alike = nodes.axis[a] == nodes.axis[b]
        if not mine and not alike:
            continue
        stiffness = abs(K[a, b]) if unit[a, b] > 1e-3 else min(K[a, a], K[b, b])
        entry = (dofs[a], dofs[b]), c.shapes[a] - c.shapes[b], stiffness
        (named if mine else coupled).append(entry)
    for a, name in enumerate(dofs):
        ground.append(((name,), c.shapes[a], K[a, a], UNLIKELY if nodes.axis[a] > 2 else 1.0))
    shares = (0.7, 0.2, 0.1) if named else (0.0, 0.8, 0.2)
    out = []
    for share, group in zip(shares, (named, coupled, ground), strict=True):
        total = sum(g[3] if len(g) > 3 else 1.0 for g in group)
        out += [(g[0], g[1], float(g[2]), share * (g[3] if len(g) > 3 else 1.0) / total) for g in group]
    return out
