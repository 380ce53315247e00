r"""Joints fitted in full where a force at one place explains what nothing else does, whatever a single harmonic says.

A strong joint's force may be so far from one harmonic that its law fits badly that way, at a wrong strength or behind
another law. Which place it is, and how far the data can be explained at all, is told by the force that is measured
there (:mod:`~modalax.diagnose.search.measured_force`). There every law is balanced with its higher harmonics at
strengths around the one that most lines ask for, and the best is fitted.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.search.candidates import cost_of
from modalax.diagnose.search.harmonics import balanced, fitted_in_full, one_joint
from modalax.diagnose.search.measured_force import MeasuredForce, measured_forces, robust_sizes, sizes_by_force
from modalax.diagnose.thresholds import THRESHOLDS

PLACES, MOST_PLACES = 2, 6  # places that are tried, and where more are alike but for noise
AROUND = (0.6, 0.75, 0.9, 1.0, 1.1, 1.3, 1.6)  # strengths that are balanced, over the one that was read off


def joints_by_force(
    comparison: Comparison, null: Hypothesis, causes: Sequence[Cause], best: Hypothesis
) -> list[Hypothesis]:
    """Joints of any law, fitted with harmonics; none where the best so far leaves no more than a free force does.

    Laws are tried in the order in which most lines agree with them by one harmonic, until one leaves hardly more than
    noise.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    causes
        What to look for.
    best
        The leading hypothesis.
    """
    problem = comparison.problem
    blind = problem.channels[0] < 2 or problem.held is not None or comparison.question == "free" or best.hum is not None
    if blind or as_noise(comparison, best.chi2):
        return []
    less = best.chi2 - THRESHOLDS.one_force * np.sqrt(2 * problem.samples)
    enough = min(less, THRESHOLDS.unexplained * problem.samples)
    forces = measured_forces(comparison, comparison.joint_places(), enough)[:MOST_PLACES]
    if not forces:  # there was no time
        return []
    close = THRESHOLDS.other_places + THRESHOLDS.one_force * np.sqrt(4 * forces[0].motion.size)  # noise of a difference
    forces = [f for k, f in enumerate(forces) if k < PLACES or f.chi2 < forces[0].chi2 + close]
    order = [
        (cost + 0.5 * force.chi2, h)
        for force in forces
        if force.chi2 < enough
        for cause in causes
        if isinstance(cause, JointCause) and not cause.each_run
        for cost, h in started(comparison, null, cause, force)
    ]
    out: list[Hypothesis] = []
    for _, h in sorted(order, key=lambda one: one[0]):
        if comparison.late():
            break
        if one_joint(comparison, h):
            out.append(fitted_in_full(comparison, null, nearest(comparison, h)))
            if as_noise(comparison, out[-1].chi2):
                break
    return out


def as_noise(comparison: Comparison, chi2: float) -> bool:
    """Whether a chi-square is hardly more than noise leaves."""
    samples = comparison.problem.samples
    return chi2 - samples < THRESHOLDS.one_force * np.sqrt(2 * samples)


def started(
    comparison: Comparison, null: Hypothesis, cause: JointCause, force: MeasuredForce
) -> list[tuple[float, Hypothesis]]:
    """A law at the place of a force, sized by it, after the misfit that most lines agree on; none where it has no size.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    cause
        The law.
    force
        The force that was measured.
    """
    at = force.place_of(cause, comparison.scene)
    sized = None if at is None else robust_sizes(comparison, cause, at, force)
    if at is None or sized is None:
        return []
    by_all = sizes_by_force(comparison, cause, at, force)[:1]
    about = replace(null, theta=force.theta)
    tried = [about.with_cause(cause, at, None, p) for p in (sized[1], *(p for _, p in by_all))]
    first = min(tried, key=lambda h: misfit(comparison, h)) if len(tried) > 1 else tried[0]
    return [(sized[0], replace(first, freedom=cost_of(first.causes, first.extras)))]


def nearest(comparison: Comparison, h: Hypothesis) -> Hypothesis:
    """The joint at the strength, of several around its own, with which most lines agree once harmonics are balanced."""
    tried = [replace(h, params=(h.params[0] * np.array([s, *np.ones(len(h.params[0]) - 1)]),)) for s in AROUND]
    return min(tried, key=lambda one: misfit(comparison, balanced(comparison, one, slopes=False)))


def misfit(comparison: Comparison, h: Hypothesis) -> float:
    """Misfit in which lines far off count little more than others, as of Cauchy's distribution."""
    left = np.nan_to_num((np.abs(comparison.residual(h)) ** 2).sum(axis=2), nan=1e300, posinf=1e300)
    return float(np.log1p(left).sum())
