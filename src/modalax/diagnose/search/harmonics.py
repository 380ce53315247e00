"""Leading joints fitted again with the higher harmonics of their motion, where the data is exact enough to ask."""

from dataclasses import replace

import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.gauss_newton import covariance_of
from modalax.diagnose.fitting.hypothesis import Hypothesis, from_search, searched, split, with_item
from modalax.diagnose.prediction.frf import NEAR
from modalax.diagnose.prediction.harmonic_rows import linear_factor
from modalax.diagnose.prediction.harmonics import HIGHEST
from modalax.diagnose.search.candidates import cost_of
from modalax.diagnose.search.law_force import FEWER, beyond
from modalax.diagnose.search.rows import measured_rows
from modalax.diagnose.search.singles import PATIENT
from modalax.diagnose.search.tolerance import tolerated

TIMES = 8  # most rounds of harmonics and fit in turn
SHARES = (1.0, 0.3, 0.1, 0.02)  # of a step, tried one after the other
ASKED = 0.3  # error of a parameter by a single harmonic, in standard deviations, from which on more are taken
SETTLED = ASKED**2  # change of chi-square at which harmonics and fit have settled
TRIED = 6  # leading hypotheses that are fitted so
ONE_LAW = 2  # of these, most with the same causes
REACHED = 3.0  # standard deviations of its strength within which a joint may be as strong as one likes


def joints_in_full(comparison: Comparison, null: Hypothesis, ranked: list[Hypothesis]) -> list[Hypothesis]:
    r"""Fit the leading hypotheses that hold a joint with all harmonics that its force needs.

    One harmonic leaves a relative error :math:`\varepsilon` of the joint's effect (the cause's ``fidelity``). An effect
    :math:`d` standard deviations long then bends parameters by up to :math:`\varepsilon d` of theirs, and chi-square
    by up to :math:`\varepsilon^2 d^2`: all hypotheses within that of the best are fitted again.

    So are the simpler laws that some of these may be the limit of (:func:`is_limit`). What was fitted so before is
    left as it is, and so is, once time is up, what has not been begun.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    ranked
        Hypotheses, the best first.
    """
    best = ranked[0].chi2
    effect = max(null.chi2 - best, 0.0)
    out: list[Hypothesis] = []
    for h in ranked:
        if len(out) == TRIED:
            break
        if h.fidelity is not None and h.since is None:
            continue
        bend = max((c.fidelity for c in h.causes), default=0.0) * np.sqrt(effect)
        alike = sum(h.causes == other.causes for other in out) < ONE_LAW
        if bend > ASKED and h.chi2 < best + 4 * bend**2 + 1 and alike and one_joint(comparison, h):
            out.append(h)
    full = [fitted_in_full(comparison, null, h) for k, h in enumerate(out) if k == 0 or not comparison.late()]
    limits = [simpler for h in full if (simpler := limit_of(h)) is not None and not comparison.late()]
    return full + [fitted_in_full(comparison, null, comparison.fit([h], PATIENT)[0]) for h in limits]


def _strength(h: Hypothesis) -> tuple[float, float]:
    """Strength of the first joint of a hypothesis, and its standard deviation; without one, 1 and 0."""
    if not h.joints or h.covariance is None:
        return 1.0, 0.0
    first = sum(len(p) for p in h.params[: h.joints[0]])
    return abs(float(h.params[h.joints[0]][0])), float(np.sqrt(max(h.covariance[first, first], 0.0)))


