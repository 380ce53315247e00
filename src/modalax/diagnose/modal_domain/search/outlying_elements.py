"""Elements that the general inaccuracy has off by far more than the others, as causes.

One that is far off may hide among errors that are taken to be alike, beside another cause that was found first. One
whose mass is wrong as a whole, of another density or with mass spread over it that nobody modelled, is no lump at one
node; it is told as mass that is added at the end of the element which moves most.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.places import JOINT
from modalax.diagnose.modal_domain.fitting.attempts import attempt, key_of
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.outlying import outlying
from modalax.diagnose.modal_domain.search.damped_along import damped_along
from modalax.diagnose.modal_domain.search.steps import MOST, Search
from modalax.diagnose.modal_domain.search.uneven_element import is_of

RARER = 0.1  # chance of a whole element, relative to that of a lump at one of its nodes


@dataclass(frozen=True)
class HeavyElement(Change):
    """Mass added to an element as it has it already; ``ends`` are the DoFs that tell which."""

    ends: tuple[str, ...] = ()

    def said(self) -> str:
        """How it is spread."""
        return f"the mass at {self.where[0]} is spread over the element at {' - '.join(self.ends)} as its own mass is"


def outlying_elements(search: Search, late: Callable[[], bool]) -> None:
    """Fit the leading explanation with the elements that stand out as causes, and these alone."""
    best = search.best
    for name, cause_of in (("stiffness", _softer), ("mass", _heavier)):
        found = [] if late() else outlying(search.setting, best, name)[: MOST + 1]
        causes = {c: k.size for k in found if (c := cause_of(search, k.number)) is not None}
        if not causes or len(causes) > MOST:
            continue
        u = [size * c.whole / c.scale for c, size in causes.items()]
        slug = next(iter(causes)).slug
        for beside, start in {**_others(best, slug), **_damped(search, best), (): []}.items():
            if not late() and len(beside) + len(causes) <= MOST:
                _with_losses(search, (*beside, *causes), np.concatenate([*start, u]), late)


def _others(f: Fit, slug: str) -> dict[tuple[Change, ...], list[np.ndarray]]:
    """The causes of a fit but for those of one kind, with their sizes."""
    kept = tuple(c for c in f.causes if c.slug != slug)
    return {kept: [f.u[own_sizes(f.causes, f.causes.index(c))] for c in kept]}


def _damped(search: Search, f: Fit) -> dict[tuple[Change, ...], list[np.ndarray]]:
    """The damper at the place of the only cause of a fit, which may be no more than that, where it was fitted."""
    at = f.causes[0].where if len(f.causes) == 1 else None
    return {key: [own.u] for key, own in search.found.items()
            if len(key) == 1 and key[0].slug == "local_damper" and key[0].where == at}  # fmt: skip


def _with_losses(search: Search, causes: tuple[Change, ...], u: np.ndarray, late: Callable[[], bool]) -> None:
    """Fit causes, and with the damping of one along."""
    attempt(search.setting, search.found, causes, u, None)
    fitted = search.found.get(key_of(causes))
    for along, sizes, start in [] if fitted is None else damped_along(search.setting, [fitted]):
        if not late():
            attempt(search.setting, search.found, along, sizes, start)


def _softer(search: Search, number: int) -> Change | None:
    """The change of an element by the whole that is a cause by itself; None where there is none."""
    a = search.setting.inaccuracy
    pattern = a.patterns[a.groups.index("stiffness")][number]
    return next((c for c in search.candidates if is_of(c, pattern)), None)


def _heavier(search: Search, number: int) -> Change | None:
    """The change of an element's mass, told at the end that moves most; None where it has none to move."""
    a, c = search.setting.inaccuracy, search.setting.coordinates
    weight, pattern = float(a.kilograms[number]), a.patterns[a.groups.index("mass")][number]
    lumps = (c for c in search.candidates if c.slug == "added_mass" and len(c.where) == 1)
    ends = [lump for lump in lumps if lump.where[0] in a.places["mass"][number]]
    if weight <= 0 or not ends:
        return None
    at = max(ends, key=lambda lump: float((c.everywhere[c.names.index(str(lump.where[0]))] ** 2).sum()))
    return HeavyElement(
        "added_mass", at.where, JOINT * weight, pattern=pattern / weight, reference=weight, weight=RARER,
        ends=a.places["mass"][number],
    )  # fmt: skip
