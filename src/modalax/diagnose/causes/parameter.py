"""Unknowns of a cause, and the values that a search starts from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

INFINITE = float("inf")


@dataclass(frozen=True)
class Parameter:
    """One unknown of a cause: name, SI unit, bounds, and whether it is searched on a logarithmic scale.

    ``ends`` says that beyond the upper bound the cause is not what its name says, so that a fit that ends there is
    likely of another kind.
    """

    name: str
    unit: str
    lower: float = -INFINITE
    upper: float = INFINITE
    log: bool = False
    ends: bool = False


def strengths(
    scale: float, shapes: Sequence[Sequence[float]] = ((),), sizes: Sequence[float] = (1e-4, 0.03, 0.2, 1.0),
    both: bool = True,
) -> np.ndarray:  # fmt: skip
    """Starting values: the first parameter at ``sizes`` times ``scale`` (and its negatives), the others at ``shapes``.

    Shape ``(start, parameter)``; the first size stands for the derivative at zero, which has one sign only.
    """
    signed = [*sizes, *(-size for size in sizes[1:])] if both else sizes
    return np.array([[size * scale, *shape] for shape in shapes for size in signed])
