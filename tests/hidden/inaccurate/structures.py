"""Structures built element by element, so that every element can be off by itself: frames, plates, shafts.

20 to 60 degrees of freedom; a ``Build`` keeps the elements apart until they are assembled with factors on stiffness and
mass. DoFs in ``deflections`` can be measured and driven; rotations of frames and plates cannot.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from generator.systems import beam, log_uniform
from scipy.sparse.csgraph import connected_components

KINDS = ("frame", "plate", "shaft")
SMALL = "small"  # a kind that is drawn only where it is asked for: shafts and trees of a few degrees of freedom


@dataclass(frozen=True)
class Element:
    """Stiffness and mass on the DoFs ``at``; ``kind`` is beam, plate, spring or lump.

    ``where``: for springs the DoFs that they join (one: to ground), for beams the rotations of both ends.
    """

    kind: str
    at: np.ndarray
    k: np.ndarray
    m: np.ndarray
    where: tuple[int, ...] = ()


@dataclass(frozen=True)
class Build:
    """A structure in elements; ``rigid`` counts its rigid-body modes, soft suspension modes included."""

    dofs: list[str]
    elements: list[Element]
    deflections: list[int]
    kind: str
    variant: str
    rigid: int

    @property
    def n(self) -> int:
        return len(self.dofs)

    def assemble(self, stiffness: np.ndarray | float = 1.0, mass: np.ndarray | float = 1.0):
        """``M, K`` with every element times its factor."""
        M, K = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        fk, fm = (np.broadcast_to(f, len(self.elements)) for f in (stiffness, mass))
        for e, a, b in zip(self.elements, fk, fm, strict=True):
            K[np.ix_(e.at, e.at)] += a * e.k
            M[np.ix_(e.at, e.at)] += b * e.m
        return M, K

    def direction(self, where: tuple[int, ...]) -> np.ndarray:
        """Relative displacement of a place: +1 at the first DoF, -1 at the second if there is one."""
        b = np.zeros(self.n)
        b[list(where)] = [1.0, -1.0][: len(where)]
        return b

    @property
    def springs(self) -> list[int]:
        return [j for j, e in enumerate(self.elements) if e.kind == "spring"]


def spring(where: tuple[int, ...], k: float) -> Element:
    b = np.array([1.0, -1.0][: len(where)])
    return Element("spring", np.array(where), k * np.outer(b, b), np.zeros((len(where),) * 2), where)


def lump(at: int, m: float) -> Element:
    return Element("lump", np.array([at]), np.zeros((1, 1)), np.array([[m]]))


def modes(M, K):
    """Circular frequencies, rising, and mass-normalised shapes; a body's motion in free space has exactly 0."""
    square, shapes = scipy.linalg.eigh(K, M)
    size = np.einsum("dr,de,er->r", np.abs(shapes), np.abs(K), np.abs(shapes))  # what rounding is relative to
    return np.sqrt(np.where(square < 1e-9 * size, 0.0, square)), shapes


# frames -----------------------------------------------------------------------------------------------------------


