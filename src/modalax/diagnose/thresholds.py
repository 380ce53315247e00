"""The thresholds of the decision: value, unit, meaning, and the script that measures how well each is set."""

from dataclasses import dataclass, field, fields
from typing import Any


def _threshold(value: float, unit: str, meaning: str, measured_by: str) -> Any:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "measured_by": measured_by})


ALARMS = "experiments/diagnosis/alarms.py"
SCORE = "experiments/diagnosis/score.py"
PREDICTED = "experiments/diagnosis/predicted.py"
HUM = "experiments/diagnosis/hum.py"
INACCURATE = "experiments/diagnosis/score_inaccurate.py"
JOINTS = "experiments/diagnosis/joints.py"
SECONDS = "experiments/benchmarks/diagnosis.py"


@dataclass(frozen=True)
class Thresholds:
    """Every number that the verdict depends on; :meth:`table` tells what each means.

    None of them is fitted: they were chosen beforehand, and the script of each measures, on draws of hidden cases, how
    often the decision that it stands for is right.
    """

    alarm: float = _threshold(
        0.01, "chance",
        "Something is wrong where what the simulation leaves has less than this chance under noise alone.", ALARMS,
    )  # fmt: skip
    share_of_scores: float = _threshold(
        0.55, "share of alarm", "The scores of all causes at all places together may raise this share of the alarms.",
        ALARMS,
    )  # fmt: skip
    share_of_patterns: float = _threshold(
        0.1, "share of alarm", "Modes that the simulation lacks may raise this share of the alarms.", ALARMS
    )
    share_of_hum: float = _threshold(
        0.1, "share of alarm", "Hum at the mains frequency may raise this share of the alarms.", HUM
    )
    share_of_lengths: float = _threshold(
        0.05, "share of alarm", "Records that are cut off, at the best of all lengths, may raise this share of alarms.",
        ALARMS,
    )  # fmt: skip
    share_of_omnibus: float = _threshold(
        0.2, "share of alarm", "The tests that know no cause may raise this share of the alarms.", ALARMS
    )
    explains: float = _threshold(
        9.0, "chi-square",
        "A set of causes explains something only if it takes more than this off the chi-square of the simulation.",
        SCORE,
    )  # fmt: skip
    left: float = _threshold(
        0.002, "chance",
        "What a single cause leaves holds something more where it has less than this chance under noise alone.", SCORE,
    )  # fmt: skip
    left_by_several: float = _threshold(
        0.01, "chance",
        "What several causes leave holds something more below this chance, as several can imitate a third thing.",
        SCORE,
    )  # fmt: skip
    doubtful: float = _threshold(
        0.1, "chance",
        "Where a single cause leaves what has less than this chance under noise alone, pairs are weighed against it.",
        SCORE,
    )  # fmt: skip
    further_cause: float = _threshold(
        22.0, "chi-square",
        "A further cause is tried where it promises more than this and the logarithm of the number of samples.", SCORE,
    )  # fmt: skip
    several_causes: float = _threshold(
        5.0, "nats", "Each cause after the first costs this much before the data: two things are rarely wrong at once.",
        SCORE,
    )  # fmt: skip
    nameless: float = _threshold(
        0.5, "probability",
        "No name is given where things without a name in the answer are together likelier than this.", SCORE,
    )  # fmt: skip
    certain: float = _threshold(
        0.95, "probability", "Names are given where sets of just these names have at least this probability.", SCORE
    )
    placed: float = _threshold(
        0.9, "probability",
        "Names are given where each has one place that is at least so likely among all; of 24 given with less, joints "
        "for the most part, 8 were right.", SCORE,
    )  # fmt: skip
    missed: float = _threshold(
        4.0, "standard deviations",
        "Causes fail on the held-out block where their parameters, once fitted to it too, explain the rest worse by "
        "more than this than noise makes them; or, in the modal domain, where it is likelier without them by more.",
        SCORE,
    )  # fmt: skip
    farther: float = _threshold(
        1.05, "ratio of chi-squares",
        "They fail only if that chi-square is also more than this many times the one of a fit to all data.", SCORE,
    )  # fmt: skip
    contradicted: float = _threshold(
        2.0, "standard deviations",
        "They fail from here on where the block is less likely with them than by the simulation alone. Of 411 names "
        "given line by line to hidden effects five had such a block, by more than a nat; all were wrong.", PREDICTED,
    )  # fmt: skip
    rival: float = _threshold(
        0.005, "probability", "A rival of an ambiguous set is reported from this probability on.", SCORE
    )
    elsewhere: float = _threshold(
        0.05, "probability", "Another place of what is named is reported from this probability on.", SCORE
    )
    likeness: float = _threshold(
        0.05,
        "probability",
        "What the data looks like beside the catalogue is reported from this probability on.",
        SCORE,
    )
    power: float = _threshold(
        1.28, "standard deviations",
        "The smallest detectable strength lies this far above the threshold of a single score, so that nine effects in "
        "ten of that strength are seen.", SCORE,
    )  # fmt: skip
    # The modal domain: what stands out beyond a general inaccuracy.
    beyond: float = _threshold(
        3.0, "ratio", "A joint or mass stands out where it is off by more than this many times the general inaccuracy.",
        INACCURATE,
    )  # fmt: skip
    calibration: float = _threshold(
        0.02, "relative error",
        "A gain stands out beyond this error, which is usual for calibrated and mounted sensors (ISO 16063-21).",
        INACCURATE,
    )  # fmt: skip
    angle: float = _threshold(
        0.01, "rad", "A delay stands out where it turns the phase at the end of the band by more than this.", INACCURATE
    )
    misfit: float = _threshold(
        2.0, "chi-square per feature", "Modes that are missed by more than this are not explained.", INACCURATE
    )
    lines_missed: float = _threshold(
        20.0, "ratio of chi-squares",
        "A fit explains the lines where it leaves at most this many times what the measured modes by themselves leave; "
        "beyond that lines only bend what modes tell, and nothing is clean or named.", INACCURATE,
    )  # fmt: skip
    lines_missed_by_several: float = _threshold(
        2.0, "ratio of chi-squares",
        "The same of several causes, which can stand for much on few modes: right ones leave about as much as the "
        "measured modes do.", INACCURATE,
    )  # fmt: skip
    modes_miss: float = _threshold(
        2.0, "chi-square per sample",
        "Measured FRFs of which the best sum of modes leaves more than this are said to be none: twice the noise.",
        INACCURATE,
    )  # fmt: skip
    hopeless: float = _threshold(
        0.8, "share of the largest inaccuracy searched for",
        "A simulation that is off by more than this is not one of this structure.", INACCURATE,
    )  # fmt: skip
    far_beyond_claim: float = _threshold(
        8.0, "ratio",
        "An inaccuracy of elements is no longer the one that its author claims where it is this many times larger: "
        "three standard deviations of a claim that is wrong by a factor of two.", INACCURATE,
    )  # fmt: skip
    kinds: float = _threshold(
        2.0, "causes",
        "More unlike causes than this are not named together, however well they explain the data: each is rare, and "
        "one thing that is not listed is as likely.", SCORE,
    )  # fmt: skip
    over_a_factor: float = _threshold(
        5.0, "nats",
        "As much mass under every sensor is named only if it is so much likelier than one factor on all of the "
        "simulation's mass or stiffness, which is what such a factor must gain to be fitted at all.", INACCURATE,
    )  # fmt: skip
    stands_out: float = _threshold(
        3.5, "standard deviations",
        "One place among hundreds shows an effect from this score on; a cause stands out that is so far from none.",
        INACCURATE,
    )  # fmt: skip
    explained_by_joint: float = _threshold(
        0.9, "share of the sum of squares",
        "A joint fitted together with the modes explains force levels where it takes away more than this of what "
        "linear modes leave, at the levels that are fitted and at the one that is predicted.",
        "experiments/measured/beam.py",
    )  # fmt: skip
    # The choice between line by line and the modal domain.
    off: float = _threshold(
        3e-4, "relative error", "Stiffness off by more than this is off in general, not by one thing.", INACCURATE
    )  # fmt: skip
    surely_off: float = _threshold(
        2e-3, "relative error",
        "Line by line, which takes all but the causes as exact, adds nothing to a named cause where stiffness or mass "
        "is certainly off by more than this; mass alone is off in general from here on.", INACCURATE,
    )  # fmt: skip
    left_by_modes: float = _threshold(
        0.01, "chance",
        "The modal domain leaves nothing to explain where what it leaves has more than this chance under noise alone.",
        INACCURATE,
    )  # fmt: skip
    damping_off: float = _threshold(
        0.01, "relative error",
        "Line by line, which takes the dampings of all modes as exact, adds nothing to a named cause that leaves "
        "nothing where these are certainly off by more than this.", INACCURATE,
    )  # fmt: skip
    damping_far: float = _threshold(
        0.1, "relative error",
        "A simulation of which nothing is wrong but the dampings of its modes, certainly by more than this, is not "
        "searched line by line, which takes these as exact.", INACCURATE,
    )  # fmt: skip
    as_noise: float = _threshold(
        1.2, "chi-square per sample", "A fit predicts the held-out block where it leaves less than this on it.",
        INACCURATE,
    )  # fmt: skip
    unexplained: float = _threshold(
        1.5, "chi-square per sample",
        "A search line by line explains nothing where its answer leaves more than this on the held-out block.",
        INACCURATE,
    )  # fmt: skip
    inexact: float = _threshold(
        0.1, "relative error", "Law and place of a joint are certain where its force is explained better than this.",
        INACCURATE,
    )  # fmt: skip
    inexact_law: float = _threshold(
        0.03, "relative error",
        "Where a force at one place is all that is missing, a law is told that explains it but for less than this.",
        JOINTS,
    )  # fmt: skip
    inexact_alone: float = _threshold(
        0.01, "relative error",
        "Such a law is named where it explains the force but for less than this, and no other comes near.", JOINTS,
    )  # fmt: skip
    law_ahead: float = _threshold(
        10.0, "ratio of errors", "No other law or place comes near where all leave more than this many times as much.",
        JOINTS,
    )  # fmt: skip
    elements_lead: float = _threshold(
        20.0, "ratio of chi-squares",
        "A simulation that is claimed to be off in its modes is off in its elements where these explain the measured "
        "modes, and frequencies and damping ratios alone leave more than this many times as much: no cause that the "
        "modal domain does not know does that and is explained by elements.", INACCURATE,
    )  # fmt: skip
    decisive: float = _threshold(
        0.999, "probability",
        "A large problem is not searched line by line where the modal domain names a cause with this probability.",
        INACCURATE,
    )  # fmt: skip
    places_spared: float = _threshold(
        120.0, "places", "A problem counts as large in that sense where causes have more places than this.", SECONDS
    )
    one_force: float = _threshold(
        4.0, "standard deviations",
        "A force at one place explains the data where the chi-square that it leaves exceeds that of noise by less than "
        "this.", SECONDS,
    )  # fmt: skip
    other_places: float = _threshold(
        40.0, "chi-square",
        "A force is looked for where it takes away at most this much less than at the best, noise apart.", SECONDS,
    )  # fmt: skip
    places_by_lines: float = _threshold(
        300.0, "places", "A search line by line takes minutes where causes have more places than this.", SECONDS
    )
    places_in_time: float = _threshold(
        5000.0, "places",
        "Up to so many places a search line by line, which takes some minutes then, still follows a modal domain that "
        "answers unknown.", SECONDS,
    )  # fmt: skip
    work_in_time: float = _threshold(
        1.5e7, "places times samples",
        "Up to so much work a search line by line, which takes half a minute then, still follows a modal domain that "
        "finds nothing wrong and nothing off.", SECONDS,
    )  # fmt: skip
    work_by_lines: float = _threshold(
        5e6, "places times samples", "The same where places times real samples are more than this.", SECONDS
    )

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the alarms by kind of test, summing to 1."""
        return {
            "scores": self.share_of_scores, "patterns": self.share_of_patterns, "hum": self.share_of_hum,
            "lengths": self.share_of_lengths, "omnibus": self.share_of_omnibus,
        }  # fmt: skip

    def table(self) -> list[tuple[str, float, str, str, str]]:
        """Rows of name, value, unit, meaning and the script that measures it."""
        rows = ((f.name, getattr(self, f.name), f.metadata) for f in fields(self))
        return [(name, value, m["unit"], m["meaning"], m["measured_by"]) for name, value, m in rows]


THRESHOLDS = Thresholds()
