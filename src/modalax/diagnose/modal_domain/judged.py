"""What stands out in each explanation beyond the general inaccuracy, made ready for the verdict."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.decision.beyond import (
    BeyondUsual,
    ModalCase,
    Names,
    OddChannel,
    modal_verdict,
    odd_told,
    usual_size,
)
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.causes.line_forces import EvenCoupling, SkewCoupling
from modalax.diagnose.modal_domain.causes.supports import SensorMasses
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior, weighed
from modalax.diagnose.modal_domain.fitting.fit import by_data, fit, without_causes
from modalax.diagnose.modal_domain.fitting.inaccuracy import TOLD, USUAL, WITHIN, claims_of
from modalax.diagnose.modal_domain.fitting.linear import LARGEST
from modalax.diagnose.modal_domain.fitting.throughout import nats_over_a_factor
from modalax.diagnose.modal_domain.levels.slipping import part_of_joint
from modalax.diagnose.modal_domain.odd_channels.odd_channel import only_output
from modalax.diagnose.modal_domain.on_lines.polish import taken_on, without_spare
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.thresholds import THRESHOLDS

NEAR = 0.3  # relative distance within which a mode of the simulation may be the measured one
ONE_SIDED = 0.5  # symmetric over skew part of a coupling that is none: between 0, of a skew one, and 1, of one-way
GAINS = "channel_gain", "force_gain"
PHASES = "time_delay", "sensor_filter"  # what turns the phase of a sensor
LIKELIER = 0.5  # probability of nothing beyond the inaccuracy above which nothing is what the answer is about


@dataclass(frozen=True)
class Judged:
    """The verdict and what it is about.

    Attributes
    ----------
    word, reasons
        The verdict, and why.
    chosen
        The explanation that the answer is about: the likeliest one in which just this stands out, or the general
        inaccuracy alone if nothing does.
    sets
        What stands out, that of the answer first, the others by falling probability.
    likeliest
        The likeliest explanation of that kind, with causes that are no larger than usual: what these do is no
        inaccuracy of all elements.
    odd
        The channel that is told to be odd; None where none is.
    """

    word: str
    reasons: tuple[str, ...]
    chosen: Explanation
    sets: tuple[BeyondUsual, ...]
    likeliest: Explanation
    odd: OddChannel | None = None


def judge(stage: Stage) -> Judged:
    """Bring what the rules look at together, and apply them."""
    stage = _with_usual_dampers(_without_one_sided(stage))
    sets, best = _leading(stage)
    plain = next((e for e in stage.explanations if not e.causes), None)
    off, (_, small) = inaccuracy_of_fit(stage, best), told_by_size(stage, best)
    case = ModalCase(
        sets, [name for c in best.causes if not of_the_joint(stage, c) for name in c.told_as], off,
        max(off[name] / LARGEST[name] for name in ("stiffness", "mass")),
        best.misfit,
        None if plain is None else best.log_posterior - plain.log_posterior,
        stage.odd,
        _told(tuple(c for c in small if not (c.absent or c.dissipates))) if needs(stage, best, small) else (),
        {name: size for name, size in claims_of(stage.setting.inaccuracy).items() if name in ("stiffness", "mass")},
        _at_one_output(stage, best), _as_a_factor(stage, best), _one_sided(stage, best),
    )  # fmt: skip
    word, reasons = modal_verdict(case)
    # small causes without which the modes are much less likely stay in what the FRFs are corrected by
    behind = math.inf if plain is None else best.log_posterior - plain.log_posterior
    needed = behind > -math.log(1 - THRESHOLDS.certain) or any(of_the_joint(stage, c) for c in best.causes)
    alone = word == "clean" and plain is not None and not needed
    return Judged(word, reasons, plain if alone and plain is not None else best, sets, best, odd_told(case))


def _leading(stage: Stage) -> tuple[tuple[BeyondUsual, ...], Explanation]:
    """What stands out, and the likeliest explanation in which just the first of that does."""
    sets = sets_beyond(stage)
    return sets, next(e for e in stage.explanations if _key(_told(standing_out(stage, e))) == _key(sets[0].names))


def _without_one_sided(stage: Stage) -> Stage:
    """The stage without skew couplings where one that is none takes up a small rest beside what explains the modes."""
    best = _leading(stage)[1]
    skew = tuple(c for c in best.causes if type(c) is SkewCoupling)
    others = set(best.causes) - set(skew)
    fitted = any(set(e.causes) == others for e in stage.explanations)
    if not skew or not others or not fitted or needs(stage, best, skew) or not _one_sided(stage, best):
        return stage
    kept = [e for e in stage.explanations if not any(type(c) is SkewCoupling for c in e.causes)]
    return replace(stage, explanations=weighed(kept))


def _with_usual_dampers(stage: Stage) -> Stage:
    """The stage where dampers no larger than usual cost nothing, if nothing leads, or what turns a sensor's phase.

    Dampings are off somewhere with certainty, and a damper at a sensor turns the phase of its residues: of as many
    places as there are, each would be less likely than the same at a sensor's output. Beside one a second cause would
    be one too many, however much the data ask for it.
    """
    leading = _leading(stage)[1]
    out = standing_out(stage, leading)
    if not (any(c.slug in PHASES for c in out) or (leading.causes and not out)):
        return stage
    prior, raised = Prior(stage.candidates), []
    for e in stage.explanations:
        some = standing_out(stage, e)
        others = [c for c in e.causes if c.slug != "local_damper" or c in some]
        raised.append(replace(e, log_posterior=e.log_posterior - prior.of(e.causes) + prior.of(others)))
    return replace(stage, explanations=weighed(raised))


def _at_one_output(stage: Stage, e: Explanation) -> tuple[str, ...]:
    """Outputs that alone show a measured mode, where a mode is added and the simulation has none like it near."""
    f, plain = stage.measured.features, next((x for x in stage.explanations if not x.causes), None)
    if plain is None or not any(c.adds_mode for c in standing_out(stage, e)):
        return ()
    state, found = plain.fit.state, set()
    for k, pole in enumerate(f.poles):
        output = only_output(f, k)
        if output is None:
            continue
        energy = (np.abs(state.plain / f.units[k]) ** 2).sum(axis=2)
        alike = energy[:, output] > 0.5 * energy.sum(axis=1)
        near = np.abs(np.abs(state.modes.poles) / abs(pole) - 1) < NEAR
        found |= set() if (alike & near).any() else {output}
    return tuple(stage.measurement.outputs[k] for k in sorted(found))


def _as_a_factor(stage: Stage, e: Explanation) -> float | None:
    """By how many nats as much mass under every sensor is likelier than a factor throughout; None without such mass."""
    at = [k for k, c in enumerate(e.causes) if isinstance(c, SensorMasses)]
    return nats_over_a_factor(stage.setting, e.fit, at[0]) if at else None


def _one_sided(stage: Stage, e: Explanation) -> tuple[tuple[str | int, ...], ...]:
    """Places of couplings that are said to be skew and surely act on one end more than on the other.

    One that acts on one end alone has a symmetric part as large as the skew one; beside elements that are off, a small
    one is no wonder.
    """
    found = []
    for c in standing_out(stage, e):
        if type(c) is SkewCoupling:
            even = EvenCoupling(c.slug, c.where, c.scale, basis=c.basis, middle=c.middle)
            u = np.append(e.fit.u, 0.0)
            f = fit(stage.setting, (*e.causes, even), without_causes(e.fit), u, temperatures=(3.0,))
            sure = f is not None and abs(f.u[-1]) > THRESHOLDS.stands_out * math.sqrt(max(f.covariance[-1, -1], 0.0))
            own = own_sizes(e.causes, e.causes.index(c)).start
            found += [c.where] if sure and f is not None and abs(f.u[-1]) > ONE_SIDED * abs(f.u[own]) else []
    return tuple(found)


def on_its_lines(stage: Stage, e: Explanation) -> Explanation:
    """The explanation that the answer is about, taken on to the lines where the same stands out in it there.

    It need not have been among the likeliest, which were taken on before. Causes that may be none there are left out.
    """
    again = taken_on(stage.setting, e, stage.measured)
    if again is not e and set(standing_out(stage, again)) != set(standing_out(stage, e)):
        again = e
    told = told_by_size(stage, again)
    spare = [c for c in again.causes if not (c in told[0] or c in told[1] or of_the_joint(stage, c) or not c.sized)]
    return without_spare(stage.setting, again, spare, stage.measured)


def sets_beyond(stage: Stage) -> tuple[BeyondUsual, ...]:
    """What stands out, the same causes at the same places as one: first nothing if that is likelier than all else."""
    total: dict[Names, tuple[Names, float]] = {}
    for e in stage.explanations:
        told = _told(standing_out(stage, _in_the_limit(stage, e)))
        names, p = total.get(_key(told), (told, 0.0))
        total[_key(told)] = names, p + e.probability
    sets = sorted((BeyondUsual(*v) for v in total.values()), key=lambda s: -s.probability)
    nothing = next((s for s in sets if not s.names), None)
    leads = nothing is not None and (nothing.probability > LIKELIER or len(sets) == 1)
    leading = nothing if leads else next(s for s in sets if s.names)
    assert leading is not None
    return (leading, *(s for s in sets if s is not leading))


def _in_the_limit(stage: Stage, e: Explanation) -> Explanation:
    """The likeliest explanation by one of the limits of a cause that the data do not tell from it.

    What is no likelier than another cause of the same limits is told from them no better than that one.
    """
    for c in e.causes:
        slugs, nats = c.limits
        alike = [(x, _instead(x, e, c)) for x in stage.explanations if slugs]  # by falling probability
        data = [(x, y, by_data(x.fit, x.causes, y)) for x, y in alike if y is not None]
        ahead = [g for x, y, g in data if y.limits == c.limits and x.log_posterior >= e.log_posterior]
        ahead += [by_data(e.fit, e.causes, c)] if slugs else []  # of two causes at one place neither stands alone
        for x, y, g in data:
            if y.slug in slugs and not y.along and min(ahead) - g < nats:
                return x
    return e


def _instead(x: Explanation, e: Explanation, cause: Change) -> Change | None:
    """The cause that an explanation has at the place of another's, where all their other causes are the same."""
    rest = {(y.slug, y.where) for y in e.causes if y is not cause}
    found = [y for y in x.causes if y.where == cause.where and (y.slug, y.where) not in rest]
    same = len(found) == 1 and {(y.slug, y.where) for y in x.causes if y is not found[0]} == rest
    return found[0] if same else None


