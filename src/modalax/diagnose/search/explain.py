"""The causes that explain the residual of a simulation: one alone, several together, and the check for imitations."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.comparison import Comparison, noise_beside
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.decision.posterior import Ranked, evidence, posterior
from modalax.diagnose.decision.verdict import Leftover, verdict
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.search.candidates import best_of_each, moderate
from modalax.diagnose.search.compounds import FURTHER, Leavings, Rest, alone, exchanged, fit_together, one_more_cause
from modalax.diagnose.search.elsewhere import elsewhere, restarted
from modalax.diagnose.search.harmonics import is_limit, joints_in_full
from modalax.diagnose.search.imitator_check import apart, imitations, likeness
from modalax.diagnose.search.in_pairs import best_pairs
from modalax.diagnose.search.joints_by_force import joints_by_force
from modalax.diagnose.search.look import Look
from modalax.diagnose.search.look import look as first_look
from modalax.diagnose.search.measured_force import STRONG
from modalax.diagnose.search.named_before import NamedCause, explained_by
from modalax.diagnose.search.one_cause import singles, untried
from modalax.diagnose.search.singles import PATIENT
from modalax.diagnose.search.tolerance import tolerated, uncounted
from modalax.diagnose.thresholds import THRESHOLDS

NEAR = 12.0  # nats behind the best up to which hypotheses are fitted again with complex modes made exact
DEEPEST = 3  # causes in one answer
MOVES = 3  # times that the leading set is looked for at other places, as long as another comes to lead
SEVERAL = THRESHOLDS.left_by_several
NEARLY = 0.05  # share of what a pair promised in linear order by which its fit may differ to be taken for linear
SLIGHT = 1.0  # chi-square that harmonics may change at most for pairs to be fitted before them
HOPEFUL = 0.5  # share of the residual beyond noise that two causes must explain before a third is looked for


@dataclass(frozen=True)
class Explanation:
    """Sets of causes that explain the residual of a simulation, with their probabilities.

    Attributes
    ----------
    look
        The simulation alone beside the data.
    comparison
        In which the sets of causes were fitted: that of ``look`` but for what complex modes are exact about.
    ranked
        Sets of causes by falling probability; empty where none was looked for or none explains anything.
    leftover
        What the simulation leaves, with and without the leading set.
    after
        Omnibus test of what the leading set leaves.
    fitted
        All hypotheses that were fitted.
    notes
        Sentences for the answer.
    by_force
        Whether it is a law that explains the force which is measured at one place and leaves no more than noise, so
        that no other search can explain more.
    """

    look: Look
    comparison: Comparison
    ranked: list[Ranked]
    leftover: Leftover
    after: Omnibus
    fitted: list[Hypothesis] = field(default_factory=list, repr=False)
    notes: tuple[str, ...] = ()
    by_force: bool = False

    @property
    def best(self) -> Hypothesis:
        """The leading hypothesis; the simulation alone where nothing was found."""
        return self.ranked[0].best if self.ranked else self.look.null


def explain(
    look: Look, causes: Sequence[Cause], named: Sequence[NamedCause] = (), only_named: bool = False
) -> Explanation:
    """Search single causes, then one more at a time, if the residual of the simulation is more than noise.

    What is ``named`` before stands for the search of single causes where it explains all, alone or with further causes
    beside it; where it does not, nothing is searched for if ``only_named``.
    """
    leftover = Leftover(alarm=look.detection.p_value)
    nothing = Explanation(look, look.comparison, [], leftover, look.omnibus)
    if not look.detection.anything:
        return nothing
    before, known = explained_by(look, named, causes)
    if known is not None and known.p_value < SEVERAL:
        before, known = beside_named(look, before, known, causes)
    if only_named and not before:
        return nothing
    look = look if before or not named else first_look(look.comparison, causes)
    fitted = before or singles(look, causes)
    ranked = weigh(look, fitted)
    explained = look.null.chi2 - ranked[0].best.chi2 if ranked else 0.0
    leftover = replace(leftover, explained=explained, untried=() if before else untried(look, fitted))
    if verdict(ranked, leftover)[0] == "unknown":
        return replace(nothing, leftover=leftover)
    look, fitted, ranked = with_noise_again(look, fitted, ranked)
    comparison, fitted, ranked = centred(look, fitted, ranked)
    fitted, ranked = from_leading_modes(look, comparison, fitted, ranked)
    rest = Leavings(comparison, look.null, causes)
    if before and ranked[0].best is before[0] and known is not None:
        rest.know(before[0], known)
    if not (before and ranked[0].best.names == before[0].names) or rest(ranked[0].best).p_value < SEVERAL:
        fitted, ranked, settled = with_harmonics_or_pairs(look, comparison, fitted, ranked, rest)
        if not settled:
            fitted, ranked = by_force(look, comparison, fitted, ranked, causes)
            fitted, ranked = together(look, comparison, fitted, ranked, rest)
    fitted, ranked = at_other_places(look, comparison, fitted, ranked, causes)
    left = rest(ranked[0].best)
    leftover = replace(leftover, p_value=left.p_value, tolerated=left.tolerated)
    return Explanation(look, comparison, ranked, leftover, left.omnibus, fitted)


def check_imitations(found: Explanation, imitators: Sequence[Cause], late: Deadline) -> Explanation:
    """Look for causes without a name in the answer that may explain the data better than those about to be named.

    Parameters
    ----------
    found
        What is about to be named.
    imitators
        The causes without a name.
    late
        Whether time is up; what is named then has not been compared with them, which is noted.
    """
    several_with_hum = found.best.hum is not None and bool(found.best.causes)
    if not found.ranked or several_with_hum or verdict(found.ranked, found.leftover)[0] == "ambiguous":
        return found
    if late():
        return replace(found, leftover=replace(found.leftover, untried=("causes beside the catalogue",)))
    state = replace(found.look.state, comparison=replace(found.comparison, late=late))
    others = imitations(state, found.best, imitators)
    ranked, nameless = apart(weigh(found.look, found.fitted + others, found.comparison))
    notes = likeness(nameless)
    chance = float(sum(r.probability for r in nameless))
    leftover = replace(found.leftover, nameless=chance, likeness=notes[0] if notes else "")
    return replace(found, ranked=ranked, leftover=leftover, notes=notes)


def weigh(look: Look, fitted: list[Hypothesis], comparison: Comparison | None = None) -> list[Ranked]:
    """Give sets of causes their probabilities among all hypotheses that were fitted.

    Parameters
    ----------
    look
        The simulation alone, whose chi-square and number of samples count.
    fitted
        The hypotheses.
    comparison
        In which they were fitted; that of ``look`` if None.
    """
    used = comparison or look.comparison
    samples = look.comparison.problem.samples
    each = best_of_each(fitted, used)
    null = look.null.chi2
    return posterior([(h, evidence(h, used.scene, samples, null) - 0.5 * uncounted(h, each, null)) for h in each])


def with_noise_again(
    look: Look, fitted: list[Hypothesis], ranked: list[Ranked]
) -> tuple[Look, list[Hypothesis], list[Ranked]]:
    """Read noise off the lines once more, beside the leading hypothesis, where the simulation alone misses by more.

    Scatter between neighbouring lines holds the curvature of what the simulation misses; beside an explanation it does
    not. The hypotheses keep their parameters, but for those near the best, which are fitted again.
    """
    best = ranked[0].best
    if best.hum is not None or look.null.chi2 - best.chi2 < look.comparison.problem.samples:
        return look, fitted, ranked
    noise = noise_beside(look.comparison, best)
    if noise is None:
        return look, fitted, ranked
    comparison = look.comparison.with_noise(noise)
    null = comparison.fit([look.null], PATIENT)[0]
    state = score_state_of(comparison, null)
    look = replace(look, state=state, omnibus=omnibus(comparison.residual(null), comparison.live(), noise.freedom))
    near = [r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - NEAR and r.best.hum is None]
    others = [h for h in fitted if h.hum is None and not any(h is one for one in near)]
    fitted = comparison.fit(near, PATIENT) + [replace(h, chi2=comparison.chi2(h)) for h in others]
    return look, fitted, weigh(look, fitted)


def centred(
    look: Look, fitted: list[Hypothesis], ranked: list[Ranked]
) -> tuple[Comparison, list[Hypothesis], list[Ranked]]:
    """Make complex modes exact about the leading hypothesis, and fit those near it again.

    Parameters
    ----------
    look
        The simulation alone.
    fitted
        All hypotheses so far.
    ranked
        Sets of causes by falling probability.
    """
    comparison = look.comparison.centred(ranked[0].best)
    if comparison is look.comparison or comparison.late():
        return comparison, fitted, ranked
    near = [r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - NEAR and r.best.hum is None]
    fitted = comparison.fit(near, PATIENT) + [h for h in fitted if not any(h is other for other in near)]
    return comparison, fitted, weigh(look, fitted, comparison)


def from_leading_modes(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked]
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Fit what a strong effect may have kept in another minimum of the modes again, begun from those of the leader."""
    strong = look.null.chi2 > STRONG * comparison.problem.samples and not comparison.late()
    more = restarted(comparison, ranked[0].best, [r.best for r in ranked[1:]]) if strong else []
    return (fitted + more, weigh(look, fitted + more, comparison)) if more else (fitted, ranked)


