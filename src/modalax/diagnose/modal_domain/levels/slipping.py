r"""A joint that slips is a spring until it does: one that the simulation has, or one that it lacks.

Of a spring that the simulation has, the levels alone tell. One that it lacks shows twice, linearly as a stiffness ``s``
at its place, and by level as the stiffness ``k`` that is lost: one joint, if both have one size. Before the data each
is as likely; the latter's linear part needs no prior of its own, but that of the law,

.. math:: \frac{p(s\mid k)}{p(s)}=\frac{\mathcal N(s;\,k,\ \sigma_s^2+\sigma_k^2)}{\mathcal N(s;\,0,\ s_0^2)}.

Where the simulation has no spring, and the lowest level shows none, nothing is there that could slip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.joints import ElastoSlip
from modalax.diagnose.causes.power_laws import IwanMicroSlip
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.fitting.explanation import SECOND, Explanation, Prior
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.levels.explain import ByLevel, JointFound
from modalax.diagnose.modal_domain.levels.laws import LawFit
from modalax.diagnose.modal_domain.search.explain import further
from modalax.diagnose.modal_domain.search.force_places import JOINTS

SLIPPING = (ElastoSlip, IwanMicroSlip)  # laws of a spring that slips
# What a joint may do at any amplitude; one that slips at the lowest level already is a spring that loses energy there
LINEAR_PART = "joint_stiffness", "local_damper", *JOINTS
LIKELY = 1e-3  # probability of a joint by level from which its spring is looked for
EITHER = math.log(0.5)  # of a spring that the simulation has, or lacks


@dataclass(frozen=True)
class Whole:
    """A joint that the simulation lacks altogether.

    Attributes
    ----------
    spring
        The cause that it is to the linear structure.
    stiffness, std
        Its stiffness until it slips [N/m].
    fit
        The whole joint's law; that of what is lost by level, where the law has no other form.
    """

    spring: Change
    stiffness: float
    std: float
    fit: LawFit

    @property
    def alone(self) -> bool:
        """Whether the law holds the spring."""
        return isinstance(self.fit.law, ElastoSlip)


def same_place(one: Sequence[Any], other: Sequence[Any]) -> bool:
    """Whether two places are the same, a pair of DoFs in either order."""
    return sorted(map(str, one)) == sorted(map(str, other))


def part_of_joint(c: Change, where: Sequence[str]) -> bool:
    """Whether a cause is a spring, damper or loss at a joint's place: what that joint does at any level."""
    return c.slug in LINEAR_PART and same_place(c.where, where)


def spring_of(e: Explanation, j: JointFound) -> int | None:
    """Which cause of an explanation is a spring at the place of a joint that slips; None where there is none."""
    if not isinstance(j.fit.law, SLIPPING):
        return None
    return next((k for k, c in enumerate(e.causes) if is_spring_at(c, j.spot.where)), None)


def is_spring_at(c: Change, where: Sequence[str]) -> bool:
    """Whether a cause is a spring at a place."""
    return c.slug == "joint_stiffness" and c.pattern is None and same_place(c.where, where)


def size_of(e: Explanation, k: int) -> tuple[float, float]:
    """Stiffness of a spring among the causes, and its standard deviation [N/m]."""
    own, scale = own_sizes(e.causes, k).start, e.causes[k].scale
    return float(e.fit.u[own]) * scale, float(np.sqrt(max(e.fit.covariance[own, own], 0.0))) * scale


def with_springs(
    setting: Setting, explanations: list[Explanation], found: ByLevel, candidates: list[Change]
) -> list[Explanation]:
    """Explanations together with those of a spring at each place where a joint that slips is likely.

    Where the leading explanation has one at the leading joint's place already, none is looked for at others.
    """
    if found.best == "joint" and explanations and spring_of(explanations[0], found.joints[0]) is not None:
        return explanations
    likely = [j for j in found.joints if j.probability > LIKELY and isinstance(j.fit.law, SLIPPING)]
    for j in likely if found.best == "joint" else ():
        if any(spring_of(e, j) is not None for e in explanations):
            continue
        springs = (c for c in candidates if is_spring_at(c, j.spot.where))
        spring = next(springs, None)
        if spring is not None:
            lost = float(j.fit.p[0]) if isinstance(j.fit.law, ElastoSlip) else 0.0
            explanations = further(setting, explanations, candidates, spring, lost / spring.scale)
    return explanations


