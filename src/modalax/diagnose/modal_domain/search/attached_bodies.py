"""Bodies with their centre of mass off a node, looked for where no cause explains what is measured.

Far from the simulation only finite sizes tell: all nodes are compared by a few of them, and the nearest are fitted.
"""

import itertools
from collections.abc import Callable

import numpy as np
import scipy.optimize

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.places import LUMP
from modalax.diagnose.modal_domain.causes.rigid_bodies import RigidBody
from modalax.diagnose.modal_domain.fitting.attempts import attempt, explains
from modalax.diagnose.modal_domain.fitting.state import Setting, state_at
from modalax.diagnose.modal_domain.search.screen import UNUSABLE, cost_of_size, tolerance
from modalax.diagnose.modal_domain.search.steps import FAR, MOST, Search
from modalax.diagnose.modal_domain.structure.nodes import Nodes, nodes_of

RARER = 0.1  # chance of such a body, relative to that of a lump at its node
NODES, NEAREST, STARTS = 3, 4, 2  # that are tried; first trials that are made nearer, and of these that are fitted
MASSES, RADII = (0.2, 1.0, 3.0), (0.15, 0.6)  # first trials, over the usual sizes
OFFSETS = -1.2, -0.2, 0.0, 0.2, 1.2
EVALUATIONS = 200  # of the distance, by which each of the nearest is made nearer
STILL = 1e-12  # square of a motion, relative to the largest of its kind, below which a node does not move so

Late = Callable[[], bool]  # whether time is up


def attached_bodies(search: Search, late: Late) -> None:
    """Fit bodies at the nearest nodes, alone and beside the other causes of the leading explanation."""
    best, usual = search.best, search.setting.inaccuracy.usual
    matrices = np.isin(search.setting.inaccuracy.groups, ("stiffness", "mass"))
    masses = [c for c in best.causes if c.slug == "added_mass"]
    if explains(best) and not (best.epsilon > FAR * usual)[matrices].any() and len(masses) < 2:
        return
    if () not in search.found:  # the simulation has too few modes to be compared without a cause
        return
    bodies, kept = _bodies(search), tuple(c for c in best.causes if c.slug != "added_mass")
    sizes = [best.u[own_sizes(best.causes, best.causes.index(c))] for c in kept]
    for causes, u in {(): np.zeros(0), kept: np.concatenate([np.zeros(0), *sizes])}.items():
        left = _Distance(search.setting, causes, u, late)
        for body in sorted(bodies, key=left.nearest)[:NODES]:
            for start in left.starts(body):
                if not late() and len(causes) < MOST:
                    attempt(search.setting, search.found, (*causes, body), np.concatenate([u, start]), None)
            if search.best is not best and explains(search.best):
                return


class _Distance:
    """What a body leaves beside what the general inaccuracy explains, and what its sizes cost before the data.

    It is beside other ``causes``, of sizes ``sizes``.
    """

    def __init__(self, setting: Setting, causes: tuple[Change, ...], sizes: np.ndarray, late: Late) -> None:
        self.setting, self.late, self.shrink = setting, late, tolerance(setting)[1]
        self.still, self.causes, self.sizes = np.zeros(len(setting.inaccuracy.group_of)), causes, sizes

    def at(self, body: RigidBody, u: np.ndarray) -> float:
        """What a body of some sizes leaves."""
        if self.late() or not body.possible(u):
            return UNUSABLE
        try:
            every = (*self.causes, body), np.concatenate([self.sizes, u])
            r = state_at(self.setting, self.still, *every).difference
        except np.linalg.LinAlgError:
            return UNUSABLE
        h = self.shrink @ r
        return float(r @ r - h @ h) + float(cost_of_size(u).sum())

    def nearest(self, body: RigidBody) -> float:
        """The least of few trials: an offset along one axis at most, and one radius for all."""
        offsets = np.vstack([np.zeros(len(body.axes)), *(size * np.eye(len(body.axes)) for size in OFFSETS if size)])
        return min(self.at(body, body.round(*trial)) for trial in itertools.product(MASSES, offsets, RADII))

    def starts(self, body: RigidBody) -> list[np.ndarray]:
        """Sizes of a body that leave least, all radii alike."""
        alike = lambda u: self.at(body, body.round(u[0], u[1:-1], u[-1]))
        trials = [np.array(u) for u in itertools.product(MASSES, *(OFFSETS for _ in body.axes), RADII)]
        nearest = np.argsort([alike(u) for u in trials], kind="stable")[:NEAREST]
        options = {"maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1.0}
        found = [scipy.optimize.minimize(alike, trials[k], method="Nelder-Mead", options=options) for k in nearest]
        least = sorted(found, key=lambda each: each.fun)[:STARTS]
        return [body.round(each.x[0], each.x[1:-1], each.x[-1]) for each in least if each.fun < UNUSABLE]


def _bodies(search: Search) -> list[RigidBody]:
    """A body at every node that moves and turns, so that an offset shows."""
    c = search.setting.coordinates
    nodes, inside = nodes_of(c.names), slice(0, len(search.setting.features.poles))
    lumps = {m.where[0]: m for m in search.candidates if m.slug == "added_mass" and len(m.where) == 1}
    motions = [_motions(nodes, members) for members in nodes.members]
    moved = [which.T @ c.everywhere for which in motions]
    sizes = [(moves[:, inside] ** 2).sum(axis=1) for moves in moved]
    least = STILL * np.repeat(np.reshape(sizes, (-1, 2, 3)).max(axis=(0, 2)), 3)
    out = []
    for members, which, moves, size in zip(nodes.members, motions, moved, sizes, strict=True):
        there = size > least
        axes = tuple(k for k in range(3) if any(there[3 + a] and there[3 - a - k] for a in range(3) if a != k))
        straight = [k for k in members if 0 <= nodes.axis[k] < 3 and c.names[k] in lumps]
        if not axes or not straight:
            continue
        lump = lumps[c.names[max(straight, key=lambda k: size[nodes.axis[k]])]]
        body = RigidBody(
            "added_mass", lump.where, LUMP * len(search.setting.features.poles) / float(size[:3].sum()),
            pattern=moves[:3].T @ moves[:3], reference=lump.reference, weight=RARER * lump.weight, moves=moves,
            axes=axes, turns=tuple(np.flatnonzero(there[3:]).tolist()), factor=which,
            reach=float(np.sqrt(size[:3].sum() / size[3:].sum())),
        )  # fmt: skip
        out.append(body)
    return out


def _motions(nodes: Nodes, members: np.ndarray) -> np.ndarray:
    """Which DoFs are the six motions of a node, with their signs, shape ``(n, 6)``."""
    which = np.zeros((len(nodes.axis), 6))
    for k in members[nodes.axis[members] >= 0]:
        which[k, nodes.axis[k]] = nodes.sign[k]
    return which
