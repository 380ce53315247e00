"""The verdict about differences between force levels or runs: its rules one by one."""

from dataclasses import replace

import pytest

from modalax.diagnose.decision.levels import LevelsCase, levels_verdict, outweighing

JOINT = LevelsCase(
    "joint", before=7.0, after=1.1, law="cubic_stiffness", where=("3", "5"), law_probability=0.97,
    place_probability=0.92, behaviour="it stiffens",
)  # fmt: skip
DRIFT = LevelsCase("drift", "runs", 4.0, drift=0.002, drifting=0.96)


@pytest.mark.parametrize(
    ("case", "word", "because"),
    [
        (LevelsCase("nothing"), "clean", []),
        (JOINT, "named", ["the force levels differ", "across 3 - 5, it stiffens", "cubic_stiffness at 3 - 5"]),
        (replace(JOINT, after=1.6), "unknown", ["differ", "it stiffens", "no law explains it (chi-square 1.6"]),
        (replace(JOINT, before=70.0, after=1.6), "ambiguous", ["", "", "cubic", "leaves 9.3 % of the differences"]),
        (replace(JOINT, before=70.0, after=1.8), "unknown", ["", "", "no law explains it (chi-square 1.8"]),
        (replace(JOINT, nameless=0.51), "unknown", ["differ", "it stiffens", "none of the laws that have a name"]),
        (replace(JOINT, nameless=0.5), "named", ["differ", "it stiffens", "(probability 0.970 of the law, 0.920"]),
        (replace(JOINT, law_probability=0.94), "ambiguous", ["differ", "", "cubic", "other laws cannot be excluded"]),
        (replace(JOINT, place_probability=0.89), "ambiguous", ["differ", "", "cubic", "its place is not certain"]),
        (replace(JOINT, inexact=0.1), "ambiguous", ["differ", "", "cubic", "explains the force there to 10 % only"]),
        (replace(JOINT, aside=3), "named", ["differ", "", "cubic", "3 lines were set aside"]),
        (replace(JOINT, inexact=0.03), "named", ["differ", "it stiffens", "cubic_stiffness at 3 - 5"]),
        (DRIFT, "named", ["the runs differ", "0.2 % up to the last of them"]),
        (replace(DRIFT, after=1.6), "unknown", ["the runs differ", "neither a joint nor a shift"]),
        (replace(DRIFT, untried=True), "unknown", ["the runs differ", "time was up before a joint"]),
        (replace(DRIFT, drifting=0.94), "ambiguous", ["the runs differ", "(probability 0.940)"]),
    ],
)
def test_each_rule_about_levels(case, word, because):
    found, reasons = levels_verdict(case)
    assert found == word
    assert len(reasons) == len(because) and all(b in r for b, r in zip(because, reasons, strict=True)), reasons


def test_the_worse_part_of_an_answer_decides():
    assert outweighing("clean", "named") == "named"
    assert outweighing("ambiguous", "named") == "ambiguous"
    assert outweighing("ambiguous", "unknown", "clean") == "unknown"