def lacked(e: Explanation, k: int, j: JointFound, prior: Prior) -> float:
    """Log of how much likelier the data make a joint that the simulation lacks than its two parts by themselves."""
    s, std = size_of(e, k)
    others = [c for n, c in enumerate(e.causes) if n != k]
    saved = prior.of(others) - prior.of(e.causes) + EITHER
    if not isinstance(j.fit.law, ElastoSlip):  # which tells what is lost, and not of how much
        return saved if s > 0 else -math.inf
    lost, variance = float(j.fit.p[0]), std**2 + float(j.fit.covariance[0, 0]) + (j.tolerance * float(j.fit.p[0])) ** 2
    scale = e.causes[k].scale
    return saved + 0.5 * ((s / scale) ** 2 - (s - lost) ** 2 / variance + math.log(scale**2 / variance))


def _together(e: Explanation, j: JointFound, prior: Prior) -> tuple[float, bool]:
    """Log probability of a joint beside an explanation, relative to the two alone, and whether their spring is one.

    Beside a joint any linear cause but its own is a second thing that is wrong.
    """
    further = any(not part_of_joint(c, j.spot.where) for c in e.causes)
    price = math.log(SECOND) if further else 0.0
    if not isinstance(j.fit.law, SLIPPING):
        return price, False
    k = spring_of(e, j)
    held = EITHER if j.spot.held or k is not None else -math.inf
    whole = -math.inf if k is None else lacked(e, k, j, prior)
    return price + max(held, whole), whole > held


def settled(explanations: list[Explanation], found: ByLevel, prior: Prior) -> tuple[list[Explanation], ByLevel]:
    """Explanations of the linear structure and joints, each by its probability beside all of the others."""
    joints = [j for j in found.joints if j.probability > 0]
    if found.best != "joint" or not joints:
        return explanations, found
    alone = np.log([max(e.probability, 1e-300) for e in explanations])
    pairs = np.array(
        [[a + _together(e, j, prior)[0] for j in joints] for e, a in zip(explanations, alone, strict=True)]
    )
    pairs += np.log([j.probability for j in joints])
    if not np.isfinite(pairs).any():
        return explanations, found
    share = np.exp(pairs - pairs.max())
    by_joint, top = share.sum(axis=0), math.exp(min(pairs.max(), 700.0))
    rest = np.array([found.nothing, found.drifting]) / max(top, 1e-300)
    total = by_joint.sum() + rest.sum()
    told = [replace(j, probability=float(p / total)) for j, p in zip(joints, by_joint, strict=True)]
    told.sort(key=lambda j: -j.probability)
    nothing, drifting = (float(v) for v in rest / total)
    after = min(found.before, found.after * told[0].fit.chi2 / max(found.joints[0].fit.chi2, 1e-300))
    by_set = share.sum(axis=1) / share.sum()
    ranked = [replace(e, probability=float(p)) for e, p in zip(explanations, by_set, strict=True)]
    return sorted(ranked, key=lambda e: -e.probability), replace(
        found, joints=told, nothing=nothing, drifting=drifting, after=after
    )  # fmt: skip


def whole_joint(e: Explanation, j: JointFound, prior: Prior) -> Whole | None:
    """The joint that the simulation lacks altogether, from both its parts; None where its parts are not one joint."""
    k = spring_of(e, j)
    if k is None or not _together(e, j, prior)[1]:
        return None
    s, std = size_of(e, k)
    f, spring = j.fit, e.causes[k]
    if not isinstance(f.law, ElastoSlip):
        return Whole(spring, s, std, f)
    P = f.covariance
    share = P[:, 0] / (P[0, 0] + std**2)  # of what the linear part adds to what is known by level
    step = share * (s - f.p[0])
    p = np.array([f.p[0] + step[0], f.p[1] * math.exp(step[1])])
    covariance = P - np.outer(share, P[0])
    fit = LawFit(ElastoSlip(False), p, covariance, f.chi2)
    return Whole(spring, float(p[0]), float(np.sqrt(max(covariance[0, 0], 0.0))), fit)
