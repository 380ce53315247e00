"""The verdict about differences between force levels or runs: a joint, a drift, or none."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from modalax._numerics.text import percent
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS

WEIGHT = ("clean", "named", "ambiguous", "unknown")  # verdicts; each outweighs those before it


@dataclass(frozen=True)
class LevelsCase:
    """All that a rule about levels may look at.

    Attributes
    ----------
    best
        Likeliest explanation of the differences.
    kind
        What differs: ``force levels`` or ``runs``.
    before, after
        Chi-square per real sample of the differences, without and with what explains them best.
    drift, drifting
        Relative shift of the frequencies up to the last run, and the probability of a drift.
    law, where
        Slug and place of the leading joint.
    law_probability, place_probability
        Of the law, wherever it sits, and of the place among all places of that law.
    inexact
        Relative error that the law's force must be allowed.
    aside
        Lines that were set aside, since the joint moves otherwise there.
    nameless
        Probability of laws that the answer has no name for.
    untried
        Whether no joint was tried although one may be the cause.
    behaviour
        The leading joint's equivalent stiffness against its amplitude, as a clause.
    holds
        Stiffness of the leading joint until it slips, and its standard deviation [N/m], where the simulation lacks it.
    """

    best: Literal["nothing", "drift", "joint"]
    kind: str = "force levels"
    before: float = 1.0
    after: float = 1.0
    drift: float = 0.0
    drifting: float = 0.0
    law: str = ""
    where: tuple[str, ...] = ()
    law_probability: float = 0.0
    place_probability: float = 0.0
    inexact: float = 0.0
    aside: int = 0
    nameless: float = 0.0
    untried: bool = False
    behaviour: str = ""
    holds: tuple[float, float] | None = None

    @property
    def missed(self) -> float:
        """Share of the differences, as a root mean square over that of all, which the explanation leaves."""
        return math.sqrt(max(self.after - 1.0, 0.0) / max(self.before, 1e-300))

    @property
    def observed(self) -> tuple[str, ...]:
        """What was seen, before any explanation."""
        differ = f"the {self.kind} differ beyond their noise (chi-square {self.before:.3g} per sample of these)"
        return (differ, f"across {' - '.join(self.where)}, {self.behaviour}") if self.best == "joint" else (differ,)

    @property
    def support(self) -> tuple[str, ...]:
        """What speaks for the likeliest explanation."""
        if self.best == "drift":
            return (
                *self.observed,
                f"a shift of the frequencies by {percent(self.drift)} up to the last of them, the same at every "
                f"amplitude, explains it (probability {self.drifting:.3f})",
            )
        told = (
            *self.observed,
            f"of all laws and places {cause_at(self.law, self.where)} describes it best (probability "
            f"{self.law_probability:.3f} of the law, {self.place_probability:.3f} of the place)",
        )
        if self.aside:
            lines = "1 line was" if self.aside == 1 else f"{self.aside} lines were"
            told = (*told, f"{lines} set aside: the joint moves otherwise there than this law has it")
        if self.holds is None:
            return told
        stiffness, std = self.holds
        return (
            *told,
            f"the simulation lacks this joint: until it slips it is a spring of {stiffness:.4g} ± {std:.2g} N/m there",
        )


Rule = Callable[[LevelsCase], tuple[str, ...] | None]


def levels_agree(case: LevelsCase) -> tuple[str, ...] | None:
    """Nothing but noise differs."""
    return () if case.best == "nothing" else None


def joints_were_not_tried(case: LevelsCase) -> tuple[str, ...] | None:
    """A drift leads only because nothing else was tried."""
    return (*case.observed, "time was up before a joint had been tried as its cause") if case.untried else None


def nothing_explains(case: LevelsCase) -> tuple[str, ...] | None:
    """Every law of a joint, or a drift, leaves too much of the differences."""
    if case.after <= THRESHOLDS.unexplained or (case.best == "joint" and case.missed < THRESHOLDS.inexact):
        return None
    what = "no law" if case.best == "joint" else "neither a joint nor a shift of the frequencies from run to run"
    return *case.observed, f"{what} explains it (chi-square {case.after:.3g} per sample is left)"


def law_has_no_name(case: LevelsCase) -> tuple[str, ...] | None:
    """A law without a name in the answer is likelier than those with one."""
    if case.best != "joint" or case.nameless <= THRESHOLDS.nameless:
        return None
    return *case.observed, "it follows none of the laws that have a name, but a power of the amplitude"


def drift_is_not_sure(case: LevelsCase) -> tuple[str, ...] | None:
    """A drift is the likeliest, but not sure."""
    return case.support if case.best == "drift" and case.drifting < THRESHOLDS.certain else None


def law_is_not_sure(case: LevelsCase) -> tuple[str, ...] | None:
    """Other laws are likely too."""
    sure = case.best != "joint" or case.law_probability >= THRESHOLDS.certain
    return None if sure else (*case.support, "other laws cannot be excluded")


def force_is_not_explained_well(case: LevelsCase) -> tuple[str, ...] | None:
    """The law explains the force across the place roughly only, so that another law or place may be right."""
    if case.best != "joint" or case.inexact < THRESHOLDS.inexact:
        return None
    return *case.support, f"it explains the force there to {percent(case.inexact)} only: law and place are not certain"


def more_than_noise_is_left(case: LevelsCase) -> tuple[str, ...] | None:
    """What is left of large differences is small beside them, but no noise."""
    if case.best != "joint" or case.after <= THRESHOLDS.unexplained:
        return None
    left = f"{percent(case.missed)} of the differences, more than noise (chi-square {case.after:.3g} per sample)"
    return *case.support, f"it leaves {left}: law and place are not certain"


def place_is_not_sure(case: LevelsCase) -> tuple[str, ...] | None:
    """Other places are likely too."""
    sure = case.best != "joint" or case.place_probability >= THRESHOLDS.placed
    return None if sure else (*case.support, "its place is not certain")


RULES: tuple[tuple[str, Rule], ...] = (
    ("clean", levels_agree),
    ("unknown", joints_were_not_tried),
    ("unknown", nothing_explains),
    ("unknown", law_has_no_name),
    ("ambiguous", drift_is_not_sure),
    ("ambiguous", law_is_not_sure),
    ("ambiguous", force_is_not_explained_well),
    ("ambiguous", more_than_noise_is_left),
    ("ambiguous", place_is_not_sure),
    ("named", lambda case: case.support),
)


def levels_verdict(case: LevelsCase) -> tuple[str, tuple[str, ...]]:
    """The verdict of the first of ``RULES`` that applies, and its reasons."""
    return next((word, reasons) for word, rule in RULES if (reasons := rule(case)) is not None)


def outweighing(*words: str) -> str:
    """The verdict of an answer with several parts: the one that outweighs the others."""
    return max(words, key=WEIGHT.index)
