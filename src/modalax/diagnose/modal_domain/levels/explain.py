"""Which law of which joint explains what changes from level to level, or whether the structure drifts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import ElastoSlip
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.modal_domain.levels.change import Base, Levels, projected, unexplained
from modalax.diagnose.modal_domain.levels.drift import Drift
from modalax.diagnose.modal_domain.levels.laws import NAMED, NAMELESS, LawFit, fit_law, regressed
from modalax.diagnose.modal_domain.levels.motion import (
    BALANCED,
    Motion,
    compliances_of,
    for_law,
    in_harmonics,
    motions_of,
)
from modalax.diagnose.modal_domain.levels.series import SERIES
from modalax.diagnose.modal_domain.levels.weigh import Shapes, weigh
from modalax.diagnose.thresholds import THRESHOLDS

JOINT, DRIFT = 0.2, 0.05  # chances before the data that a joint, or a drift, tells levels or runs apart
SAMPLED = 2000  # forces that places are screened on
HALVINGS = 4  # times that the distance of the thresholds that are tried is halved about the best of them
FITTED = 12  # leading places at which laws are fitted, where one gains enough to stand out
ALIKE, HARMONICS = 0.01, 300  # share of the gain that first harmonics do not tell, and forces on which all harmonics do
NEIGHBOURS = 8  # lines over which errors of a law's force go together
TOGETHER = 32  # places that are worked on at once
REFITTED = 8  # leading fits behind a compliance that are fitted again with all harmonics
BESIDE = 3  # leading fits beside which laws without a name are tried at the same places
AGREE = 0.01  # probability that nothing differs from which on no joint or drift is told
WEIGHED, NEAR = 8, 1000.0  # most fits that are weighed on all samples, and nats behind the best up to which they are,
NEAR_SHARE = 0.1  # or that share of all its nats: errors of the motion cost a wrong place and the right one alike


@dataclass(frozen=True, eq=False)
class Spot:
    """Where a joint may sit.

    Attributes
    ----------
    where, direction, weight
        Names, direction in modal coordinates, and weight among the places.
    held
        Whether the simulation has a spring there, which may slip.
    within
        Whether the linear model has one, of the simulation or as a cause.
    """

    where: tuple[str, ...]
    direction: np.ndarray
    weight: float
    held: bool = True
    within: bool = True


@dataclass(frozen=True)
class JointFound:
    """A law at a place, with its probability among all that were weighed.

    The direction, the relative error of the law's force and the lines set aside are as weighed.
    """

    spot: Spot
    fit: LawFit
    direction: np.ndarray
    tolerance: float
    aside: int
    log_posterior: float
    probability: float = 0.0

    @property
    def slug(self) -> str:
        """The law by name."""
        return self.fit.law.slug


@dataclass(frozen=True)
class ByLevel:
    """What the levels tell.

    Attributes
    ----------
    joints
        By falling probability.
    drift, drifting
        The likelier drift from run to run, and its probability.
    nothing
        Probability that nothing changes from level to level.
    before, after
        Chi-square per real sample of the changes from level to level, without and with what is likeliest.
    untried
        Whether no joint was tried although one may be the cause.
    places
        Where a joint would most likely be.
    """

    joints: list[JointFound]
    drift: Drift
    drifting: float
    nothing: float
    before: float
    after: float
    untried: bool = False
    places: Sequence[Spot] = ()

    @property
    def best(self) -> str:
        """What is told: the likelier of ``joint`` and ``drift``, or ``nothing`` where that may well be."""
        if self.nothing > AGREE:
            return "nothing"
        joint = self.joints[0].probability if self.joints else 0.0
        return max((self.drifting, "drift"), (joint, "joint"))[1]

    def sure(self, slug: str) -> float:
        """Probability of a law, wherever it is."""
        return sum(j.probability for j in self.joints if j.slug == slug)

    def placed(self, slug: str, where: tuple[str, ...]) -> float:
        """Probability of a place among all places of a law."""
        return self.sure_at(slug, where) / max(self.sure(slug), 1e-300)

    def sure_at(self, slug: str, where: tuple[str, ...]) -> float:
        """Probability of a law at a place."""
        return sum(j.probability for j in self.joints if j.slug == slug and j.spot.where == where)


def explain_levels(
    levels: Levels, base: Base, spots: Sequence[Spot], shapes: Shapes, drift: Drift,
    laws: Sequence[JointCause] = NAMED, late: Callable[[], bool] = lambda: False, untried: bool = False,
) -> ByLevel:  # fmt: skip
    """Fit every law at the leading places, weigh the best, and compare with a drift and with nothing at all."""
    before = unexplained(levels)
    places, gains, begun = _promising(levels, base, spots, laws, late) if spots else ([], [], {})
    some = [s for s, gain in zip(places, gains, strict=True) if gain > 0.5 * THRESHOLDS.stands_out**2]
    fits = _fitted(levels, base, some, laws, begun, late) if some else []
    found: list[JointFound] = []
    for rough, spot, f in fits[:WEIGHED]:
        if found and (rough < _near(fits[0][0]) or late()):
            break
        w = weigh(levels, base, shapes, spot.direction, f, spot.within)
        if w is None or not w.fit.rival:
            continue
        value = w.log_evidence + math.log(JOINT) + _prior(spot, f)
        together = NEIGHBOURS if w.tolerance > 0 else 1
        common = _common_error(w.fit, w.tolerance)
        best = replace(w.fit, covariance=together * w.fit.covariance + common)
        # what noise has in common with a force here is no law; that a place may move otherwise makes no force of noise
        if apart_from_zero(replace(w.fit, covariance=together * w.sharp + common)) < THRESHOLDS.stands_out:
            continue
        found.append(JointFound(spot, best, w.b, w.tolerance, w.aside, value))
    found.sort(key=lambda j: -j.log_posterior)
    if found and found[0].tolerance > 0:
        found = _told_apart(found, max(NEIGHBOURS, len(base.s) / len(shapes.fit.state.pairs)))
    elif found and isinstance(found[0].fit.law, BALANCED):
        found = _told_apart(found, NEIGHBOURS)  # errors of the motion are in the variance of its force
    nothing, moved = math.log(1 - JOINT - DRIFT) - 0.5 * before, math.log(DRIFT) + drift.log_evidence
    values = np.array([nothing, moved, *(j.log_posterior for j in found)])
    share = np.exp(values - values.max())
    share /= share.sum()
    joints = [replace(j, probability=float(p)) for j, p in zip(found, share[2:], strict=True)]
    best = ByLevel(joints, drift, float(share[1]), float(share[0]), before / levels.samples, 0.0, untried, places)
    after = {"nothing": before, "drift": drift.chi2, "joint": joints[0].fit.chi2 if joints else before}[best.best]
    return replace(best, after=min(before, after) / levels.samples)


def _near(best: float) -> float:
    """Log evidence before weighing [nats] below which a fit is not weighed beside the best."""
    return best - max(NEAR, NEAR_SHARE * abs(best))


def _told_apart(found: list[JointFound], lines: float) -> list[JointFound]:
    """Joints weighed by what is left to tell them apart where none of them explains all to the noise.

    What a law leaves goes together over neighbouring lines; what the motion at a place does, over so many ``lines``.
    """
    top = found[0]
    return [
        replace(j, log_posterior=top.log_posterior + (j.log_posterior - top.log_posterior) / count)
        for j in found
        for count in [NEIGHBOURS if j.spot.where == top.spot.where else lines]
    ]


def _common_error(f: LawFit, tolerance: float) -> np.ndarray:
    """What the strength of a law may be off by where the law's own error is the same at all lines."""
    strength = 1.0 if f.law.parameters[0].log else f.p[0]
    return np.diag([(tolerance * strength) ** 2, *np.zeros(len(f.p) - 1)])


