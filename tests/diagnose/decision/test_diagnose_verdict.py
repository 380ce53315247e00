"""What is said of sets of causes with given probabilities, and why: the rules of the verdict one by one."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from modalax.diagnose.causes.channels import ChannelGain, ForceDropout, TimeDelay
from modalax.diagnose.causes.forces import Crosstalk, ForceGain
from modalax.diagnose.causes.joints import BilinearStiffness, CubicStiffness, ElastoSlip
from modalax.diagnose.causes.local import AddedMass, JointStiffness, TunedMass
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.signals import HumLines
from modalax.diagnose.causes.viscoelastic import ZenerJoint
from modalax.diagnose.decision.advice import advise, advise_modes
from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.decision.sets import as_stated, rivals
from modalax.diagnose.decision.verdict import RULES, Leftover, told_chance, verdict
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.thresholds import THRESHOLDS, Thresholds

CUBIC, MASS, SPRING, BILINEAR = CubicStiffness(), AddedMass(), JointStiffness(), BilinearStiffness()
GAIN, DELAY, HEARD = ChannelGain(), TimeDelay(), Crosstalk()
ALARM = Leftover(alarm=1e-6, explained=900.0, p_value=0.4)
HELD = Gain("run 3 at 9 N, the highest level", 40.0, 1.02, 500.0, 20.0, missed=0.5, chi2_within=1.0)
MISSED = replace(HELD, chi2_after=3.0, missed=9.0)
WORSE = replace(HELD, chi2_before=1.01, chi2_after=1.02, missed=2.1, log_likelihood_gain=-9.0)  # with the cause


def ranked(*sets):
    """``(probability, (cause, *where), ...)`` each."""
    out = []
    for probability, *causes in sets:
        places = tuple(Place(tuple(where), (int(where[0]), -1, 0)) for _, *where in causes)
        h = Hypothesis(causes=tuple(c for c, *_ in causes), places=places)
        out.append(Ranked(h.names, h, 0.0, probability))
    return out


def sized(sets, value, deviation):
    """The leading cause with its only parameter."""
    best = replace(sets[0].best, params=(np.array([value]),), covariance=np.array([[deviation**2]]))
    return [replace(sets[0], best=best), *sets[1:]]


def stuck(stiffness, deviation):
    """An elasto-slip joint of which slip displacement and stiffness are known to a factor of three and a deviation."""
    (found,) = ranked((1.0, (MASS, "2"), (ElastoSlip(False), "1")))
    params, covariance = (np.array([0.1]), np.array([stiffness, 1e-6])), np.diag([0.01, deviation, 1.1]) ** 2
    return [replace(found, best=replace(found.best, params=params, covariance=covariance))]


def dropping_out(correlation):
    """Noise and impedance of a shaker, each off by twice its size."""
    (found,) = ranked((1.0, (ForceDropout(), "1")))
    params, deviation = np.array([1e-4, 50.0]), np.array([2e-4, 100.0])
    covariance = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer(deviation, deviation)
    return [replace(found, best=replace(found.best, params=(params,), covariance=covariance))]


def at_zero(variance):
    """A relaxing joint, which is no joint with a force law, of whose three parameters the last is zero."""
    (found,) = ranked((1.0, (ZenerJoint(), "1", "2")))
    best = replace(found.best, params=(np.array([80.0, 2e-4, 0.0]),), covariance=np.diag([variance, 9.0, 1.0]))
    return [replace(found, best=best)]


def damped(ratio):
    """An oscillator of this damping ratio."""
    (found,) = ranked((1.0, (TunedMass(), "1")))
    return [replace(found, best=replace(found.best, params=(np.array([0.1, 20.0, ratio]),)))]


def untold(where, worse=0.0):
    """A spring, and one that differs in push and pull, which leaves a larger chi-square."""
    spring, other = ranked((0.98, (SPRING, "1")), (0.02, (BILINEAR, where)))
    return [
        replace(spring, best=replace(spring.best, chi2=1e3)), replace(other, best=replace(other.best, chi2=1e3 + worse))
    ]  # fmt: skip


ONE = ranked((0.99, (CUBIC, "1")), (0.01, (SPRING, "1")))
TWO = ranked((0.99, (CUBIC, "1"), (MASS, "2")), (0.01, (CUBIC, "1")))
TABLE = [
    # sets, leftover, held out, verdict, words of each reason in order
    ([], Leftover(alarm=0.3), None, "clean", ["noise alone"]),
    (ONE, replace(ALARM, alarm=0.01), HELD, "clean", ["noise alone"]),
    ([], ALARM, None, "unknown", ["no cause"]),
    (ONE, replace(ALARM, explained=8.9), HELD, "unknown", ["no cause"]),
    (ONE, replace(ALARM, explained=9.0), HELD, "named", ["0.99"]),
    (ONE, ALARM, HELD, "named", ["cubic_stiffness has a probability of 0.99"]),
    (untold("1"), ALARM, HELD, "named", ["0.98", "bilinear_stiffness there explains the data about as well"]),
    (untold("1", worse=8.9), ALARM, HELD, "named", ["0.98", "record the mean displacement and the even harmonics"]),
    (untold("1", worse=9.1), ALARM, HELD, "named", ["0.98"]),
    (untold("2"), ALARM, HELD, "named", ["0.98"]),
    (ONE, ALARM, MISSED, "unknown", ["cubic_stiffness leaves a chi-square of 3.000 per sample there"]),
    (ONE, ALARM, WORSE, "unknown", ["there, the simulation alone 1.010: it imitates"]),
    (TWO, ALARM, WORSE, "unknown", ["they imitate something else"]),
    (ONE, ALARM, replace(WORSE, missed=2.0), "named", ["0.99"]),
    (ONE, ALARM, replace(WORSE, log_likelihood_gain=0.1), "named", ["0.99"]),
    (ONE, ALARM, replace(MISSED, missed=4.0), "named", ["0.99"]),
    (ONE, ALARM, replace(MISSED, chi2_within=2.9), "named", ["0.99"]),
    (ONE, replace(ALARM, p_value=0.0019), HELD, "unknown", ["still more than noise"]),
    (ONE, replace(ALARM, p_value=0.002), HELD, "named", ["0.99"]),
    (TWO, replace(ALARM, p_value=0.0099), HELD, "unknown", ["still more than noise"]),
    (TWO, replace(ALARM, p_value=0.01), HELD, "named", ["added_mass and cubic_stiffness"]),
    (TWO, ALARM, MISSED, "unknown", ["the highest level"]),
    (TWO, ALARM, replace(MISSED, missed=4.0), "named", ["0.99"]),
    (TWO, ALARM, replace(MISSED, chi2_within=2.9), "named", ["0.99"]),
    (TWO, ALARM, None, "named", ["0.99"]),
    (ONE, replace(ALARM, nameless=0.51, likeness="a clock"), HELD, "unknown", ["a clock"]),
    (ONE, replace(ALARM, nameless=0.5), HELD, "named", ["0.99"]),
    ([], replace(ALARM, nameless=1.0), HELD, "unknown", ["no cause", "beside the catalogue"]),
    (ONE, replace(ALARM, p_value=1e-5, nameless=0.9), HELD, "unknown", ["more than noise", "beside the catalogue"]),
    (ranked((0.9, (CUBIC, "1")), (0.1, (SPRING, "1"))), ALARM, HELD, "ambiguous", ["other causes compete"]),
    (ranked((0.89, (CUBIC, "1")), (0.11, (CUBIC, "2"))), ALARM, HELD, "ambiguous", ["may sit elsewhere"]),
    (ranked((0.9, (CUBIC, "1")), (0.1, (CUBIC, "2"))), ALARM, HELD, "named", ["over 0.999"]),
    (ranked((1.0, (GAIN, "1"), (DELAY, "2"))), ALARM, HELD, "named", ["over 0.999"]),
    (ranked((1.0, (GAIN, "1"), (DELAY, "1"))), ALARM, HELD, "ambiguous", ["of one sensor may be one fault"]),
    (ranked((1.0, (HEARD, "1", "2"), (HEARD, "1", "3"))), ALARM, HELD, "ambiguous", ["of one sensor may be one fault"]),
    (ranked((1.0, (HEARD, "1", "2"), (HEARD, "3", "2"))), ALARM, HELD, "named", ["over 0.999"]),
    (ranked((1.0, (GAIN, "1"), (ForceGain(), "1"))), ALARM, HELD, "named", ["over 0.999"]),  # of its load cell
    (damped(0.5), ALARM, HELD, "ambiguous", ["the damping ratio of tuned_mass ends at 0.5"]),
    (damped(0.45), ALARM, HELD, "named", ["tuned_mass"]),
    (ONE, replace(ALARM, untried=("gap", "added_mass")), HELD, "ambiguous", ["before gap, added_mass had been tried"]),
    (ONE, replace(ALARM, p_value=0.0, inexact=0.02), MISSED, "ambiguous", ["explains it but for 2 % of its size"]),
    (ONE, replace(ALARM, inexact=0.02, ahead=50.0), HELD, "ambiguous", ["explains it but for 2 % of its size"]),
    (ONE, replace(ALARM, inexact=0.005, ahead=9.0), HELD, "ambiguous", ["explains it but for 0.5 % of its size"]),
    (ONE, replace(ALARM, inexact=0.005, ahead=50.0), MISSED, "ambiguous", ["but for 0.5 % of its size"]),
    (ONE, replace(ALARM, inexact=0.005, ahead=50.0), replace(MISSED, chi2_after=1.4), "named", ["50 times as much"]),
    (ONE, replace(ALARM, inexact=0.005, ahead=50.0), HELD, "named", ["the next law or place leaves 50 times as much"]),
    (ranked((1.0, (CUBIC, "1"), (SPRING, "1"))), ALARM, HELD, "ambiguous", ["one joint of another law"]),
    (
        ranked((0.4, (CUBIC, "1")), (0.4, (CUBIC, "2")), (0.2, (SPRING, "1"))), ALARM, HELD, "ambiguous",
        ["other causes compete", "may sit elsewhere"],
    ),
    (sized(ONE, 5.0, 5.1), ALARM, MISSED, "ambiguous", ["no parameter of cubic_stiffness"]),
    (sized(ONE, 5.0, 4.9), ALARM, HELD, "named", ["0.99"]),
    (ranked((1.0, (CUBIC, "1"), (MASS, "2"), (SPRING, "3"))), ALARM, HELD, "ambiguous", ["3 unlike causes at once"]),
    (ranked((1.0, (SPRING, "1"), (MASS, "2"), (SPRING, "3"))), ALARM, HELD, "named", ["over 0.999"]),
    (stuck(1e6, 2e6), ALARM, HELD, "ambiguous", ["elasto_slip cannot be told from coulomb_friction"]),
    (stuck(1e6, 9e5), ALARM, HELD, "named", ["over 0.999"]),
    (at_zero(1.0), ALARM, HELD, "named", ["over 0.999"]),
    (at_zero(1e6), ALARM, HELD, "ambiguous", ["no parameter of maxwell_joint"]),
    (dropping_out(-0.7), ALARM, HELD, "ambiguous", ["no parameter of force_dropout"]),
    (dropping_out(-0.999), ALARM, HELD, "named", ["over 0.999"]),  # their product is known
    (ranked((0.5, (CUBIC, "1"), (SPRING, "1")), (0.5, (MASS, "3"))), ALARM, MISSED, "ambiguous", ["", "", "one joint"]),
]  # fmt: skip


@pytest.mark.parametrize(("sets", "leftover", "held_out", "word", "reasons"), TABLE)
def test_truth_table(sets, leftover, held_out, word, reasons):
    said, why = verdict(sets, leftover, held_out)
    assert said == word
    assert len(why) == len(reasons) and all(part in one for part, one in zip(reasons, why, strict=True))


def test_the_law_that_a_joint_without_a_size_is_the_limit_of_stands_beside_it():
    assert stuck(1e6, 2e6)[0].best.at_limits == [("added_mass", ("2",)), ("coulomb_friction", ("1",))]
    assert stuck(1e6, 9e5)[0].best.at_limits == [] == sized(ONE, 5.0, 5.1)[0].best.at_limits


def test_every_rule_decides_a_row_and_the_last_always_does():
    assert [word for word, _ in RULES] == ["clean", *["unknown"] * 3, *["ambiguous"] * 9, "unknown", "named", "named"]
    reasons = " ".join(part for *_, parts in TABLE for part in parts)
    assert all(
        p in reasons for p in ("noise alone", "no cause", "still more", "beside", "compete", "tried", "elsewhere")
    )


@pytest.mark.parametrize(
    ("name", "strict", "word"),
    [
        ("alarm", 1e-9, "clean"), ("explains", 1e4, "unknown"), ("left", 0.5, "unknown"),
        ("certain", 0.995, "ambiguous"), ("placed", 0.995, "ambiguous"), ("nameless", -0.1, "unknown"),
    ],
)  # fmt: skip
def test_each_threshold_is_the_one_that_its_rule_asks(name, strict, word):
    assert verdict(ONE, ALARM, HELD)[0] == "named"
    assert verdict(ONE, ALARM, HELD, replace(THRESHOLDS, **{name: strict}))[0] == word


@pytest.mark.parametrize(("name", "strict"), [("left_by_several", 0.5), ("missed", 0.4), ("farther", 0.9)])
def test_thresholds_of_several_causes(name, strict):
    gain = replace(HELD, missed=5.0) if name == "farther" else replace(HELD, chi2_after=1.2)
    assert verdict(TWO, ALARM, gain)[0] == "named"
    assert verdict(TWO, ALARM, gain, replace(THRESHOLDS, **{name: strict}))[0] == "unknown"


def test_every_threshold_says_what_it_is_and_names_a_script_that_stands():
    assert sum(THRESHOLDS.shares.values()) == pytest.approx(1.0)
    rows = THRESHOLDS.table()
    assert [row[0] for row in rows] == [f.name for f in fields(Thresholds)]
    root = Path(__file__).parents[3]
    for name, value, unit, meaning, script in rows:
        assert np.isfinite(value) and unit and meaning.endswith(".") and meaning[0].isupper(), name
        assert (root / script).is_file(), script


def told(verdict, sets):
    return [sorted(r.names) for r in rivals(verdict, sets)]


def test_a_sure_law_is_named_at_its_likeliest_place_and_the_others_stand_beside():
    sets = ranked((0.9, (CUBIC, "1")), (0.06, (CUBIC, "2")), (0.04, (CUBIC, "3")))
    assert verdict(sets, ALARM)[0] == "named"
    assert told("named", sets) == [[("cubic_stiffness", ("2",))]]
    assert "1, 2" in advise("named", [sets[0], *rivals("named", sets)])


def test_rivals_of_a_set_are_told_however_unlikely_the_next_best_is():
    sets = ranked((0.94, (CUBIC, "1")), (0.04, (SPRING, "1")), (0.016, (MASS, "1")), (0.004, (MASS, "2")))
    assert len(told("ambiguous", sets)) == 2
    assert told("ambiguous", ranked((0.999, (CUBIC, "1")), (0.001, (SPRING, "1")))) == [[("joint_stiffness", ("1",))]]


def test_each_place_of_a_pair_counts_by_itself():
    """0.81 for the leading places of both together, but 0.9 for each."""
    sets = ranked(
        (0.81, (MASS, "1"), (CUBIC, "2")), (0.1, (MASS, "1"), (CUBIC, "3")),
        (0.1, (MASS, "4"), (CUBIC, "2")), (0.01, (MASS, "4"), (CUBIC, "3")),
    )  # fmt: skip
    assert verdict(sets, ALARM)[0] == "named"
    assert len(told("named", sets)) == 2


def test_advice_is_that_of_the_causes():
    laws = ranked((0.6, (CUBIC, "1")), (0.4, (BilinearStiffness(), "1")))
    assert "three force levels" in advise("ambiguous", laws) and "even harmonics" in advise("ambiguous", laws)
    h = Hypothesis(hum=HumLines(np.ones(3, bool), -30.0, 1.0, 2.0, 50.0, 1e-6))
    hum = Ranked(h.names, h, 0.0, 0.5)
    assert h.names == {("mains_hum", ())}
    assert MainsHum.advice in advise("ambiguous", [*ranked((0.5, (MASS, "1"))), hum])
    assert advise("ambiguous", ranked((0.9, (SPRING, "1")))) == "measure another column of the FRF matrix"


@pytest.mark.parametrize(("p", "told"), [(1e-15, "1e-15"), (0.13, "0.13"), (0.962, "0.96"), (0.9971, "over 0.99"),
                                         (1.0, "over 0.999")])  # fmt: skip
def test_no_chance_is_told_as_certain(p, told):
    assert told_chance(p) == told


@pytest.mark.parametrize(("word", "most"), [("named", 0.999), ("ambiguous", 0.95), ("unknown", 0.5)])
def test_no_cause_is_likelier_than_its_verdict_leaves_room_for(word, most):
    causes = [{"name": "gap", "where": ["1"], "probability": 0.999}, {"name": "units", "where": [], "probability": 0.2}]
    assert [c["probability"] for c in as_stated(word, causes)] == [most, 0.2]
    assert causes[0]["probability"] == 0.999  # which is left as it was


def test_what_to_do_after_modes_were_not_explained_depends_on_what_is_left():
    assert "its supports, its units" in advise_modes("unknown", 0)
    assert "residual map" in advise_modes("unknown", 0, mostly=True)
    assert "lower force levels" in advise_modes("unknown", 0, by_level=True, mostly=True)
    odd = OddChannel("3:+Z", False, 20.0)
    assert "the sensor at 3:+Z" in advise_modes("unknown", 0, odd, by_level=True, mostly=True)
    assert (
        "further point" in advise_modes("ambiguous", 2) and advise_modes("named", 0) is advise_modes("clean", 0) is None
    )
