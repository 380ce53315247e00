r"""One element that is off unevenly, as where one of several members in parallel is wrong.

Such an element (:mod:`modalax.diagnose.modal_domain.causes.within_elements`) is looked for where elements seem to be
off unevenly in general, which one that is far off makes of them.
"""

from collections.abc import Callable

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.places import JOINT
from modalax.diagnose.modal_domain.causes.within_elements import OneMember, PlateElement, UnevenElement, of_rows
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import WITHIN
from modalax.diagnose.modal_domain.fitting.throughout import coupled_elements, uneven_patterns, ways_of
from modalax.diagnose.modal_domain.search.steps import MOST, Search
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.nodes import nodes_of

NEGLIGIBLE = 1e-6  # difference of two elements, relative to their stiffness, below which they are one
FEW = 2  # elements that are tried, those that are farthest off
MOST_WAYS = 3  # of being strained, of an element that may be off in all: a storey sways two ways and twists


def off_unevenly(search: Search, late: Callable[[], bool]) -> None:
    """Fit the leading explanation with the elements that seem to be farthest off as causes, and each of these alone."""
    best = search.best
    for element, u in _farthest(search, best):
        kept = tuple(c for c in best.causes if set(c.where) != set(element.where) or c.kind != "K")
        sizes = [best.u[own_sizes(best.causes, best.causes.index(c))] for c in kept]
        for causes, start in {kept: sizes, (): []}.items():
            if not late() and len(causes) < MOST:
                attempt(search.setting, search.found, (*causes, element), np.concatenate([*start, u]), None)


def _farthest(search: Search, f: Fit) -> list[tuple[Change, np.ndarray]]:
    """The elements that a fit has farthest off in their uneven changes, and one spring of each, with their sizes."""
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
    far = np.array([float((part**2).sum()) for part in parts])
    pieces, number = a.patterns[a.groups.index("stiffness")], a.elements.get("stiffness", np.arange(len(wholes)))
    out: list[tuple[Change, np.ndarray]] = []
    for k in np.argsort(-far)[:FEW].tolist():
        among = [wholes[k], *(pieces[number == k] if len(pieces) != len(wholes) else [])]
        told = [c for P in among for c in search.candidates if is_of(c, P)]
        if not told or far[k] == 0:
            continue
        if ranks[k] <= MOST_WAYS:
            ways = uneven_patterns(wholes[k : k + 1])
            cause = UnevenElement(
                "joint_stiffness", told[0].where, JOINT, pattern=wholes[k], weight=told[0].weight, ways=ways
            )
            out.append((cause, parts[k] / JOINT))
        out += _springs(search.setting.coordinates, wholes[k], parts[k], told[0])
    return out


def _springs(c: Coordinates, P: np.ndarray, sizes: np.ndarray, told: Change) -> list[tuple[Change, np.ndarray]]:
    """A softer and a stiffer spring of an element ``P``, strained as its uneven ``sizes`` change it most."""
    ways, nodes = ways_of(P), nodes_of(c.names)
    values, vectors = np.linalg.eigh(of_rows(sizes))
    at = dict.fromkeys(int(nodes.of_dofs[c.names.index(str(name))]) for name in told.where)
    held = np.concatenate([nodes.members[k] for k in at])
    forces, first = np.linalg.lstsq(c.everywhere[held].T, ways.T, rcond=1e-9)[0].T, next(iter(at))
    moves, factor = np.zeros((len(ways), 6)), np.zeros((len(c.names), len(ways)))
    factor[held] = forces.T
    for k, force in zip(held.tolist(), forces.T, strict=True):
        if nodes.axis[k] >= 0 and nodes.of_dofs[k] == first:
            moves[:, nodes.axis[k]] = nodes.sign[k] * force
    out: list[tuple[Change, np.ndarray]] = []
    for value, a in ((values[0], vectors[:, 0]), (values[-1], vectors[:, -1])):
        main = int(np.argmax(np.abs(a @ moves[:, :3])))
        where = tuple(c.names[k] for k in held if nodes.axis[k] == main) if moves[:, :3].any() else told.where
        spring = OneMember(
            "joint_stiffness", where, JOINT, pattern=P, factor=factor, weight=told.weight, ways=ways, moves=moves,
            stiffer=value > 0,
        )  # fmt: skip
        if value != 0 and len(where) == len(told.where):
            out.append((spring, a * np.sqrt(abs(value) * len(ways) / JOINT)))
    return out


def is_of(cause: Change, P: np.ndarray) -> bool:
    """Whether a cause is a change of an element, or of a piece of it, by the whole."""
    if type(cause) not in (Change, PlateElement) or cause.kind != "K" or cause.absent:
        return False
    return bool(np.abs(cause.matrix / JOINT - P).max() < NEGLIGIBLE * np.abs(P).max())
