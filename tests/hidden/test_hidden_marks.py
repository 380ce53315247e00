"""The scoring of large draws: what counts as right, and the limits of shares."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from modalax.diagnose.holdout import held_out_block

SCRIPTS = Path(__file__).parents[2] / "experiments" / "diagnosis"


@pytest.fixture(scope="module")
def marks():
    sys.path.insert(0, str(SCRIPTS))
    yield importlib.import_module("marks")
    sys.path.remove(str(SCRIPTS))


def cause(name, *where, **parameters):
    return {"name": name, "where": list(where), "parameters": parameters, "probability": 0.97}


def mark(marks, hidden, said, verdict="named", alternatives=(), d=20.0):
    truth = {"cause": "+".join(c["name"] for c in hidden) or "clean", "causes": hidden, "d": d}
    return marks.Mark("case", truth, {"verdict": verdict, "causes": said, "alternatives": list(alternatives)})


def test_right_means_name_and_place_in_either_order(marks):
    hidden = [cause("joint_stiffness", "1", "2")]
    turned = mark(marks, hidden, [cause("joint_stiffness", "2", "1")])
    assert turned.named_right and turned.place_right and marks.right(turned)
    elsewhere = mark(marks, hidden, [cause("joint_stiffness", "1", "3")])
    assert elsewhere.named_right and not elsewhere.place_right and not marks.right(elsewhere)
    other = mark(marks, hidden, [cause("local_damper", "1", "2")])
    assert not other.name_right and not other.within and other.outcome == "local_damper"


def test_sets_compounds_and_clean(marks):
    hidden = [cause("added_mass", "4")]
    rivals = [[cause("added_mass", "4")], [cause("tuned_mass", "4")]]
    unsure = mark(marks, hidden, [cause("sensor_mass", "4")], "ambiguous", rivals)
    assert unsure.within and not unsure.named_right and unsure.outcome == "set with truth"
    both = [cause("gap", "1"), cause("channel_gain", "2")]
    assert mark(marks, both, both[::-1]).place_right
    assert not mark(marks, both, both[:1]).name_right
    nothing = mark(marks, [], [], "clean", d=0.0)
    assert nothing.kind == "clean" and not nothing.detected and nothing.within
    assert mark(marks, [cause("outside:clock_error")], [], "unknown").kind == "outside"
    truth = marks.renamed({"cause": "outside:maxwell", "causes": [cause("outside:maxwell", "1")]})
    assert truth["cause"] == truth["causes"][0]["name"] == "maxwell_joint"
    assert marks.Mark("case", truth, {}).kind == "single"


def test_intervals_count_where_the_place_is_right(marks):
    hidden = [cause("gyroscopic", "1", "2", coupling={"value": 3.0, "unit": "N s/m"})]
    value = {"value": -2.9, "std": 0.2, "unit": "N s/m"}
    assert mark(marks, hidden, [cause("gyroscopic", "2", "1", coupling=value)]).parameters() == [
        ("gyroscopic.coupling", -3.0, -2.9, 0.2)
    ]
    assert mark(marks, hidden, [cause("gyroscopic", "1", "3", coupling=value)]).parameters() == []
    wide = mark(marks, hidden, [cause("gyroscopic", "2", "1", coupling={**value, "value": -1.0})])
    shares = marks.coverage([mark(marks, hidden, [cause("gyroscopic", "2", "1", coupling=value)]), wide])
    assert (shares["all"].hits, shares["all"].count) == (1, 2)


def test_limits_are_those_of_the_binomial(marks):
    for hits, count in ((0, 10), (3, 40), (10, 10)):
        low, high = marks.Share(hits, count).limits
        want = scipy.stats.binomtest(hits, count).proportion_ci(0.95, "exact")
        assert (low, high) == pytest.approx((want.low, want.high), abs=1e-12)


def test_oracle_is_the_two_sided_test(marks):
    z = np.random.default_rng(0).normal(3.0, 1.0, 200_000)
    assert marks.oracle(3.0) == pytest.approx(np.mean(np.abs(z) > scipy.stats.norm.isf(0.005)), abs=0.004)
    assert marks.oracle(0.0) == pytest.approx(0.01)


def test_reliability_puts_probabilities_into_bins(marks):
    hidden = [cause("gap", "1")]
    rows = marks.reliability([mark(marks, hidden, hidden)] * 3 + [mark(marks, hidden, [cause("gap", "2")])])
    assert len(rows) == 1
    low, high, stated, share = rows[0]
    assert (low, high, share.hits, share.count) == (0.95, 0.99, 3, 4) and stated == pytest.approx(0.97)


@pytest.mark.parametrize(
    ("level", "inputs", "alike", "words"),
    [
        ([1.0, 3.0, 2.0], 2, True, "run 2 at"),
        ([3.0, 1.0, 3.0], 2, True, "runs 1, 3 at"),
        ([1.0, 1.0], 2, True, "run 2, the last"),
        ([1.0, 1.0], 2, False, "the column"),
        ([1.0], 2, True, "the column"),
        ([1.0, 2.0], 1, False, "every"),
    ],
)
def test_the_block_held_out_is_read_back_from_its_words(marks, level, inputs, alike, words):
    shape = (len(level), 50, 3, inputs)
    said, mask = held_out_block(np.array(level), tuple(f"in{k}" for k in range(inputs)), shape, 50, alike)
    assert said.startswith(words)
    np.testing.assert_array_equal(importlib.import_module("held_out").held_out_mask(said, shape), mask)
    with pytest.raises(ValueError, match="held out is 'Tuesday'"):
        importlib.import_module("held_out").held_out_mask("Tuesday", shape)
