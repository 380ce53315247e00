"""The explanation where a force at one place is all that is missing: laws fitted to that force, and what they leave."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.stats

from modalax.diagnose.causes.base import Cause, JointCause, LocalCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.decision.omnibus import omnibus
from modalax.diagnose.decision.verdict import Leftover
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.balanced_force import has_law
from modalax.diagnose.prediction.harmonic_rows import factor_rows
from modalax.diagnose.prediction.harmonics import MORE_INSTANTS
from modalax.diagnose.search.candidates import cost_of
from modalax.diagnose.search.explain import Explanation, weigh
from modalax.diagnose.search.force_fit import ForceFit, laws_by_force
from modalax.diagnose.search.imitator_check import apart, likeness
from modalax.diagnose.search.law_force import beyond, force_of
from modalax.diagnose.search.look import Look
from modalax.diagnose.search.measured_force import measured_forces
from modalax.diagnose.thresholds import THRESHOLDS

TELLING = 1.0  # standard deviations that one harmonic of a law may miss, from which on all are balanced


def explain_force(look: Look, causes: Sequence[Cause]) -> Explanation | None:
    r"""Fit laws to the force at the places at one of which it explains the data; None where none comes near.

    Harmonics above the first are left out where they hardly count: an effect :math:`d` standard deviations long of
    which one harmonic leaves the part :math:`\varepsilon` bends the answer by up to :math:`\varepsilon d`.

    Parameters
    ----------
    look
        The simulation alone, in a comparison that knows these places.
    causes
        What to look for, things without a name in the answer included.
    """
    comparison, null = look.comparison, look.null
    elements = [c for c in causes if isinstance(c, JointCause | LocalCause)]
    found: list[tuple[Hypothesis, ForceFit]] = []
    forces = list(measured_forces(comparison, comparison.only))
    effect = max((null.chi2 - force.chi2 for force in forces), default=0.0)
    several = max((c.fidelity for c in elements), default=0.0) * np.sqrt(max(effect, 0.0)) >= TELLING
    for force in forces:
        least = min((h.chi2 for h, _ in found), default=np.inf)
        fitted = [f for _, f in found]
        for fit in laws_by_force(comparison, elements, force, null.chi2 - force.chi2, least, several, fitted):
            place = force.place_of(fit.cause, comparison.scene)
            assert place is not None
            found.append((_hypothesis(null, fit, place), fit))
    if not found:
        return None
    first = weigh(look, [h for h, _ in found])[0].best
    fit = next(f for h, f in found if h is first)
    seen = fit.seen
    left, free = fit.chi2 - seen.least, max(2 * int((seen.precision > 0).sum()), 1)
    effect = max(float((np.abs(seen.precision * seen.force) ** 2).sum()), 1e-300)
    excess = max(left - free, 0.0)
    chance = chance_of(left, free - 2 * int(fit.aside.sum()), seen.least, seen.samples - free)
    inexact = float(np.sqrt(excess / effect)) if chance < THRESHOLDS.left else 0.0
    if inexact > THRESHOLDS.inexact_law:
        return None
    best = in_full(comparison, first, fit)
    if inexact:  # an error of the law moves a parameter by up to as many deviations as it is long
        best = replace(best, covariance=fit.covariance * (1 + excess), fidelity=inexact)
    ranked, nameless = apart(weigh(look, [best, *(h for h, _ in found if h is not first)]))
    if not ranked or ranked[0].best is not best and nameless and nameless[0].best is best:
        return None
    after = omnibus(comparison.residual(best), comparison.live(), comparison.noise.freedom)
    notes = likeness(nameless)
    alarm = min(look.detection.p_value, alarm_of(null.chi2 - best.chi2, len(fit.params), comparison, len(elements)))
    leftover = Leftover(
        alarm, null.chi2 - best.chi2, min(1.0, 2 * min(chance, after.p_value)),
        float(sum(r.probability for r in nameless)), notes[0] if notes else "", inexact=inexact,
        ahead=_ahead(first, fit, found),
    )  # fmt: skip
    by_force = several and (inexact > 0 or leftover.p_value > THRESHOLDS.doubtful)
    return Explanation(look, comparison, ranked, leftover, after, [h for h, _ in found], notes, by_force=by_force)


def law_leaves_noise(found: Explanation) -> bool:
    """Whether the law of a joint leads, and leaves no more than noise of the data."""
    joint = any(isinstance(c, JointCause) for c in found.ranked[0].best.causes)
    return joint and not found.leftover.inexact and found.leftover.p_value > THRESHOLDS.doubtful


def _ahead(h: Hypothesis, fit: ForceFit, others: Sequence[tuple[Hypothesis, ForceFit]]) -> float:
    """How many times as much of the force the nearest other law leaves, at any place, or the same law elsewhere."""
    rest = [f.chi2 for other, f in others if other.parts != h.parts]
    left = np.array([fit.chi2, min(rest, default=np.inf)]) - fit.seen.least
    return float(np.sqrt(max(left[1], 0.0) / max(left[0], 1.0)))


def alarm_of(explained: float, parameters: int, comparison: Comparison, laws: int) -> float:
    """Chance that of all laws at all places one explains as much of noise alone, at most (Bonferroni's inequality).

    Parameters
    ----------
    explained
        Chi-square that the best of them takes away.
    parameters
        Their number.
    comparison
        Data and simulation, whose places count.
    laws
        Number of laws.
    """
    tried = laws * max(len(comparison.scene.pairs()), 1)
    return min(1.0, tried * float(scipy.stats.chi2.sf(explained, max(parameters, 1))))


def chance_of(left: float, count: int, rest: float, others: int) -> float:
    """Chance under noise alone that a law leaves so much of the measured force, by Fisher's F.

    Parameters
    ----------
    left, count
        Chi-square between the law's force and the measured one, and its real numbers.
    rest, others
        Chi-square that the measured force itself leaves, and its degrees of freedom.
    """
    if count < 1 or others < 1:
        return 1.0
    return float(scipy.stats.f.sf(left / count / max(rest / others, 1e-300), count, others))


def _hypothesis(null: Hypothesis, fit: ForceFit, place: Place) -> Hypothesis:
    """A fitted law as a hypothesis, without what harmonics do; its covariance is that of the force."""
    h = replace(null, theta=fit.seen.theta).with_cause(fit.cause, place, None, fit.params)
    return replace(
        h, chi2=fit.chi2, freedom=cost_of(h.causes, h.extras) + fit.cause.unseen + 2 * int(fit.aside.sum()),
        covariance=fit.covariance,
    )  # fmt: skip


def in_full(comparison: Comparison, h: Hypothesis, fit: ForceFit) -> Hypothesis:
    """The hypothesis of one fitted law with the effect of its harmonics, and what those left out may do.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The law at its place, as a hypothesis.
    fit
        How it was fitted.
    """
    seen, wider = fit.seen, inflation(fit)
    harmonics = has_law(fit.cause) or isinstance(fit.cause, JointCause) and fit.cause.rigid
    if not harmonics or not seen.several:
        return replace(h, covariance=fit.covariance * np.outer(wider, wider))
    extra = joint_extra(comparison, fit)
    force, _, sound, _ = force_of(fit.cause, fit.params, seen, fit.motion, instants=MORE_INSTANTS, highest=fit.highest)
    other, _, also, _ = force_of(fit.cause, fit.params, seen, fewer=True, highest=fit.highest)
    both = sound & also & ~fit.aside
    share = 1.0 if fit.cause.rigid else beyond(fit.highest)
    change = share * seen.precision * (np.where(both, force, 0.0) - np.where(both, other, 0.0))
    fidelity = float(np.linalg.norm(change) / max(np.linalg.norm(seen.precision * seen.force), 1e-300))
    shift = fit.covariance @ (fit.alone.conj() @ change).real
    covariance = fit.covariance * np.outer(wider, wider) + np.outer(shift, shift)
    return replace(h, extras=(extra,), fidelity=fidelity, covariance=covariance)


def inflation(fit: ForceFit) -> np.ndarray:
    """Factor on each standard deviation where lines scatter by more than their noise (White 1980), never below 1."""
    inverse = fit.covariance
    score = (fit.alone.conj() * fit.residual).real
    spread = np.diag(inverse @ score @ score.T @ inverse) / np.maximum(np.diag(inverse), 1e-300)
    return np.sqrt(np.maximum(spread, 1.0))


def joint_extra(comparison: Comparison, fit: ForceFit) -> np.ndarray:
    """What the prediction needs of a joint beside its parameters, as ``prediction.frf.factor_at`` takes it."""
    cause, p, seen = fit.cause, fit.params, fit.seen
    assert isinstance(cause, JointCause)
    force, slopes, sound, _ = force_of(cause, p, seen, fit.motion, instants=MORE_INSTANTS, highest=fit.highest)
    G, level = seen.receptance[:, 1], seen.level
    made = factor_rows(cause, p, force, slopes[: len(p)], sound, G, seen.free, seen.omega, level)
    given = np.where(fit.aside, seen.force / np.where(level > 0, level, 1.0), 0.0)
    rows = np.concatenate([made, given[None]])
    runs, padded, _, all_inputs = comparison.problem.data.shape
    lines, inputs = comparison.problem.lines, comparison.problem.channels[1]
    rows = rows.reshape(len(rows), runs, lines, inputs)
    return np.pad(rows, ((0, 0), (0, 0), (0, padded - lines), (0, all_inputs - inputs)), mode="edge")
