"""What is off by one factor throughout is told with its sign, beside what single elements are off."""

import chains_off
import numpy as np
import pytest
from frames import measured, simulation
from kinds import few_or_all

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting import throughout
from modalax.diagnose.modal_domain.fitting.explanation import Prior
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import THROUGHOUT
from modalax.diagnose.modal_domain.fitting.throughout import all_scaled, beside_one_factor, only_scaled, with_groups
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.model import Structure


def scaled(stiffness: float = 1.0, mass: float = 1.0) -> Structure:
    """The beam with all of its stiffness and mass times a factor, and the same damping ratios."""
    s = simulation()
    M, C, K = (np.asarray(A) for A in (s.M, s.C, s.K))
    return Structure(mass * M, np.sqrt(stiffness * mass) * C, stiffness * K, s.dofs)


@pytest.mark.parametrize(
    ("stiffness", "mass", "name", "value", "word"),
    [
        pytest.param(1.08, 1.0, "stiffness", 0.08, "high", marks=pytest.mark.slow),
        pytest.param(0.9, 1.0, "stiffness", -0.1, "low", marks=pytest.mark.slow),
        (1.0, 1.05, "mass", 0.05, "high"),
    ],
)
def test_a_factor_on_all_of_a_matrix_is_told_apart_from_the_elements(stiffness, mass, name, value, word):
    found = diagnose_modes(measured(2, 0.01)[0], scaled(stiffness, mass))
    answer = found.to_dict()
    assert answer["verdict"] == "clean"
    told = answer["throughout"]
    assert list(told) == [name]
    assert abs(told[name]["value"] - value) < 3 * told[name]["std"] < 0.02
    assert answer["inaccuracy"][name]["value"] < 0.01  # of single elements, which are 1 % off
    assert any(f"the {name} of the simulation is" in r and f"% too {word}" in r for r in answer["reasons"])
    extended = np.asarray(found.extended.base.K if name == "stiffness" else found.extended.base.M)
    own = np.asarray(simulation().K if name == "stiffness" else simulation().M)
    assert np.trace(extended) == pytest.approx(np.trace(own), rel=0.02)


@few_or_all("force_gain")
@pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])
def test_a_factor_is_found_behind_a_cause_too(structure, wanted):
    if structure == "beam":
        data, model, at = measured(5, 0.01, mass=("5:+Z", 0.05))[0], scaled(1.08), "5:+Z"
    else:
        M, C, K = chains_off.chain_off(5, 0.005)
        H = chains_off.response(M + 0.2 * np.diag(np.arange(5) == 2), C, K, chains_off.FREQ)
        data, model, at = chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.simulation(), chains_off.DOFS[2]
        model = model.replace(C=np.sqrt(1.08) * np.asarray(model.C), K=1.08 * np.asarray(model.K))
    answer = diagnose_modes(data, model, wanted=wanted).to_dict()
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("added_mass", [at])]
    assert answer["throughout"]["stiffness"]["value"] == pytest.approx(0.08, abs=0.01)


@pytest.mark.slow  # by default where nothing stands out of a simulation that is off everywhere
def test_nothing_is_told_where_elements_are_off_each_by_itself():
    assert diagnose_modes(measured(6, 0.02)[0], simulation()).to_dict()["throughout"] == {}


@pytest.mark.slow  # by default of elements that scatter less
def test_a_factor_is_told_apart_from_elements_that_scatter_widely():
    told = diagnose_modes(measured(3, 0.02)[0], scaled(1.08)).to_dict()["throughout"]
    assert list(told) == ["stiffness"] and abs(told["stiffness"]["value"] - 0.08) < 3 * told["stiffness"]["std"] < 0.05