def in_full(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked]
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Fit leading joints again with their higher harmonics; these stand for what was fitted with one."""
    again = [] if comparison.late() else joints_in_full(comparison, look.null, [r.best for r in ranked])
    if not again:
        return fitted, ranked
    done = {frozenset(h.parts) for h in again}
    fitted = again + [h for h in fitted if frozenset(h.parts) not in done]
    fitted = [h for h in fitted if not any(is_limit(h, other, look.null) for other in again)]
    return fitted, weigh(look, fitted, comparison)


def by_force(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked], causes: Sequence[Cause]
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Fit joints in full where a force is measured that what was fitted so far does not explain."""
    best = min(ranked, key=lambda r: r.best.chi2).best
    more = [] if comparison.late() else joints_by_force(comparison, look.null, causes, best)
    return (fitted + more, weigh(look, fitted + more, comparison)) if more else (fitted, ranked)


def leader_in_full(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked]
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Fit the joint of the leading set again with its higher harmonics, as it is once alone, until such a set leads."""
    for _ in range(DEEPEST):
        again = in_full(look, comparison, fitted, ranked[:1])
        if again[0] is fitted:
            break
        fitted, ranked = again
    return fitted, ranked


def together(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked], rest: Leavings
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Add one cause at a time, as long as what is left asks for one and the leading set takes it up."""
    done: list[Hypothesis] = []
    for depth in range(2, DEEPEST + 1):
        if comparison.late() or (depth > 2 and _explained(look, ranked[0]) < HOPEFUL):
            break
        more = one_more_cause(comparison, ranked, rest, done, lambda some: weigh(look, some, comparison))
        fitted = fitted + more
        fitted, ranked = leader_in_full(look, comparison, fitted, weigh(look, fitted, comparison))
        if not more or len(ranked[0].names) < depth:
            break
        # the first cause was found while the second still hid its like
        fitted = fitted + exchanged(comparison, ranked[0].best, lambda h: rest(h).trials, FURTHER, done)
        fitted, ranked = leader_in_full(look, comparison, fitted, weigh(look, fitted, comparison))
    return fitted, ranked


