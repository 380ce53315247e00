"""The verdict beyond a general inaccuracy: its rules one by one, and the size from which a cause stands out."""

from dataclasses import replace

import numpy as np
import pytest

from modalax.diagnose.decision.beyond import (
    BeyondUsual,
    ModalCase,
    OddChannel,
    held_out_verdict,
    lines_verdict,
    modal_verdict,
    one_missed,
    usual_size,
)
from modalax.diagnose.decision.gain import Gain

OFF = {"stiffness": 0.01, "mass": 0.005, "damping": 0.3}
SPRING, MASS, NOTHING = ("joint_stiffness", ("3", "4")), ("added_mass", ("2",)), ()
MODE = ("missing_mode", ())


def case(*sets, **changed):
    """Sets given as probability and names."""
    found = [BeyondUsual(tuple(names), p) for p, *names in sets]
    return replace(ModalCase(found, found[0].names, OFF, 0.1, 1.0, 12.3), **changed)


@pytest.mark.parametrize(
    ("given", "word", "because"),
    [
        (case((0.97, SPRING), (0.03,)), "named", "(probability 0.970)"),
        (case((0.94, SPRING), (0.06,)), "ambiguous", "other causes"),
        (case((0.94, SPRING), (0.06, MASS)), "ambiguous", "other causes"),
        (case((0.9, SPRING), (0.1, ("joint_stiffness", ("1", "2")))), "named", "(probability 1.000)"),
        (case((0.89, SPRING), (0.11, ("joint_stiffness", ("1", "2")))), "ambiguous", "its place"),
        (case((0.9, *NOTHING), (0.1, SPRING)), "clean", "(probability 0.900)"),
        (case((0.9, *NOTHING), fitted=[SPRING]), "clean", "joint_stiffness at 3 - 4 is no larger than is usual"),
        (case((0.97, SPRING), share_of_largest=0.81), "unknown", "stiffness 1 %, mass 0.5 %, damping 30 %"),
        (case((0.97, *NOTHING), misfit=2.1), "unknown", "not explained"),
        (case((0.97, *NOTHING), needed=[SPRING]), "unknown", "several elements may be off by the same factor"),
        (case((0.997, SPRING), needed=[SPRING]), "named", "stands out beyond the general inaccuracy"),
        (case((0.97, SPRING), share_of_largest=0.8, misfit=2.0), "named", "12.3 nats"),
        (case((0.97, SPRING), odd=OddChannel("7:+Z", False, 2.1)), "unknown", "the FRFs at 7:+Z alone"),
        (case((0.97, SPRING), odd=OddChannel("7:+Z", True, 2.1)), "unknown", "the FRFs to the force at 7:+Z alone"),
        (case((0.97, *NOTHING), odd=OddChannel("7:+Z", False, 2.9)), "clean", "nothing stands out"),
        (case((0.97, *NOTHING), odd=OddChannel("7:+Z", True, 3.0, "8:+X", 0.1)), "unknown", "if 0.1 of it also acted"),
        (case((0.97, *NOTHING), odd=OddChannel("7:+Z", False, 3.0, "7:+X", 0.1)), "unknown", "also measured 0.1 of"),
        (
            case((1.0, SPRING, MASS, ("channel_gain", ("1",)))),
            "ambiguous",
            "3 unlike causes at once (added_mass, channel",
        ),
        (case((1.0, SPRING, MASS, ("added_mass", ("4",)))), "named", "stand out beyond"),
        (case((0.97, MASS), over_a_factor=4.9), "ambiguous", "cannot be told from one factor on all of"),
        (case((0.97, MASS), over_a_factor=5.0), "named", "12.3 nats"),
        (case((0.97, ("missing_mode", ())), at_one_output=("7:+Z",)), "unknown", "shows at 7:+Z alone"),
        (case((0.97, ("gyroscopic", ("1", "2"))), one_sided=[("1", "2")]), "unknown", "gyroscopic at 1 - 2 would be"),
        (case((0.9, *NOTHING), at_one_output=("7:+Z",)), "clean", "nothing stands out"),
        (
            case((1.0, MODE, MODE, SPRING)),
            "named",
            "missing_mode (2 times) and joint_stiffness at 3 - 4 stand out",
        ),
        (case((1.0, SPRING, MASS)), "named", "joint_stiffness at 3 - 4 and added_mass at 2 stand out beyond"),
        (case((1.0, SPRING, MASS)), "named", "without them the data are"),
        (case((0.9, *NOTHING), fitted=[SPRING, MASS]), "clean", "added_mass at 2 are no larger than is usual"),
    ],
)
def test_each_rule_of_the_modal_domain(given, word, because):
    found, reasons = modal_verdict(given)
    assert found == word and any(because in reason for reason in reasons), reasons