def _told(causes: tuple[Change, ...]) -> Names:
    return tuple(name for c in causes for name in c.told_as)


def _key(names: Names) -> Names:
    """Causes in an order of their own, a pair of DoFs the same in either order."""
    return tuple(sorted((slug, tuple(sorted(where, key=str))) for slug, where in names))


def standing_out(stage: Stage, e: Explanation) -> tuple[Change, ...]:
    """Causes of an explanation that are larger than usual, surely not zero, and no joint's own linear part.

    Where the modes are not explained without them, springs where the simulation has none stand out as well, and losses
    at a place, which are no part of an inaccuracy that has the damping off mode by mode. So does what all elements
    would have to be off far more without: a spring across a slender rod is small beside what the rod is along itself.
    """
    out, small = told_by_size(stage, e)
    needed = small if needs(stage, e, small) else ()
    lone = [c for c in small if (c in needed and (c.absent or c.dissipates)) or _outdone(stage, e, c)]
    return tuple(c for c in e.causes if c in out or c in lone)


def _outdone(stage: Stage, e: Explanation, cause: Change) -> bool:
    """Whether stiffness or mass would have to be off in general beyond any usual size without one cause.

    One element that is off no more than others are hardly changes how much these are off in general.
    """
    own, without = inaccuracy_of_fit(stage, e), [inaccuracy_of_fit(stage, x) for x in _without(stage, e, (cause,))]
    return bool(without) and all(
        max(x[name] / max(own[name], USUAL[name]) for name in ("stiffness", "mass")) > THRESHOLDS.beyond
        for x in without
    )


