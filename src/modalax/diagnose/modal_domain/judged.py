"""The verdict of the modal domain: is the simulation generally off, what stands out beyond that, and how sure is it."""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.explain import Explanation
from modalax.diagnose.modal_domain.fit import LARGEST, Fit
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.thresholds import THRESHOLDS

BEYOND = 3.0  # times the general inaccuracy that a joint or element must be off by to stand out
CALIBRATION = 0.02  # relative error of a gain that is usual for calibrated and mounted sensors (ISO 16063-21)
ANGLE = 0.01  # phase [rad] at the end of the band that a delay must make to stand out
MISSED = 2.0  # chi-square per feature beyond which modes are not explained
HOPELESS = 0.8  # part of the greatest inaccuracy from which a simulation is not one of this structure


def remarkable(stage: Stage, f: Fit, cause: Change, u: float) -> bool:
    """Whether a cause is beyond the usual in size, and not only significant."""
    size = abs(u * cause.scale)
    epsilon = dict(zip(stage.setting.inaccuracy.groups, f.epsilon, strict=True))
    if cause.slug == "joint_stiffness":
        whole = 1.0 if cause.pattern is not None else cause.reference
        return bool(size > BEYOND * epsilon["stiffness"] * whole)
    if cause.slug == "added_mass":
        return bool(size > BEYOND * epsilon["mass"] * cause.reference)
    if cause.slug in ("channel_gain", "force_gain"):
        return size > CALIBRATION
    if cause.slug == "time_delay":
        return bool(size * 2 * np.pi * stage.measured.freq[-1] > ANGLE)
    return True


def judge(stage: Stage) -> tuple[str, list[str], Explanation]:
    """Word, reasons, and the explanation that the answer is about."""
    ranked = stage.explanations
    best = ranked[0]
    reasons = []
    groups = stage.setting.inaccuracy.groups
    count = best.fit.state.difference.size
    hopeless = bool((best.fit.epsilon[:2] > HOPELESS * LARGEST[:2]).any()) or best.fit.chi2 > MISSED * count
    if hopeless:
        told = ", ".join(f"{g} {100 * e:.2g} %" for g, e in zip(groups, best.fit.epsilon, strict=True))
        reasons.append(f"even with elements off by {told} the measured modes are not explained")
        return "unknown", reasons, best
    plain = next((e for e in ranked if not e.causes), None)
    core = standing_out(stage, best)
    if not core:
        if best.causes:
            told = ", ".join(f"{c.slug} at {' - '.join(c.where)}" for c in best.causes)
            reasons.append(f"{told} is significant, but no larger than is usual")
        else:
            reasons.append(f"nothing stands out beyond the general inaccuracy (probability {best.probability:.3f})")
        return "clean", reasons, plain if plain is not None else best
    cores = [(standing_out(stage, e), e.probability) for e in ranked]
    alike = [(c, p) for c, p in cores if _slugs(c) == _slugs(core)]
    sure = sum(p for _, p in alike)
    placed = all(sum(p for other, p in alike if any(_same(c, o) for o in other)) > THRESHOLDS.placed for c in core)
    what = " and ".join(f"{c.slug} at {' - '.join(c.where) or 'everywhere'}" for c in core)
    reasons.append(f"{what} stands out beyond the general inaccuracy (probability {sure:.3f})")
    if plain is not None:
        reasons.append(f"without it the data are {best.log_posterior - plain.log_posterior:.3g} nats less likely")
    if sure >= THRESHOLDS.certain and placed:
        return "named", reasons, best
    reasons.append("other causes are too likely beside it" if sure < THRESHOLDS.certain else "its place is not sure")
    return "ambiguous", reasons, best


def standing_out(stage: Stage, e: Explanation) -> tuple[Change, ...]:
    """Causes of an explanation that are beyond the usual in size."""
    return tuple(c for c, u in zip(e.causes, e.fit.u, strict=True) if remarkable(stage, e.fit, c, float(u)))


def _slugs(causes: tuple[Change, ...]) -> tuple[str, ...]:
    return tuple(sorted(c.slug for c in causes))


def _same(a: Change, b: Change) -> bool:
    return a.slug == b.slug and sorted(a.where) == sorted(b.where)
