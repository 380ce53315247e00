r"""One element that is off unevenly, as where one of several members in parallel is wrong.

A matrix shows the columns of a storey as one element :math:`K_e=FF^T`. Where one of them is wrong, its ways of being
strained change each by itself and are coupled: :math:`F(I+Z)F^T` with ``Z`` symmetric, no eigenvalue below -1. Such an
element is looked for where elements seem to be off unevenly in general, which one that is far off makes of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.modal_domain.causes.change import UNITS, Change, own_sizes
from modalax.diagnose.modal_domain.causes.places import JOINT
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import WITHIN
from modalax.diagnose.modal_domain.fitting.throughout import coupled_elements, uneven_patterns, ways_of
from modalax.diagnose.modal_domain.search.steps import MOST, Search

NEGLIGIBLE = 1e-6  # difference of two elements, relative to their stiffness, below which they are one
FEW = 2  # elements that are tried, those that are farthest off
MOST_WAYS = 3  # of being strained, of an element that is looked at: a storey sways two ways and twists


@dataclass(frozen=True)
class UnevenElement(Change):
    """An element whose ways of being strained are off each by itself; its sizes are those of ``Z``.

    Attributes
    ----------
    ways
        Changes by sizes of one, as :func:`modalax.diagnose.modal_domain.fitting.throughout.uneven_patterns` makes them,
        shape ``(r (r + 1) / 2, n, n)``.
    """

    ways: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)), compare=False)

    @property
    def count(self) -> int:
        """One for each way of being strained, and for each two of them."""
        return len(self.ways)

    @property
    def telling(self) -> int:
        """All of its sizes."""
        return self.count

    @property
    def screened(self) -> bool:
        """Only where elements seem to be off unevenly."""
        return False

    @property
    def linear(self) -> bool:
        """It has several sizes."""
        return False

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Change of the stiffness."""
        return {"K": self.scale * np.tensordot(u, self.ways, 1)}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """The changes by sizes of one."""
        return [{"K": self.scale * way} for way in self.ways]

    def relative_changes(self, u: np.ndarray) -> np.ndarray:
        """Eigenvalues of ``Z``, rising: by how much each of some ways of being strained is stiffer."""
        rank = int(np.sqrt(2 * len(u)))
        Z, rows = np.zeros((rank, rank)), [(a, b) for a in range(rank) for b in (a, *range(a))]
        for (a, b), size in zip(rows, self.scale * u, strict=True):
            Z[a, b] = Z[b, a] = size if a == b else size / np.sqrt(2)
        return np.linalg.eigvalsh(Z)

    def possible(self, u: np.ndarray) -> bool:
        """No way of being strained has less than no stiffness."""
        return bool(self.relative_changes(u)[0] > -1)

    def size(self, u: np.ndarray) -> float:
        """The largest relative change of any way of being strained."""
        return float(max(self.relative_changes(u), key=abs))

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The mean relative change of all ways, which is linear in the sizes."""
        rank = int(np.sqrt(2 * len(u)))
        own = np.cumsum(np.arange(rank))
        mean = np.zeros(len(u))
        mean[own] = self.scale / rank
        name, unit = UNITS["modal_damping"]
        std = float(np.sqrt(max(mean @ covariance @ mean, 0.0)))
        return {name: {"value": float(mean @ u), "std": std, "unit": unit}}

    def said(self) -> str:
        """What would change an element so."""
        between = " and ".join(map(str, self.where)) if len(self.where) > 1 else f"{self.where[0]} and the ground"
        return (
            f"what joins {between} is off by unlike amounts in its different motions, which it couples: as where "
            "one of several members in parallel is wrong"
        )


def off_unevenly(search: Search, late: Callable[[], bool]) -> None:
    """Fit the leading explanation with the elements that seem to be farthest off as causes, and each of these alone."""
    best = search.best
    for element, u in _farthest(search, best):
        kept = tuple(c for c in best.causes if set(c.where) != set(element.where) or c.kind != "K")
        sizes = [best.u[own_sizes(best.causes, best.causes.index(c))] for c in kept]
        for causes, start in {kept: sizes, (): []}.items():
            if not late() and len(causes) < MOST:
                attempt(search.setting, search.found, (*causes, element), np.concatenate([*start, u]), None)


def _farthest(search: Search, f: Fit) -> list[tuple[UnevenElement, np.ndarray]]:
    """The elements that a fit has farthest off in their uneven changes, with the sizes that it has."""
    a = search.setting.inaccuracy
    if WITHIN["stiffness"] not in a.groups:
        return []
    single, uneven = (np.flatnonzero(a.group_of == a.groups.index(g)) for g in ("stiffness", WITHIN["stiffness"]))
    wholes = coupled_elements(a.patterns[a.groups.index("stiffness")], a.elements.get("stiffness"))
    ranks = np.array([len(ways_of(P)) for P in wholes])
    counts = np.where(ranks > 1, ranks * (ranks + 1) // 2, 0)
    if counts.sum() != len(uneven) or not len(single):  # they stand for couplings of what is no element
        return []
    parts = np.split(f.sizes[uneven], np.cumsum(counts)[:-1])
    far = np.array([float((part**2).sum()) for part in parts]) * (ranks <= MOST_WAYS)
    pieces, number = a.patterns[a.groups.index("stiffness")], a.elements.get("stiffness", np.arange(len(wholes)))
    out = []
    for k in np.argsort(-far)[:FEW].tolist():
        among = [wholes[k], *(pieces[number == k] if len(pieces) != len(wholes) else [])]
        told = [c for P in among for c in search.candidates if _is_of(c, P)]
        if far[k] > 0 and told:
            ways = uneven_patterns(wholes[k : k + 1])
            cause = UnevenElement(
                "joint_stiffness", told[0].where, JOINT, pattern=wholes[k], weight=told[0].weight, ways=ways
            )
            out.append((cause, parts[k] / JOINT))
    return out


def _is_of(cause: Change, P: np.ndarray) -> bool:
    """Whether a cause is a change of an element, or of a piece of it, by the whole."""
    if type(cause) is not Change or cause.kind != "K" or cause.absent:
        return False
    return bool(np.abs(cause.matrix / JOINT - P).max() < NEGLIGIBLE * np.abs(P).max())