def apart_from_zero(f: LawFit) -> float:
    """Standard deviations by which the parameters together differ from zero; of logarithms, over one."""
    value = np.array([1.0 if q.log else p for q, p in zip(f.law.parameters, f.p, strict=True)])
    size = np.sqrt(np.maximum(np.diag(f.covariance), 1e-300))
    inverse = np.linalg.pinv(f.covariance / size[:, None] / size, rcond=1e-9)
    return float(np.sqrt(max((value / size) @ inverse @ (value / size), 0.0)))


def _prior(spot: Spot, f: LawFit) -> float:
    return math.log(max(spot.weight, 1e-300)) + math.log(f.law.prior) + believed(f.law.slug)


def _promising(
    levels: Levels, base: Base, spots: Sequence[Spot], laws: Sequence[JointCause], late: Callable[[], bool]
) -> tuple[list[Spot], list[float], dict[tuple[str, ...], np.ndarray]]:
    """The leading places, what the best law gains there [nats], and how a spring would slip there."""
    gain = _screened(levels, base, np.array([s.direction for s in spots]), laws)
    order, begun = np.argsort(-(gain + np.log([max(s.weight, 1e-300) for s in spots]))), {}
    if any(isinstance(law, ElastoSlip) for law in laws):
        order, begun = _by_harmonics(levels, base, spots, gain, order, late)
    leading = order[:FITTED].tolist()
    return [spots[k] for k in leading], [float(gain[k]) for k in leading], begun


