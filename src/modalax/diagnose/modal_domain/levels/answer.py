"""What the levels add to an answer: a joint by its law, a drift, or levels that differ without an explanation."""

from typing import Any

import numpy as np

from modalax.diagnose.causes.scene import Place
from modalax.diagnose.modal_domain.levels.change import projected
from modalax.diagnose.modal_domain.levels.explain import JointFound
from modalax.diagnose.modal_domain.levels.laws import NAMELESS, motions_of, stiffness_of
from modalax.diagnose.modal_domain.levels.seen import Seen
from modalax.diagnose.result import parameters_told
from modalax.diagnose.thresholds import THRESHOLDS


def judge_levels(seen: Seen | None) -> tuple[str, list[str]]:
    """Word and reasons of the levels alone: ``clean`` where they agree."""
    if seen is None or seen.found.best == "nothing":
        return "clean", []
    found = seen.found
    kind = "force levels" if len(np.unique(seen.levels.force)) > 1 else "runs"
    differ = f"the {kind} differ beyond their noise (chi-square {found.before:.3g} per sample of their differences)"
    if found.best == "drift":
        d = found.drift
        told = f"a shift of frequencies by {100 * d.frequency:.2g} % up to the last, at every amplitude alike"
        word = "named" if found.drifting >= THRESHOLDS.certain else "ambiguous"
        return word, [differ, f"{told}, explains it (probability {found.drifting:.3f})"]
    j = found.joints[0]
    where = " - ".join(j.spot.where)
    reasons = [differ, f"across {where}, {described(seen, j)}"]
    if found.after > THRESHOLDS.unexplained:
        return "unknown", [*reasons, f"no law explains it (chi-square {found.after:.3g} per sample is left)"]
    nameless = {law.slug for law in NAMELESS}
    if sum(p.probability for p in found.joints if p.slug in nameless) > THRESHOLDS.nameless:
        return "unknown", [*reasons, "it follows none of the laws that have a name, but a power of the amplitude"]
    sure, placed = found.sure(j.slug), found.placed(j.slug, j.spot.where)
    reasons.append(f"{j.slug} at {where} explains it (probability {sure:.3f} of the law, {placed:.3f} of the place)")
    if sure >= THRESHOLDS.certain and placed > THRESHOLDS.placed:
        return "named", reasons
    doubt = "its place is not sure" if sure >= THRESHOLDS.certain else "other laws are too likely"
    return "ambiguous", [*reasons, doubt]


def causes_told(seen: Seen) -> list[dict[str, Any]]:
    """The joint or the drift, as told in the answer."""
    found = seen.found
    if found.best == "drift":
        d = found.drift
        told = {"relative_stiffness_drift": {"value": 2 * d.frequency, "std": 2 * d.std, "unit": "-"}}
        return [{"name": "time_varying", "where": [], "probability": found.drifting, "parameters": told}]
    j = seen.joint
    if j is None or j.fit.law in NAMELESS:
        return []
    scale = np.array([v if q.log else 1.0 for v, q in zip(j.fit.p, j.fit.law.parameters, strict=True)])
    covariance = j.fit.covariance * np.outer(scale, scale)
    parameters = parameters_told(j.fit.law, Place(j.spot.where), j.fit.p, covariance)
    name = {"name": j.slug, "where": list(j.spot.where), "probability": float(min(found.sure(j.slug), 1.0))}
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
    b = j.direction[None]
    m = motions_of(seen.levels, seen.base, b, projected(seen.levels, seen.base, b))[0]
    N, A = stiffness_of(j.fit.law, m, j.fit.p), m.amplitude
    top = np.unravel_index(int(A.argmax()), A.shape)
    change = complex(N[top] - N[(0, *top[1:])])
    return (
        f"from an amplitude of {A[(0, *top[1:])]:.2g} to one of {A[top]:.2g} m at {m.omega[top[1]] / 2 / np.pi:.4g} Hz "
        f"force over displacement changes by {change.real:.3g} N/m in phase and {change.imag:.3g} N/m in quadrature"
    )
