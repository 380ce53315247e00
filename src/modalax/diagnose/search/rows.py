r"""Where the motion across a joint is measured itself: which of several steady motions it is, and where there is none.

At every line the outputs tell the joint's force, whatever its law: the prediction is :math:`H_0 - H_b q`, linear in one
complex force :math:`q` per unit force at the input. The motion across the joint follows from it. A strong joint may
have several steady motions at one line (a jump of a hardening spring), or none (a stop that is hit now and then). The
first are told apart by the amplitude that was measured. Lines that none of them comes near are set aside: the force
measured there stands in for the law's, and its two numbers are paid for as unknowns.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis, with_item
from modalax.diagnose.prediction.frf import GIVEN
from modalax.diagnose.prediction.harmonics import beside_joints
from modalax.diagnose.search.candidates import cost_of, set_aside
from modalax.diagnose.search.singles import PATIENT

MOST = 0.05  # largest share of lines, over all runs, that may be set aside
OUTLYING = 100.0  # misfit of a line, over that of the worst of the others, from which on it is set aside
KNOWN = 0.3  # relative error of a measured amplitude up to which it chooses among several
CLEAR = 5.0  # deviations from zero from which on a line shows a force
HALF = 0.5  # share of the lines that show a force, from which on they are not set aside
AGAIN = 3  # times that lines are set aside and the rest is fitted


class Measured(NamedTuple):
    """Force and amplitude of a joint as measured, each of shape ``(run, f, i)``.

    Attributes
    ----------
    force
        Force over that at the input [-].
    gain
        Chi-square by which this force is nearer to the data than that of the law.
    amplitude
        Displacement across the joint and what is in series with it [m]; 0 where it is not known well.
    series
        Compliance in series with a rigid joint [m/N], else 0.
    effect
        Chi-square that the force takes away.
    """

    force: np.ndarray
    gain: np.ndarray
    amplitude: np.ndarray
    series: np.ndarray
    effect: np.ndarray


def measured(comparison: Comparison, h: Hypothesis) -> Measured:
    """Force and amplitude of the one joint of a hypothesis, whose other parameters are taken as they are."""
    problem, k = comparison.problem, h.joints[0]
    theta = h.theta * comparison.nuisance.spread
    found = beside_joints(h.causes, h.index, h.extras, h.params, theta, problem)
    H, H_ob, H_bi, H_bb = (np.asarray(a) for a in found)
    weight = np.asarray(problem.weight)
    column = weight * H_ob[..., 0][..., None]
    length = np.maximum((np.abs(column) ** 2).sum(axis=2), 1e-300)
    missing = weight * (np.asarray(problem.data) - H)
    force = -(column.conj() * missing).sum(axis=2) / length
    gain = np.abs((column.conj() * comparison.residual(_by_law(h))).sum(axis=2)) ** 2 / length
    drive, motion = H_bb[:, :, 0, 0][..., None], H_bi[:, :, 0]
    series = np.broadcast_to(np.abs(drive) if h.causes[k].rigid else 0.0, force.shape)
    z = motion - (drive - series) * force
    error = np.abs(drive - series) * np.sqrt(2 / length)
    amplitude = np.asarray(problem.level)[:, :, None] * np.abs(z)
    known = np.where(error < KNOWN * np.abs(z), amplitude, 0.0)
    return Measured(force, gain, known, series, np.abs(force) ** 2 * length)


def _by_law(h: Hypothesis) -> Hypothesis:
    """The hypothesis with its joint's law at every line."""
    k = h.joints[0]
    if h.extras[k] is None:
        return h
    extra = np.array(h.extras[k])
    extra[GIVEN] = 0.0
    return replace(h, extras=with_item(h.extras, k, extra))


def measured_rows(comparison: Comparison, h: Hypothesis) -> tuple[Measured, np.ndarray]:
    """What is measured of a joint, and the two rows that its prediction needs of that, shape ``(2, run, f, i)``."""
    found = measured(comparison, h)
    live = comparison.live().any(axis=2)
    usual = float(np.quantile(found.gain[live], 1 - MOST)) if live.any() else 0.0
    paid = 2 * np.log(max(comparison.problem.samples, 30))
    aside = live & (found.gain > max(OUTLYING * usual, paid))
    shown = live & (found.effect > CLEAR**2)
    if (aside & shown).sum() > HALF * shown.sum():  # a law without these explains nothing
        aside = np.zeros_like(aside)
    return found, np.stack([found.amplitude + 0j, np.where(aside, found.force, 0.0)])


def force_taken(h: Hypothesis) -> np.ndarray:
    """Where the force of a joint is taken as measured, shape ``(run, f, i)`` or ``(1, 1, 1)``; False without one."""
    where = np.zeros((1, 1, 1), bool)
    for cause, extra in zip(h.causes, h.extras, strict=True):
        where = where | (np.asarray(extra[GIVEN]) != 0) if set_aside(cause, extra) else where
    return where


def lines_aside(h: Hypothesis) -> int:
    """Number of lines, over all runs and inputs, at which the law of a hypothesis' joint is not asked."""
    return sum(set_aside(c, e) for c, e in zip(h.causes, h.extras, strict=True))


def with_rows(comparison: Comparison, h: Hypothesis) -> Hypothesis:
    """The hypothesis of one joint, by a single harmonic, with what is measured of it; not fitted."""
    k = h.joints[0]
    found, rows = measured_rows(comparison, h)
    shape = found.force.shape
    one, none = np.ones((1, *shape)), np.zeros((len(h.params[k]) + 1, *shape))
    extra = np.concatenate([one, none, found.series[None], rows])
    extras = with_item(h.extras, k, extra)
    return replace(h, extras=extras, freedom=cost_of(h.causes, extras))


def fitted_beside_outliers(comparison: Comparison, h: Hypothesis) -> Hypothesis:
    """Set lines aside and fit the rest in turn, a single harmonic of the joint's motion being balanced.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        A hypothesis of one joint with a force law.
    """
    for _ in range(AGAIN):
        before = lines_aside(h), h.chi2
        h = comparison.fit([with_rows(comparison, h)], PATIENT)[0]
        if before == (lines_aside(h), h.chi2):
            break
    return h