def with_harmonics_or_pairs(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked], rest: Leavings
) -> tuple[list[Hypothesis], list[Ranked], bool]:
    """Fit single joints with their harmonics and pairs of causes, first what may make the other needless.

    What harmonics can change is known before they are fitted (:func:`tolerated`). Where that is nothing beside what the
    leading cause leaves, pairs come first. Tells whether the search is settled, too (:func:`both_at_once`).
    """
    first = tolerated(ranked[0].best, look.null.chi2) < SLIGHT
    before, settled = fitted, False
    if first:
        fitted, ranked, settled = both_at_once(look, comparison, fitted, ranked, rest)
    if settled:
        return fitted, ranked, True
    with_pairs = fitted
    fitted, ranked = in_full(look, comparison, fitted, ranked)
    # beside the same hypotheses no pair would promise more than it did
    if not first or (with_pairs is before and fitted is not before):
        fitted, ranked, settled = both_at_once(look, comparison, fitted, ranked, rest)
    return fitted, ranked, settled


def at_other_places(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked], causes: Sequence[Cause]
) -> tuple[list[Hypothesis], list[Ranked]]:
    """Fit elements of the leading set at other places, begun from what was fitted where they are, until it stays."""
    for _ in range(MOVES):
        best = ranked[0].best
        if len(best.causes) < 2 and all(len(p) < 2 for p in best.params):
            break
        known = {r.names for r in ranked if r.log_evidence > ranked[0].log_evidence - NEAR}
        starts = [h for h in elsewhere(comparison, best, causes) if h.names not in known]
        more = [h for h in fit_together(comparison, starts) if moderate(h, comparison)] if starts else []
        if not more:
            break
        fitted, ranked = leader_in_full(look, comparison, fitted + more, weigh(look, fitted + more, comparison))
        if ranked[0].names == best.names:
            break
    return fitted, ranked


