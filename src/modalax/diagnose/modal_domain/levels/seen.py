"""What the levels tell beside a linear explanation, what that predicts, and the linear structure without its joint."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.further_causes import TunedMass
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.levels.change import Base, Levels, base_of, by_level, change_by
from modalax.diagnose.modal_domain.levels.drift import Drift, by_run, change_of, drifts
from modalax.diagnose.modal_domain.levels.explain import ByLevel, JointFound, Spot, explain_levels
from modalax.diagnose.modal_domain.levels.laws import NAMED, LawFit, force_of, stiffness_of
from modalax.diagnose.modal_domain.levels.motion import motion_of
from modalax.diagnose.modal_domain.levels.slipping import is_spring_at, settled, with_springs
from modalax.diagnose.modal_domain.levels.weigh import Shapes, weigh
from modalax.diagnose.modal_domain.modes.features import Features, chosen, sure, whitener_of
from modalax.diagnose.modal_domain.modes.measured import Measured, features_beside, reidentified
from modalax.diagnose.modal_domain.search.explain import again, explain

MOST = 4_000_000  # samples times modes that are worked on at once, some 0.5 GB
BENT = 10.0  # chi-square of a joint's force at the lowest level from which the linear structure is sought without it
FARTHEST = 0.5  # greatest relative change of a parameter by which its deviation is felt
PASSES = 3  # times that the structure without its joint is looked for
GRID, HALVINGS, RANGE = 60, 25, 60.0  # search for an amplitude: points, bisections, factor on either side


@dataclass(frozen=True)
class Seen:
    """What levels tell, with all that a prediction needs.

    Attributes
    ----------
    levels, base, shapes
        Runs by level, the linear model that their changes are told from, and how well its shapes are known.
    found
        Joints, drift or nothing, with probabilities.
    """

    levels: Levels
    base: Base
    shapes: Shapes
    found: ByLevel

    @property
    def joint(self) -> JointFound | None:
        """The leading joint, where a joint is likeliest."""
        return self.found.joints[0] if self.found.best == "joint" else None

    @property
    def drift(self) -> Drift | None:
        """The drift from run to run, where that is likeliest."""
        return self.found.drift if self.found.best == "drift" else None


# A look at the levels beside a linear structure, after an earlier one, whose leading places alone may be looked at.
Look = Callable[[Measured, Setting, Fit, Seen | None, bool], Seen | None]


def look_at_levels(
    H: np.ndarray, level: np.ndarray, measured: Measured, setting: Setting, f: Fit, spots: Sequence[Spot],
    wanted: Callable[[str], bool], tell: Callable[[str], None], late: Callable[[], bool], drift: Drift | None = None,
) -> Seen | None:  # fmt: skip
    """Compare the runs; None where there is one only. A drift that was fitted to them before stays what it was."""
    if len(H) < 2:
        return None
    tell("comparing the runs")
    levels = by_level(H, measured.noise.sigma, level, float(np.mean(level[measured.runs])))
    base = base_of(setting, f, measured.freq, measured.channels.order)
    plain = by_run(H, measured.noise.sigma) if levels is None else levels
    step = -(-plain.H.size * max(len(measured.modes.poles), 1) // MOST)  # very large tests: some lines only
    if drift is None:
        c = measured.channels
        few = replace(c, s=c.s[::step], data=c.data[::step], weight=c.weight[::step])
        drift = max(drifts(plain.thinned(step), measured.modes, few), key=lambda d: d.log_evidence)
    shapes = Shapes(setting, f, base)
    laws = [law for law in NAMED if wanted(law.slug)]
    spots = [replace(s, within=s.held or any(is_spring_at(c, s.where) for c in f.causes)) for s in spots]
    asked = levels is not None and bool(laws)
    untried = asked and late()
    places = spots if asked and not untried else []
    found = explain_levels(plain.thinned(step), base.thinned(step), places, shapes, drift, laws, late, untried)
    return Seen(plain, base, shapes, found)


def at_levels(seen: Seen, j: JointFound, level: np.ndarray) -> np.ndarray:
    """FRFs ``(run, f, o, i)`` with a joint, at the measured amplitudes."""
    motion = motion_of(seen.levels, seen.base, j.direction, j.fit.law, j.spot.within)
    force = force_of(j.fit.law, motion, j.fit.p)
    every = np.concatenate([np.zeros_like(force[..., :1]), force], axis=2) + motion.first[..., None]
    return seen.base.H + change_by(seen.base, j.direction, every)[seen.levels.of_runs(level)]


def drift_by_run(seen: Seen, measured: Measured, level: np.ndarray) -> np.ndarray | float:
    """By what a drift has changed each run since the first, shape ``(run, f, o, i)``; 0 where there is none."""
    if seen.drift is None:
        return 0.0
    change = change_of(seen.drift, measured.modes, measured.channels).reshape(-1, *seen.levels.H.shape[1:])
    return change[seen.levels.of_runs(level)] if np.ptp(seen.levels.force) else change


def force_taken(seen: Seen, level: np.ndarray, used: np.ndarray, p: np.ndarray | None = None) -> np.ndarray:
    r"""What the joint changes of some runs, ``(run, f, o, i)``, from the structure without it.

    With its law's :math:`N_1` at the lowest level, and the receptance :math:`d_1` across the place there, a force
    ``q`` on the structure as it is at that level is one of :math:`q/(1 - N_1d_1)` on the structure without the joint.
    """
    j, b = seen.joint, seen.base
    assert j is not None
    p = j.fit.p if p is None else p
    m = motion_of(seen.levels, b, j.direction, j.fit.law, j.spot.within)
    N = stiffness_of(j.fit.law, m, p)
    force = N * m.moved(force_of(j.fit.law, m, p)) * m.turn / (1 - N[0] * (m.drive + m.compliance))
    return change_by(b, j.direction, force.transpose(1, 2, 0))[seen.levels.of_runs(level[used])]


def without_joint(
    H: np.ndarray, measured: Measured, setting: Setting, seen: Seen, taken: np.ndarray, level: np.ndarray
) -> tuple[Measured, Setting]:  # fmt: skip
    """The linear structure's own modes, with the joint's force taken out of the runs that they are identified from."""
    j = seen.joint
    assert j is not None
    free = H.copy()
    free[measured.runs] -= taken
    again = reidentified(measured, free, j.tolerance * np.abs(taken))
    if not len(again.features.poles):  # the force that was taken out is none that leaves modes
        return again, setting
    other = [force_taken(seen, level, measured.runs, p) for p in _within_deviation(j.fit)]
    inexact = [(1 + j.tolerance * way) * taken for way in (1, 1j)]
    features = _widened(again, H, other, inexact)
    again = replace(again, features=chosen(features, sure(features)))
    return again, replace(setting, features=again.features, whitener=whitener_of(again.features))


def felt(change: np.ndarray, measured: Measured) -> bool:
    """Whether a change of the runs that the linear structure is identified from, ``(run, f, o, i)``, may move it."""
    return 2 * float((np.abs(change / measured.noise.sigma[measured.runs]) ** 2).sum()) >= BENT


def joint_and_structure(
    H: np.ndarray, level: np.ndarray, measured: Measured, setting: Setting, explanations: list[Explanation],
    candidates: list[Change], look: Look, late: Deadline, tell: Callable[[str], None], early: Sequence[Seen] = (),
) -> tuple[Measured, Setting, list[Explanation], Seen | None]:  # fmt: skip
    """What the levels tell, and the linear structure beside it; each is looked for again until neither moves the other.

    What describes the lowest level still holds some of a joint. What is found without it describes the levels better,
    else it is not kept: a law that is not exact there takes out what the structure does by itself.
    ``early`` is what they tell beside the explanations, if anything, where these hold one cause at most.
    """
    # what a law leaves of a peak that it distorts looks like a mode too many
    some = [c for c in candidates if c.freed is None and not isinstance(c, TunedMass)]
    prior, taken = Prior(candidates), None
    raw = early[0] if early else look(measured, setting, explanations[0].fit, None, False)
    seen = beside(explanations, raw, prior)[1]
    for _ in range(PASSES):
        if seen is None or seen.joint is None or late():
            break
        now = force_taken(seen, level, measured.runs)
        if not felt(now if taken is None else now - taken, measured):
            break
        tell("identifying the structure without its joint")
        freed, alone = without_joint(H, measured, setting, seen, now, level)
        found = again(alone, explanations, some) if len(freed.features.poles) else []
        after = look(freed, alone, found[0].fit, seen, taken is not None) if found else None
        if after is None or after.found.untried or not _better(after, seen):
            break
        raw, taken, measured, setting, explanations = after, now, freed, alone, found
        seen = beside(explanations, raw, prior)[1]
    if taken is not None or early:
        some = candidates if taken is None else some
        setting, _, explanations = explain(setting, some, late, tell)
        after = look(measured, setting, explanations[0].fit, seen, taken is not None) if explanations else None
        raw = after if _better(after, raw) else raw
    if raw is not None and explanations:  # a few fits, whatever the time
        explanations = with_springs(setting, explanations, raw.found, candidates)
    told_from = explanations[0].causes if explanations else ()
    explanations, seen = beside(explanations, raw, prior)
    if seen is not None and explanations and explanations[0].causes != told_from and not late():
        after = look(measured, setting, explanations[0].fit, seen, True)
        seen = beside(explanations, after, prior)[1] if _better(after, seen) else seen
    return measured, setting, explanations, seen


def _better(after: Seen | None, before: Seen | None) -> bool:
    """Whether a further look finds a joint that describes the levels no worse than the one before."""
    if after is None or after.joint is None:
        return False
    return before is None or before.joint is None or after.joint.log_posterior >= before.joint.log_posterior


def beside(explanations: list[Explanation], seen: Seen | None, prior: Prior) -> tuple[list[Explanation], Seen | None]:
    """Explanations of the linear structure and what levels tell, each by its probability beside the other."""
    if seen is None or not explanations:
        return explanations, seen
    ranked, found = settled(explanations, seen.found, prior)
    return ranked, replace(seen, found=found)


def _within_deviation(f: LawFit) -> list[np.ndarray]:
    """Parameters one standard deviation off along each principal axis of their covariance."""
    log = np.array([q.log for q in f.law.parameters])
    size = np.sqrt(np.maximum(np.diag(f.covariance), 1e-300))
    values, axes = np.linalg.eigh(f.covariance / size[:, None] / size)
    steps = (np.sqrt(np.maximum(values, 0.0)) * axes).T * size
    largest = FARTHEST * np.where(log, 1.0, np.abs(f.p))
    steps = steps * np.minimum(1.0, largest / np.maximum(np.abs(steps), 1e-300)).min(axis=1, keepdims=True)
    return [np.where(log, f.p * np.exp(np.where(log, v, 0.0)), f.p + v) for v in steps]


def _widened(measured: Measured, H: np.ndarray, taken: list[np.ndarray], inexact: list[np.ndarray]) -> Features:
    """Features as uncertain as noise and the joint that was taken out of the runs leave them.

    ``taken`` is what other parameters of its law would take out, which moves all modes together; ``inexact`` what an
    error of its force in phase and in quadrature would, which is another one about each mode.
    """
    f = measured.features
    covariance = f.covariance.copy()
    own = np.kron(np.eye(len(f.poles)), np.ones((f.width, f.width)))
    for change, together in [(c, 1.0) for c in taken] + [(c, own) for c in inexact]:
        other = H.copy()
        other[measured.runs] -= change
        off = (features_beside(measured, other) - f.values).ravel()
        covariance += together * np.outer(off, off)
    return replace(f, covariance=covariance)


def foretold(seen: Seen) -> np.ndarray | None:
    """FRF ``(f, o, i)`` at the level farthest from the linear model's by a law fitted to the others, if two or more.

    The amplitude is that of the lowest branch; nothing measured at that level enters.
    """
    levels, j = seen.levels, seen.joint
    if j is None or len(levels.force) < 3:
        return None
    fewer = Levels(levels.force[:-1], levels.H[:-1], levels.weight[:-1])
    w = weigh(fewer, seen.base, seen.shapes, j.spot.direction, j.fit, j.spot.within)
    if w is None:
        return None
    m = motion_of(fewer, seen.base, w.b, w.fit.law, j.spot.within)
    first = stiffness_of(w.fit.law, m, w.fit.p, m.amplitude[0])

    def miss(A: np.ndarray) -> np.ndarray:
        N = stiffness_of(w.fit.law, m, w.fit.p, A) - first
        return np.log(A) + np.log(np.abs(1 + N * m.drive)) - np.log(free)

    free = levels.force[-1] * np.maximum(np.abs(m.still), 1e-300)
    steps = RANGE ** np.linspace(-1, 1, GRID)
    above = np.stack([miss(free * s) >= 0 for s in steps])
    first_above = np.where(above.any(axis=0), above.argmax(axis=0), GRID - 1)
    low, high = free * steps[np.maximum(first_above - 1, 0)], free * steps[first_above]
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        up = miss(middle) >= 0
        low, high = np.where(up, low, middle), np.where(up, middle, high)
    N = stiffness_of(w.fit.law, m, w.fit.p, np.sqrt(low * high)) - first
    force = N * m.still * m.turn / (1 + N * m.drive)
    return seen.base.H + change_by(seen.base, w.b, (m.first + force)[..., None])[0]
