"""Unknowns of a cause, and the values that a search starts from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

INFINITE = float("inf")


@dataclass(frozen=True)
class Parameter:
    """One unknown of a cause: name, SI unit, bounds, and whether it is searched on a logarithmic scale.

    ``log`` searches the logarithm of the value, ``relative`` that of one and the value, for a part by which something
    that stays positive changes. ``ends`` says that beyond the upper bound the cause is not what its name says, so that
    a fit that ends there is likely of another kind.
    """

    name: str
    unit: str
    lower: float = -INFINITE
    upper: float = INFINITE
    log: bool = False
    ends: bool = False
    relative: bool = False

    @property
    def logarithmic(self) -> bool:
        """Whether a logarithm is searched."""
        return self.log or self.relative

    def within(self, value: float) -> float:
        """The value within the bounds; a linear step that leaves those of a relative change is one of its logarithm."""
        if self.relative and value < self.lower:
            value = np.expm1(value)
        return float(np.clip(value, self.lower, self.upper))

    def searched(self, value: float) -> float:
        """What is searched, of a value."""
        if self.relative:
            return float(np.log1p(np.maximum(value, -1 + 1e-15)))
        return float(np.log(np.maximum(value, 1e-300))) if self.log else float(value)

    def slope(self, value: float) -> float:
        """Derivative of the value by what is searched."""
        return 1.0 + value if self.relative else value if self.log else 1.0


def strengths(
    scale: float, shapes: Sequence[Sequence[float]] = ((),), sizes: Sequence[float] = (1e-4, 0.03, 0.2, 1.0),
    both: bool = True,
) -> np.ndarray:  # fmt: skip
    """Starting values: the first parameter at ``sizes`` times ``scale`` (and its negatives), the others at ``shapes``.

    Shape ``(start, parameter)``; the first size stands for the derivative at zero, which has one sign only.
    """
    signed = [*sizes, *(-size for size in sizes[1:])] if both else sizes
    return np.array([[size * scale, *shape] for shape in shapes for size in signed])
