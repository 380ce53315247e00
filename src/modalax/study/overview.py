"""Statistics of a study as text, for ``print`` and for the command line."""

from collections.abc import Mapping, Sequence
from typing import Any

from modalax._numerics.text import text_table
from modalax.data.overview import counted
from modalax.study.statistics import reason_lines

COLUMNS = {
    "truth": "True", "mean": "Mean", "std": "Std", "stated_std": "Stated", "bias": "Bias", "coverage": "In 95 %",
}  # fmt: skip
CAPTION = (
    "Stated: mean of the standard deviations that the draws state. In 95 %: part of the draws [%] whose 95 % interval "
    "holds the true value."
)


def title(group: Mapping[str, Any]) -> str:
    """Settings and number of draws of a group."""
    where = ", ".join(f"{name} = {value}" for name, value in group["where"].items())
    failed = f", {group['failed']} failed" if group["failed"] else ""
    return f"{where + ': ' if where else ''}{counted(group['draws'], 'draw')}{failed}"


def caption(group: Mapping[str, Any]) -> str | None:
    """What the columns mean that the draws' own standard deviations give; None where they state none."""
    return CAPTION if any(q["stated_std"] is not None for q in group["quantities"]) else None


def table(group: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the statistics of a group; columns that are empty are left out."""
    shown = [name for name in COLUMNS if any(q[name] is not None for q in group["quantities"])]
    rows = []
    for q in group["quantities"]:
        missing = f" ({q['missing']} missing)" if q["missing"] else ""
        rows.append([q["name"] + missing, *(_number(q[name], name, q) for name in shown)])
    return ["Quantity", *(COLUMNS[name] for name in shown)], rows


def of_summary(told: Mapping[str, Any]) -> str:
    """A table for each group of draws, and why draws failed."""
    said: Sequence[str] = [
        line
        for group in told["groups"]
        for line in (title(group), text_table(*table(group), left=(0,)), *filter(None, [caption(group)]))
    ]
    return "\n".join([*said, *reason_lines(told)])


def _number(value: float | None, name: str, q: Mapping[str, Any]) -> str:
    if value is None:
        return ""
    if name == "coverage":
        return f"{100 * value:.1f}"
    if name == "bias" and q["bias_std"] is not None:
        return f"{value:+.2g} ± {q['bias_std']:.1g}"
    return f"{value:.6g}" if name in ("truth", "mean") else f"{value:.2g}"
