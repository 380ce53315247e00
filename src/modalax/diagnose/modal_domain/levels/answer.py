"""The part of an answer that comes from the levels: a joint by its law, a drift, or differences without explanation."""

import math
from typing import Any

import numpy as np

from modalax.diagnose.causes.scene import Place
from modalax.diagnose.decision.levels import LevelsCase, levels_verdict
from modalax.diagnose.fitting.hypothesis import slopes
from modalax.diagnose.modal_domain.levels.explain import JointFound
from modalax.diagnose.modal_domain.levels.laws import NAMELESS, stiffness_of
from modalax.diagnose.modal_domain.levels.motion import motion_of
from modalax.diagnose.modal_domain.levels.seen import Seen
from modalax.diagnose.modal_domain.levels.slipping import Whole
from modalax.diagnose.result import parameters_told
from modalax.diagnose.thresholds import THRESHOLDS


def judge_levels(seen: Seen | None, whole: Whole | None = None) -> tuple[str, tuple[str, ...]]:
    """Verdict and reasons of the levels alone: ``clean`` where they agree."""
    if seen is None or seen.found.best == "nothing":
        return levels_verdict(LevelsCase("nothing"))
    found = seen.found
    kind = "force levels" if len(np.unique(seen.levels.force)) > 1 else "runs"
    if found.best == "drift":
        return levels_verdict(
            LevelsCase(
                "drift",
                kind,
                found.before,
                found.after,
                drift=found.drift.frequency,
                drifting=found.drifting,
                untried=found.untried,
            )
        )
    j, nameless = found.joints[0], {law.slug for law in NAMELESS}
    return levels_verdict(LevelsCase(
        "joint", kind, found.before, found.after, law=j.slug, where=j.spot.where, law_probability=found.sure(j.slug),
        place_probability=found.placed(j.slug, j.spot.where), inexact=j.tolerance, aside=j.aside,
        nameless=sum((p.probability for p in found.joints if p.slug in nameless), 0.0), behaviour=described(seen, j),
        holds=None if whole is None else (whole.stiffness, whole.std),
    ))  # fmt: skip


def causes_told(seen: Seen, whole: Whole | None = None, misfit: float = 1.0) -> list[dict[str, Any]]:
    """The joint or the drift, as told in the answer; a joint that the simulation lacks as one with its spring.

    Its deviations are widened by what modes leave of the level that it is told from, ``misfit`` times the noise.
    """
    found = seen.found
    if found.best == "drift":
        d = found.drift
        off = math.expm1(2 * d.frequency)  # stiffness goes with the square of frequencies, whose logarithm moved
        told = {"relative_stiffness_drift": {"value": off, "std": 2 * d.std * (1 + off), "unit": "-"}}
        return [{"name": "time_varying", "where": [], "probability": found.drifting, "parameters": told}]
    j = seen.joint
    if j is None or j.fit.law in NAMELESS:
        return []
    f = j.fit if whole is None else whole.fit
    scale = slopes(f.law, f.p)
    parameters = parameters_told(f.law, Place(j.spot.where), f.p, misfit * f.covariance * np.outer(scale, scale))
    if whole is not None and not whole.alone:
        std = whole.std * math.sqrt(misfit)
        parameters = {"stiffness": {"value": whole.stiffness, "std": std, "unit": "N/m"}, **parameters}
    sure = found.sure_at(j.slug, j.spot.where)
    name = {"name": j.slug, "where": list(j.spot.where), "probability": float(min(sure, 1.0))}
    return [{**name, "parameters": parameters}]


def rivals_told(seen: Seen, named: bool) -> list[list[dict[str, Any]]]:
    """Other laws and places that are likely enough."""
    j, found = seen.joint, seen.found
    if j is None:
        return []
    least = THRESHOLDS.elsewhere if named else THRESHOLDS.rival
    nameless = {law.slug for law in NAMELESS}
    out = [
        [{"name": o.slug, "where": list(o.spot.where)}] for o in found.joints[1:]
        if o.probability >= least and o.slug not in nameless and (o.slug, o.spot.where) != (j.slug, j.spot.where)
    ]  # fmt: skip
    return out + ([[{"name": "time_varying", "where": []}]] if found.drifting >= least else [])


def described(seen: Seen, j: JointFound) -> str:
    """The equivalent stiffness of a joint against its amplitude, in words."""
    m = motion_of(seen.levels, seen.base, j.direction, j.fit.law, j.spot.within)
    N, A = stiffness_of(j.fit.law, m, j.fit.p), m.amplitude
    top = np.unravel_index(int(A.argmax()), A.shape)
    least = (int(A[(slice(None), *top[1:])].argmin()), *top[1:])
    change = complex(N[top] - N[least])
    return (
        f"from an amplitude of {A[least]:.2g} to one of {A[top]:.2g} m at {m.omega[top[1]] / 2 / np.pi:.4g} Hz "
        f"force over displacement changes by {change.real:.3g} N/m in phase and {change.imag:.3g} N/m in quadrature"
    )
