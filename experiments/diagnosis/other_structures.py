"""Structures and hidden effects unlike those of the large draws, diagnosed by the command as a user would.

``python experiments/diagnosis/other_structures.py --out FOLDER [--structure ring] [--effect gain] [--seed 0]`` writes
``FOLDER/NAME/measurement.npz``, ``simulation.npz`` and ``truth.json``, runs ``modalax diagnose`` on what has no
``answer.json`` yet, and prints a table of all that the folder holds. Every element's stiffness is off by 1 to 3 %, each
mass by a third of that, every modal damping by 20 %. Nothing of the package is used to make the tests: NumPy and SciPy
only. A joint is solved at its first harmonic.
"""

import argparse
import contextlib
import functools
import io
import json
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy.linalg
from rich.console import Console
from rich.table import Table

from modalax.cli import main as modalax

NOISE, LINES, MODES = 0.01, 5.0, 8  # of each channel's rms; lines to a half-power bandwidth; modes in the band
LEVELS = np.array([1.0, 3.0, 9.0])


@dataclass
class World:
    """A structure as the sum of its elements, each with its DoFs and its matrix."""

    dofs: list[str]
    stiffness: list[tuple[list[int], np.ndarray]]
    mass: list[tuple[list[int], np.ndarray]]
    zeta: float = 0.01
    measurable: list[int] = field(default_factory=list)

    def sum(self, parts: list[tuple[list[int], np.ndarray]], factors: np.ndarray | None = None) -> np.ndarray:
        """Matrix with a factor on each part."""
        out = np.zeros((len(self.dofs), len(self.dofs)))
        for k, (at, matrix) in enumerate(parts):
            out[np.ix_(at, at)] += (1.0 if factors is None else factors[k]) * matrix
        return out

    def node(self, k: int) -> str:
        """Node of a DoF."""
        return self.dofs[k].split(":")[0]

    def translations(self) -> list[int]:
        """DoFs that are no rotations."""
        return [k for k, name in enumerate(self.dofs) if "R" not in name.split(":")[-1] or ":" not in name]


def _bar(x: np.ndarray, y: np.ndarray, EA: float) -> np.ndarray:
    d = y - x
    L = np.linalg.norm(d)
    b = np.concatenate([-d, d]) / L
    return EA / L * np.outer(b, b)


