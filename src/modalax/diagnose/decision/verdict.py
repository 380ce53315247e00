"""The verdict: one ordered list of rules about what was found, what is left and how well it predicts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from modalax.diagnose.causes.base import ChannelCause, ElementCause
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.decision.sets import certainty, many_kinds, unplaced
from modalax.diagnose.thresholds import THRESHOLDS, Thresholds

NEAR_END = 0.99  # share of the largest value of a parameter from which on a fit counts as ended there
TOLD = 10.0  # chi-square put down to an inexact law from which on the reasons say so


@dataclass(frozen=True)
class Leftover:
    """The residual of the simulation, with and without the causes that were found.

    Attributes
    ----------
    alarm
        Chance under noise alone of what the simulation leaves, over all kinds of tests.
    explained
        Chi-square that the best single cause takes away.
    p_value
        Chance under noise alone of what the leading set leaves, less ``tolerated``.
    nameless
        Probability of things without a name in the answer beside the sets that have one.
    likeness
        What the likeliest of these is, in words.
    tolerated
        Chi-square that the inexactness of the laws may leave: of a joint, the harmonics of its motion left out.
    untried
        Kinds of causes that may explain the data as well and for which there was no time.
    inexact
        Relative error of the force of a joint by its law, where a force at its place is all that is missing and the law
        leaves more of it than noise; else 0.
    ahead
        How many times as much of that force the next law leaves, or the same law at another place.
    """

    alarm: float
    explained: float = 0.0
    p_value: float = 1.0
    nameless: float = 0.0
    likeness: str = ""
    tolerated: float = 0.0
    untried: tuple[str, ...] = ()
    inexact: float = 0.0
    ahead: float = 1.0

    @property
    def allowance(self) -> str:
        """What of the rest is put down to the law, as a clause; empty where that is less than noise scatters."""
        return "" if self.tolerated < TOLD else (
            f", once a chi-square of {self.tolerated:.2g} is put down to the higher harmonics that the predicted joint "
            f"lacks, {self.tolerated / max(self.tolerated + self.explained, 1e-300):.2g} of its effect"
        )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """All that a rule may look at."""

    ranked: Sequence[Ranked]
    leftover: Leftover
    held_out: Gain | None
    limits: Thresholds

    @property
    def best(self) -> Ranked:
        """The leading set of causes."""
        return self.ranked[0]

    @property
    def names(self) -> str:
        """The causes of the leading set, in words; how many of a kind."""
        slugs = [slug for slug, _ in sorted(self.best.names, key=str)]
        number = {slug: slugs.count(slug) for slug in slugs}
        return " and ".join(slug if count == 1 else f"{slug} at {count} places" for slug, count in number.items())

    @property
    def subject(self) -> str:
        """The causes with the verb that goes with them."""
        return f"{self.names} {'have' if len(self.best.names) > 1 else 'has'}"

    @property
    def certainty(self) -> float:
        """Probability of the names, wherever they are."""
        return certainty(self.ranked)


Rule = Callable[[Case], str | None]


def told_chance(p: float) -> str:
    """A probability in words: never one, for it is as certain as what was looked for only."""
    return f"{p:.2g}" if p < 0.995 else "over 0.99" if p < 0.9995 else "over 0.999"


def nothing_stands_out(case: Case) -> str | None:
    """The residual of the simulation is no more than noise."""
    chance, limit = case.leftover.alarm, case.limits.alarm
    return None if chance < limit else (
        f"the residual of the simulation is no more than noise: noise alone would leave as much with a chance of "
        f"{told_chance(chance)}, and an alarm needs less than {limit:g}"
    )  # fmt: skip


def nothing_explains(case: Case) -> str | None:
    """No cause explains enough of the residual."""
    enough = case.ranked and case.leftover.explained >= case.limits.explains
    return None if enough else "the residual is more than noise, and no cause that was looked for explains it"


def something_is_left(case: Case) -> str | None:
    """The residual with the causes is more than noise; the limit is stricter for several causes together."""
    if not case.ranked or case.leftover.inexact:
        return None
    several = len(case.best.names) > 1
    limit = max(case.limits.left, case.limits.left_by_several) if several else case.limits.left
    chance = case.leftover.p_value
    return None if chance >= limit else (
        f"with {case.names} the residual is still more than noise: noise alone would leave as much with a chance of "
        f"{chance:.2g}{case.leftover.allowance}, and at least {limit:g} is required"
    )  # fmt: skip


def nameless_is_likelier(case: Case) -> str | None:
    """Something that the answer has no name for is likelier."""
    p = case.leftover.nameless
    return None if p <= case.limits.nameless else (
        "something beside the catalogue is likelier than any of its causes: "
        f"{case.leftover.likeness or f'unlisted (probability {p:.2f})'}"
    )  # fmt: skip


def other_names_compete(case: Case) -> str | None:
    """The names are not sure."""
    p, asked = case.certainty, case.limits.certain
    return None if p >= asked else f"{case.subject} a probability of {p:.3g}, less than {asked:g}: other causes compete"


def others_are_untried(case: Case) -> str | None:
    """There was no time for causes that may explain the residual as well."""
    rest = case.leftover.untried
    return None if not rest else (
        f"time was up before {', '.join(rest)} had been tried, which may explain the data as well: give it more time"
    )  # fmt: skip


def law_is_inexact(case: Case) -> str | None:
    """The law comes near to the force that is measured at its place, but not within noise.

    It is named where it comes so near as no other law does, nor itself elsewhere, and predicts what it was not fitted
    to.
    """
    error, limits = case.leftover.inexact, case.limits
    alone = error < limits.inexact_alone and case.leftover.ahead > limits.law_ahead and not held_out_is_missed(case)
    return None if not error or alone else (
        f"a force at this place is all that is missing, and {case.names} explains it but for {100 * error:.2g} % of "
        f"its size, more than noise: the joint's own law differs by so much, and the intervals allow for that"
    )  # fmt: skip


def places_compete(case: Case) -> str | None:
    """No place is sure among all."""
    names, asked = unplaced(case.ranked, case.limits), case.limits.placed
    return None if not names else f"{' and '.join(names)} may sit elsewhere: no place has a probability of {asked:g}"


def elements_share_a_place(case: Case) -> str | None:
    """Several elements at one place may together be one joint of a law that is not listed."""
    h = case.best.best
    at = [p.where for c, p in zip(h.causes, h.places, strict=True) if isinstance(c, ElementCause)]
    return None if len(set(at)) == len(at) else f"{case.names} at one place may be one joint of another law"


def faults_share_a_sensor(case: Case) -> str | None:
    """Several faults of one sensor may together be one fault that is not listed."""
    h = case.best.best
    faults = [(c, p.where) for c, p in zip(h.causes, h.places, strict=True) if isinstance(c, ChannelCause) and p.where]
    at = [where[0] for c, where in faults if c.rows or len(where) > 1]  # a force's has one place, and no output to it
    return None if len(set(at)) == len(at) else f"{case.names} of one sensor may be one fault of another kind"


def causes_are_many(case: Case) -> str | None:
    """Causes are too many to come together by chance."""
    return many_kinds(case.best, case.limits)


def nothing_is_determined(case: Case) -> str | None:
    """A cause of whose parameters none is larger than its own deviation is at the end of what it can be."""
    h = case.best.best
    if not h.undetermined:
        return None
    limits = ", ".join(f"{h.causes[k].slug} cannot be told from {law}" for k, law in h.limits.items())
    return (
        f"the data determine no parameter of {' and '.join(h.causes[k].slug for k in h.undetermined)}: "
        + (limits or "it stands for a limit, such as a joint that never moves")
    )  # fmt: skip


def range_ends(case: Case) -> str | None:
    """A parameter stands at the end of what its cause can be: what acts there is likely of another kind."""
    h, at = case.best.best, []
    for cause, values in zip(h.causes, h.params, strict=False):
        at += [
            f"the {q.name.replace('_', ' ')} of {cause.slug} ends at {q.upper:g}, the largest that is looked for"
            for q, value in zip(cause.parameters, values, strict=True) if q.ends and value > NEAR_END * q.upper
        ]  # fmt: skip
    return f"{' and '.join(at)}: something of another kind may act there" if at else None


def held_out_is_missed(case: Case) -> str | None:
    """What imitates a third thing on what it is fitted to hardly predicts it elsewhere."""
    gain = case.held_out
    if gain is None or not fails(gain, case.limits):
        return None
    if case.leftover.inexact and gain.chi2_after < case.limits.unexplained:  # what a law leaves there too
        return None
    several = len(case.best.best.causes) > 1
    other = "fitted with it", gain.chi2_within
    if gain.log_likelihood_gain < 0:
        other = "the simulation alone", gain.chi2_before
    return (
        f"fitted without {gain.held_out}, {case.names} leave{'' if several else 's'} a chi-square of "
        f"{gain.chi2_after:.3f} per sample there, {other[0]} {other[1]:.3f}: "
        f"{'they imitate' if several else 'it imitates'} something else"
    )


def named(case: Case) -> str | None:
    """Nothing speaks against the names."""
    if case.leftover.inexact:
        return (
            f"{case.subject} a probability of {told_chance(case.certainty)} among all causes that were looked for, and "
            f"explains the force at this place but for {100 * case.leftover.inexact:.2g} % of its size; more than "
            f"noise is left, but the next law or place leaves {case.leftover.ahead:.2g} times as much"
        )
    return (
        f"{case.subject} a probability of {told_chance(case.certainty)} among all causes that were looked for, and "
        f"noise alone would leave as much as it does with a chance of {told_chance(case.leftover.p_value)}"
        f"{case.leftover.allowance}"
    )


def frfs_hardly_tell(case: Case) -> str | None:
    """A cause that differs by what FRFs do not show explains the data about as well at the same places."""
    own = case.best
    alike = (
        r for r in case.ranked[1:] if _places(r) == _places(own) and r.best.chi2 < own.best.chi2 + case.limits.explains
    )
    others = {c.slug: c.advice for r in alike for c in r.best.causes if c.unseen and c not in own.best.causes}
    return None if not others else (
        f"{' and '.join(others)} there explains the data about as well, as FRFs hardly show how it differs: "
        f"{'; '.join(filter(None, others.values()))} to tell them apart"
    )  # fmt: skip


def _places(r: Ranked) -> list[tuple[Any, ...]]:
    """Where the causes of a set sit."""
    return sorted((where for _, where in r.names), key=str)


RULES: tuple[tuple[str, Rule], ...] = (
    ("clean", nothing_stands_out),
    ("unknown", nothing_explains),
    ("unknown", something_is_left),
    ("unknown", nameless_is_likelier),
    ("ambiguous", other_names_compete),
    ("ambiguous", others_are_untried),
    ("ambiguous", law_is_inexact),
    ("ambiguous", places_compete),
    ("ambiguous", elements_share_a_place),
    ("ambiguous", faults_share_a_sensor),
    ("ambiguous", causes_are_many),
    ("ambiguous", nothing_is_determined),
    ("ambiguous", range_ends),
    ("unknown", held_out_is_missed),
    ("named", named),
    ("named", frfs_hardly_tell),
)


def verdict(
    ranked: Sequence[Ranked], leftover: Leftover, held_out: Gain | None = None, thresholds: Thresholds = THRESHOLDS
) -> tuple[str, tuple[str, ...]]:
    """Decide on the verdict about the sets of causes that were found, with reasons.

    The first of ``RULES`` that applies gives the verdict; those right after it that give the same one and apply too add
    their reasons.

    Parameters
    ----------
    ranked
        Sets of causes by falling probability; empty where none was found.
    leftover
        What the simulation leaves, with and without the leading set.
    held_out
        How the leading set predicts a block that it was not fitted to; None where that is not known yet.
    thresholds
        Limits of the rules.

    Returns
    -------
    tuple
        ``clean``, ``named``, ``ambiguous`` or ``unknown``, and the reasons, each a clause.
    """
    case, word, reasons = Case(ranked, leftover, held_out, thresholds), "", []
    for name, rule in RULES:
        if word and name != word:
            break
        reason = rule(case)
        if reason is not None:
            word, reasons = name, [*reasons, reason]
    return word, tuple(reasons)


def fails(gain: Gain, thresholds: Thresholds = THRESHOLDS) -> bool:
    """Whether causes fail to predict the block held out, beyond their parameters' errors.

    They do so where it is less likely with them than without, and where they miss it by far and by more than a little.
    """
    far = gain.missed > thresholds.missed and gain.chi2_after > thresholds.farther * gain.chi2_within
    return far or (gain.missed > thresholds.contradicted and gain.log_likelihood_gain < 0)
