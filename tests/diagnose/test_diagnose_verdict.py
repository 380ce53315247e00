"""What is said of sets of causes with given probabilities."""

import pytest

from modalax.diagnose.causes.joints import CubicStiffness
from modalax.diagnose.causes.local import AddedMass, JointStiffness
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.decision.advice import advise
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.decision.verdict import _verdict, rivals
from modalax.diagnose.fitting.hypothesis import Hypothesis

CUBIC, MASS, SPRING = CubicStiffness(), AddedMass(), JointStiffness()


def ranked(*sets):
    """``(probability, (cause, *where), ...)`` each."""
    out = []
    for probability, *causes in sets:
        places = tuple(Place(tuple(where), (int(where[0]), -1, 0)) for _, *where in causes)
        h = Hypothesis(causes=tuple(c for c, *_ in causes), places=places)
        out.append(Ranked(h.names, h, 0.0, probability))
    return out


def told(verdict, some):
    return [sorted(r.names) for r in rivals(verdict, some)]


def test_a_sure_law_is_named_at_its_likeliest_place_and_the_others_stand_beside():
    some = ranked((0.55, (CUBIC, "1")), (0.30, (CUBIC, "2")), (0.13, (CUBIC, "3")), (0.02, (CUBIC, "4")))
    assert _verdict(some, 1.0) == "named"
    assert told("named", some) == [[("cubic_stiffness", ("2",))], [("cubic_stiffness", ("3",))]]
    assert "1, 2, 3" in advise("named", [some[0], *rivals("named", some)])


@pytest.mark.parametrize(
    "some",
    [
        ranked((0.48, (CUBIC, "1")), (0.47, (CUBIC, "2")), (0.05, (CUBIC, "3"))),  # the place is anywhere
        ranked((0.90, (CUBIC, "1")), (0.10, (SPRING, "1"))),  # another law
        ranked((1.0, (CUBIC, "1"), (SPRING, "1"))),  # two elements at one place: a joint of no listed law
    ],
    ids=["place", "law", "one place"],
)
def test_what_is_not_sure_is_a_set(some):
    assert _verdict(some, 1.0) == "ambiguous"
    assert len(rivals("ambiguous", some)) == len(some) - 1


def test_each_place_of_a_pair_counts_by_itself():
    """0.36 for the leading places of both together, but 0.6 for each."""
    some = ranked(
        (0.36, (MASS, "1"), (CUBIC, "2")), (0.24, (MASS, "1"), (CUBIC, "3")),
        (0.24, (MASS, "4"), (CUBIC, "2")), (0.16, (MASS, "4"), (CUBIC, "3")),
    )  # fmt: skip
    assert _verdict(some, 1.0) == "named"
    assert len(told("named", some)) == 3


def test_what_is_left_makes_any_name_unknown():
    sure = ranked((1.0, (CUBIC, "1")))
    assert _verdict(sure, 1.0) == "named" and told("named", sure) == []
    assert _verdict(sure, 1e-3) == "unknown"
    assert _verdict(ranked((1.0, (MASS, "1"), (CUBIC, "2"))), 5e-3) == "unknown"