def _beam(d: np.ndarray, EI: float, EA: float, line: float) -> tuple[np.ndarray, np.ndarray]:
    """Planar beam element, (u, v, rotation) at either end."""
    L = float(np.linalg.norm(d))
    k, m, b = np.zeros((6, 6)), np.zeros((6, 6)), [1, 2, 4, 5]
    k[np.ix_([0, 3], [0, 3])] = EA / L * np.array([[1, -1], [-1, 1]])
    m[np.ix_([0, 3], [0, 3])] = line * L / 6 * np.array([[2, 1], [1, 2]])
    k[np.ix_(b, b)] = EI / L**3 * np.array(
        [[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
         [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]]
    )  # fmt: skip
    m[np.ix_(b, b)] = line * L / 420 * np.array(
        [[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
         [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]]
    )  # fmt: skip
    c, s = d / L
    R = np.kron(np.eye(2), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    return R.T @ k @ R, R.T @ m @ R


def beam(rng: np.random.Generator) -> World:
    """A stepped beam on two soft feet, in deflections and rotations."""
    n, L = 13, 0.12
    world = World([f"{k + 1}:{way}" for k in range(n) for way in ("+Z", "+RY")], [], [], 0.008)
    for k in range(n - 1):
        EI = 40.0 * (1.6 if k < 5 else 1.0)
        K, M = _beam(np.array([L, 0.0]), EI, 1.0, 0.9)
        b = np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
        at = [2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3]
        world.stiffness.append((at, K[b]))
        world.mass.append((at, M[b]))
    for k in (2, 10):
        world.stiffness.append(([2 * k], np.array([[4e3]])))
    world.measurable = list(range(0, 2 * n, 2))
    return world


def lumped(rng: np.random.Generator) -> World:
    """A clamped beam whose mass is lumped at its points: rotations have none."""
    n, L = 11, 0.15
    world = World([f"{k + 1}:{way}" for k in range(n) for way in ("+Z", "+RY")], [], [], 0.007)
    for k in range(n):
        b = [1, 2, 4, 5] if k else [4, 5]
        K = _beam(np.array([L, 0.0]), 55.0, 1.0, 1.0)[0][np.ix_(b, b)]
        world.stiffness.append(([2 * k - 2, 2 * k - 1, 2 * k, 2 * k + 1] if k else [0, 1], K))
        world.mass.append(([2 * k], np.array([[rng.uniform(0.1, 0.2)]])))
    world.measurable = list(range(0, 2 * n, 2))
    return world


def ring(rng: np.random.Generator) -> World:
    """A free ring on soft supports: pairs of modes that are all but repeated."""
    n, r = 14, 0.3
    xy = r * np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(n) / n])
    world = World([f"{k + 1}:{way}" for k in range(n) for way in ("+X", "+Y", "+RZ")], [], [], 0.006)
    for k in range(n):
        j = (k + 1) % n
        at = [3 * k, 3 * k + 1, 3 * k + 2, 3 * j, 3 * j + 1, 3 * j + 2]
        K, M = _beam(xy[j] - xy[k], 30.0, 2e6, 0.8)
        world.stiffness.append((at, K))
        world.mass.append((at, M))
    for k in (0, 5, 9):
        world.stiffness.append(([3 * k, 3 * k + 1], 8e2 * np.eye(2)))
    world.measurable = [3 * k + w for k in range(n) for w in (0, 1)]
    return world


def tower(rng: np.random.Generator) -> World:
    """A lattice tower of pinned bars in a plane."""
    bays, w, h = 7, 0.5, 0.6
    xy = np.array([[x, h * level] for level in range(1, bays + 1) for x in (0.0, w)])
    foot = np.array([[0.0, 0.0], [w, 0.0]])
    every = np.concatenate([foot, xy])
    world = World([f"{k + 1}:{way}" for k in range(len(xy)) for way in ("+X", "+Y")], [], [], 0.005)
    bars = []
    for level in range(bays):
        a, b, c, d = (2 * level + k for k in range(4))
        bars += [(a, c), (b, d), (c, d), (a, d) if level % 2 else (b, c)]
    for a, b in bars:
        K = _bar(every[a], every[b], 2.1e6 * rng.uniform(0.8, 1.2))
        keep = [k for k, p in enumerate((a, a, b, b)) if p >= 2]
        at = [2 * (p - 2) + way for p, way in ((a, 0), (a, 1), (b, 0), (b, 1)) if p >= 2]
        world.stiffness.append((at, K[np.ix_(keep, keep)]))
    world.mass = [([2 * k, 2 * k + 1], rng.uniform(0.6, 1.2) * np.eye(2)) for k in range(len(xy))]
    world.measurable = list(range(len(world.dofs)))
    return world


def grid(rng: np.random.Generator) -> World:
    """Masses in a plane grid joined by springs, some to ground; names that tell no direction."""
    rows, columns = 4, 5
    world = World([f"r{a}c{b}" for a in range(rows) for b in range(columns)], [], [], 0.01)
    at = lambda a, b: a * columns + b
    for a in range(rows):
        for b in range(columns):
            for c, d in ((a, b + 1), (a + 1, b)):
                if c < rows and d < columns:
                    k = 5e4 * rng.uniform(0.6, 1.4)
                    world.stiffness.append(([at(a, b), at(c, d)], k * np.array([[1.0, -1], [-1, 1]])))
            if b == 0:
                world.stiffness.append(([at(a, b)], np.array([[6e4 * rng.uniform(0.7, 1.3)]])))
            world.mass.append(([at(a, b)], np.array([[rng.uniform(0.7, 1.3)]])))
    world.measurable = list(range(rows * columns))
    return world


def fork(rng: np.random.Generator) -> World:
    """Two equal cantilevers joined by a weak spring: every mode twice, close by."""
    n, L = 6, 0.12
    world = World([f"{s}{k + 1}:{way}" for s in "LR" for k in range(n) for way in ("+Z", "+RY")], [], [], 0.004)
    for s in range(2):
        for k in range(n):
            K, M = _beam(np.array([L, 0.0]), 25.0, 1.0, 0.7)
            b = [1, 2, 4, 5] if k else [4, 5]
            first = 2 * n * s + 2 * (k - 1)
            at = [first, first + 1, first + 2, first + 3] if k else [first + 2, first + 3]
            world.stiffness.append((at, K[np.ix_(b, b)]))
            world.mass.append((at, M[np.ix_(b, b)]))
    ends = [2 * (n - 3), 2 * n + 2 * (n - 3)]
    world.stiffness.append((ends, 120.0 * np.array([[1.0, -1], [-1, 1]])))
    world.measurable = list(range(0, 4 * n, 2))
    return world


def building(rng: np.random.Generator) -> World:
    """Floors that sway two ways and twist, on columns at four corners: modes close in threes."""
    floors, half = 6, np.array([3.0, 2.6])
    world = World([f"{k + 1}:{way}" for k in range(floors) for way in ("+X", "+Y", "+RZ")], [], [], 0.012)
    for k in range(floors):
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            k_xy = 4e6 * rng.uniform(0.9, 1.1) * np.array([1.0, 1.15])
            T = np.array([[1, 0, -y * half[1]], [0, 1, x * half[0]]])
            T = np.hstack([-T, T]) if k else T
            at = [3 * (k - 1) + j for j in range(6)] if k else [0, 1, 2]
            world.stiffness.append((at, T.T @ np.diag(k_xy) @ T))
        m = 9e3 * rng.uniform(0.95, 1.05)
        world.mass.append(([3 * k, 3 * k + 1, 3 * k + 2], np.diag([m, m, m * (half**2).sum() / 3])))
    world.measurable = list(range(3 * floors))
    return world


def space(rng: np.random.Generator) -> World:
    """A cantilevered space truss, three displacements a node, without a sign in its names."""
    bays, w, h = 5, 0.35, 0.4
    section = np.array([[0, 0], [w, 0], [w / 2, w * 0.8]])
    xyz = np.array([[y, z, h * k] for k in range(bays + 1) for y, z in section])
    world = World([f"{k + 1}:{way}" for k in range(3 * bays) for way in ("+X", "+Y", "+Z")], [], [], 0.005)
    bars = []
    for k in range(bays):
        for c in range(3):
            a, b, up = 3 * k + c, 3 * k + (c + 1) % 3, 3 * (k + 1) + c
            bars += [(a, up), (up, 3 * (k + 1) + (c + 1) % 3), (b, up)]
    for a, b in bars:
        K = _bar(xyz[a], xyz[b], 3e6 * rng.uniform(0.8, 1.2))
        ends = [(p, way) for p in (a, b) for way in range(3)]
        keep = [k for k, (p, _) in enumerate(ends) if p >= 3]
        at = [3 * (p - 3) + way for p, way in ends if p >= 3]
        world.stiffness.append((at, K[np.ix_(keep, keep)]))
    world.mass = [(list(range(3 * k, 3 * k + 3)), rng.uniform(0.4, 0.8) * np.eye(3)) for k in range(3 * bays)]
    world.measurable = list(range(len(world.dofs)))
    return world


def train(rng: np.random.Generator) -> World:
    """A free row of masses, which has a rigid-body mode, in names with neither order nor direction."""
    n = 12
    names = [str(x) for x in rng.permutation(["alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta",
                                              "iota", "kappa", "lambda", "mu"])]  # fmt: skip
    world = World(names, [], [], 0.01)
    for k in range(n - 1):
        world.stiffness.append(([k, k + 1], rng.uniform(0.7, 1.3) * 3e5 * np.array([[1.0, -1], [-1, 1]])))
    world.mass = [([k], np.array([[rng.uniform(1, 3)]])) for k in range(n)]
    world.measurable = list(range(n))
    return world


STRUCTURES: dict[str, Callable[[np.random.Generator], World]] = {
    f.__name__: f for f in (beam, lumped, ring, tower, grid, fork, building, space, train)
}


@dataclass
class Test:
    """One test being made: the true matrices, the channels, and what shows on them."""

    world: World
    M: np.ndarray
    K: np.ndarray
    C_extra: np.ndarray
    outputs: list[int]
    inputs: list[int]
    rng: np.random.Generator
    band: tuple[float, float]
    shape: np.ndarray  # rms motion of every DoF in the modes of the band
    zeta: np.ndarray
    first: float
    truth: dict = field(default_factory=lambda: {"name": "none", "accepted": []})
    on_channels: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    joint: tuple[np.ndarray, Callable[[np.ndarray, np.ndarray], np.ndarray]] | None = None
    hysteretic: bool = False
    decay: float = 0.0  # of an impact window [1/s]
    times: float = 1.0  # the usual size of masses, springs, dampers and elements
    askew: tuple[bool, int, int, float] | None = None  # whether a force, which channel, what DoF it shares, how much

    def tell(self, name: str, *accepted: list[str], size: float | None = None) -> None:
        """Write down the truth."""
        self.truth = {"name": name, "accepted": [sorted(a) for a in accepted], "size": size}

    def lively(self, some: list[int], share: float = 0.35) -> int:
        """One of some DoFs that moves well."""
        rms = self.shape[some]
        return int(self.rng.choice([k for k, r in zip(some, rms, strict=True) if r > share * rms.max()]))


def effect_none(t: Test) -> None:
    """Nothing but the general inaccuracy."""


def effect_mass(t: Test) -> None:
    """A lump that moves with all displacements of its node."""
    k = t.lively(t.world.translations())
    own = [j for j in t.world.translations() if t.world.node(j) == t.world.node(k) or j == k]
    own = own if ":" in t.world.dofs[k] else [k]
    m = t.rng.uniform(0.04, 0.08) * np.trace(t.M[np.ix_(t.world.translations(), t.world.translations())]) / max(
        len({d.split(":")[-1] for d in t.world.dofs if "R" not in d.split(":")[-1]}), 1
    ) if ":" in t.world.dofs[k] else t.rng.uniform(0.04, 0.08) * np.trace(t.M)  # fmt: skip
    m *= t.times
    t.M[own, own] += m
    t.tell("added_mass", *([t.world.dofs[j]] for j in own), size=float(m))


def _strain(t: Test, part: tuple[list[int], np.ndarray]) -> float:
    _, shapes = modes(t.K, t.M)
    some = shapes[:, : 2 * MODES]
    at, matrix = part
    energy = np.einsum("ik,ij,jk->k", some[at], matrix, some[at])
    return float(np.max(energy / np.maximum(np.einsum("ik,ij,jk->k", some, t.K, some), 1e-300)))


def effect_element(t: Test) -> None:
    """One element that is much softer or stiffer."""
    strain = np.array([_strain(t, p) for p in t.world.stiffness])
    few = [k for k in np.argsort(-strain) if len(t.world.stiffness[k][0]) > 1][: max(3, len(strain) // 2)]
    k = int(t.rng.choice(few))
    at, matrix = t.world.stiffness[k]
    size = t.rng.choice([-0.5, 0.8])
    size = size * t.times if size > 0 else 0.5 / t.times - 1
    t.K[np.ix_(at, at)] += size * matrix
    ends = sorted({t.world.node(j) if ":" in t.world.dofs[j] else t.world.dofs[j] for j in at})
    t.tell("joint_stiffness", size=float(size))
    t.truth["nodes"] = ends


def effect_ground(t: Test) -> None:
    """A spring to ground that the simulation has not."""
    k = t.lively(t.world.translations())
    size = t.times * t.rng.uniform(0.15, 0.4) * _modal_stiffness(t, k)
    t.K[k, k] += size
    t.tell("joint_stiffness", [t.world.dofs[k]], size=float(size))


def _modal_stiffness(t: Test, k: int) -> float:
    w = 2 * np.pi * np.sqrt(t.band[0] * t.band[1])
    return w**2 / max(t.shape[k] ** 2, 1e-300) / 4


def effect_off_topology(t: Test) -> None:
    """A spring between two DoFs that nothing joins in the simulation."""
    K0, some = t.world.sum(t.world.stiffness), t.world.translations()
    ways = [d.split(":")[-1] if ":" in d else "" for d in t.world.dofs]
    pairs = [
        (a, b) for a in some for b in some
        if a < b and K0[a, b] == 0 and ways[a] == ways[b] and min(t.shape[[a, b]]) > 0.3 * t.shape[some].max()
    ]  # fmt: skip
    a, b = pairs[int(t.rng.integers(len(pairs)))]
    size = t.times * t.rng.uniform(0.2, 0.5) * min(_modal_stiffness(t, a), _modal_stiffness(t, b))
    v = np.zeros(len(t.K))
    v[[a, b]] = 1, -1
    t.K += size * np.outer(v, v)
    t.tell("joint_stiffness", [t.world.dofs[a], t.world.dofs[b]], size=float(size))


def effect_damper(t: Test) -> None:
    """A damper across a pair that is joined, or to ground."""
    k = t.lively(t.world.translations())
    w = 2 * np.pi * np.sqrt(t.band[0] * t.band[1])
    size = t.times * t.rng.uniform(2, 5) * 2 * t.world.zeta * w / t.shape[k] ** 2
    t.C_extra[k, k] += size
    t.tell("local_damper", [t.world.dofs[k]], size=float(size))


def effect_gain(t: Test) -> None:
    """A sensor whose calibration is wrong."""
    c, factor = int(t.rng.integers(len(t.outputs))), float(t.rng.choice([0.8, 1.15, 1.3]))
    g = np.ones(len(t.outputs))
    g[c] = factor
    t.on_channels = lambda H, f: H * g[:, None]
    t.tell("channel_gain", [t.world.dofs[t.outputs[c]]], size=factor - 1)


def effect_force(t: Test) -> None:
    """A hammer whose calibration is wrong."""
    c, factor = int(t.rng.integers(len(t.inputs))), float(t.rng.choice([0.85, 1.2]))
    g = np.ones(len(t.inputs))
    g[c] = factor
    t.on_channels = lambda H, f: H * g
    t.tell("force_gain", [t.world.dofs[t.inputs[c]]], size=factor - 1)


def effect_sign(t: Test) -> None:
    """A sensor the wrong way round."""
    c = int(t.rng.integers(len(t.outputs)))
    g = np.ones(len(t.outputs))
    g[c] = -1
    t.on_channels = lambda H, f: H * g[:, None]
    t.tell("channel_sign", [t.world.dofs[t.outputs[c]]])


def effect_swap(t: Test) -> None:
    """Two cables exchanged."""
    a, b = t.rng.choice(len(t.outputs), 2, replace=False)
    turn = np.arange(len(t.outputs))
    turn[[a, b]] = turn[[b, a]]
    t.on_channels = lambda H, f: H[..., turn, :]
    t.tell("channel_swap", [t.world.dofs[t.outputs[a]], t.world.dofs[t.outputs[b]]])


def effect_hits(t: Test) -> None:
    """Two hits written down at each other's points."""
    a, b = t.rng.choice(len(t.inputs), 2, replace=False)
    turn = np.arange(len(t.inputs))
    turn[[a, b]] = turn[[b, a]]
    t.on_channels = lambda H, f: H[..., turn]
    t.tell("channel_swap", [t.world.dofs[t.inputs[a]], t.world.dofs[t.inputs[b]]])


def effect_delay(t: Test) -> None:
    """One channel late."""
    c = int(t.rng.integers(len(t.outputs)))
    late = t.rng.uniform(0.15, 0.4) / (2 * np.pi * t.band[1])

    def act(H: np.ndarray, f: np.ndarray) -> np.ndarray:
        H = H.copy()
        H[..., c, :] *= np.exp(-2j * np.pi * f * late)[:, None]
        return H

    t.on_channels = act
    t.tell("time_delay", [t.world.dofs[t.outputs[c]]], size=float(late))


def effect_tuned(t: Test) -> None:
    """A small oscillator that nobody knew of."""
    k = t.lively(t.world.translations())
    w = 2 * np.pi * t.rng.uniform(*np.quantile(t.band, (0.3, 0.7)))
    m = 0.04 / t.shape[k] ** 2
    n = len(t.M)
    M, K, C = (np.pad(A, ((0, 1), (0, 1))) for A in (t.M, t.K, t.C_extra))
    v = np.zeros(n + 1)
    v[[k, n]] = -1, 1
    M[n, n] = m
    t.M, t.K, t.C_extra = M, K + m * w**2 * np.outer(v, v), C + 2 * 0.02 * w * m * np.outer(v, v)
    t.tell("tuned_mass", [t.world.dofs[k]], size=float(m))


def effect_missing(t: Test) -> None:
    """A mode that the simulation has not, such as one of a fixture."""
    w, z = 2 * np.pi * t.rng.uniform(*np.quantile(t.band, (0.3, 0.7))), 0.01
    o, i = (t.rng.standard_normal(len(x)) for x in (t.outputs, t.inputs))
    scale = 0.5 * float(np.median(t.shape[t.outputs])) ** 2
    t.on_channels = lambda H, f: H + scale * np.outer(o, i) * (
        (2j * np.pi * f) ** 2 / (w**2 - (2 * np.pi * f) ** 2 + 2j * z * w * 2 * np.pi * f)
    )[:, None, None]  # fmt: skip
    t.tell("missing_mode", [])


def effect_units(t: Test) -> None:
    """Velocities taken for accelerations."""
    t.on_channels = lambda H, f: H / (2j * np.pi * f)[:, None, None]
    t.tell("units", [])


def effect_hysteretic(t: Test) -> None:
    """Damping that goes with displacement."""
    t.hysteretic = True
    t.zeta = np.maximum(t.zeta, 0.01) * 2
    t.tell("structural_damping", [])


def effect_window(t: Test) -> None:
    """The decay of an impact window."""
    t.decay = t.rng.uniform(1.0, 3.0) * t.world.zeta * 2 * np.pi * t.first
    t.tell("exponential_window", [], size=t.decay)


def effect_crosstalk(t: Test) -> None:
    """A sensor that hears another."""
    a, b = (int(k) for k in t.rng.choice(len(t.outputs), 2, replace=False))
    share = t.rng.uniform(0.04, 0.1)

    def leak(H: np.ndarray, f: np.ndarray) -> np.ndarray:
        out = H.copy()
        out[:, :, a] += share * H[:, :, b]
        return out

    t.on_channels = leak
    t.tell("crosstalk", [t.world.dofs[t.outputs[k]] for k in (a, b)], size=float(share))


def _askew(t: Test, force: bool, channel: int, others: list[int], share: float) -> None:
    """A channel that shares another DoF, at which a rotation counts as a displacement of the same size."""
    own = (t.inputs if force else t.outputs)[channel]
    dof = int(t.rng.choice(others))
    turns = dof not in t.world.translations()
    t.askew = force, channel, dof, share * (float(t.shape[own] / t.shape[dof]) if turns else 1.0)
    t.tell("outside", size=float(t.askew[3]))
    t.truth["where"] = [t.world.dofs[own], t.world.dofs[dof]]


def effect_stray(t: Test) -> None:
    """A shaker that also pushes another point, or a hammer that hits obliquely: no cause of the catalogue."""
    c = int(t.rng.integers(len(t.inputs)))
    others = [k for k in range(len(t.M)) if k != t.inputs[c] and t.shape[k] > 0.2 * t.shape.max()]
    _askew(t, True, c, others, t.rng.uniform(0.05, 0.2))


def effect_tilted(t: Test) -> None:
    """A sensor that also measures another direction of its point: no cause of the catalogue."""
    own = {c: [j for j in range(len(t.M)) if t.world.node(j) == t.world.node(k) and j not in t.outputs]
           for c, k in enumerate(t.outputs)}  # fmt: skip
    c = int(t.rng.choice([c for c, others in own.items() if others]))
    _askew(t, False, c, own[c], t.rng.uniform(0.05, 0.2))


def effect_hum(t: Test) -> None:
    """Mains hum at one line in each multiple of 50 Hz."""

    def pickup(H: np.ndarray, f: np.ndarray) -> np.ndarray:
        out = H.copy()
        for multiple in np.arange(50.0, f[-1], 50.0):
            k = int(np.abs(f - multiple).argmin())
            if f[0] < multiple and abs(f[k] - multiple) < 0.5 * (f[1] - f[0]):
                phase = np.exp(2j * np.pi * t.rng.random(H[:, k].shape))
                out[:, k] += np.sqrt((np.abs(H) ** 2).mean(axis=1)) * phase
        return out

    t.on_channels = pickup
    t.tell("mains_hum", [])


def effect_soft(t: Test) -> None:
    """The whole structure is softer than its simulation, which is no cause but told."""
    t.K *= t.rng.choice([0.9, 0.94])


def _joint(t: Test, name: str, law: Callable[[np.ndarray, np.ndarray, float], np.ndarray]) -> None:
    """A joint between two joined DoFs, or to ground; ``law`` gives its complex stiffness over a usual amplitude."""
    k = t.lively(t.world.translations())
    b = np.zeros(len(t.K))
    b[k] = 1
    w = 2 * np.pi * t.first
    usual = LEVELS[1] * t.shape[k] ** 2 / (2 * t.world.zeta * w**2)  # the first peak at the middle level
    own = t.world.zeta * w**2 / t.shape[k] ** 2
    t.joint = b, lambda A, s: own * law(np.abs(A) / usual, s / (1j * w), 1.0)
    t.tell(name, [t.world.dofs[k]], size=float(own))


def effect_cubic(t: Test) -> None:
    """A hardening spring to ground."""
    _joint(t, "cubic_stiffness", lambda a, s, _: 0.6 * a**2)


def effect_slip(t: Test) -> None:
    """A spring that slips (Jenkins)."""

    def law(a: np.ndarray, s: np.ndarray, _: float) -> np.ndarray:
        x = np.minimum(1.0, 0.25 / np.maximum(a, 1e-12))
        angle = np.arccos(np.clip(1 - 2 * x, -1, 1))
        return (angle - 0.5 * np.sin(2 * angle)) / np.pi + 4j / np.pi * x * (1 - x)

    _joint(t, "elasto_slip", lambda a, s, _: 2.0 * law(a, s, _))


def effect_quadratic(t: Test) -> None:
    """A damper whose force grows with the square of speed."""
    _joint(t, "quadratic_damping", lambda a, s, _: 1j * np.abs(s) ** 2 * a * 1.5)


EFFECTS: dict[str, Callable[[Test], None]] = {
    name.removeprefix("effect_"): f for name, f in list(globals().items()) if name.startswith("effect_")
}


def frf(t: Test, C: np.ndarray, f: np.ndarray, level: np.ndarray | None) -> np.ndarray:
    """Accelerances at sensors and shakers ``(run, f, o, i)``, with the joint's first harmonic."""
    s = 2j * np.pi * f + t.decay
    loss = 1j * C * (2 * np.pi * np.sqrt(t.band[0] * t.band[1])) if t.hysteretic else 0
    Z = s[:, None, None] ** 2 * t.M + (0 if t.hysteretic else s[:, None, None] * C) + t.K + loss
    n = len(t.M)
    b = np.zeros(n) if t.joint is None else np.pad(t.joint[0], (0, n - len(t.joint[0])))
    right = np.zeros((n, len(t.inputs) + 1))
    right[t.inputs, np.arange(len(t.inputs))] = 1
    if t.askew is not None and t.askew[0]:
        right[t.askew[2], t.askew[1]] = t.askew[3]
    right[:, -1] = b
    X = np.linalg.solve(Z, np.broadcast_to(right, (len(f), *right.shape)))
    x, g = X[:, :, :-1], X[:, :, -1]
    if t.askew is not None and not t.askew[0]:
        x = x.copy()
        x[:, t.outputs[t.askew[1]]] += t.askew[3] * x[:, t.askew[2]]
    if t.joint is None or level is None:
        return (x[:, t.outputs] * s[:, None, None] ** 2)[None]
    runs = []
    for F in level:
        rel, drive = np.einsum("n,fni->fi", b, x), (g @ b)[:, None]
        grid = np.geomspace(1e-3, 30.0, 900)
        free = F * np.abs(rel)
        trial = grid[:, None, None] * free
        kappa = t.joint[1](trial, s[:, None])
        miss = trial * np.abs(1 + drive * kappa) - free
        first = np.argmax(miss >= 0, axis=0)  # the lowest branch
        A = np.take_along_axis(trial, first[None], axis=0)[0]
        low, high = np.take_along_axis(trial, np.maximum(first - 1, 0)[None], axis=0)[0], A
        for _ in range(60):  # bisect between the two points of the grid
            mid = np.sqrt(low * high)
            up = mid * np.abs(1 + drive * t.joint[1](mid, s[:, None])) >= free
            low, high = np.where(up, low, mid), np.where(up, mid, high)
        kappa = t.joint[1](high, s[:, None])
        force = kappa * rel / (1 + kappa * drive)
        runs.append((x[:, t.outputs] - np.einsum("fo,fi->foi", g[:, t.outputs], force)) * s[:, None, None] ** 2)
    return np.array(runs)


def modes(K: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared circular frequencies and shapes of unit modal mass, also where some DoFs have no mass."""
    held = np.diag(M) <= 0
    if not held.any():
        return scipy.linalg.eigh(K, M)
    free = ~held
    follow = -np.linalg.solve(K[np.ix_(held, held)], K[np.ix_(held, free)])
    w2, V = scipy.linalg.eigh(K[np.ix_(free, free)] + K[np.ix_(free, held)] @ follow, M[np.ix_(free, free)])
    every = np.zeros((len(K), len(w2)))
    every[free], every[held] = V, follow @ V
    return w2, every


def damping(M: np.ndarray, K: np.ndarray, zeta: np.ndarray | float) -> np.ndarray:
    """Viscous modal damping."""
    w2, V = modes(K, M)
    w, zeta = np.sqrt(np.maximum(w2, 0.0)), zeta * np.ones(len(M))
    zeta = zeta[: len(w)]
    return M @ V @ np.diag(2 * zeta * w) @ V.T @ M


def draw(name: str, effect: str, seed: int, how: dict) -> tuple[dict, dict, dict]:
    """Measurement, simulation and truth."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), zlib.crc32(effect.encode()), seed])
    world = STRUCTURES[name](np.random.default_rng([zlib.crc32(name.encode()), seed]))
    M0, K0 = world.sum(world.mass), world.sum(world.stiffness)
    spread = how.get("spread") or float(rng.choice([0.01, 0.02, 0.03]))
    K = world.sum(world.stiffness, 1 + spread * rng.standard_normal(len(world.stiffness)))
    M = world.sum(world.mass, 1 + spread / 3 * rng.standard_normal(len(world.mass)))
    w2, V = modes(K0, M0)
    f = np.sqrt(np.maximum(w2, 0)) / 2 / np.pi
    rigid = int((f < 1e-4 * f[-1]).sum())
    first, last = rigid + how.get("skip", 0), rigid + how.get("skip", 0) + MODES
    low = 0.6 * f[first] if first == rigid else 0.5 * (f[first - 1] + f[first])
    high = 0.5 * (f[last - 1] + f[last]) if last < len(f) else 1.15 * f[-1]
    shape = np.sqrt((V[:, first:last] ** 2).mean(axis=1))
    some = [k for k in world.measurable if shape[k] > 0.15 * shape[world.measurable].max()]
    outputs = sorted(int(k) for k in rng.choice(some, min(how.get("sensors", 10), len(some)), replace=False))
    inputs = [int(k) for k in rng.choice(some, how.get("inputs", 2), replace=False)]
    zeta = world.zeta * np.exp(0.2 * rng.standard_normal(len(M)))
    t = Test(world, M, K, np.zeros_like(M), outputs, inputs, rng, (low, high), shape, zeta, f[first])
    t.times = how.get("times", 1.0)
    n, bare = len(M0), (M.copy(), K.copy())  # effects change what the test holds
    several_effects(t, effect.split("+")) if "+" in effect else EFFECTS[effect](t)
    # an oscillator, or what outweighs the structure, leaves the damping of the rest as it was
    own = damping(*(bare if len(t.M) > n or t.times > 1 else (t.M, t.K)), t.zeta)
    C = np.pad(own, (0, len(t.M) - n)) + t.C_extra
    step = 2 * world.zeta * f[first] * 1.5 / how.get("lines", LINES)
    freq = np.arange(low, high, max(step, (high - low) / 1600))
    level = LEVELS if t.joint is not None or how.get("levels") else None
    H = frf(t, C, freq, level)
    H = np.repeat(H, len(LEVELS), axis=0) if level is not None and len(H) == 1 else H
    H = H if t.on_channels is None else t.on_channels(H, freq)
    sigma = NOISE * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True))
    repeats = 1 if how.get("variance") == "missing" else how.get("repeats", 20)
    e = [rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape) for _ in range(repeats)]
    e = np.array(e) * sigma * np.sqrt(repeats / 2)
    data = {
        "freq": freq, "H": H + e.mean(axis=0), "level": np.full(1, np.nan) if level is None else level,
        "outputs": [world.dofs[k] for k in outputs], "inputs": [world.dofs[k] for k in inputs], "form": "accelerance",
    }  # fmt: skip
    if repeats > 1:
        data |= {"variance": (np.abs(e - e.mean(axis=0)) ** 2).sum(axis=0) / (repeats - 1) / repeats,
                 "averages": repeats}  # fmt: skip
    turn = rng.permutation(n)  # the simulation lists its DoFs in another order
    C0 = damping(M0, K0, world.zeta)
    simulation = {key: A[np.ix_(turn, turn)] for key, A in (("M", M0), ("C", C0), ("K", K0))}
    simulation["dofs"] = [world.dofs[k] for k in turn]
    return data, simulation, {**t.truth, "structure": name, "effect": effect, "spread": spread, "lines": len(freq)}


def several_effects(t: Test, effects: Sequence[str]) -> None:
    """One effect after the other."""
    truths, on_channels = [], []
    for effect in effects:
        t.on_channels = None
        EFFECTS[effect](t)
        truths.append(t.truth)
        on_channels += [] if t.on_channels is None else [t.on_channels]
    if on_channels:
        t.on_channels = lambda H, f: functools.reduce(lambda x, channel: channel(x, f), on_channels, H)
    t.truth = {"name": " + ".join(truth["name"] for truth in truths), "accepted": [], "both": truths}


def judged(truth: dict, said: dict) -> str:
    """``right``, ``leading`` (right, not named), ``set`` (among the rivals), ``half``, ``wrong`` or ``no name``."""
    named = said["verdict"] == "named"
    if "both" in truth:
        return judged_both(truth["both"], said)
    if truth["name"] == "outside":  # without a name, but the reasons may tell the channel and the DoF
        told = any(all(f" {dof} " in f"{r} " for dof in truth["where"]) for r in said["reasons"])
        return "wrong" if named else "right" if told and said["verdict"] == "unknown" else "no name"
    if truth["name"] == "none":
        return "right" if said["verdict"] == "clean" else "wrong" if named else "no name"

    def fits(causes: list[dict]) -> bool:
        if {c["name"] for c in causes} != {truth["name"]}:
            return False
        nodes = sorted({str(w).split(":")[0] for c in causes for w in c["where"]})
        if len(causes) > 1:  # a mount that is wrong in all its directions is told at each
            return nodes == truth.get("nodes") and len(nodes) == 1
        where = sorted(map(str, causes[0]["where"]))
        return where in truth["accepted"] or (bool(truth.get("nodes")) and nodes == truth["nodes"])

    if fits(said["causes"]):
        return "right" if named else "leading"
    if named:
        return "wrong"
    return "set" if any(fits(s) for s in said["alternatives"]) else "no name"


def judged_both(truths: list[dict], said: dict) -> str:
    """The same of several effects; ``half`` where some are named and nothing else is."""

    def told(causes: list[dict]) -> tuple[int, int]:
        """How many effects are among the causes, and how many causes are none of them."""
        own = [[c for c in causes if c["name"] == truth["name"]] for truth in truths]
        alone = [{"verdict": "named", "causes": some, "alternatives": []} for some in own]
        hit = [bool(a["causes"]) and judged(t, a) == "right" for t, a in zip(truths, alone, strict=True)]
        fitting = sum(len(some) for some, right in zip(own, hit, strict=True) if right)
        return sum(hit), len(causes) - fitting

    count, others = told(said["causes"])
    if (count, others) == (len(truths), 0):
        return "right" if said["verdict"] == "named" else "leading"
    if said["verdict"] == "named":
        return "half" if count and not others else "wrong"
    return "set" if any(told(s) == (len(truths), 0) for s in said["alternatives"]) else "no name"


def tell(folder: Path) -> None:
    """A row a case, and counts."""
    table = Table("case", "spread", "lines", "hidden", "size", "answer", "said", "off by %", "CPU s")
    counts: Counter = Counter()
    for file in sorted(folder.glob("*/answer.json")):
        said, truth = json.loads(file.read_text()), json.loads((file.parent / "truth.json").read_text())
        what = judged(truth, said)
        counts[what] += 1
        told = "; ".join(
            f"{c['name']} {'-'.join(map(str, c['where']))} " + " ".join(
                f"{p['value']:.3g}" for p in c["parameters"].values()) for c in said["causes"]
        )  # fmt: skip
        inaccuracy = ((said.get("inaccuracy") or {}).get("stiffness") or {}).get("value")
        off = "" if inaccuracy is None else f"{100 * inaccuracy:.2f}"
        where = truth.get("nodes") or truth.get("where") or (truth["accepted"] or [""])[0]
        table.add_row(
            file.parent.name, f"{100 * truth['spread']:.0f} %", str(truth["lines"]),
            f"{truth['name']} {'-'.join(where)}", f"{truth.get('size') or 0:.3g}", what, f"{said['verdict']} {told}",
            off, f"{truth['cpu']:.0f}",
        )  # fmt: skip
    Console(width=190).print(table)
    print(", ".join(f"{k} {v}" for k, v in counts.most_common()))


def ask(folder: Path, truth: dict, seconds: float) -> str:
    """Run the command on one test, and judge its answer."""
    began, start, said = time.process_time(), time.perf_counter(), io.StringIO()
    command = [
        "diagnose", str(folder / "measurement.npz"), "--simulation", str(folder / "simulation.npz"), "--json",
        str(folder / "answer.json"), "--time", str(seconds),
    ]  # fmt: skip
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = modalax(command)
    truth["cpu"] = time.process_time() - began
    (folder / "said.txt").write_text(said.getvalue())
    (folder / "truth.json").write_text(json.dumps(truth))
    if status:
        return f"failed: {said.getvalue().strip()}"
    what = judged(truth, json.loads((folder / "answer.json").read_text()))
    return f"{what}, {truth['cpu']:.0f} CPU s, {time.perf_counter() - start:.0f} s"


def as_modes(simulation: dict, count: int) -> dict:
    """The simulation as its lowest modes that vibrate, at all degrees of freedom; rigid bodies as a residual term."""
    M, C, K = (np.asarray(simulation[key]) for key in ("M", "C", "K"))
    values, shapes = scipy.linalg.eigh(K, M)
    rigid = values < 1e-9 * values[-1]
    some = np.flatnonzero(~rigid)[:count]
    w, phi, free = np.sqrt(values[some]), shapes[:, some], shapes[:, rigid]
    return {
        "frequency_hz": w / 2 / np.pi, "damping_ratio": np.einsum("nk,nm,mk->k", phi, C, phi) / 2 / w,
        "shapes": phi.T, "modal_mass": np.ones(len(some)), "lower": free @ free.T,
        "outputs": simulation["dofs"], "inputs": simulation["dofs"],
    }  # fmt: skip


def main() -> None:
    """Draw, ask, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--structure", nargs="+", choices=STRUCTURES, default=list(STRUCTURES))
    parser.add_argument("--effect", nargs="+", choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--spread", type=float)
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--inputs", type=int, default=2)
    parser.add_argument("--lines", type=float, default=LINES)
    parser.add_argument("--skip", type=int, default=0, help="elastic modes below the band")
    parser.add_argument("--times", type=float, default=1.0, help="the size of masses, springs, dampers and elements")
    parser.add_argument("--variance", choices=("repeats", "missing"), default="repeats")
    parser.add_argument("--levels", action="store_true", help="three force levels for every effect")
    parser.add_argument("--case", default="", help="STRUCTURE-EFFECT or STRUCTURE-EFFECT+EFFECT,... instead of all")
    parser.add_argument("--name", default="", help="added to the names of the cases")
    parser.add_argument(
        "--modes", type=int, default=0, help="the simulation is given as so many modes, not as matrices"
    )
    parser.add_argument("--time", type=float, default=600.0)
    args = parser.parse_args()
    how = {k: getattr(args, k) for k in ("spread", "sensors", "inputs", "lines", "skip", "times", "variance", "levels")}
    pairs = [(s, e) for e in args.effect for s in args.structure]
    known = [f"{structure}-{effect}" for structure in STRUCTURES for effect in EFFECTS]
    asked = [case for case in args.case.split(",") if case]
    every = [f"{case.split('-')[0]}-{effect}" for case in asked for effect in case.split("-", 1)[-1].split("+")]
    if other := [case for case in every if case not in known]:
        parser.error(f"--case {','.join(other)} is none of {', '.join(known)}")
    for structure, effect in [tuple(case.split("-")) for case in asked] or pairs:
        folder = args.out / f"{structure}-{effect}-{args.seed}{args.name}"
        if (folder / "answer.json").exists():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        data, simulation, truth = draw(structure, effect, args.seed, how)
        np.savez(folder / "measurement.npz", **data)
        np.savez(folder / "simulation.npz", **as_modes(simulation, args.modes) if args.modes else simulation)
        print(folder.name, ask(folder, truth, args.time), flush=True)
    tell(args.out)


if __name__ == "__main__":
    main()
