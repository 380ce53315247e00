"""A small draw of hidden effects that a diagnosis must find: cause and place, or a set that holds the truth.

The truth is opened only here, after the answer. Cases share the structures and sizes of three tests, so that one
compilation serves many; the large draw with its marks is in ``experiments/diagnosis``.
"""

import generator
import numpy as np
import pytest

from modalax.diagnose import diagnose, pipeline
from modalax.diagnose.causes import ChannelCause, JointCause, LinesCause, LocalCause, ModesCause, catalogue, imitators
from modalax.diagnose.causes.drift import DriftingSpring
from modalax.diagnose.causes.groups import GroupCause
from modalax.diagnose.causes.joints import ElastoSlip
from modalax.diagnose.causes.power_laws import IwanJoint
from modalax.diagnose.comparison import empty, make_comparison
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.search.singles import STRAYED, from_nominal_modes
from modalax.files import load

STRUCTURES = {"chain": ("masses", 35), "beam": ("frame", 12), "other chain": ("masses", 20)}
# One structure, so that one compilation serves all: a mass among the whole catalogue (a joint and a cause of a channel
# in the slow run),
WHOLE = ["added_mass", *(pytest.param(c, marks=pytest.mark.slow) for c in ("cubic_stiffness", "channel_gain"))]
# the others, and another structure, among those of the own kind,
ALIKE = {
    ("cubic_stiffness", "chain"): JointCause, ("channel_gain", "chain"): ChannelCause,
    ("joint_stiffness", "beam"): LocalCause, ("local_damper", "chain"): LocalCause,
    ("channel_swap", "chain"): ChannelCause, ("mains_hum", "chain"): LinesCause | ModesCause,
    ("time_varying", "chain"): ModesCause | DriftingSpring, ("force_gain", "chain"): ChannelCause,
    ("crosstalk", "chain"): ChannelCause, ("hysteretic_joint", "chain"): LocalCause,
    ("fractional_joint", "chain"): LocalCause, ("sensor_clipping", "chain"): ChannelCause,
    ("missing_mode", "chain"): ModesCause | ChannelCause, ("iwan_joint", "chain"): ElastoSlip | IwanJoint,
    ("units", "chain"): ChannelCause,
}  # fmt: skip
# Draws that get a name by itself, so that its place and what it leaves are checked too.
NAMED = {"cubic_stiffness": 103, "iwan_joint": 101}
# These among the whole catalogue in the longer draw.
LONG = [
    *((100, *case) for case in [
        ("missing_mode", "chain"),
        ("joint_stiffness", "beam"), ("local_damper", "other chain"), ("channel_swap", "other chain"),
        ("missing_mode", "beam"), ("mains_hum", "beam"), ("time_varying", "chain"),
    ]),
    *((200, *case) for case in [
        ("modal_damping", "beam"), ("tuned_mass", "chain"), ("sensor_mass", "other chain"), ("time_delay", "beam"),
        ("exponential_window", "chain"), ("fast_sweep", "other chain"), ("leakage", "chain"), ("gap", "beam"),
        ("elasto_slip", "chain"), ("coulomb_friction", "other chain"), ("quadratic_damping", "beam"),
        ("force_dropout", "other chain"), ("added_mass", "beam"), ("units", "chain"), ("force_gain", "beam"),
        ("crosstalk", "beam"), ("hysteretic_joint", "other chain"), ("fractional_joint", "beam"),
    ]),
]  # fmt: skip


def draw(seed: int, cause: str, structure: str, variance: str = "16"):
    family, number = STRUCTURES[structure]
    plan = dict(spread=False, variance=variance, inputs=1, runs=3, structure=number)
    return generator.draw_case(seed, cause, 30.0, family, **plan)


def answer(case, folder):
    case.save(folder / "open", folder / "hidden" / "truth.json")
    return diagnose(load(folder / "open" / "measurement.npz"), load(folder / "open" / "simulation.npz")).to_dict()


def answer_among(kinds, case, folder, monkeypatch):
    """With a part of all causes, and beside the simulation's modes, for which there is no modal domain."""
    monkeypatch.setattr(pipeline, "catalogue", lambda *a: [c for c in catalogue(*a) if isinstance(c, kinds)])
    monkeypatch.setattr(pipeline, "imitators", lambda: [c for c in imitators() if isinstance(c, kinds)])
    case.save(folder)
    return diagnose(load(folder / "measurement.npz"), load(folder / "simulation.npz").modal()).to_dict()


def names(causes):
    return sorted(c["name"] for c in causes)