def _aeroplane(rng):
    fuselage, half = int(rng.integers(5, 7)), int(rng.integers(2, 4))
    nodes, links = [(x, 0.0) for x in np.linspace(0, 1.6, fuselage)], [(k, k + 1) for k in range(fuselage - 1)]
    for at, span, count in ((fuselage // 2, rng.uniform(0.8, 1.2), half), (fuselage - 1, 0.35, 1)):
        for side in (-1.0, 1.0):
            last = at
            for y in np.linspace(0, span, count + 1)[1:]:
                nodes.append((nodes[at][0] + 0.2 * y, side * y))
                links.append((last, len(nodes) - 1))
                last = len(nodes) - 1
    return nodes, links


def _ladder(rng):
    bays, width = int(rng.integers(3, 6)), rng.uniform(0.25, 0.5)
    x = np.cumsum(rng.uniform(0.25, 0.45, bays + 1))
    nodes = [(u, v) for u in x for v in (0.0, width)]
    links = [(2 * k, 2 * k + 1) for k in range(bays + 1)]
    links += [(2 * k + side, 2 * k + 2 + side) for k in range(bays) for side in (0, 1)]
    return nodes, links


def _cross(rng):
    nodes, links = [(0.0, 0.0)], []
    for angle in np.cumsum(rng.uniform(1.2, 2.2, int(rng.integers(3, 5)))):
        last, length, each = 0, rng.uniform(0.4, 0.9), int(rng.integers(3, 5))
        for r in np.linspace(0, length, each + 1)[1:]:
            nodes.append((r * np.cos(angle), r * np.sin(angle)))
            links.append((last, len(nodes) - 1))
            last = len(nodes) - 1
    return nodes, links


def _straight(rng):
    count = int(rng.integers(11, 20))
    return [(x, 0.0) for x in np.linspace(0, 1.5, count)], [(k, k + 1) for k in range(count - 1)]


def frame(rng: np.random.Generator) -> Build:
    """Beams out of their plane, with a flexible joint or two, small masses on springs, mounts or a clamped node."""
    variant = str(rng.choice(["aeroplane", "ladder", "cross", "straight"]))
    nodes, links = {"aeroplane": _aeroplane, "ladder": _ladder, "cross": _cross, "straight": _straight}[variant](rng)
    nodes = np.array(nodes)
    names = [f"{k + 1}:+{axis}" for k in range(len(nodes)) for axis in ("Z", "RX", "RY")]
    sections = np.array([200.0, 140.0, 1.0]) * log_uniform(rng, 0.5, 2.0)
    elements, joints = [], []
    busy = np.bincount(np.array(links).ravel())
    inner = [j for j, (a, _) in enumerate(links) if busy[a] >= 2 + (a == 0)]  # the node keeps another beam
    loose = rng.choice(inner, int(rng.integers(1, 3)), replace=False).tolist()
    for j, (a, b) in enumerate(links):
        along = nodes[b] - nodes[a]
        section = sections * log_uniform(rng, 0.7, 1.4, 3)
        at = np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
        if j in loose:  # its first end turns against the node: same deflection, rotations of its own
            own = len(names)
            names += [f"{len(nodes) + 1 + len(joints)}:+{axis}" for axis in ("RX", "RY")]
            stiff = section[0] / float(np.hypot(*along)) * log_uniform(rng, 2.0, 20.0)
            joints += [spring((3 * a + 1 + r, own + r), stiff * log_uniform(rng, 0.7, 1.4)) for r in (0, 1)]
            at = np.r_[3 * a, own, own + 1, 3 * b : 3 * b + 3]
        m, k = beam(along, *section)
        elements.append(Element("beam", at, k, m, tuple(at[[1, 2, 4, 5]].tolist())))
    deflections = list(range(0, 3 * len(nodes), 3))
    build = Build(names, [*elements, *joints], deflections, "frame", variant, 0)
    build = _with_stores(rng, build, len(nodes) + 1 + len(joints))
    held = str(rng.choice(["free", "soft", "clamped", "mounts"]))
    if variant == "straight":  # a straight beam has no use for torsion
        build = _without(build, [k for k, name in enumerate(build.dofs) if name.endswith("RX")])
    tip = 3 * (len(nodes) - 1)
    if held == "clamped":
        names = {build_name for build_name in np.array(names)[tip : tip + 3]}
        gone = [k for k, name in enumerate(build.dofs) if name in names]
        return replace(_without(build, gone), variant=f"{variant}, clamped")
    return _stand(rng, build, held, 2 if variant == "straight" else 3, variant)


def _without(build: Build, gone: list[int]) -> Build:
    """The structure with some DoFs held."""
    keep = np.setdiff1d(np.arange(build.n), gone)
    new = {int(d): k for k, d in enumerate(keep)}
    elements = []
    for e in build.elements:
        stays = np.array([int(d) in new for d in e.at])
        if not stays.any():
            continue
        at = np.array([new[int(d)] for d in e.at[stays]])
        where = tuple(new[d] for d in e.where if d in new)
        elements.append(replace(e, at=at, k=e.k[np.ix_(stays, stays)], m=e.m[np.ix_(stays, stays)], where=where))
    return replace(
        build, dofs=[build.dofs[k] for k in keep], elements=elements,
        deflections=[new[d] for d in build.deflections if d in new],
    )  # fmt: skip


def _with_stores(rng, build: Build, number: int) -> Build:
    """One to three small masses on springs: engines, stores, boxes."""
    M, K = build.assemble()
    z = [d for d in build.deflections]
    total = float(M[np.ix_(z, z)].sum())
    elastic = modes(M, K)[0]
    first = float(elastic[elastic > 1e-3 * elastic[-1] ** 0.5 * elastic[3] ** 0.5][0]) if len(elastic) > 4 else 1.0
    dofs, elements, deflections = list(build.dofs), list(build.elements), list(build.deflections)
    for k, at in enumerate(rng.choice(z, int(rng.integers(1, 4)), replace=False).tolist()):
        m = total * float(log_uniform(rng, 0.02, 0.08))
        dofs.append(f"{number + k}:+Z")
        deflections.append(len(dofs) - 1)
        elements.append(lump(len(dofs) - 1, m))
        elements.append(spring((int(at), len(dofs) - 1), m * first**2 * float(log_uniform(rng, 2.0, 40.0))))
    return replace(build, dofs=dofs, elements=elements, deflections=deflections)


def _stand(rng, build: Build, held: str, rigid: int, variant: str) -> Build:
    """Free in space, on soft cords, or on stiff mounts; ``rigid`` free modes otherwise."""
    M, K = build.assemble()
    if held == "free":
        return replace(build, variant=f"{variant}, free", rigid=rigid)
    first = float(modes(M, K)[0][rigid])
    at = _spread_out(rng, build, max(rigid, 3) if held == "soft" else int(rng.integers(3, 5)))
    z = build.deflections
    k = float(M[np.ix_(z, z)].sum()) / len(at) * first**2 * (0.1**2 if held == "soft" else log_uniform(rng, 0.5, 4.0))
    springs = [spring((a,), k * float(log_uniform(rng, 0.8, 1.25))) for a in at]
    return replace(
        build, elements=[*build.elements, *springs], variant=f"{variant}, {held}", rigid=rigid if held == "soft" else 0
    )


def _spread_out(rng, build: Build, count: int) -> list[int]:
    """DoFs whose motion as a rigid body differs most: pivots of the rigid shapes' QR factorisation."""
    M, K = build.assemble()
    shapes = modes(M, K)[1][build.deflections][:, : max(count, 3)] * rng.uniform(0.9, 1.1, max(count, 3))
    pivots = scipy.linalg.qr(shapes.T, pivoting=True, mode="economic")[2]
    return [build.deflections[int(p)] for p in pivots[:count]]


# plates -----------------------------------------------------------------------------------------------------------


def plate_element(a: float, b: float, D: float, nu: float, density: float):
    """Mass and stiffness (12, 12) of the rectangular bending element of Adini, Clough and Melosh, ``a`` by ``b``.

    DoFs ``(w, theta_x = dw/dy, theta_y = -dw/dx)`` of the corners (0,0), (a,0), (a,b), (0,b); ``D`` is the bending
    stiffness [N m], ``density`` the mass a surface [kg/m^2]. Twelve-term polynomial, Gauss integration.
    """
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)]

    def terms(x, y, dx, dy):
        def one(v, p, d):
            return 0.0 if d > p else float(np.prod(np.arange(p, p - d, -1))) * v ** (p - d)

        return np.array([one(x, p, dx) * one(y, q, dy) for p, q in powers])

    rows = []
    for x, y in ((0, 0), (a, 0), (a, b), (0, b)):
        rows += [terms(x, y, 0, 0), terms(x, y, 0, 1), -terms(x, y, 1, 0)]
    inverse = np.linalg.inv(np.array(rows))
    law = D * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    points, weights = np.polynomial.legendre.leggauss(4)
    for p, wx in zip((points + 1) * a / 2, weights * a / 2, strict=True):
        for q, wy in zip((points + 1) * b / 2, weights * b / 2, strict=True):
            B = np.stack([terms(p, q, 2, 0), terms(p, q, 0, 2), 2 * terms(p, q, 1, 1)]) @ inverse
            N = terms(p, q, 0, 0) @ inverse
            k += wx * wy * B.T @ law @ B
            m += wx * wy * density * np.outer(N, N)
    return m, k


