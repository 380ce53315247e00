"""Answers about a beam whose every element is off."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frames import DAMPING, DOFS, FLIP, cantilever, heavier, measured, simulation
from kinds import FEW_OR_ALL

from modalax.diagnose import ExtendedSimulation
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.beyond import BeyondUsual
from modalax.diagnose.modal_domain import answer as answers
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.discrepancy import beside, told_apart
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.modes.measured import identify
from modalax.diagnose.modal_domain.search.screen import errors_of
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of


def drawn(data_stiffness: np.ndarray) -> float:
    """Root mean square relative error of the modes' stiffness in the band, by the shapes of the simulation."""
    import scipy.linalg

    K, M = cantilever()
    K, M = (FLIP[:, None] * A * FLIP for A in (K, M))
    w2, P = scipy.linalg.eigh(K, M)
    inside = np.sqrt(w2) < 2 * np.pi * 330
    error = np.einsum("nk,nm,mk->k", P, data_stiffness - K, P)[inside] / w2[inside]
    return float(np.sqrt(np.mean(error**2)))


def poles_of(found) -> list[float]:
    """Circular frequencies of the modes that were identified."""
    return list(np.abs(found.stage.measured.features.poles))


def test_nothing_stands_out_of_a_simulation_that_is_off_everywhere():
    data, K = measured(1, 0.01)
    found = diagnose_modes(data, simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "clean"
    assert answer["causes"] == []
    low, high = answer["inaccuracy"]["stiffness"]["interval"]
    assert low < drawn(K) < high
    assert answer["gain"]["chi2_after"] < 1.3 < 20 < answer["gain"]["chi2_before"]
    assert "generally off" in answer["reasons"][0]
    assert answer["throughout"] == {}  # elements are off each by itself
    # a rest that is then told apart changes nothing of what has been fitted without it, and errors can be told
    stage, f, few = found.stage, found.chosen.fit, found.stage.candidates[:4]
    apart = told_apart(replace(stage.setting, rest=1e-4), f)
    again = beside(apart, f)
    assert len(again.sizes) > len(f.sizes) and again.state.difference is f.state.difference
    without, with_rest = errors_of(stage.setting, f, few), errors_of(apart, again, few)
    assert np.all(with_rest >= 0.999 * without) and np.all(with_rest < 10 * without)


def test_the_inaccuracy_of_damping_is_that_of_the_modes_though_damping_hardly_couples_them():
    """Were couplings that are nearly nothing counted with it, the mode that is off most would stand out."""
    data, _ = measured(22, 0.03)
    highest = 2 * np.pi * float(data.freq[-1])
    c = coordinates_of(simulation(), data.outputs, data.inputs, highest)
    features = identify(data, c).features
    inaccuracy = inaccuracy_of(simulation(), c, highest)
    found = fit(Setting(c, inaccuracy, features, whitener_of(features)))
    assert found is not None
    rms = float(np.sqrt(np.mean((features.values[:, 1] - np.log(DAMPING)) ** 2)))
    learnt = dict(zip(inaccuracy.groups, found.epsilon, strict=True))
    assert learnt["damping"] == pytest.approx(rms, rel=0.1)
    assert learnt["damping between modes"] < rms / 2


def test_a_mass_stands_out_beyond_the_general_inaccuracy():
    data, found = heavier()
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("added_mass", ["5:+Z"])]
    assert found.stage.odd is None  # there is a sensor there, of which it is no fault
    mass = answer["causes"][0]["parameters"]["mass"]
    assert abs(mass["value"] - 0.05) < 4 * mass["std"] < 0.02
    seen = answer["evidence"]
    assert [round(m["frequency_hz"]) for m in seen["by_mode"]] == [round(f / 6.2832) for f in poles_of(found)]
    errors = [[abs(m[f"frequency_error_{when}"]) for m in seen["by_mode"]] for when in ("before", "after")]
    assert max(errors[1]) < 1e-3 < 0.01 < max(errors[0])
    assert seen["tests"]["reciprocity"]["p_value"] > 1e-3 > seen["tests"]["band"]["before"]["p_value"]
    assert isinstance(found.extended, ExtendedSimulation)
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    np.testing.assert_allclose(again.H, found.predicted_after[0], atol=1e-6 * np.abs(found.predicted_after).max())


