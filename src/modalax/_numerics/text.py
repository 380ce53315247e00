"""Numbers and tables as plain text."""

import math
from collections.abc import Sequence

EXACT = 1e-9  # standard deviation, relative to its value, below which digits up to it say nothing to a reader


def with_error(value: float, std: float | None, unit: float = 1.0) -> str:
    """Write a value ± its standard deviation: the deviation with two digits, the value to the same decimal place."""
    value = value * unit
    if std is None or not math.isfinite(std) or std <= 0:
        return f"{value:.5g}"
    std = std * unit
    if std >= 1e4:
        return f"{value:.3g} ± {std:.2g}"
    if std < EXACT * abs(value):
        return f"{value:.10g} ± {std:.1e}"
    places = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{places}f} ± {std:.{places}f}"


def percent(share: float) -> str:
    """A share in per cent, to two digits, whole from a hundred on."""
    value = 100 * share
    return f"{value:.2g} %" if abs(value) < 99.5 else f"{value:.0f} %"


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[int] = ()) -> str:
    """A table as plain text; columns are aligned to the right, those with a number in ``left`` to the left."""
    every = [list(header), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*every, strict=True)]

    def line(row: Sequence[str]) -> str:
        cells = [x.ljust(w) if k in left else x.rjust(w) for k, (x, w) in enumerate(zip(row, widths, strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join([line(every[0]), "  ".join("-" * w for w in widths), *map(line, every[1:])])