def check_found(case, said):
    assert said["verdict"] in ("named", "ambiguous")
    truth = case.truth["causes"]
    assert names(truth) in [names(s) for s in (said["causes"], *said["alternatives"])]
    if said["verdict"] == "named":
        assert {str(w) for w in said["causes"][0]["where"]} == {str(w) for w in truth[0]["where"]}
        assert said["gain"]["chi2_after"] < 1.15  # on what was held out; 1 is noise


@pytest.mark.parametrize("cause", WHOLE)
def test_hidden_effect_is_found(cause, tmp_path):
    case = draw(100, cause, "chain")
    check_found(case, answer(case, tmp_path))


@pytest.mark.parametrize(("cause", "structure"), ALIKE)
def test_hidden_effect_is_told_from_those_of_its_kind(cause, structure, tmp_path, monkeypatch):
    case = draw(NAMED.get(cause, 100), cause, structure)
    check_found(case, answer_among(ALIKE[cause, structure], case, tmp_path, monkeypatch))


def test_a_sensor_that_rolls_off_near_the_band_is_no_delay(tmp_path, monkeypatch):
    case = generator.draw_case(3, "sensor_filter", 1000.0, *("masses",), spread=False, inputs=1, runs=3, structure=35)
    said = answer_among(ChannelCause, case, tmp_path, monkeypatch)
    truth = case.truth["causes"][0]
    check_found(case, said)
    assert said["verdict"] == "named"
    for name, value in truth["parameters"].items():
        told = said["causes"][0]["parameters"][name]
        assert abs(told["value"] - value["value"]) < 4 * told["std"]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "cause", "structure"), LONG)
def test_hidden_effect_is_found_in_the_longer_draw(seed, cause, structure, tmp_path):
    case = draw(seed, cause, structure)
    check_found(case, answer(case, tmp_path))


@pytest.mark.slow  # by default of five masses, among answers
@pytest.mark.parametrize("variance", ["exact", "6"])
def test_nothing_is_found_where_nothing_is_wrong(variance, tmp_path):
    said = answer(draw(100, "clean", "chain", variance), tmp_path)
    assert said["verdict"] == "clean" and said["causes"] == []


def test_a_cause_that_no_catalogue_holds_gets_no_confident_name(tmp_path):
    said = answer(draw(101, "outside:stray_force", "chain"), tmp_path)
    assert said["verdict"] in ("unknown", "ambiguous")


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["channels", "whole"])
def test_what_the_data_looks_like_beside_the_catalogue_is_told(whole, tmp_path, monkeypatch):
    """A cable that resonates bends one row about its resonance, as no named fault of a sensor does."""
    case = draw(100 if whole else 108, "outside:cable_resonance", "chain")
    said = answer(case, tmp_path) if whole else answer_among(ChannelCause, case, tmp_path, monkeypatch)
    assert said["verdict"] in ("unknown", "ambiguous")
    assert "sensor_resonance" in said["advice"] and f"at {case.truth['causes'][0]['where'][0]}" in said["advice"]


@pytest.mark.slow  # in the modal domain, as is asked first, by default
def test_wrong_units_are_named_although_the_simulation_may_be_a_little_off(tmp_path):
    """The modes would have to move by thousands of claimed standard deviations to follow such an effect."""
    plan = dict(spread=True, variance="16", inputs=1, runs=3, structure=12)
    case = generator.draw_case(300, "units", 30.0, "frame", **plan)
    case.save(tmp_path / "open", tmp_path / "hidden" / "truth.json")
    channels = [c for c in catalogue() if isinstance(c, ChannelCause | ModesCause)]
    said = diagnose(
        load(tmp_path / "open" / "measurement.npz"), load(tmp_path / "open" / "simulation.npz"), causes=channels
    )
    assert said.verdict == "named" and names(said.causes) == ["units"]


@pytest.mark.slow
def test_units_are_looked_for_where_the_simulation_has_its_modes(tmp_path):
    """With the modes where the simulation has them wrong units explain little; with the modes led astray, nothing."""
    case = generator.draw_case(1378351706, "units", 8.0, "frame", inputs=2, runs=3, structure=210)
    case.save(tmp_path)
    comparison = make_comparison(load(tmp_path / "measurement.npz"), load(tmp_path / "simulation.npz"))
    null = comparison.fit([empty(comparison)], 14)[0]
    found = from_nominal_modes(
        score_state_of(comparison, null),
        [c for c in catalogue() if not isinstance(c, JointCause | LinesCause | GroupCause)],
    )
    assert np.abs(null.theta).max() > STRAYED
    assert found[0].chi2 < 1.2 * comparison.problem.samples < 1e-3 * null.chi2