def limit_of(h: Hypothesis) -> Hypothesis | None:
    """The hypothesis with the simpler law that its joint may be the limit of, not fitted; None where it may not.

    It may where the strength is uncertain by a third of itself, so that no data bound it from above.

    Parameters
    ----------
    h
        A fitted hypothesis.
    """
    strength, std = _strength(h)
    if strength > REACHED * std:
        return None
    k = h.joints[0]
    joint = h.causes[k]
    simpler = joint.simpler(h.params[k]) if isinstance(joint, JointCause) else None
    if simpler is None:
        return None
    causes, extras = with_item(h.causes, k, simpler[0]), with_item(h.extras, k, None)
    return replace(
        h, causes=causes, params=with_item(h.params, k, simpler[1]), extras=extras, covariance=None, fidelity=None,
        freedom=cost_of(causes, extras) + (h.hum.freedom if h.hum else 0.0),
    )  # fmt: skip


def is_limit(h: Hypothesis, simpler: Hypothesis, null: Hypothesis) -> bool:
    """Whether a joint whose strength the data leave open is but the limit of a simpler law at the same place.

    A spring of any great stiffness that slips is dry friction. The simpler law must fit as well, but for what the
    harmonics left out of it may do.

    Parameters
    ----------
    h
        A fitted hypothesis.
    simpler
        Another, fitted with harmonics.
    null
        The simulation alone.
    """
    if not h.joints or h.places != simpler.places or h.freedom <= simpler.freedom:
        return False
    strength, std = _strength(h)
    allowed = tolerated(simpler, null.chi2) if simpler.fidelity is not None else 0.0
    return REACHED * std > strength and simpler.chi2 - allowed <= h.chi2


def one_joint(comparison: Comparison, h: Hypothesis) -> bool:
    """Whether a hypothesis holds one joint with a force law, on a structure that has none."""
    held = comparison.problem.held
    if held is not None and any(isinstance(c, JointCause) for c in held.causes):
        return False
    joints = [c for c in h.causes if isinstance(c, JointCause)]
    return h.hum is None and len(joints) == 1 and type(joints[0]).law is not JointCause.law


def fitted_in_full(comparison: Comparison, null: Hypothesis, h: Hypothesis) -> Hypothesis:
    """Fit with higher harmonics, from every start that a single harmonic does not tell from the hypothesis.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    h
        A hypothesis with one joint.
    """
    k = h.joints[0]
    cause = h.causes[k]
    assert isinstance(cause, JointCause)
    found: list[Hypothesis] = []
    for group in cause.untold(h.params[k]):
        if not found or not comparison.late():
            starts = [balanced(comparison, replace(h, params=with_item(h.params, k, p))) for p in group]
            found.append(settled(comparison, min(starts, key=lambda one: one.chi2)))
    h = min(found, key=lambda one: one.chi2)
    seen = sum(c.unseen for c in h.causes)  # what one harmonic does not show, the others do
    h = replace(h, freedom=h.freedom + seen)
    return with_what_is_left_out(comparison, null, h, k)


def balanced(comparison: Comparison, h: Hypothesis, rows: np.ndarray | None = None, slopes: bool = True) -> Hypothesis:
    """The hypothesis with the effect of higher harmonics at its own parameters, and the chi-square that this leaves.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        A hypothesis with one joint.
    rows
        What is measured of the joint; read off the data beside the hypothesis if None.
    slopes
        Whether the effect is to follow the parameters, so that they can be fitted.
    """
    k = h.joints[0]
    rows = measured_rows(comparison, h)[1] if rows is None else rows
    factor = _factor(comparison, h, rows, slopes=slopes)
    extras = with_item(h.extras, k, factor)
    h = replace(h, extras=extras, freedom=h.freedom + cost_of(h.causes, extras) - cost_of(h.causes, h.extras))
    left = comparison.chi2(h)
    return replace(h, chi2=left if np.isfinite(left) else np.inf)