@few_or_all("force_gain")
@pytest.mark.parametrize(
    ("gain", "factors", "damping"),
    [
        (1.0, {"stiffness": 1.09, "mass": 1.03}, 1.0),  # as of a thickness, with the same damping ratios
        (1.4, {}, 1.3),
        pytest.param(1.05, {}, 1.0, marks=pytest.mark.slow),
    ],
)
def test_a_gain_of_all_frfs_and_factors_on_all_of_a_matrix_are_not_told_beside_each_other(
    gain, factors, damping, wanted
):
    """Stiffness, mass and damping that are all a times as large make FRFs 1/a as large: data cannot tell three factors.

    The first had been a gain of -5.6 % with the mass too high, as the damping of the simulation is right then.
    """
    a = {name: factors.get(name, 1.0) for name in ("stiffness", "mass")}
    M, C, K = chains_off.chain_off(3, 0.0 if factors else 0.002)
    C = damping * C * np.sqrt(a["stiffness"] * a["mass"])
    H = gain * chains_off.response(a["mass"] * M, C, a["stiffness"] * K, chains_off.FREQ)
    data = chains_off.as_measured(H, chains_off.FREQ, 3)
    found = diagnose_modes(data, chains_off.simulation(), wanted=wanted)
    assert [(c["name"], c["where"]) for c in found.causes] == [("force_gain", [])] * (gain != 1.0)
    if gain != 1.0:
        told = found.causes[0]["parameters"]["gain"]
        assert abs(1 + told["value"] - gain) < 4 * told["std"] < 0.01
    for name in ("stiffness", "mass"):
        if name in factors:
            assert 1 / (1 + found.throughout[name]["value"]) == pytest.approx(factors[name], abs=0.002)
        else:
            assert name not in found.throughout


def test_a_factor_on_all_of_the_damping_is_told_as_one():
    M, C, K = chains_off.chain_off(3, 0.002)
    H = chains_off.response(M, 1.3 * C, K, chains_off.FREQ)
    found = diagnose_modes(chains_off.as_measured(H, chains_off.FREQ, 3), chains_off.simulation())
    assert found.verdict == "clean" and list(found.throughout) == ["damping"]
    assert 1 / (1 + found.throughout["damping"]["value"]) == pytest.approx(1.3, abs=0.03)
    assert any("the damping of the simulation is" in r and "% too low" in r for r in found.reasons)
    base = found.extended.base
    assert np.trace(np.asarray(base.C)) == pytest.approx(np.trace(1.3 * C), rel=0.05)


@pytest.mark.parametrize(
    ("stiffness", "mass", "expected"), [(1.03, 1.03, True), (1.03, 1.0, False), (1.03, 0.97, False)]
)
def test_one_factor_on_stiffness_and_mass_both_is_no_error_of_the_structure(stiffness, mass, expected):
    data, model = measured(2, 0.0)[0], scaled(stiffness, mass)
    setting = posed(data, model, identified(data, model, lambda _: None)).setting
    assert not only_scaled(setting, fit(setting))  # nothing says so without such factors
    wider = with_groups(setting, (THROUGHOUT["stiffness"], THROUGHOUT["mass"]))
    assert only_scaled(wider, fit(wider)) is expected


def test_a_gain_of_one_of_two_inputs_is_preferred_to_factors_throughout():
    """With factors on stiffness and mass the error of one load cell is the opposite error of the other.

    It had been told of the other, as factors had been sought first.
    """
    H = chains_off.response(*chains_off.chain_off(3, 0.01), chains_off.FREQ)
    H[:, :, 3] *= 1.2
    measurement = chains_off.as_measured(H, chains_off.FREQ, 3)
    task = posed(measurement, chains_off.simulation(), identified(measurement, chains_off.simulation(), lambda _: None))
    wide = with_groups(task.setting, (THROUGHOUT["stiffness"], THROUGHOUT["mass"]))
    assert all_scaled(wide)
    setting, found = beside_one_factor(task.setting, wide, fit(wide), task.candidates, Prior(task.candidates))
    assert not all_scaled(setting)
    assert [[(c.slug, c.where) for c in causes] for causes in found] == [[], [("force_gain", ("4:+Z",))]]


@pytest.mark.parametrize(
    ("x", "std", "told"), [(-0.3, 0.05, True), (-0.3, 0.2, False), (-4.9, 0.7, False), (2.0, 0.3, True)]
)
def test_a_factor_is_told_where_it_and_its_logarithm_are_surely_not_zero(monkeypatch, x, std, told):
    """One that leaves a hundredth of the damping, known to a factor of two, says nothing: others take its place."""
    monkeypatch.setattr(throughout, "_factors", lambda *_: (["damping"], np.array([x]), np.array([[std**2]])))
    found = throughout.throughout_told(None, None)
    assert list(found) == ["damping"] * told
    for v in found.values():
        assert v == {"value": pytest.approx(np.exp(-x) - 1), "std": pytest.approx(np.exp(-x) * std)}