@FEW_OR_ALL
def test_an_exact_simulation_is_told_from_one_that_is_off(wanted):
    data, _ = measured(3, 0.0, mass=("3:+Z", 0.02))
    answer = diagnose_modes(data, simulation(), wanted=wanted).to_dict()
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("added_mass", ["3:+Z"])]
    assert answer["inaccuracy"]["stiffness"]["interval"][0] == 0
    assert answer["inaccuracy"]["stiffness"]["interval"][1] < 1e-3


@FEW_OR_ALL
def test_a_channel_gain_is_no_matter_of_the_structure_and_noise_need_not_be_given(wanted):
    data, _ = measured(4, 0.01, given=False)
    gain = np.ones(len(data.outputs))
    gain[2] = 1.2
    answer = diagnose_modes(data.replace(H=np.asarray(data.H) * gain[:, None]), simulation(), wanted=wanted).to_dict()
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("channel_gain", [DOFS[4]])]
    assert answer["causes"][0]["parameters"]["gain"]["value"] == pytest.approx(0.2, abs=0.02)


def test_time_that_is_up_still_gives_an_answer():
    data, _ = measured(2, 0.01, mass=("5:+Z", 0.05))
    found = diagnose_modes(data, simulation(), late=Deadline(1e-3))
    assert found.verdict in ("clean", "named", "ambiguous", "unknown")
    assert any("time was up" in reason for reason in found.reasons)


def test_an_interrupt_gives_the_best_answer_so_far():
    data, _ = measured(2, 0.01, mass=("5:+Z", 0.05), lines=120)

    def interrupted(step: str) -> None:
        if step.startswith("screening"):
            raise KeyboardInterrupt

    found = diagnose_modes(data, simulation(), tell=interrupted)
    assert found.stage.best.causes == ()  # the general inaccuracy alone had been fitted
    assert any("time was up" in reason for reason in found.reasons)


@FEW_OR_ALL
@pytest.mark.parametrize(
    ("seed", "dof", "stiffness"),
    [(13, "6:+Z", 500.0), pytest.param(14, "2:+Z", 2e4, marks=pytest.mark.slow)],  # the smaller one by default
)
def test_a_spring_to_ground_is_named_however_small_beside_the_elements(seed, dof, stiffness, wanted):
    """Next to a node of the lowest mode it is half a per cent of what a wrong element does; yet none can replace it."""
    answer = diagnose_modes(measured(seed, 0.01, ground=(dof, stiffness))[0], simulation(), wanted=wanted).to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("joint_stiffness", [dof])]
    told = answer["causes"][0]["parameters"]["stiffness"]
    assert abs(told["value"] - stiffness) < 4 * told["std"] < 0.05 * stiffness


def test_the_mass_next_to_a_clamp_is_off_by_itself():
    """Were it tied to the next element's other end, a rotary inertia would be named at the clamp."""
    assert diagnose_modes(measured(3, 0.02)[0], simulation()).to_dict()["verdict"] == "clean"


def test_rivals_of_the_linear_causes_hold_the_joint_as_well(monkeypatch):
    joint = {"name": "elasto_slip", "where": ["7:X"], "probability": 1.0, "parameters": {}}
    monkeypatch.setattr(answers, "rivals_told", lambda seen, named: [])
    monkeypatch.setattr(answers, "causes_told", lambda seen, whole, misfit: [joint])
    sets = (BeyondUsual((), 0.8), BeyondUsual((("joint_stiffness", ("6:X", "7:X")),), 0.2))
    stage = SimpleNamespace(seen=object(), whole=None, measured=SimpleNamespace(misfit=1.0))
    given = SimpleNamespace(verdict="ambiguous", stage=stage, sets=sets, _linear=[], forced=None)
    given._beyond_modes = answers.ModalDiagnosis._beyond_modes.fget(given)
    rivals = answers.ModalDiagnosis.alternatives.fget(given)
    assert [[(c["name"], c["where"]) for c in s] for s in rivals] == [
        [("joint_stiffness", ["6:X", "7:X"]), ("elasto_slip", ["7:X"])]
    ]