def plate(rng: np.random.Generator) -> Build:
    """A rectangular plate with patches of unlike thickness, masses on springs; all DoFs, or deflections alone."""
    condensed = rng.random() < 0.6
    rows, columns = (int(rng.integers(4, 7)), int(rng.integers(5, 9))) if condensed else (4, int(rng.integers(4, 6)))
    a, b = rng.uniform(0.1, 0.2), rng.uniform(0.1, 0.2)
    names = [f"{k + 1}:+{axis}" for k in range(rows * columns) for axis in ("Z", "RX", "RY")]
    elements = []
    m, k = plate_element(a, b, 50.0 * log_uniform(rng, 0.5, 2.0), 0.3, 5.0)
    for r in range(rows - 1):
        for c in range(columns - 1):
            corners = [r * columns + c, r * columns + c + 1, (r + 1) * columns + c + 1, (r + 1) * columns + c]
            at = np.concatenate([np.r_[3 * q : 3 * q + 3] for q in corners])
            thickness = log_uniform(rng, 0.85, 1.15)
            elements.append(Element("plate", at, k * thickness**3, m * thickness))
    deflections = list(range(0, len(names), 3))
    build = Build(names, elements, deflections, "plate", "plate", 0)
    side = [3 * r * columns + d for r in range(rows) for d in range(3)]
    held = str(rng.choice(["free", "soft", "clamped", "mounts"]))
    if held == "clamped":
        build = _without(build, side)
    if condensed:
        build = _condensed(build)
    build = _with_stores(rng, build, rows * columns + 1)
    return replace(build, variant="plate, clamped") if held == "clamped" else _stand(rng, build, held, 3, "plate")


