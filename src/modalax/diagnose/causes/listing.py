"""The catalogue as a list to read: a row for each name, with what an answer tells of it."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from modalax.diagnose.causes.base import Cause, LinesCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.signals import HumLines


@dataclass
class Row:
    """What there is to read of all forms of a cause that share a name.

    Attributes
    ----------
    slug
        The name in an answer.
    forms
        The causes of this name.
    units
        Units of the parameters that an answer gives, by name.
    summaries, advice
        What the simulation lacks, and what to measure; each text once.
    """

    slug: str
    forms: list[Cause] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    summaries: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)


def listing(causes: Iterable[Cause]) -> list[Row]:
    """Rows of the causes, in their order; forms that share a name share a row."""
    rows: dict[str, Row] = {}
    for cause in causes:
        row = rows.setdefault(cause.slug, Row(cause.slug))
        row.forms.append(cause)
        row.units.update(units_told(cause))
        for text, texts in ((cause.summary, row.summaries), (cause.advice, row.advice)):
            if text and text not in texts:
                texts.append(text)
    return list(rows.values())


def units_told(cause: Cause) -> dict[str, str]:
    """Units of the parameters that an answer gives of a cause, which may not be those that it is fitted with."""
    units: dict[str, list[str]] = {}
    for motion in range(3):  # the unit of a sensor's parameter may be that of a displacement, velocity or acceleration
        told = cause.report(np.ones(len(cause.parameters)), Place(("", ""), (0, motion, 0)))
        for name, (_, unit) in told.items():
            if unit not in units.setdefault(name, []):
                units[name].append(unit)
    if isinstance(cause, LinesCause):
        lines = HumLines(lines=np.ones(1, bool), chi2=0.0, freedom=1.0, amplitude=1.0, frequency=1.0, p_value=0.0)
        units = {**{name: [unit] for name, (_, unit) in cause.told(lines).items()}, **units}
    return {name: ", ".join(each) for name, each in units.items()}