def _without(stage: Stage, e: Explanation, some: tuple[Change, ...]) -> list[Explanation]:
    """Explanations by the other causes of one, with or without those that may be none within their errors."""
    most, sure = set(e.causes) - set(some), set(itertools.chain(*told_by_size(stage, e))) - set(some)
    return [x for x in stage.explanations if sure <= set(x.causes) <= most]


def needs(stage: Stage, e: Explanation, small: tuple[Change, ...]) -> bool:
    """Whether an explanation without some of its causes leaves the measured modes unexplained."""
    without = [x.misfit for x in _without(stage, e, small)] if small else []
    return bool(without) and min(without) > THRESHOLDS.misfit >= e.misfit


def told_by_size(stage: Stage, e: Explanation) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
    """Causes of an explanation that are surely not zero: those larger than is usual, and the others."""
    off, highest = inaccuracy_of_fit(stage, e), float(stage.measured.freq[-1])
    alone, out, small = stage.setting.inaccuracy.between_modes, [], []
    if alone:  # a single element, of which modes do not tell, is off by more than modes, which have many
        off = {name: max(size, USUAL[name]) for name, size in off.items()}
    for k, (c, u) in enumerate(with_sizes(e.causes, e.fit.u)):
        size, usual = c.size(u), usual_size(c.slug, c.whole, off, highest)
        if c.slug in GAINS and alone:  # shapes at a DoF are off by as much as elements
            usual = max(usual, THRESHOLDS.beyond * off["stiffness"])
        if c.slug == "modal_damping":  # a factor, as the general inaccuracy of damping is
            size = float(np.log(max(1 + size, 1e-9)))
        own = own_sizes(e.causes, k)
        apart = np.abs(e.fit.u[own]) / np.sqrt(np.maximum(np.diag(e.fit.covariance)[own], 1e-300))
        at_any_size = usual == -math.inf and not (c.linear and c.signed)  # what may be of either sign may be none
        sure = (
            at_any_size
            or bool(apart[: c.telling].max() > THRESHOLDS.stands_out)
            or (abs(e.fit.u[own][0]) > 1 and _missed(stage, e, c))
        )
        if sure and not of_the_joint(stage, c):
            (out if abs(size) > usual else small).append(c)
    return tuple(out), tuple(small)


def _missed(stage: Stage, e: Explanation, cause: Change) -> bool:
    """Whether an explanation is far less likely without a cause; one that holds two points may be of any size."""
    rest = set(e.causes) - {cause}
    without = [x.log_posterior for x in stage.explanations if set(x.causes) == rest]
    return bool(without) and e.log_posterior - max(without) > 0.5 * THRESHOLDS.stands_out**2


def of_the_joint(stage: Stage, c: Change) -> bool:
    """Whether a spring or damper is where the levels tell a joint: what that joint does at any level."""
    joint = None if stage.seen is None else stage.seen.joint
    return joint is not None and part_of_joint(c, joint.spot.where)


def inaccuracy_of_fit(stage: Stage, e: Explanation) -> dict[str, float]:
    """General relative inaccuracy of stiffness, mass and damping that goes with an explanation."""
    every = dict(zip(stage.setting.inaccuracy.groups, e.fit.epsilon, strict=True))
    return {name: float(np.hypot(every[name], every.get(WITHIN.get(name, ""), 0.0))) for name in TOLD}
