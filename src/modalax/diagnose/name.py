"""Naming: detection, single causes, compounds up to three, and whether anything is left over."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.decide import CERTAIN, RIVAL, Detection, Ranked, detect, posterior
from modalax.diagnose.doubt import apart, imitations, likeness
from modalax.diagnose.drifting import joints_for_drifts
from modalax.diagnose.evidence import evidence, is_element, promise
from modalax.diagnose.fit import ROUNDS, Hypothesis, jacobian_of, searched
from modalax.diagnose.noise import TRUSTED
from modalax.diagnose.omnibus import Omnibus, omnibus
from modalax.diagnose.screen import Trial
from modalax.diagnose.search import (
    PATIENT,
    Screening,
    best_of_each,
    chosen,
    exchanged,
    fit_further,
    fit_single,
    from_home,
    screen_all,
)
from modalax.diagnose.state import State, state_of
from modalax.diagnose.study import Study, noise_beside

LEFT = 0.002  # chance under noise below which a residual is said to hold something more
LEFT_BY_SEVERAL = 0.01  # the same where several causes are needed
PLACED = 0.5  # posterior of each place beyond which sure names are given: likelier there than anywhere else
ELSEWHERE = 0.05  # probability from which another place is told beside the named one
NEAR = 12.0  # nats behind the best up to which hypotheses are fitted again where complex modes are exact
DEEPEST = 3  # causes in one answer
LEADING, BEHIND = 2, 40.0  # hypotheses that a further cause is added to, and nats that these may be behind the best
FURTHER = 3  # causes tried on each
CENTRED = 3  # times that complex modes are made exact about what was fitted
AGAIN = 2  # times that noise read off the lines is read again


@dataclass(frozen=True)
class Look:
    """The simulation alone beside the data: what it leaves, what the causes would explain of that, and the chance.

    Where dampers couple the modes, ``again`` is the same with complex modes exact about the parameters fitted to that.
    """

    study: Study
    null: Hypothesis
    omnibus: Omnibus
    state: State
    screening: Screening
    detection: Detection
    again: "Look | None" = None


def look(study: Study, causes: Sequence[Cause]) -> Look:
    """Whether anything is wrong at all."""
    first = _look(study, causes)
    if not first.detection.anything or study.problem.plant.mixing is None or not study.nuisance.active:
        return first
    # complex modes follow undamped ones to first order only: what that leaves is no finding
    about = study
    for _ in range(CENTRED):
        about = about.centred(about.fit([empty(study)], ROUNDS)[0])
    again = _look(about, causes)
    return replace(first, again=again) if again.detection.anything else again


def _look(study: Study, causes: Sequence[Cause]) -> Look:
    null = study.fit([empty(study)], ROUNDS)[0]
    before = omnibus(study.residual(null), study.live(), study.noise.freedom)
    state = state_of(study, null)
    screening = screen_all(study, null, causes, state)
    found = detect(screening.trials, state.sides, before, study.noise.spread)
    return Look(study, null, before, state, screening, found)


@dataclass(frozen=True)
class Naming:
    """What was found.

    Attributes
    ----------
    verdict
        ``clean``, ``named``, ``ambiguous`` or ``unknown``.
    ranked
        Sets of causes by falling probability.
    null
        The simulation alone, its modal parameters adapted within their spread.
    screening
        Of the null.
    detection
        Significance of what the simulation leaves.
    before, after
        Omnibus tests of the null and of the best hypothesis.
    studies
        In which the null and the best hypothesis were fitted: the same but for what complex modes are exact about.
    notes
        Sentences for the answer.
    """

    verdict: str
    ranked: list[Ranked]
    null: Hypothesis
    screening: Screening
    detection: Detection
    before: Omnibus
    after: Omnibus
    studies: tuple[Study, Study]
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> Hypothesis:
        """The leading hypothesis; the null where nothing was found."""
        return self.ranked[0].best if self.ranked else self.null


def name(study: Study, causes: Sequence[Cause], imitators: Sequence[Cause] = ()) -> Naming:
    """Search the causes of one study; ``imitators`` have no name, but may explain better what is about to be named."""
    first = look(study, causes)
    null, before, state, screening, detection = first.null, first.omnibus, first.state, first.screening, first.detection
    if not detection.anything:
        return Naming("clean", [], null, screening, detection, before, before, (first.study, first.study))
    samples = study.problem.samples

    def weigh(found: list[Hypothesis]) -> list[Ranked]:
        each = best_of_each(found, study)
        return posterior([(h, evidence(h, study.scene, samples, null.chi2)) for h in each])

    found = _singles(study, first, causes)
    found += joints_for_drifts(study, null, best_of_each(found, study), causes, state)
    ranked = weigh(found)
    if not ranked or ranked[0].best.chi2 > null.chi2 - 9.0:
        return Naming("unknown", [], null, screening, detection, before, before, (study, study))
    alone, study = study, study.centred(ranked[0].best)
    if study is not alone:
        near = [r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - NEAR and r.best.hum is None]
        found = study.fit(near, PATIENT) + [h for h in found if not any(h is other for other in near)]
        ranked = weigh(found)
    rests: dict[int, tuple[Hypothesis, Rest]] = {}  # the hypothesis is kept, so that its number stays its own

    def rest(h: Hypothesis) -> Rest:
        if id(h) not in rests:
            rests[id(h)] = h, _rest(study, h, null, causes)
        return rests[id(h)][1]

    for depth in range(2, DEEPEST + 1):
        more = _more(study, ranked, rest)
        found += more
        ranked = weigh(found)
        if not more or len(ranked[0].names) < depth:
            break
        # the first cause was found while the second still hid its like
        found += exchanged(study, ranked[0].best, lambda h: rest(h).trials, FURTHER)
        ranked = weigh(found)
    last = rest(ranked[0].best)
    verdict, notes = _verdict(ranked, last.p_value), ()
    hum = ranked[0].best.hum is not None and bool(ranked[0].best.causes)
    if verdict != "ambiguous" and imitators and not hum:
        ranked, nameless = apart(weigh(found + imitations(study, null, state, ranked[0].best, imitators)), imitators)
        likelier = sum(r.probability for r in nameless) > 0.5
        verdict, notes = "unknown" if likelier else _verdict(ranked, last.p_value), likeness(nameless)
    return Naming(verdict, ranked, null, screening, detection, before, last.omnibus, (alone, study), notes)


def _more(study: Study, ranked: list[Ranked], rest: Callable[[Hypothesis], "Rest"]) -> list[Hypothesis]:
    """The leading hypotheses with one cause more; others if none of those means what its name says any longer.

    A tuned mass that stood for an added mass and a joint together becomes a mass once the joint is there.
    """

    def worthy(h: Hypothesis) -> bool:
        worth = _worth(study) if rest(ranked[0].best).p_value > LEFT else 0.0
        return bool(rest(h).trials) and rest(h).trials[0].gain > worth

    def tried(some: list[Hypothesis]) -> list[Hypothesis]:
        return [k for h in some if worthy(h) for k in fit_further(study, h, rest(h).trials[:FURTHER])]

    leading = [r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - BEHIND][:LEADING]
    found = tried(leading)
    if found or not worthy(leading[0]):
        return found
    reach = max(BEHIND, 0.5 * rest(leading[0]).trials[0].gain)
    others: dict[Any, Hypothesis] = {}
    for r in ranked:
        if r.log_evidence > ranked[0].log_evidence - reach and r.best.hum is None:
            others.setdefault(frozenset(slug for slug, _ in r.names), r.best)
    return tried([h for h in others.values() if not any(h is one for one in leading)][:FURTHER])


def _singles(study: Study, first: Look, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Single causes, fitted."""
    found = fit_single(study, first.null, chosen(first.screening.trials), first.state)
    found += from_home(study, first.null, causes)
    if first.again is not None:  # a modal parameter far off is found where the modes follow it exactly
        other = first.again
        some = [t for t in chosen(other.screening.trials) if t.cause.stage == "undamped"]
        found += fit_single(other.study, other.null, some, other.state) if some else []
    return found


