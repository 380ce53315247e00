"""Rectangular plates of four-cornered elements with twelve-term polynomials (Melosh 1963)."""

import numpy as np

POWERS = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)])


def terms(x: float, y: float, dx: int, dy: int) -> np.ndarray:
    """Derivatives of all terms at a point, shape ``(12,)``."""
    one = lambda v, p, d: float(np.prod(np.arange(p, p - d, -1))) * v ** max(p - d, 0)
    return np.array([one(x, p, dx) * one(y, q, dy) for p, q in POWERS])


def element(a: float, b: float, bending: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass, over deflection and rotations about x and y at the corners (0,0), (a,0), (a,b) and (0,b)."""
    corners = ((0.0, 0.0), (a, 0.0), (a, b), (0.0, b))
    inverse = np.linalg.inv([r for x, y in corners for r in (terms(x, y, 0, 0), terms(x, y, 0, 1), -terms(x, y, 1, 0))])
    law = bending * np.array([[1, 0.3, 0], [0.3, 1, 0], [0, 0, 0.35]])
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    at, weight = np.polynomial.legendre.leggauss(4)
    for x, wx in zip((at + 1) * a / 2, weight * a / 2, strict=True):
        for y, wy in zip((at + 1) * b / 2, weight * b / 2, strict=True):
            B = np.stack([terms(x, y, 2, 0), terms(x, y, 0, 2), 2 * terms(x, y, 1, 1)]) @ inverse
            N = terms(x, y, 0, 0) @ inverse
            K, M = K + wx * wy * B.T @ law @ B, M + wx * wy * density * np.outer(N, N)
    return K, M


def quads(columns: int, rows: int) -> list[np.ndarray]:
    """DoFs of each element of a grid of nodes with three DoFs each."""
    first = [r * columns + c for r in range(rows - 1) for c in range(columns - 1)]
    each = [(k, k + 1, k + columns + 1, k + columns) for k in first]
    return [np.concatenate([[3 * n, 3 * n + 1, 3 * n + 2] for n in nodes]) for nodes in each]


def summed(parts: list[np.ndarray], at: list[np.ndarray], size: int) -> np.ndarray:
    """A matrix of which these are the parts."""
    out = np.zeros((size, size))
    for part, dofs in zip(parts, at, strict=True):
        out[np.ix_(dofs, dofs)] += part
    return out
