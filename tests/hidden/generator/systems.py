"""Structures to hide an effect in: spring-mass networks, beam frames, and a third kind kept for the last exam.

The fourth is the five-degree-of-freedom system of the aircraft modal-analysis review, whose modes are given.

Units are SI; a system's ``places`` are where a local element may sit: ``(a, b, k)`` joins DoFs ``a`` and ``b``
(``b = -1`` is the ground), and ``k`` is the stiffness [N/m] of a spring that the system already has there, or 0.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

FAMILIES = ("masses", "frame", "third", "review")


@dataclass(frozen=True)
class System:
    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    dofs: list[str]
    places: list[tuple[int, int, float]]
    family: str
    kind: str
    damping: str

    @property
    def n(self) -> int:
        return len(self.dofs)

    def modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Undamped circular frequencies, diagonal damping ratios and mass-normalised shapes (column by mode)."""
        square, shapes = scipy.linalg.eigh(self.K, self.M)
        omega = np.sqrt(np.maximum(square, 1e-9 * square.max()))
        zeta = np.einsum("dr,de,er->r", shapes, self.C, shapes) / (2 * omega)
        return omega, zeta, shapes

    def direction(self, a: int, b: int) -> np.ndarray:
        """Relative displacement across a place: +1 at ``a``, -1 at ``b`` (nothing there for the ground)."""
        e = np.zeros(self.n)
        e[a] = 1.0
        if b >= 0:
            e[b] = -1.0
        return e

    def scaled(self, factor: float) -> "System":
        """The same shapes and damping ratios, every frequency times ``factor``."""
        places = [(a, b, k * factor**2) for a, b, k in self.places]
        return replace(self, K=self.K * factor**2, C=self.C * factor, places=places)


