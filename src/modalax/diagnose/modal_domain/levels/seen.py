"""What the levels tell beside a linear explanation, what that predicts, and the linear structure without its joint."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.explain import Explanation, explain
from modalax.diagnose.modal_domain.features import Features, whitener_of
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.further_causes import TunedMass
from modalax.diagnose.modal_domain.levels.change import Base, Levels, base_of, by_level, change_by, frf_by, projected
from modalax.diagnose.modal_domain.levels.drift import by_run, drifts
from modalax.diagnose.modal_domain.levels.explain import ByLevel, JointFound, Spot, explain_levels
from modalax.diagnose.modal_domain.levels.laws import NAMED, LawFit, force_of, motions_of, stiffness_of
from modalax.diagnose.modal_domain.levels.weigh import Shapes, weigh
from modalax.diagnose.modal_domain.measured import Measured, features_beside, reidentified
from modalax.diagnose.modal_domain.state import Setting

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
    linear
        FRF of that model, shape ``(f, o, i)``.
    found
        Joints, drift or nothing, with probabilities.
    """

    levels: Levels
    base: Base
    shapes: Shapes
    linear: np.ndarray
    found: ByLevel

    @property
    def joint(self) -> JointFound | None:
        """The leading joint, where a joint is likeliest."""
        return self.found.joints[0] if self.found.best == "joint" else None


def look_at_levels(
    H: np.ndarray, level: np.ndarray, measured: Measured, setting: Setting, f: Fit, spots: Sequence[Spot],
    wanted: Callable[[str], bool], tell: Callable[[str], None], late: Callable[[], bool],
) -> Seen | None:  # fmt: skip
    """Compare the runs; None where there is one only."""
    if len(H) < 2:
        return None
    tell("comparing the runs")
    levels = by_level(H, measured.noise.sigma, level, measured.runs)
    base = base_of(setting, f, measured.freq, measured.channels.order)
    plain = by_run(H, measured.noise.sigma) if levels is None else levels
    c = measured.channels
    step = -(-plain.H.size * max(len(measured.modes.poles), 1) // MOST)  # very large tests: some lines only
    few = replace(c, s=c.s[::step], data=c.data[::step], weight=c.weight[::step])
    drift = max(drifts(plain.thinned(step), measured.modes, few), key=lambda d: d.log_evidence)
    shapes = Shapes(setting, f, base)
    laws = [law for law in NAMED if wanted(law.slug)]
    asked = levels is not None and bool(laws)
    untried = asked and late()
    places = spots if asked and not untried else []
    found = explain_levels(plain.thinned(step), base.thinned(step), places, shapes, drift, laws, late, untried)
    return Seen(plain, base, shapes, frf_by(setting, f, measured.freq, measured.channels.order), found)


def at_levels(seen: Seen, j: JointFound, level: np.ndarray) -> np.ndarray:
    """FRFs ``(run, f, o, i)`` with a joint, at the measured amplitudes."""
    b = j.direction[None]
    P = projected(seen.levels, seen.base, b)
    motion = motions_of(seen.levels, seen.base, b, P, j.fit.law)[0]
    force = force_of(j.fit.law, motion, j.fit.p)
    every = np.concatenate([np.zeros_like(force[..., :1]), force], axis=2) - (force @ seen.levels.share)[..., None]
    return seen.linear + change_by(seen.base, j.direction, every)[np.searchsorted(seen.levels.force, level)]


def without_joint(
    H: np.ndarray, level: np.ndarray, measured: Measured, setting: Setting, explanations: list[Explanation],
    candidates: list[Change], seen: Seen, late: Deadline, tell: Callable[[str], None],
) -> tuple[Measured, Setting, list[Explanation]]:  # fmt: skip
    """The linear structure with the joint's force taken out of the runs that it was identified from."""
    j = seen.joint
    assert j is not None
    levels, base = seen.levels, seen.base
    P = projected(levels, base, j.direction[None])
    m = motions_of(levels, base, j.direction[None], P, j.fit.law)[0]

    def change_at(p: np.ndarray, through: Base) -> np.ndarray:  # of each level, from a structure without the joint
        N = stiffness_of(j.fit.law, m, p).transpose(1, 2, 0)
        moved = m.still[..., None] - m.drive[:, None, None] * force_of(j.fit.law, m, p)
        return change_by(through, j.direction, N * np.concatenate([m.still[..., None], moved], axis=2))

    used = np.searchsorted(levels.force, level[measured.runs])
    weight = levels.weight[used]
    taken, best = np.zeros_like(H[measured.runs]), (measured, setting, explanations)
    # what describes the lowest level still holds some of the joint, what is found without it less and less
    for _ in range(PASSES):
        change = change_at(j.fit.p, base)[used]
        if float((weight * np.abs(change - taken) ** 2).sum()) < BENT:
            break
        tell("identifying the structure without its joint")
        taken, free = change, H.copy()
        free[measured.runs] -= change
        again = reidentified(measured, free)
        if not len(again.features.poles):
            break
        other = [change_at(p, base)[used] for p in _within_deviation(j.fit)]
        inexact = [(1 + j.tolerance * way) * change for way in (1, 1j)]
        again = replace(again, features=_widened(again, H, other, inexact))
        # what a law leaves of a peak that it distorts looks like a mode too many
        some = [c for c in candidates if c.freed is None and not isinstance(c, TunedMass)]
        now, found = explain(
            replace(setting, features=again.features, whitener=whitener_of(again.features)), some, late, tell
        )
        if not found:
            break
        best = again, now, found
        base = base_of(now, found[0].fit, measured.freq, measured.channels.order)
    return best


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
    """FRF ``(f, o, i)`` at the highest level by a law fitted to the others; None where those are fewer than two.

    The amplitude is that of the lowest branch; nothing measured at that level enters.
    """
    levels, j = seen.levels, seen.joint
    if j is None or len(levels.force) < 3:
        return None
    share = levels.share[:-1] / max(1 - levels.share[-1], 1e-12)
    fewer = Levels(levels.force[:-1], levels.H[:-1], levels.weight[:-1], share)
    w = weigh(fewer, seen.base, seen.shapes, j.spot.direction, j.fit)
    if w is None:
        return None
    m = motions_of(fewer, seen.base, w.b[None], projected(fewer, seen.base, w.b[None]), w.fit.law)[0]
    known = force_of(w.fit.law, m, w.fit.p) @ share
    drive = m.drive[:, None]
    first = stiffness_of(w.fit.law, m, w.fit.p, m.amplitude[0])

    def miss(A: np.ndarray) -> np.ndarray:
        N = stiffness_of(w.fit.law, m, w.fit.p, A) - first
        return np.log(A) + np.log(np.abs(1 + N * drive)) - np.log(free)

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
    force = N * m.still / (1 + N * drive)
    return seen.linear + change_by(seen.base, w.b, (force - known)[..., None])[0]