def _by_harmonics(
    levels: Levels, base: Base, spots: Sequence[Spot], gain: np.ndarray, order: np.ndarray, late: Callable[[], bool]
) -> tuple[np.ndarray, dict[tuple[str, ...], np.ndarray]]:  # fmt: skip
    """Places by falling gain, those that are alike by first harmonics as a spring that slips is told with all."""
    like = order[gain[order] > (1 - ALIKE) * gain.max()]
    if len(like) <= FITTED:
        return order, {}
    step = max(1, levels.H[1:, :, 0].size // HARMONICS)
    levels, base = levels.thinned(step), base.thinned(step)
    b = np.array([spots[k].direction for k in like])
    motions = in_harmonics(
        motions_of(levels, base, b, projected(levels, base, b)), base, b, [spots[k].within for k in like]
    )
    fits = [None if late() else fit_law(ElastoSlip(True), m) for m in motions]
    cost = [np.inf if f is None else f.chi2 for f in fits]
    begun = {spots[k].where: f.p for k, f in zip(like, fits, strict=True) if f is not None}
    return np.concatenate([like[np.argsort(cost)], order[~np.isin(order, like)]]), begun


def _screened(levels: Levels, base: Base, b: np.ndarray, laws: Sequence[JointCause]) -> np.ndarray:
    """What the best law gains at each place, on some lines as if on all [nats], shape ``(p,)``.

    Its threshold is sought at every place: one of those tried may be far from it, as they reach over orders of size.
    """
    out = []
    step = max(1, levels.H[1:, :, 0].size // SAMPLED)
    levels, base = levels.thinned(step), base.thinned(step)
    before = unexplained(levels)
    for part in np.array_split(np.arange(len(b)), max(1, len(b) // TOGETHER)):
        for both in _both(levels, base, b[part]):
            cost = [c for law in laws for c, _ in regressed(law, both[isinstance(law, SERIES)], 2, HALVINGS)[:1]]
            out.append(0.5 * step * (before - min(cost, default=np.inf)))
    return np.array(out)


def _both(levels: Levels, base: Base, b: np.ndarray) -> list[tuple[Motion, Motion]]:
    """Motions across places, and behind their compliances."""
    motions = motions_of(levels, base, b, projected(levels, base, b))
    return [(m, m.behind(float(g), levels.force)) for m, g in zip(motions, compliances_of(base, b), strict=True)]


def _fitted(
    levels: Levels, base: Base, spots: Sequence[Spot], laws: Sequence[JointCause],
    begun: dict[tuple[str, ...], np.ndarray], late: Callable[[], bool],
) -> list[tuple[float, Spot, LawFit]]:  # fmt: skip
    """Fits of every law at every place, the best first; where time is up, at no further place.

    A place that any force leaves too far behind is none for a law. Slips take longest, and come last of those named.
    """
    found: list[tuple[float, Spot, LawFit]] = []
    value = lambda s, f: -0.5 * f.chi2 - 0.5 * len(f.p) * math.log(levels.samples) + _prior(s, f)
    b = np.array([s.direction for s in spots])
    motions = _both(levels, base, b)
    slips = [law for law in laws if isinstance(law, ElastoSlip)]
    exact = in_harmonics([m for m, _ in motions], base, b, [s.within for s in spots]) if slips else []
    for some in ([law for law in laws if law not in slips], slips, NAMELESS):
        leading = [s for _, s, _ in found[:BESIDE]]
        for k, spot in enumerate(spots):
            if found and (late() or -0.5 * motions[k][0].least < _near(max(v for v, _, _ in found))):
                continue
            if some is NAMELESS and leading and all(spot is not s for s in leading):
                continue
            for law in some:
                slip = law in slips
                f = fit_law(law, exact[k] if slip else motions[k][isinstance(law, SERIES)], begun.get(spot.where))
                if f is not None and np.isfinite(f.chi2) and f.rival:
                    found.append((value(spot, f), spot, f))
        found.sort(key=lambda one: -one[0])
    for n, (_, spot, f) in enumerate(found[:REFITTED]):
        if isinstance(f.law, SERIES) and f.p[0] and not late():
            m = for_law(motions[spots.index(spot)][0], levels, base, spot.direction, f.law, spot.within)
            again = fit_law(f.law, m, f.p)
            if again is not None and np.isfinite(again.chi2):
                found[n] = value(spot, again), spot, again
    return sorted(found, key=lambda one: -one[0])