def _condensed(build: Build) -> Build:
    """Every element reduced to the deflections by the shapes of the structure as designed (Guyan)."""
    _, K = build.assemble()
    keep = np.array(build.deflections)
    rest = np.setdiff1d(np.arange(build.n), keep)
    T = np.zeros((build.n, len(keep)))
    T[keep, np.arange(len(keep))] = 1.0
    T[rest] = -np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, keep)])
    every = np.arange(len(keep))
    elements = [replace(e, at=every, k=T[e.at].T @ e.k @ T[e.at], m=T[e.at].T @ e.m @ T[e.at]) for e in build.elements]
    return replace(build, dofs=[build.dofs[k] for k in keep], elements=elements, deflections=every.tolist())


# shafts and trees ---------------------------------------------------------------------------------------------------


def shaft(rng: np.random.Generator, fewest: int = 20, most: int = 40) -> Build:
    """Discs on shafts that branch, or a tree of masses with a few cross links; every DoF can be measured."""
    variant = str(rng.choice(["shafts", "tree"]))
    n = int(rng.integers(fewest, most + 1))
    reach = 4 if variant == "shafts" else 7
    links = [(int(rng.integers(max(0, k - reach), k)), k) for k in range(1, n)]
    if variant == "tree":
        for _ in range(int(rng.integers(1, 5))):
            a, b = sorted(rng.choice(n, 2, replace=False).tolist())
            if (a, b) not in links:
                links.append((a, b))
    lumps = [lump(k, float(m)) for k, m in enumerate(log_uniform(rng, 0.3, 3.0, n))]
    springs = [spring(link, float(log_uniform(rng, 0.3, 3.0)) * 1e5) for link in links]
    names = [f"disc{k + 1}" if variant == "shafts" else f"m{k + 1}" for k in range(n)]
    build = Build(names, [*lumps, *springs], list(range(n)), "shaft", variant, 0)
    held = str(rng.choice(["free", "soft", "mounts", "mounts"]))
    return _stand(rng, build, held, 1, variant)


def small(rng: np.random.Generator) -> Build:
    """The same with 6 to 12 degrees of freedom, which are answered in seconds."""
    return shaft(rng, 6, 12)


BUILDERS: dict[str, Callable[[np.random.Generator], Build]] = {
    "frame": frame, "plate": plate, "shaft": shaft, SMALL: small,
}  # fmt: skip


def _connected(build: Build) -> bool:
    """Whether the structure is one: a mass on a spring to a clamped node would stand by itself."""
    _, K = build.assemble()
    return connected_components(K != 0, directed=False)[0] == 1


def draw_build(rng: np.random.Generator, kind: str) -> Build:
    """A structure of 20 to 60 DoFs, of 6 to 12 if small, whose first elastic mode lies between 5 and 60 Hz.

    Raises
    ------
    ValueError
        If the kind is not known.
    """
    if kind not in BUILDERS:
        raise ValueError(f"kind is {kind!r}; it must be one of {', '.join(BUILDERS)}")
    while True:
        build = BUILDERS[kind](rng)
        if (kind == SMALL or 20 <= build.n <= 60) and _connected(build):
            break
    first = float(modes(*build.assemble())[0][build.rigid])
    factor = (2 * np.pi * float(log_uniform(rng, 5.0, 60.0)) / first) ** 2
    return replace(build, elements=[replace(e, k=e.k * factor) for e in build.elements])
