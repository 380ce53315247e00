"""Whole elements ranked by the sizes of a change at which the structure comes nearest to the measured frequencies."""

from collections.abc import Iterator

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.features import Features
from modalax.diagnose.modal_domain.matched import CLOSE, FAR

# Sizes of lumps, over the usual one, and of elements' stiffness, relative to the whole; and then about the best.
LUMPS, RELATIVE = np.geomspace(0.5, 500.0, 18), np.array([-0.97, -0.93, -0.87, -0.75, -0.5, 0.8, 2.0, 5.0, 15.0, 50.0])
LEADING = 60  # elements whose sizes are then sought nearer
NEARER = np.array([0.8, 0.87, 0.93, 0.97, 1.03, 1.07, 1.15, 1.24])


def missed_by_elements(f: Features, c: Coordinates, elements: list[Change]) -> tuple[np.ndarray, np.ndarray]:
    """Least sum of squared, bounded misses of the measured frequencies by changes of whole elements, and their sizes.

    As masses that move in several directions, they are of no rank one, and so not among those
    of :mod:`modalax.diagnose.modal_domain.matched`, whose misses these are.
    """
    asked = np.abs(f.poles)[:, None] ** 2
    out, found = np.full(len(elements), np.inf), np.zeros(len(elements))

    def tried(k: int, sizes: np.ndarray) -> None:
        for u, squares in _squares(c, elements[k], sizes):
            apart = np.abs(np.maximum(squares, 0.0) / asked - 1).min(axis=1) / CLOSE
            missed = float((np.minimum(apart, FAR) ** 2).sum())
            if missed < out[k]:
                out[k], found[k] = missed, u

    for k, cause in enumerate(elements):
        tried(k, LUMPS if cause.kind == "M" else RELATIVE / cause.scale)
    for k in np.argsort(out)[:LEADING]:
        tried(int(k), NEARER * (found[k] or 1.0))
    return out, found


def _squares(c: Coordinates, cause: Change, sizes: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """Size, and squared circular frequencies of the simulation with it, of a change of mass or stiffness."""
    A, change = np.diag(c.frequencies**2), cause.matrix
    if cause.kind == "K":
        yield from ((float(u), np.linalg.eigvalsh(A + u * change)) for u in sizes)
        return
    b, V = np.linalg.eigh(change)
    for u in sizes[sizes * b.max() > -0.95]:
        half = V / np.sqrt(1 + u * b) @ V.T
        yield float(u), np.linalg.eigvalsh(half @ A @ half)