def log_uniform(rng: np.random.Generator, low: float, high: float, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def modal_matrix(M: np.ndarray, shapes: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """The physical matrix whose modal diagonal, in mass-normalised shapes, is ``diagonal``."""
    left = M @ shapes
    return (left * diagonal) @ left.T


def with_modal_damping(M, K, zeta) -> np.ndarray:
    square, shapes = scipy.linalg.eigh(K, M)
    return modal_matrix(M, shapes, 2 * zeta * np.sqrt(np.maximum(square, 0)))


def network(n: int, springs: list[tuple[int, int, float]]) -> np.ndarray:
    K = np.zeros((n, n))
    for a, b, k in springs:
        e = np.zeros(n)
        e[a] = 1.0
        if b >= 0:
            e[b] = -1.0
        K += k * np.outer(e, e)
    return K


def suspension(M: np.ndarray, K: np.ndarray, at: list[int], rigid: int) -> list[tuple[int, int, float]]:
    """Springs to ground so soft that the ``rigid`` free modes lie near a tenth of the first elastic frequency."""
    elastic = scipy.linalg.eigh(K, M, eigvals_only=True)[rigid]
    mass = float(np.trace(M))
    return [(a, -1, 0.1**2 * float(elastic) * mass / len(at)) for a in at]


# spring-mass networks -------------------------------------------------------------------------------------------


def _edges(rng, kind: str) -> tuple[int, list[tuple[int, int]]]:
    if kind == "chain":
        n = int(rng.integers(4, 13))
        edges = [(k, k + 1) for k in range(n - 1)]
        for _ in range(int(rng.integers(0, n // 2 + 1))):
            a, b = sorted(rng.choice(n, 2, replace=False).tolist())
            if b > a + 1 and (a, b) not in edges:
                edges.append((int(a), int(b)))
        return n, edges
    rows, columns = int(rng.integers(2, 5)), int(rng.integers(3, 7))
    at = lambda r, c: r * columns + c
    edges = [(at(r, c), at(r, c + 1)) for r in range(rows) for c in range(columns - 1)]
    edges += [(at(r, c), at(r + 1, c)) for r in range(rows - 1) for c in range(columns)]
    return rows * columns, edges


def masses(rng: np.random.Generator) -> System:
    kind = str(rng.choice(["chain", "grid"]))
    n, edges = _edges(rng, kind)
    mass = log_uniform(rng, 0.3, 3.0, n) * log_uniform(rng, 0.1, 10.0)
    M = np.diag(mass)
    springs = [(a, b, float(log_uniform(rng, 0.3, 3.0)) * 1e5) for a, b in edges]
    if rng.random() < 0.6:
        ends = [0] if rng.random() < 0.5 else [0, n - 1]
        springs += [(a, -1, float(log_uniform(rng, 0.5, 3.0)) * 1e5) for a in ends]
    else:
        springs += suspension(M, network(n, springs), [0, n - 1] if kind == "chain" else [0, n // 2, n - 1], 1)
    K = network(n, springs)
    damping = str(rng.choice(["modal", "modal", "local"]))
    if damping == "modal":
        C = with_modal_damping(M, K, log_uniform(rng, 0.005, 0.03, n))
    else:
        C = network(n, [(a, b, k * float(log_uniform(rng, 0.3, 3.0))) for a, b, k in springs])
        square, shapes = scipy.linalg.eigh(K, M)
        zeta = np.einsum("dr,de,er->r", shapes, C, shapes) / (2 * np.sqrt(square))
        C *= float(log_uniform(rng, 0.008, 0.02)) / np.median(zeta)
    return System(M, C, K, [str(k + 1) for k in range(n)], springs, "masses", kind, damping)


# beam frames ----------------------------------------------------------------------------------------------------


def beam(along: np.ndarray, EI: float, GJ: float, line_mass: float) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness (6, 6) of a beam ``along`` a vector in the plane; DoFs ``(w, theta_x, theta_y)`` of each end.

    Euler-Bernoulli bending out of the plane with St Venant torsion; the polar inertia is a small share of the mass.
    """
    L = float(np.hypot(*along))
    c, s = along / L
    bend = np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, 4 * L**2, -6 * L, 2 * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L**2, -6 * L, 4 * L**2],
        ]
    )
    inertia = np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )
    # slope along the element: dw/dl = -c theta_y + s theta_x; twist: c theta_x + s theta_y
    T = np.zeros((6, 6))
    for node in range(2):
        w, tx, ty = 3 * node, 3 * node + 1, 3 * node + 2
        T[2 * node, w] = 1.0
        T[2 * node + 1, tx], T[2 * node + 1, ty] = s, -c
        T[4 + node, tx], T[4 + node, ty] = c, s
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    k[:4, :4], m[:4, :4] = EI / L**3 * bend, line_mass * L / 420 * inertia
    k[4:, 4:] = GJ / L * np.array([[1, -1], [-1, 1]])
    m[4:, 4:] = line_mass * L * (0.02 * L) ** 2 / 6 * np.array([[2, 1], [1, 2]])
    return T.T @ m @ T, T.T @ k @ T


def grillage(nodes: np.ndarray, elements: list[tuple[int, int, float, float, float]]):
    """Mass and stiffness of beams; ``elements`` are ``(first, last, EI, GJ, mass per length)``."""
    size = 3 * len(nodes)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for a, b, *section in elements:
        m, k = beam(nodes[b] - nodes[a], *section)
        at = np.ix_(*[np.r_[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]] * 2)
        M[at] += m
        K[at] += k
    return M, K


def condense(M, K, keep: np.ndarray):
    """Guyan reduction to the DoFs ``keep``."""
    rest = np.setdiff1d(np.arange(len(M)), keep)
    T = np.zeros((len(M), len(keep)))
    T[keep, np.arange(len(keep))] = 1.0
    T[rest] = -np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, keep)])
    return T.T @ M @ T, T.T @ K @ T


def _aeroplane(rng) -> tuple[np.ndarray, list[tuple[int, int]], list[int]]:
    fuselage, half = int(rng.integers(5, 8)), int(rng.integers(2, 5))
    nodes = [(x, 0.0) for x in np.linspace(0.0, 1.5, fuselage)]
    links = [(k, k + 1) for k in range(fuselage - 1)]
    root, tail = fuselage // 2, fuselage - 1
    tips = []
    for at, span, count in ((root, rng.uniform(0.8, 1.1), half), (tail, 0.35, 1)):
        for side in (-1.0, 1.0):
            last = at
            for y in np.linspace(0.0, span, count + 1)[1:]:
                nodes.append((nodes[at][0] + 0.15 * y, side * y))
                links.append((last, len(nodes) - 1))
                last = len(nodes) - 1
            tips.append(last)
    return np.array(nodes), links, [0, tips[0], tips[1]]


def _straight(rng) -> tuple[np.ndarray, list[tuple[int, int]], list[int]]:
    count = int(rng.integers(6, 13))
    nodes = np.stack([np.linspace(0.0, 1.0, count), np.zeros(count)], axis=1)
    return nodes, [(k, k + 1) for k in range(count - 1)], [0, count - 1]


def _cross(rng) -> tuple[np.ndarray, list[tuple[int, int]], list[int]]:
    arms, each = int(rng.integers(3, 5)), int(rng.integers(2, 5))
    nodes, links = [(0.0, 0.0)], []
    for angle in np.sort(rng.uniform(0.5, 1.0, arms).cumsum()) * 1.6:
        last, length = 0, rng.uniform(0.4, 0.9)
        for r in np.linspace(0.0, length, each + 1)[1:]:
            nodes.append((r * np.cos(angle), r * np.sin(angle)))
            links.append((last, len(nodes) - 1))
            last = len(nodes) - 1
    return np.array(nodes), links, [last]


def frame(rng: np.random.Generator) -> System:
    kind = str(rng.choice(["aeroplane", "cantilever", "free beam", "cross"]))
    nodes, links, hang = {"aeroplane": _aeroplane, "cross": _cross}.get(kind, _straight)(rng)
    EI, GJ, line = log_uniform(rng, 30, 300), log_uniform(rng, 20, 200), log_uniform(rng, 0.5, 3)
    elements = [(a, b, *(v * float(log_uniform(rng, 0.6, 1.7)) for v in (EI, GJ, line))) for a, b in links]
    M, K = grillage(nodes, elements)
    free = np.arange(len(M))
    held = {"cantilever": 0, "cross": hang[0]}.get(kind)  # a cross held at its centre would be separate arms
    clamped = [] if held is None else [3 * held, 3 * held + 1, 3 * held + 2]
    free = np.setdiff1d(free, clamped)
    if kind in ("cantilever", "free beam"):  # a straight beam has no use for torsion
        free = free[free % 3 != 1]
    M, K = M[np.ix_(free, free)], K[np.ix_(free, free)]
    deflection = np.flatnonzero(free % 3 == 0)
    node_of = free // 3
    names = [
        f"{node_of[k] + 1}:{'+Z' if free[k] % 3 == 0 else '+RX' if free[k] % 3 == 1 else '+RY'}"
        for k in range(len(free))
    ]
    at = {int(node_of[k]): int(k) for k in deflection}
    pods = _pods(rng, M, K, [at[k] for k in sorted(at)])
    M, K, springs = _attach(M, K, pods)
    names += [f"{len(nodes) + 1 + k}:+Z" for k in range(len(pods))]
    translation = list(deflection) + list(range(len(free), len(free) + len(pods)))
    if kind in ("aeroplane", "free beam"):
        hung = suspension(M, K, [at[k] for k in hang], 3 if kind == "aeroplane" else 2)
        K = K + network(len(K), hung)
        springs += hung
    pairs = [(at[a], at[b], 0.0) for a, b in links if a in at and b in at]
    if kind != "aeroplane" and len(names) < 20 and rng.random() < 0.35:
        keep = np.arange(len(names))
    else:
        keep = np.array(translation)
        M, K = condense(M, K, keep)
    where = {int(d): k for k, d in enumerate(keep)}
    places = [(where[a], where[b] if b >= 0 else -1, k) for a, b, k in springs + pairs]
    C = with_modal_damping(M, K, log_uniform(rng, 0.005, 0.03, len(M)))
    return System(M, C, K, [names[k] for k in keep], places, "frame", kind, "modal")


def _pods(rng, M, K, candidates: list[int]) -> list[tuple[int, float, float]]:
    """Small masses on springs: engines, stores, control surfaces."""
    count = min(int(rng.integers(1, 4)), len(candidates))
    square = scipy.linalg.eigh(K, M, eigvals_only=True)
    elastic = square[square > 1e-3 * square[4]]
    mass = float(np.trace(M[np.ix_(candidates, candidates)]))
    chosen = rng.choice(candidates, count, replace=False)
    result = []
    for a in chosen:
        m = mass * float(log_uniform(rng, 0.02, 0.08))
        result.append((int(a), m, m * float(elastic[0]) * float(log_uniform(rng, 2.0, 30.0))))
    return result


def _attach(M, K, pods):
    n, extra = len(M), len(pods)
    M, K = (np.pad(A, ((0, extra), (0, extra))) for A in (M, K))
    springs = [(a, n + k, stiffness) for k, (a, _, stiffness) in enumerate(pods)]
    for k, (_, mass, _) in enumerate(pods):
        M[n + k, n + k] = mass
    return M, K + network(n + extra, springs), springs


# the third family: not to be looked at while a diagnosis is being developed -------------------------------------


def third(rng: np.random.Generator) -> System:
    return _plate(rng) if rng.random() < 0.5 else _torsion_tree(rng)


def _plate(rng) -> System:
    """A simply supported, nearly square plate on a grid of points: pairs of close modes, a full stiffness matrix."""
    rows, columns = int(rng.integers(3, 5)), int(rng.integers(3, 6))
    x, y = np.arange(1, columns + 1) / (columns + 1), np.arange(1, rows + 1) / (rows + 1)
    p, q = np.arange(1, columns + 1), np.arange(1, rows + 1)
    X, Y = np.sin(np.pi * np.outer(x, p)), np.sin(np.pi * np.outer(y, q))
    shapes = np.kron(Y, X) * 2 / np.sqrt((columns + 1) * (rows + 1))
    side = rng.uniform(1.005, 1.06)
    omega = (q[:, None] ** 2 * side**2 + p[None] ** 2).ravel() * 2 * np.pi * 10
    omega = omega * rng.uniform(0.98, 1.02, omega.size)
    m = float(log_uniform(rng, 0.05, 1.0))
    n = rows * columns
    M = np.eye(n) * m
    K = (shapes * omega**2 * m) @ shapes.T
    C = (shapes * 2 * log_uniform(rng, 0.005, 0.03, n) * omega * m) @ shapes.T
    at = lambda r, c: r * columns + c
    places = [(at(r, c), at(r, c + 1), 0.0) for r in range(rows) for c in range(columns - 1)]
    places += [(at(r, c), at(r + 1, c), 0.0) for r in range(rows - 1) for c in range(columns)]
    names = [f"p{r + 1}{c + 1}" for r in range(rows) for c in range(columns)]
    return System(M, (C + C.T) / 2, (K + K.T) / 2, names, places, "third", "plate", "modal")


def _torsion_tree(rng) -> System:
    """Discs on shafts that branch (a geared drive train brought to one speed); DoFs are rotations."""
    n = int(rng.integers(6, 15))
    inertia = log_uniform(rng, 0.005, 0.1, n)
    shafts = [(int(rng.integers(max(0, k - 3), k)), k, float(log_uniform(rng, 300, 5000))) for k in range(1, n)]
    M = np.diag(inertia)
    shafts += [(0, -1, float(log_uniform(rng, 300, 3000)))]
    K = network(n, shafts)
    C = with_modal_damping(M, K, log_uniform(rng, 0.005, 0.03, n))
    return System(M, C, K, [f"disc{k + 1}" for k in range(n)], shafts, "third", "torsion tree", "modal")


# the review's system ---------------------------------------------------------------------------------------------

SHAPES = """
0.7147  1.0000 -0.0911 -0.9230 -0.6083
0.7166  0.9999 -0.1493  1.0000 -0.1937
0.7981  0.2257  0.1554 -0.1518  1.0000
0.8518 -0.5166  1.0000  0.1231 -0.3936
1.0000 -0.8590 -0.5860  0.0196 -0.2041
"""


def review(rng: np.random.Generator) -> System:
    """Tables 1 and 2 of the review: modes, modal masses, 2 % damping; any two DoFs may be joined, or one grounded."""
    shapes = np.array(SHAPES.split(), float).reshape(5, 5) / np.sqrt([2.52, 1.97, 0.90, 1.09, 1.05])
    inverse = np.linalg.inv(shapes)
    omega = 2 * np.pi * np.array([26.06, 36.84, 51.47, 56.21, 62.60])
    K = inverse.T @ np.diag(omega**2) @ inverse
    M, C = inverse.T @ inverse, inverse.T @ np.diag(0.04 * omega) @ inverse
    places = [(a, b, max(-float(K[a, b]), 0.0)) for a in range(5) for b in range(a + 1, 5)]
    places += [(a, -1, 0.0) for a in range(5)]
    return System(M, C, (K + K.T) / 2, [str(k + 1) for k in range(5)], places, "review", "five masses", "modal")


def draw_system(rng: np.random.Generator, family: str) -> System:
    """A random system of a family; its first elastic mode lies between 4 and 60 Hz."""
    build = {"masses": masses, "frame": frame, "third": third, "review": review}
    if family not in build:
        raise ValueError(f"family is {family!r}; it must be one of {', '.join(FAMILIES)}")
    system = build[family](rng)
    return system.scaled(float(log_uniform(rng, 4.0, 60.0)) / elastic_frequencies(system)[0])


def elastic_frequencies(system: System) -> np.ndarray:
    """Frequencies [Hz] above those of the suspension, told by the largest jump at the start of the list."""
    freq = system.modes()[0] / (2 * np.pi)
    jump = freq[1:4] / freq[:3]
    k = int(np.argmax(jump))
    soft = system.kind in ("aeroplane", "free beam") or (system.family == "masses" and jump[0] > 3)
    return freq[k + 1 :] if soft and jump[k] > 2.5 else freq