def with_noise_beside(study: Study) -> Study:
    """The same study with noise that had to be read off the lines read beside the simulation as it fits."""
    for _ in range(AGAIN):
        noise = noise_beside(study, study.fit([empty(study)], ROUNDS)[0])
        if noise is None:
            return study
        study = study.with_noise(noise)
    return study


def _verdict(ranked: list[Ranked], left: float) -> str:
    """Named only if the names are sure, each place likelier than all others, and nothing hints at something more.

    Two causes together can imitate a third thing, the more so at one place: they must leave less behind.
    """
    best = ranked[0]
    slugs = sorted(slug for slug, _ in best.names)
    if left < LEFT or (len(slugs) > 1 and left < LEFT_BY_SEVERAL):
        return "unknown"
    alike = [r for r in ranked if sorted(slug for slug, _ in r.names) == slugs]
    placed = all(sum(r.probability for r in alike if one in r.names) > PLACED for one in best.names)
    sure = sum(r.probability for r in alike) >= CERTAIN and placed and not _one_joint(best.best)
    return "named" if sure else "ambiguous"


def _one_joint(h: Hypothesis) -> bool:
    """Whether several elements sit at one place: together they may be one joint of a law that no one listed."""
    at = [p.where for c, p in zip(h.causes, h.places, strict=True) if is_element(c)]
    return len(set(at)) < len(at)