def test_two_causes_of_one_kind_are_another_set_than_one():
    """An element and a spring at the same place count as two, so one of them alone is a rival."""
    assert modal_verdict(case((0.6, SPRING, SPRING), (0.4, SPRING)))[0] == "ambiguous"


def test_nothing_is_said_of_a_comparison_that_was_not_made():
    assert modal_verdict(case((1.0, SPRING), nats=None))[1] == (
        "joint_stiffness at 3 - 4 stands out beyond the general inaccuracy (probability 1.000)",
    )


@pytest.mark.parametrize(("claims", "far"), [({"stiffness": 0.001}, True), ({"stiffness": 0.002, "mass": 5e-4}, True),
                                             ({"stiffness": 0.002}, False), ({}, False)])  # fmt: skip
def test_elements_are_not_off_by_far_more_than_their_author_says(claims, far):
    """Of 1 % in stiffness and 0.5 % in mass where a tenth of it is claimed, with a cause or without."""
    for found in (case((1.0, SPRING)), case((1.0,))):
        word, reasons = modal_verdict(replace(found, claims=claims))
        assert (word == "unknown") == far and ("is claimed" in reasons[0]) == far


@pytest.mark.parametrize(
    ("slug", "whole", "expected"),
    [
        ("joint_stiffness", 2e5, 3 * 0.01 * 2e5), ("added_mass", 0.8, 3 * 0.005 * 0.8), ("channel_gain", 0.0, 0.02),
        ("force_gain", 0.0, 0.02), ("time_delay", 0.0, 0.01 / (2 * np.pi * 400)), ("channel_sign", 0.0, -np.inf),
        ("local_damper", 20.0, 3 * 0.3 * 20.0), ("channel_swap", 1.0, -np.inf), ("gyroscopic", 20.0, 0.3 * 20.0),
    ],
)  # fmt: skip
def test_a_cause_stands_out_beyond_what_is_usual(slug, whole, expected):
    assert usual_size(slug, whole, OFF, 400.0) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("word", "after", "plain", "preferred", "said"),
    [
        ("named", 1.1, 8.0, -9.0, "named"), ("named", 8.5, 8.0, 5.0, "unknown"), ("named", 8.3, 8.0, 9.0, "named"),
        ("named", 8.5, 8.0, 3.0, "named"), ("named", 1.1, np.nan, np.inf, "named"),
        ("ambiguous", 9.0, 8.0, 9.0, "ambiguous"),
    ],
)  # fmt: skip
def test_one_cause_too_must_predict_the_block_held_out(word, after, plain, preferred, said):
    gain = Gain("run 3 at 9 N, the highest level", 40.0, after, 500.0, 20.0, chi2_plain=plain, preferred=preferred)
    found, reasons = held_out_verdict(word, ["as before"], gain)
    assert found == said and reasons[0] == "as before"
    assert ("imitates something else" in reasons[-1]) == (said != word)


@pytest.mark.parametrize(
    ("word", "left", "by_modes", "said"),
    [
        ("clean", 19.0, 1.0, "clean"), ("clean", 21.0, 1.0, "unknown"), ("clean", 173.0, 10.0, "clean"),
        ("named", 19.0, 1.0, "named"), ("named", 21.0, 1.0, "unknown"), ("unknown", 21.0, 1.0, "unknown"),
        ("ambiguous", 19.0, 1.0, "ambiguous"), ("ambiguous", 21.0, 1.0, "unknown"),
    ],
)  # fmt: skip
def test_nothing_is_told_whose_lines_are_not_explained(word, left, by_modes, said):
    found, reasons = lines_verdict(word, ["as before"], left, by_modes)
    assert found == said and reasons[0] == "as before"
    assert ("own modes" in reasons[-1]) == (left > 20 * by_modes and word != "unknown")


