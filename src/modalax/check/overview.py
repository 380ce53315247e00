"""Findings of a check as text, for ``print`` and for the command line."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from modalax._numerics.text import text_table

if TYPE_CHECKING:
    from modalax.check.finding import Finding, Findings

COLUMNS = ("What", "Where", "Size", "Sure")
SOUND = "nothing wrong was found"


def row(f: "Finding") -> tuple[str, str, str, str]:
    """A finding as a row of a table with the columns ``COLUMNS``."""
    return f.what, f.place, f.measure, f"{f.sure:.2f}"


def of_finding(f: "Finding") -> str:
    """The evidence and the advice, a line each."""
    return f"{f.what} ({f.place}): {f.evidence}.\n  to do: {f.advice}."


def of_findings(found: "Findings") -> str:
    """What was checked, a table of the findings, and below it the evidence and the advice of each."""
    return "\n".join([*found.about, *([SOUND] if not len(found) else _table(found))])


def _table(found: "Findings") -> Iterator[str]:
    yield text_table(COLUMNS, [row(f) for f in found], left=(0, 1))
    yield from map(of_finding, found)