@dataclass(frozen=True)
class Rest:
    """What a hypothesis leaves: further causes, the best first, the chance of so much under noise, the omnibus test."""

    trials: list[Trial]
    p_value: float
    omnibus: Omnibus


def _rest(study: Study, h: Hypothesis, null: Hypothesis, causes: Sequence[Cause]) -> Rest:
    """Screen what a hypothesis leaves, less what the laws' own inexactness may leave."""
    used = study if h.hum is None else study.without(h.hum.lines)
    fidelity = max((c.fidelity for c in h.causes), default=0.0)
    tolerated = fidelity**2 * max(null.chi2 - h.chi2, 0.0)
    after = omnibus(used.residual(h), used.live(), study.noise.freedom, tolerated)
    state = state_of(used, h, _jacobian(used, h))
    trials = screen_all(used, h, causes, state, finite=False).trials
    if h.hum is not None:
        trials = [t for t in trials if t.cause.stage != "lines"]
    if study.noise.freedom < TRUSTED:  # the noise is no better known than what the omnibus test would say of it
        after = replace(after, p_value=1.0)
    p_value = detect(trials, state.sides, after, study.noise.spread, tolerated).p_value
    trials = [t for t in chosen(trials) if (t.cause.slug, t.place.where) not in h.names]
    samples = used.problem.samples
    return Rest(sorted(trials, key=lambda t: -promise(t, study.scene, samples)), p_value, after)


def rivals(verdict: str, ranked: list[Ranked]) -> list[Ranked]:
    """Sets worth telling beside the leading one: other places of what is named, else the next best at least."""
    if verdict == "named":
        return [r for r in ranked[1:] if r.probability >= ELSEWHERE]
    return [r for r in ranked[1:] if r.probability >= RIVAL] or ranked[1:2]


def empty(study: Study) -> Hypothesis:
    """The simulation alone."""
    return Hypothesis(theta=np.zeros((2, study.problem.plant.stiffness.shape[0])))


def _worth(study: Study) -> float:
    """Chi-square that a further cause must promise."""
    return 22.0 + math.log(max(study.problem.samples, 30))


def _jacobian(study: Study, h: Hypothesis) -> np.ndarray:
    """Directions of the fitted parameters, long enough to count as free."""
    problem, nuisance = study.problem, study.nuisance
    if not h.causes or not len(searched(h)):
        return np.zeros((0, *problem.data.shape[2:], 2 * problem.data.shape[0] * problem.data.shape[1]))
    J = np.asarray(
        jacobian_of(h.causes, h.index, h.extras, searched(h), h.theta, nuisance.spread, nuisance.basis, problem)
    )
    norm = np.sqrt((J**2).sum(axis=(1, 2, 3), keepdims=True))
    return J / np.where(norm > 0, norm, 1.0) * 1e4