@pytest.mark.parametrize(
    ("squares", "name", "samples"),
    [
        ([[1.0, 1.1], [30.0, 34.0], [1.2, 0.9]], "b", 200),
        ([[1.0, 30.0], [1.2, 34.0], [0.9, 32.0]], "q", 300),
        ([[30.0, 34.0], [31.0, 33.0], [1.2, 0.9]], None, 0),
        ([[1.0, 1.1], [1.5, 1.2], [1.2, 0.9]], None, 0),
    ],
    ids=["output", "input", "two of them", "none"],
)
def test_a_channel_that_alone_is_missed_is_told(squares, name, samples):
    """By how much is a likelihood ratio, here the mean over draws of noise that is 32 times as strong as stated."""
    odd = one_missed(np.array(squares), 100, 1.0, ("a", "b", "c"), ("p", "q"))
    if name is None:
        assert odd is None
        return
    assert (odd.name, odd.force, odd.along) == (name, name in "pq", "")
    z = np.random.default_rng(3).standard_normal((400, samples, 2)) * np.sqrt(32 / 2)  # of complex samples
    likelier = (np.abs(z) ** 2).sum(axis=(1, 2)) * (1 - 1 / 32) - samples * np.log(32)
    assert odd.nats == pytest.approx(likelier.mean(), rel=0.01)
    assert f"{name} alone" in odd.said


@pytest.mark.parametrize(("word", "left", "said"), [
    ("named", 19.0, "named"), ("named", 21.0, "ambiguous"), ("ambiguous", 21.0, "ambiguous"),
    ("unknown", 21.0, "unknown"),
])  # fmt: skip
def test_a_joint_that_the_levels_tell_leads_though_lines_are_not_explained(word, left, said):
    found, reasons = lines_verdict(word, ["as before"], left, 1.0, joint=True)
    assert found == said and ("own modes" in reasons[-1]) == (said != word)


@pytest.mark.parametrize(("word", "left", "said"), [
    ("named", 1.9, "named"), ("named", 2.1, "unknown"), ("clean", 2.1, "clean"),
])  # fmt: skip
def test_several_causes_must_explain_the_lines_better_than_one(word, left, said):
    """On few modes they stand for much: a gain that wanders was told as two of crosstalk and a soft joint."""
    assert lines_verdict(word, ["as before"], left, 1.0, several=True)[0] == said
    assert lines_verdict(word, ["as before"], left, 1.0)[0] == word


@pytest.mark.parametrize(("word", "left", "by_modes", "told"), [
    ("clean", 12.0, 11.5, True), ("named", 2.3, 2.1, True), ("clean", 1.9, 1.9, False), ("unknown", 12.0, 11.5, False),
    ("named", 1.02, 11.5, False),
])  # fmt: skip
def test_frfs_that_no_modes_make_are_said_to_be_so(word, left, by_modes, told):
    """The answer stays: what is off in general may be right, but it has not been seen to twice the noise.

    A joint that is found explains what no sum of modes does, and nothing is left to say.
    """
    found, reasons = lines_verdict(word, ["as before"], left, by_modes)
    assert found == word and any("no sum of modes" in reason for reason in reasons) == told


@pytest.mark.parametrize(
    ("word", "before", "after", "verdict"),
    [("named", 50.0, 60.0, "unknown"), ("ambiguous", 50.0, 60.0, "unknown"), ("named", 50.0, 51.0, "named"),
     ("named", 1.0, 1.1, "named"), ("clean", 50.0, 60.0, "clean"), ("unknown", 50.0, 60.0, "unknown")],
)  # fmt: skip
def test_what_predicts_worse_than_the_simulation_explains_nothing(word, before, after, verdict):
    gain = Gain("a column", before, after, 0.0, 1.0)
    found, reasons = held_out_verdict(word, ["as before"], gain)
    assert found == verdict and (len(reasons) > 1) is (word != verdict)
