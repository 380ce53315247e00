"""Numbers as text."""

import math


def with_error(value: float, std: float | None, unit: float = 1.0) -> str:
    """Write a value and its standard deviation, the latter to two figures and the former to the same place."""
    value = value * unit
    if std is None or not math.isfinite(std) or std <= 0:
        return f"{value:.5g}"
    std = std * unit
    if std >= 1e4:
        return f"{value:.3g} ± {std:.2g}"
    places = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{places}f} ± {std:.{places}f}"
