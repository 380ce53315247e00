"""The verdict of the modal domain: which causes stand out beyond the general inaccuracy, and how sure they are."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from modalax._numerics.text import percent
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.sets import certainty, many_kinds, unplaced
from modalax.diagnose.summary import cause_at
from modalax.diagnose.thresholds import THRESHOLDS

MANY = 5  # places of one cause beyond which a sentence only counts them
Names = tuple[tuple[str, tuple[str | int, ...]], ...]


@dataclass(frozen=True)
class BeyondUsual:
    """Causes of an explanation that stand out beyond the general inaccuracy, with their probability.

    Attributes
    ----------
    names
        Slug and place of each; empty where nothing stands out.
    probability
        Sum over all explanations in which just these stand out.
    """

    names: Names
    probability: float


@dataclass(frozen=True)
class OddChannel:
    """A channel that differs from all others as no cause explains.

    Attributes
    ----------
    name, force
        The channel, and whether it is an input.
    nats
        Log probability that this has over the likeliest explanation by causes.
    along, share
        A DoF at which a share of the force also acts, or along which the sensor also measures; none where ``along`` is
        empty, as what is odd about the channel is not known.
    turned
        Whether that is another direction of the channel's own point, so that it is turned towards it.
    """

    name: str
    force: bool
    nats: float
    along: str = ""
    share: float = 0.0
    turned: bool = False

    @property
    def said(self) -> str:
        """What is odd, and what to check."""
        where, it = (f"to the force at {self.name}", "the force") if self.force else (f"at {self.name}", "the sensor")
        likelier = f"({self.nats:.3g} nats likelier than any cause)"
        if not self.along:
            check = "its direction, contact elsewhere and load cell" if self.force else "its cable, mounting and range"
            return (
                f"the FRFs {where} alone differ from all others in a way that no cause explains {likelier}: check "
                f"{it}, {check}"
            )
        does = f"{self.share:.3g} of it also acted at" if self.force else f"it also measured {self.share:.3g} of"
        turned = f", as one turned by {math.degrees(math.atan(abs(self.share))):.3g} degrees" if self.turned else ""
        return (
            f"the FRFs {where} are those of the simulation if {does} {self.along}{turned} {likelier}: check how {it} "
            "is aligned"
        )


@dataclass(frozen=True)
class ModalCase:
    """All that a rule of the modal domain may look at.

    Attributes
    ----------
    sets
        What stands out, the set of the likeliest explanation first, the others by falling probability.
    fitted
        Slug and place of every cause of the likeliest explanation, whether it stands out or not.
    inaccuracy
        General relative inaccuracy by ``stiffness``, ``mass`` and ``damping``.
    share_of_largest
        Inaccuracy of stiffness or mass relative to the largest that is searched for; the greater of the two.
    misfit
        Chi-square per feature of the measured modes.
    nats
        Log probability that the likeliest explanation has over the general inaccuracy alone; None where the latter
        could not be fitted.
    odd
        A channel that differs from all others as no cause explains; None where there is none.
    needed
        Causes no larger than the general inaccuracy without which the measured modes are not explained.
    claims
        What the author claims, for those of stiffness and mass that have a claim.
    at_one_output
        Outputs that alone show a mode which the simulation is said to lack.
    over_a_factor
        By how many nats as much mass under every sensor is likelier than one factor on all of the simulation's mass or
        stiffness; None where no such mass is told.
    one_sided
        Places of couplings that are said to be skew and surely act on one end more than on the other.
    """

    sets: Sequence[BeyondUsual]
    fitted: Sequence[tuple[str, tuple[str | int, ...]]]
    inaccuracy: Mapping[str, float]
    share_of_largest: float
    misfit: float
    nats: float | None
    odd: OddChannel | None = None
    needed: Sequence[tuple[str, tuple[str | int, ...]]] = ()
    claims: Mapping[str, float] = field(default_factory=dict)
    at_one_output: Sequence[str] = ()
    over_a_factor: float | None = None
    one_sided: Sequence[tuple[str | int, ...]] = ()

    @property
    def support(self) -> tuple[str, ...]:
        """What speaks for the leading set."""
        names = self.sets[0].names
        stand, it = ("stand", "them") if len(names) > 1 else ("stands", "it")
        first = f"{_listed(names)} {stand} out beyond the general inaccuracy (probability {certainty(self.sets):.3f})"
        return (first,) if self.nats is None else (first, f"without {it} the data are {self.nats:.3g} nats less likely")


def _listed(names: Names) -> str:
    """Causes with their places; only how many, of a cause at many or of one that is there several times."""
    slugs = [slug for slug, _ in names]
    many = [slug for slug in dict.fromkeys(slugs) if slugs.count(slug) > MANY]
    each = [
        cause_at(*one) + (f" ({names.count(one)} times)" if names.count(one) > 1 else "")
        for one in dict.fromkeys(names) if one[0] not in many
    ]  # fmt: skip
    return " and ".join([*each, *(f"{slug} at {slugs.count(slug)} places" for slug in many)])


Rule = Callable[[ModalCase], tuple[str, ...]]


def modes_are_not_explained(case: ModalCase) -> tuple[str, ...]:
    """Even an inaccuracy as large as is searched for does not explain the measured modes."""
    if case.share_of_largest <= THRESHOLDS.hopeless and case.misfit <= THRESHOLDS.misfit:
        return ()
    off = ", ".join(f"{name} {percent(size)}" for name, size in case.inaccuracy.items())
    return (f"even with elements off by {off} the measured modes are not explained",)


def claim_is_far_exceeded(case: ModalCase) -> tuple[str, ...]:
    """Elements would have to be off by so much more than is claimed that one thing without a name is likelier."""
    far = {n: v for n, v in case.claims.items() if v > 0 and case.inaccuracy[n] > THRESHOLDS.far_beyond_claim * v}
    if not far:
        return ()
    off = " and ".join(f"{percent(case.inaccuracy[n])} in {n} where {percent(v)} is claimed" for n, v in far.items())
    return (
        f"elements would have to be off by {off}: either the claim is far too small, or something is wrong that no "
        "cause explains",
    )


def the_usual_is_needed(case: ModalCase) -> tuple[str, ...]:
    """Nothing stands out, but what is no larger than usual explains what errors of single elements do not."""
    if not case.needed or case.sets[0].names:
        return ()
    what = " and ".join(cause_at(slug, where) for slug, where in case.needed)
    are = "are" if len(case.needed) > 1 else "is"
    return (
        f"errors of single elements do not explain the measured modes, and {what}, with which they would, {are} no "
        "larger than these errors: several elements may be off by the same factor",
    )


def nothing_beyond_the_usual(case: ModalCase) -> tuple[str, ...]:
    """No cause, or none that is larger than is usual."""
    if case.sets[0].names:
        return ()
    if case.fitted:
        what = " and ".join(cause_at(slug, where) for slug, where in case.fitted)
        are, its = ("are", "their errors") if len(case.fitted) > 1 else ("is", "its error")
        return (f"{what} {are} no larger than is usual, or may be none at all within {its}",)
    return (f"nothing stands out beyond the general inaccuracy (probability {case.sets[0].probability:.3f})",)


def odd_told(case: ModalCase) -> OddChannel | None:
    """The odd channel that is told: where nothing stands out only one that is as certain as a cause must be."""
    if case.odd is None:
        return None
    sure = case.odd.nats > math.log(THRESHOLDS.certain / (1 - THRESHOLDS.certain))
    return case.odd if case.sets[0].names or sure else None


def one_channel_differs(case: ModalCase) -> tuple[str, ...]:
    """What stands out, or nothing, is less likely than that one channel is wrong in a way without a name."""
    odd = odd_told(case)
    return () if odd is None else (odd.said,)


def one_output_has_a_mode(case: ModalCase) -> tuple[str, ...]:
    """A mode that the simulation lacks shows at one output alone, as none of a structure does."""
    return tuple(
        f"a mode that the simulation lacks shows at {name} alone: it is that of its sensor, cable or mounting, or of a "
        "part at that point that the other outputs do not feel"
        for name in case.at_one_output
    )


def coupling_is_one_sided(case: ModalCase) -> tuple[str, ...]:
    """A coupling that acts on one end more than on the other is not skew."""
    return tuple(
        f"{cause_at('gyroscopic', where)} would be a skew coupling, but this one acts on one end more than on the "
        "other, which no cause explains"
        for where in case.one_sided
    )


def causes_are_many(case: ModalCase) -> tuple[str, ...]:
    """Unlike causes are too many to come together by chance."""
    many = many_kinds(case.sets[0])
    return () if many is None else (*case.support, many)


def all_of_a_matrix_may_be_off(case: ModalCase) -> tuple[str, ...]:
    """As much mass under every sensor is not told from a factor on all of the mass or the stiffness."""
    if case.over_a_factor is None or case.over_a_factor >= THRESHOLDS.over_a_factor:
        return ()
    return (
        *case.support,
        "as much mass under every sensor cannot be told from one factor on all of the simulation's mass or stiffness, "
        "or on all frequencies: weigh a sensor, or measure again with one more at each point",
    )


def other_causes_compete(case: ModalCase) -> tuple[str, ...]:
    """The causes are not sure."""
    sure = certainty(case.sets) >= THRESHOLDS.certain
    return () if sure else (*case.support, "other causes cannot be excluded")


def other_places_compete(case: ModalCase) -> tuple[str, ...]:
    """No place is sure among all."""
    asked = f"its place is not certain: none has a probability of {THRESHOLDS.placed:g}"
    return (*case.support, asked) if unplaced(case.sets) else ()


RULES: tuple[tuple[str, Rule], ...] = (
    ("unknown", one_channel_differs),
    ("unknown", modes_are_not_explained),
    ("unknown", claim_is_far_exceeded),
    ("unknown", the_usual_is_needed),
    ("clean", nothing_beyond_the_usual),
    ("unknown", one_output_has_a_mode),
    ("unknown", coupling_is_one_sided),
    ("ambiguous", other_causes_compete),
    ("ambiguous", other_places_compete),
    ("ambiguous", causes_are_many),
    ("ambiguous", all_of_a_matrix_may_be_off),
    ("named", lambda case: case.support),
)


def modal_verdict(case: ModalCase) -> tuple[str, tuple[str | int, ...]]:
    """The verdict of the first of ``RULES`` that applies, and its reasons."""
    return next((word, reasons) for word, rule in RULES if (reasons := rule(case)))


def held_out_verdict(word: str, reasons: Sequence[str], gain: Gain) -> tuple[str, tuple[str, ...]]:
    """The verdict once the held-out block is known: a cause without which it is surely predicted better is not named.

    That it is predicted as well says nothing: an inaccuracy of many elements may imitate a cause, only less likely.
    Nothing is said to be wrong that predicts it worse than the simulation as it is.
    """
    if word in ("named", "ambiguous") and gain.chi2_after > THRESHOLDS.farther * max(
        gain.chi2_before, THRESHOLDS.unexplained
    ):
        return "unknown", (
            *reasons,
            f"fitted without {gain.held_out}, this leaves a chi-square of {gain.chi2_after:.3g} per sample there, and "
            f"the simulation as it is {gain.chi2_before:.3g}: it is no explanation",
        )  # fmt: skip
    better = gain.chi2_after > THRESHOLDS.farther * gain.chi2_plain and gain.preferred > THRESHOLDS.missed
    if word != "named" or not better:
        return word, tuple(reasons)
    return "unknown", (
        *reasons,
        f"fitted without {gain.held_out}, this leaves a chi-square of {gain.chi2_after:.3g} per sample there, and what "
        f"is found without it {gain.chi2_plain:.3g}: it imitates something else",
    )  # fmt: skip


def lines_verdict(
    word: str, reasons: Sequence[str], left: float, by_modes: float, several: bool = False, joint: bool = False
) -> tuple[str, tuple[str, ...]]:
    """The verdict once all lines are known: nothing is told whose lines are not explained with it.

    But a joint, which explains what differs from level to level: it is no more than the leading answer then.

    Parameters
    ----------
    left, by_modes
        Chi-square per sample that the corrected simulation with its causes leaves, and that the measurement's own
        modes leave.
    several
        Whether several causes stand out, which together can stand for much that is none of them.
    joint
        Whether a joint is told by the force levels.
    """
    if word in ("clean", "named") and min(left, by_modes) > THRESHOLDS.modes_miss:  # not where a joint explains it
        reasons = (
            *reasons,
            f"the measured FRFs themselves are no sum of modes: the best one leaves a chi-square of {by_modes:.3g} per "
            "sample. Leakage, a force that drops at resonances, a non-linear joint or noise that is larger than stated "
            "would do that, and what is small beside it is not seen here",
        )  # fmt: skip
    most = THRESHOLDS.lines_missed_by_several if several and word == "named" else THRESHOLDS.lines_missed
    if word == "unknown" or left <= most * by_modes or (joint and word == "ambiguous"):
        return word, tuple(reasons)
    return "ambiguous" if joint else "unknown", (
        *reasons,
        f"but the corrected simulation leaves a chi-square of {left:.3g} per sample, the measurement's own modes "
        f"{by_modes:.3g}: the FRFs differ from it in a way that no error of elements explains",
    )  # fmt: skip


def one_missed(
    squares: np.ndarray, lines: int, by_modes: float, outputs: Sequence[str], inputs: Sequence[str]
) -> OddChannel | None:
    r"""The channel that alone is not explained on its lines; None where others are not either, or none is.

    With noise of its own size, unknown, its n complex samples of chi-square :math:`c` are likelier by
    :math:`n(c - 1 - \ln c)`.

    Parameters
    ----------
    squares
        Chi-square per sample that is left, shape ``(o, i)``.
    lines
        Samples behind each.
    by_modes
        Chi-square per sample that the measurement's own modes leave.
    outputs, inputs
        Names of the channels.
    """
    most = THRESHOLDS.lines_missed_by_several * max(by_modes, 1.0)
    for names, force, axis in ((outputs, False, 1), (inputs, True, 0)):
        each = squares.mean(axis=axis)
        missed = np.flatnonzero(each > most)
        if len(missed) == 1 and len(names) > (1 if force else 2):
            c = float(each[missed[0]])
            return OddChannel(names[missed[0]], force, lines * squares.shape[axis] * (c - 1 - math.log(c)))
    return None


def usual_size(slug: str, whole: float, inaccuracy: Mapping[str, float], highest: float) -> float:
    r"""Size above which a cause stands out, in its own unit; minus infinity for causes that stand out at any size.

    Parameters
    ----------
    slug
        The cause.
    whole
        Stiffness [N/m], mass [kg] or damping [N s/m] that the simulation has at the place, for joints that lose energy
        and skew couplings the damping times the circular frequency in the middle of the band [N/m]; 1 for a relative
        change of a whole element.
    inaccuracy
        General relative inaccuracy by ``stiffness``, ``mass`` and ``damping``.
    highest
        Highest measured frequency [Hz], at which a delay :math:`\tau` turns the phase by :math:`2\pi f\tau`; the size
        of a sensor's filter is such a phase itself.
    """
    return {
        "joint_stiffness": THRESHOLDS.beyond * inaccuracy["stiffness"] * whole,
        "added_mass": THRESHOLDS.beyond * inaccuracy["mass"] * whole,
        "local_damper": THRESHOLDS.beyond * inaccuracy.get("damping", 0.0) * whole,
        "hysteretic_joint": THRESHOLDS.beyond * inaccuracy.get("damping", 0.0) * whole,
        "maxwell_joint": THRESHOLDS.beyond * inaccuracy.get("damping", 0.0) * whole,
        "gyroscopic": inaccuracy.get("damping", 0.0) * whole,  # errors of dampers are symmetric
        "modal_damping": THRESHOLDS.beyond * inaccuracy.get("damping", 0.0),
        "element_group": THRESHOLDS.beyond * inaccuracy["stiffness"] * whole,
        "element_group_mass": THRESHOLDS.beyond * inaccuracy["mass"] * whole,
        "channel_gain": THRESHOLDS.calibration,
        "force_gain": THRESHOLDS.calibration,
        "crosstalk": THRESHOLDS.calibration,
        "time_delay": THRESHOLDS.angle / (2 * math.pi * highest),
        "sensor_filter": THRESHOLDS.angle,
    }.get(slug, -math.inf)
