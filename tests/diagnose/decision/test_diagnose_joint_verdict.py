"""The verdict on a joint fitted together with the modes: every case once."""

import pytest

from modalax.diagnose.decision.joint import joint_verdict

ONE = (("cubic_stiffness", ("1",)),)
TWO = (("gap", ("1",)), ("iwan_joint", ("1",)))


@pytest.mark.parametrize(
    ("names", "probability", "placed", "word", "said"),
    [
        (None, 0.0, True, "unknown", "none of the laws"),
        (ONE, 0.99, True, "named", "probability of 0.99"),
        (ONE, 0.9, True, "ambiguous", "less than 0.95"),
        (ONE, 0.99, False, "ambiguous", "where the joint sits"),
        (TWO, 0.99, True, "ambiguous", "one joint of another law"),
    ],
)
def test_every_case(names, probability, placed, word, said):
    told, reasons = joint_verdict(names, probability, placed)
    assert told == word
    assert len(reasons) == 1 and said in reasons[0]