def both_at_once(
    look: Look, comparison: Comparison, fitted: list[Hypothesis], ranked: list[Ranked], rest: Leavings
) -> tuple[list[Hypothesis], list[Ranked], bool]:
    """Fit the pairs of causes that promise most at once, where the leading cause leaves more than noise.

    Either cause of the leading pair is fitted alone, too. The search is settled where what leads then leaves no more
    than noise and the pair takes away what it promised in linear order, so that other pairs keep what they promise.
    """
    best = ranked[0].best
    if len(best.causes) != 1 or best.hum is not None or comparison.late() or rest(best).p_value > THRESHOLDS.doubtful:
        return fitted, ranked, False
    state = look.state if comparison is look.comparison else score_state_of(comparison, look.null)
    pairs = best_pairs(state, look.screening.trials)
    if rest(best).p_value > THRESHOLDS.left:  # no more than noise, unless a pair promises to be likelier
        pairs = [p for p in pairs if p.worth > 2 * ranked[0].log_evidence + look.null.chi2]
    if not pairs or comparison.late():
        return fitted, ranked, False
    found = comparison.fit([p.start(look.null) for p in pairs], PATIENT)
    fitted = fitted + [h for h in found if moderate(h, comparison)]
    fitted, ranked = leader_in_full(look, comparison, fitted, weigh(look, fitted, comparison))
    pair = ranked[0].best
    if len(pair.causes) > 1 and not comparison.late():  # one that no search of single causes came by may explain all
        fitted = fitted + alone(comparison, pair)
        fitted, ranked = leader_in_full(look, comparison, fitted, weigh(look, fitted, comparison))
    promised = {frozenset((t.cause.slug, t.place.where) for t in p.trials): p.gain for p in pairs}.get(pair.names)
    if promised is None or rest(ranked[0].best).p_value < SEVERAL:
        return fitted, ranked, False
    return fitted, ranked, abs(look.null.chi2 - pair.chi2 - promised) < NEARLY * promised


def beside_named(
    look: Look, fitted: list[Hypothesis], rest: Rest, causes: Sequence[Cause]
) -> tuple[list[Hypothesis], Rest | None]:
    """Named causes with further ones beside them, the likeliest set first; nothing where these do not explain it best.

    Parameters
    ----------
    look
        The simulation alone.
    fitted
        The named causes, fitted.
    rest
        What the first of them leaves.
    causes
        What to look for.
    """
    named, leaves = fitted[0], Leavings(look.comparison, look.null, causes)
    leaves.know(named, rest)
    fitted, ranked, settled = both_at_once(look, look.comparison, fitted, weigh(look, fitted), leaves)
    if not settled:
        fitted, ranked = together(look, look.comparison, fitted, ranked, leaves)
    left = leaves(ranked[0].best)
    best = ranked[0].best
    if left.p_value < SEVERAL or not named.names < best.names:
        return [], None  # others that explain as much without what was named cast doubt on it
    return [best, *(h for h in fitted if h is not best)], left


def _explained(look: Look, best: Ranked) -> float:
    """Share of the simulation's residual beyond noise that a set of causes explains."""
    noise = float(look.comparison.problem.samples)
    return (look.null.chi2 - best.best.chi2) / max(look.null.chi2 - noise, 1.0)
