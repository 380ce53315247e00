"""Elements whose mass is wrong as a whole, as of another density or with mass spread over them that nobody modelled.

A lump at one node is another pattern. Such elements are looked for where the general inaccuracy has one or two of them
off by far more than the others, and told as mass that is added at the end of the element which moves most.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.places import JOINT
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.outlying import outlying
from modalax.diagnose.modal_domain.search.steps import MOST, Search

RARER = 0.1  # chance of a whole element, relative to that of a lump at one of its nodes


@dataclass(frozen=True)
class HeavyElement(Change):
    """Mass added to an element as it has it already; ``ends`` are the DoFs that tell which."""

    ends: tuple[str, ...] = ()

    def said(self) -> str:
        """How it is spread."""
        return f"the mass at {self.where[0]} is spread over the element at {' - '.join(self.ends)} as its own mass is"


def heavy_elements(search: Search, late: Callable[[], bool]) -> None:
    """Fit the leading explanation with the elements whose mass stands out as causes, and these alone."""
    best, lumps = search.best, [c for c in search.candidates if c.slug == "added_mass" and len(c.where) == 1]
    a = search.setting.inaccuracy
    if not lumps or late():
        return
    found = [(_cause(search, k.number, lumps), k) for k in outlying(search.setting, best, "mass")[: MOST + 1]]
    heavy = [(c, k.size * a.kilograms[k.number] / c.scale) for c, k in found if c is not None]
    if not heavy or len(heavy) > MOST:
        return
    causes, u = tuple(c for c, _ in heavy), np.array([size for _, size in heavy])
    kept = tuple(c for c in best.causes if c.slug != "added_mass")
    sizes = [best.u[own_sizes(best.causes, best.causes.index(c))] for c in kept]
    for beside, start in {kept: sizes, (): []}.items():
        if not late() and len(beside) + len(causes) <= MOST:
            attempt(search.setting, search.found, (*beside, *causes), np.concatenate([*start, u]), None)


def _cause(search: Search, number: int, lumps: list[Change]) -> Change | None:
    """The change of an element's mass, told at the end that moves most; None where it has none to move."""
    a, c = search.setting.inaccuracy, search.setting.coordinates
    weight, pattern = float(a.kilograms[number]), a.patterns[a.groups.index("mass")][number]
    ends = [lump for lump in lumps if lump.where[0] in a.places["mass"][number]]
    if weight <= 0 or not ends:
        return None
    at = max(ends, key=lambda lump: float((c.everywhere[c.names.index(str(lump.where[0]))] ** 2).sum()))
    return HeavyElement(
        "added_mass", at.where, JOINT * weight, pattern=pattern / weight, reference=weight, weight=RARER,
        ends=a.places["mass"][number],
    )  # fmt: skip
