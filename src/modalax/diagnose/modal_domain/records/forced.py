r"""A search on the lines, beside the general inaccuracy, for one force at one place that the modes do not explain.

All lines are linearised about a fit of the modes, in all parts of the inaccuracy (J) and in each force at each place
(column g). With the residual e and the prior information :math:`P` of the parts the gain of a force is
:math:`\tfrac12 (g^Te - g^TJ A^{-1} b)^2 / (1 + g^Tg - g^TJ A^{-1} J^Tg)`, :math:`A = J^TJ + P`, :math:`b = J^Te - Px`:
what the inaccuracy can imitate counts for nothing. The leading places of each kind are fitted, and one is told only
where all lines are explained with it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.line_forces import LineForce
from modalax.diagnose.modal_domain.fitting.explanation import SECOND, Explanation, Prior
from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.measured import channels_of
from modalax.diagnose.modal_domain.on_lines.lines import Lines, lines_of
from modalax.diagnose.modal_domain.on_lines.polish import (
    OnLines,
    blocks,
    chi2_of,
    descended,
    force_columns,
    frf_on_lines,
    slopes_on_lines,
)
from modalax.diagnose.modal_domain.search.force_places import roving_masses
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS

FINISHED, STEPS = 2, 24  # fits that leave the least are taken on to their end, by at most so many steps more
FITTED = 3  # leading places of each kind that are fitted
WORTH = 10.0  # nats that a force must promise: the least that tells one place among thousands


@dataclass(frozen=True)
class Forced:
    """A force that was found.

    Attributes
    ----------
    cause, u, covariance
        The force with its sizes over their usual ones.
    probability
        Of its place and kind among all that were fitted.
    nats
        By how much likelier the lines are with it.
    rivals
        Others of them, with their probabilities, the likeliest first.
    effect
        What it adds to the FRFs, in the form of the measurement, shape ``(f, o, i)``.
    """

    cause: Change
    u: np.ndarray
    covariance: np.ndarray
    probability: float
    nats: float
    rivals: tuple[tuple[Change, float], ...]
    effect: np.ndarray


@dataclass(frozen=True)
class Trial:
    """One force fitted beside a fit of the modes."""

    base: Fit
    cause: LineForce
    found: OnLines
    log_evidence: float


def force_beside(
    stage: Stage, measurement: Measurement, wanted: Callable[[str], bool], late: Deadline, tell: Callable[[str], None]
) -> Forced | None:  # fmt: skip
    """The force that explains what the modes of a stage do not; None where none does, or where runs differ.

    Only forces that modes are not asked about: of those that they are, one that they do not show would stand for an
    error of no element.
    """
    found, c, m = stage.measured, stage.coordinates, measurement
    if len(found.runs) < len(m.H) or (stage.seen is not None and stage.seen.joint is not None):
        return None
    low, high = (2 * np.pi * float(found.freq[k]) for k in (0, -1))
    forces = [f for f in roving_masses(c, m.outputs, low, high) if wanted(f.slug)]
    if not forces:
        return None
    own = found.channels
    channels = channels_of(own.s, np.asarray(m.H), found.noise.sigma, own.order, own.outside)
    lines, before = lines_of(channels, stage.setting, found.misfit), Prior(stage.candidates)
    return find_force(stage.setting, stage.explanations, before, forces, lines, own.s, late, tell)


def force_told(forced: Forced) -> dict[str, Any]:
    """A force as in the answer."""
    c = forced.cause
    return {
        "name": c.slug, "where": list(c.where), "probability": forced.probability,
        "parameters": c.told(forced.u, forced.covariance),
    }  # fmt: skip


def force_rivals(forced: Forced, named: bool) -> list[list[dict[str, Any]]]:
    """Other forces that are likely enough to be told, beside a named one or in an ambiguous set."""
    least = THRESHOLDS.elsewhere if named else THRESHOLDS.rival
    return [[{"name": c.slug, "where": list(c.where)}] for c, p in forced.rivals if p >= least]


def force_said(forced: Forced) -> str:
    """In one sentence."""
    what = cause_at(forced.cause.slug, forced.cause.where)
    return (
        f"{what} explains on all lines what modes alone leave (probability {forced.probability:.3f}); without it the "
        f"lines are {forced.nats:.3g} nats less likely"
    )


def find_force(
    setting: Setting, explanations: Sequence[Explanation], before: Prior, forces: Sequence[LineForce], lines: Lines,
    s: np.ndarray, late: Deadline, tell: Callable[[str], None],
) -> Forced | None:  # fmt: skip
    """The force that explains what the modes do not; None where none does.

    Parameters
    ----------
    explanations
        By the modes; a force is looked for beside the likeliest and beside the general inaccuracy alone.
    before
        Prior probability of their causes.
    lines
        That it is fitted to.
    s
        Laplace variable of all measured lines [rad/s].
    """
    bases = [e.fit for e in explanations if not e.causes][:1]
    bases += [explanations[0].fit] if explanations[0].causes else []
    tell(f"looking for a force at one of {len(forces)} places, line by line")
    trials: list[Trial] = []
    for base in bases:
        gain, size = screened(setting, base, forces, lines)
        leading = [
            k for slug in sorted({f.slug for f in forces})
            for k in sorted((k for k, f in enumerate(forces) if f.slug == slug), key=lambda k: -gain[k])[:FITTED]
        ]  # fmt: skip
        starts = [(base, forces[k], size[k : k + 1]) for k in leading if gain[k] > WORTH]
        trials += fitted_from(setting, starts, lines, late)
        if late():
            break
    return told_force(setting, trials, bases, before, forces, lines, s)


def told_force(
    setting: Setting, trials: Sequence[Trial], bases: Sequence[Fit], before: Prior, forces: Sequence[LineForce],
    lines: Lines, s: np.ndarray, left: float = 1.0,
) -> Forced | None:  # fmt: skip
    """The likeliest of some forces that were fitted; None where none explains the lines.

    Parameters
    ----------
    trials, bases
        The fits, and those without a force that they were fitted beside.
    left
        Chi-square per sample that lines without the force leave anyway.
    """
    good = [t for t in trials if t.found.chi2 < THRESHOLDS.as_noise * left * lines.samples]
    if not good:
        return None
    prior = {f: math.log(f.weight / sum(g.weight for g in forces if g.slug == f.slug)) for f in {t.cause for t in good}}
    best_of: dict[LineForce, tuple[float, Trial]] = {}
    for t in good:
        value = t.log_evidence + prior[t.cause] + before.of(t.base.causes)
        if t.cause not in best_of or value > best_of[t.cause][0]:
            best_of[t.cause] = value, t
    ranked = sorted(best_of.values(), key=lambda v: -v[0])
    weights = np.exp([v - ranked[0][0] for v, _ in ranked])
    shares = weights / weights.sum()
    best = ranked[0][1]
    nats = ranked[0][0] - max(_alone(setting, base, lines) + before.of(base.causes) for base in bases)
    if nats < WORTH - math.log(SECOND):
        return None
    n, k = len(best.base.sizes), best.cause.count
    x = best.found.x
    sizes, causes = x[:n], (*best.base.causes, best.cause)
    with_it = frf_on_lines(setting, causes, sizes, x[n:], s, lines.order)
    without = frf_on_lines(setting, best.base.causes, sizes, x[n : len(x) - k], s, lines.order)
    rivals = tuple((t.cause, float(p)) for (_, t), p in zip(ranked[1:], shares[1:], strict=True))
    return Forced(
        best.cause, x[-k:], best.found.covariance[-k:, -k:], float(shares[0]), nats, rivals, with_it - without
    )


def _alone(setting: Setting, base: Fit, lines: Lines) -> float:
    """Log evidence of a fit without a force, up to what all have in common."""
    x = np.concatenate([base.sizes, base.u])
    cost = chi2_of(setting, base, lines) + float(((x / scale_of(setting, base)) ** 2).sum())
    return 0.5 * float(np.linalg.slogdet(base.covariance)[1] if base.causes else 0.0) - 0.5 * cost


def fitted_from(
    setting: Setting, starts: Sequence[tuple[Fit, LineForce, np.ndarray]], lines: Lines, late: Deadline
) -> list[Trial]:  # fmt: skip
    """Forces fitted beside a fit of the modes each, those that leave the least to their end."""
    found: list[tuple[Fit, Fit, OnLines]] = []
    for base, cause, size in starts:
        if late():
            break
        both = replace(base, causes=(*base.causes, cause), u=np.concatenate([base.u, size]))
        near = descended(setting, both, lines, late)
        found += [] if near is None else [(base, both, near)]
    found.sort(key=lambda one: one[2].chi2)
    for k, (base, both, near) in enumerate(found[:FINISHED]):
        n = len(base.sizes)
        there = replace(both, sizes=near.x[:n], u=near.x[n:])
        found[k] = base, both, descended(setting, there, lines, late, STEPS) or near
    trials = [_trial(setting, base, both, end) for base, both, end in found]
    return [t for t in trials if t.cause.signed or t.found.x[-t.cause.count] > 0]


def _trial(setting: Setting, base: Fit, both: Fit, end: OnLines) -> Trial:
    n, cause = len(base.sizes), both.causes[-1]
    assert isinstance(cause, LineForce)
    narrower = float(np.linalg.slogdet(end.covariance[n:, n:])[1])
    value = 0.5 * narrower - 0.5 * (end.chi2 + float(((end.x / scale_of(setting, both)) ** 2).sum()))
    return Trial(base, cause, end, value)


def screened(
    setting: Setting, base: Fit, forces: Sequence[LineForce], lines: Lines
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Nats that each force of one size promises, and the size to fit it from."""
    scale, x = scale_of(setting, base), np.concatenate([base.sizes, base.u])
    p, m = len(x), len(forces)
    gram, cross, own = np.zeros((p, p)), np.zeros((p, m)), np.zeros(m)
    slope, score, chi2 = np.zeros(p), np.zeros(m), 0.0
    for part in blocks(setting, lines.s, (p + m) * lines.H[0].size):
        s, root = lines.s[part], np.sqrt(lines.weight[part])
        H, J = slopes_on_lines(setting, base.causes, base.sizes, base.u, s, lines.order)
        g = force_columns(setting, base, forces, s, lines.order)
        J, g = ((a * root).reshape(len(a), -1).view(float) for a in (J, g))
        e = (root * (lines.H[part] - H)).ravel().view(float)
        gram, cross, own = gram + J @ J.T, cross + J @ g.T, own + (g**2).sum(axis=1)
        slope, score, chi2 = slope + J @ e, score + g @ e, chi2 + float(e @ e)
    heat = max(1.0, chi2 / max(lines.samples, 1))
    inner = np.eye(p) + scale[:, None] * gram * scale / heat
    both = np.linalg.solve(inner, scale[:, None] * np.c_[cross / heat, slope / heat - x / scale**2])
    through = scale[:, None] * cross / heat
    direct = score / heat - through.T @ both[:, -1]
    left = 1 + own / heat - (through * both[:, :-1]).sum(axis=0)
    size = direct / left
    possible = (size > 0) | np.array([f.signed for f in forces])
    return np.where(possible, 0.5 * (direct**2 / left), -np.inf), size