def settled(comparison: Comparison, h: Hypothesis) -> Hypothesis:
    """Fit with the effect of harmonics linear about the parameters, and find it anew, until neither changes.

    A step after which the effect as found anew leaves more is shortened. Once time is up, no further step is begun.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        A hypothesis with one joint, balanced.
    """
    k = h.joints[0]
    for step in range(TIMES):
        if step and comparison.late():
            break
        fit = comparison.fit([h], PATIENT)[0]
        h = replace(h, covariance=fit.covariance)
        rows = np.asarray(h.extras[k])[NEAR:]
        nearer = (balanced(comparison, between(h, fit, share), rows) for share in SHARES)
        after = next((one for one in nearer if one.chi2 < h.chi2), None)
        if after is None:
            break
        drop, now = h.chi2 - after.chi2, measured_rows(comparison, after)[1]
        alike = np.array_equal(now[1] != 0, rows[1] != 0)
        h = after if alike else balanced(comparison, after, now)
        if drop < SETTLED or limit_of(h) is not None:  # a limit is fitted as such
            break
    return h


def between(h: Hypothesis, other: Hypothesis, share: float) -> Hypothesis:
    """The hypothesis at a share of the way to another with the same causes, in the variables of the search."""
    u = searched(h) + share * (searched(other) - searched(h))
    params = [np.asarray(from_search(c, v)) for c, v in zip(h.causes, split(h.causes, u), strict=True)]
    theta = np.asarray(h.theta) + share * (np.asarray(other.theta) - np.asarray(h.theta))
    return replace(h, params=tuple(params), theta=theta)


def _factor(
    comparison: Comparison, h: Hypothesis, rows: np.ndarray, kept: int = HIGHEST, slopes: bool = True
) -> np.ndarray:
    theta = h.theta * comparison.nuisance.spread
    return linear_factor(h.causes, h.index, h.extras, h.params, theta, comparison.problem, kept, rows, slopes)


def with_what_is_left_out(comparison: Comparison, null: Hypothesis, h: Hypothesis, k: int) -> Hypothesis:
    """The hypothesis with fidelity and covariance that include harmonics left out, and lines that the law misses.

    Of a force that jumps, as dry friction does, the error falls as :math:`1/(h+1)`, h the highest harmonic, so that
    harmonics beyond ``HIGHEST`` may do ``beyond(HIGHEST)`` times as much as the change from ``FEWER`` to these; of any
    smoother force they do far less. Dry friction is followed at instants, and half as many leave twice the error.
    """
    cause = h.causes[k]
    share = 1.0 if isinstance(cause, JointCause) and cause.rigid else beyond(HIGHEST)
    fewer = _factor(comparison, h, h.extras[k][NEAR:], FEWER)
    other = replace(h, extras=with_item(h.extras, k, fewer))
    change = comparison.residual(h) - comparison.residual(other)
    effect = comparison.residual(h) - comparison.residual(null)
    fidelity = share * float(np.linalg.norm(change) / max(np.linalg.norm(effect), 1e-300))
    shift = share * (searched(comparison.fit([other], PATIENT)[0]) - searched(h))
    wider = inflation(comparison, h)
    return replace(
        h, fidelity=fidelity, since=None, covariance=h.covariance * np.outer(wider, wider) + np.outer(shift, shift)
    )


def inflation(comparison: Comparison, h: Hypothesis) -> np.ndarray:
    r"""Factor on each standard deviation by the stated noise where the residual of some lines is larger.

    The covariance that holds whatever the errors of each line are, :math:`A^{-1} B A^{-1}` with :math:`A = J^TJ` and
    :math:`B` the sum over lines of :math:`J_l^T r_l r_l^T J_l` (White 1980, Econometrica 48:817), beside
    :math:`A^{-1}`; never less than 1.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        A fitted hypothesis.
    """
    r, J = comparison.real_residual(h), comparison.slopes(h)
    runs, lines = comparison.problem.data.shape[:2]
    score = (J * r).reshape(len(J), -1, runs * lines, 2).sum(axis=(1, 3))
    flat = J.reshape(len(J), -1)
    A = flat @ flat.T
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = covariance_of(A / np.outer(scale, scale))
    robust = inverse @ (score / scale[:, None]) @ (score / scale[:, None]).T @ inverse
    return np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(inverse), 1e-300), 1.0))
