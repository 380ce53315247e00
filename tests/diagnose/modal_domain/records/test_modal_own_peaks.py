"""The mass of a sensor that roves, found in a chain whose every element is off."""

from dataclasses import replace

import numpy as np
import pytest
from chains_off import DOFS, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain import diagnosis
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.records.own_peaks import mass_of_sensor, own_peaks, without_output
from modalax.diagnose.modal_domain.stage import identified, run_stage

LINES = np.linspace(12.0, 110.0, 150)
OUTPUTS, LOADED, MASS = (0, 1, 3, 4), 3, 0.15  # measured DoFs, the one with the roving sensor, and its mass [kg]
LIGHT = 0.003  # mass of a sensor [kg] that moves one peak alone by more than the noise


def loaded(seed: int, mass: float = MASS):
    """FRFs of which those at one output are of the structure with a sensor's mass there."""
    M, C, K = chain_off(seed, 0.02)
    H = response(M, C, K, LINES)
    H[:, LOADED] = response(M + np.diag(np.eye(5)[LOADED] * mass), C, K, LINES)[:, LOADED]
    return as_measured(H, LINES, seed)


def on_a_soft_foot(seed: int):
    """FRFs of which those at one output have the resonance of the sensor's own foot as well."""
    H = response(*chain_off(seed, 0.02), LINES)
    r = LINES / 75.0
    H[:, LOADED] *= ((1 + 0.04j * r) / (1 - r**2 + 0.04j * r))[:, None]
    return as_measured(H, LINES, seed)


@pytest.mark.parametrize("mass", [MASS, 0.02])  # the lighter one moves peaks by less than their width
def test_the_output_whose_peaks_are_its_own_is_told_without_a_simulation(mass):
    data = loaded(4, mass)
    found = identified(data, simulation(), lambda _: None)
    assert own_peaks(found, *data.H.shape[2:]) == OUTPUTS.index(LOADED)


@pytest.mark.parametrize(("light", "told"), [(True, OUTPUTS.index(LOADED)), (False, None)])
def test_a_single_peak_of_its_own_tells_it_where_another_is_missing_there(light, told):
    data = loaded(4, LIGHT) if light else on_a_soft_foot(4)
    found = identified(data, simulation(), lambda _: None)
    assert len(found.modes.poles) == 6
    assert own_peaks(found, *data.H.shape[2:]) == told


def test_no_output_is_told_where_all_have_the_same_peaks():
    data = as_measured(response(*chain_off(4, 0.02), LINES), LINES, 4)
    assert own_peaks(identified(data, simulation(), lambda _: None), *data.H.shape[2:]) is None


def test_an_output_is_left_out_with_its_variance():
    data = loaded(4)
    less = without_output(data, 2)
    kept = [0, 1, 3]
    assert less.outputs == tuple(data.outputs[k] for k in kept)
    assert np.array_equal(less.H, np.asarray(data.H)[:, :, kept])
    assert np.array_equal(less.variance, np.asarray(data.variance)[:, :, kept])


def test_no_mass_is_told_where_the_output_only_tells_more_of_the_structure():
    data = as_measured(response(*chain_off(4, 0.02), LINES), LINES, 4)
    which, late = 0, Deadline()
    stage = run_stage(without_output(data, which), simulation(), late, lambda _: False, lambda _: None)
    assert stage is not None
    sizes = stage.best.fit.sizes + 0.01  # as where the other outputs leave some of it open
    vague = replace(stage, explanations=[replace(stage.best, fit=replace(stage.best.fit, sizes=sizes))])
    assert mass_of_sensor(vague, data, identified(data, simulation(), lambda _: None), which, late) is None


@pytest.mark.slow
def test_its_mass_is_named_at_its_place():
    found = diagnose_modes(loaded(4), simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("sensor_mass", [DOFS[LOADED]])]
    told = answer["causes"][0]["parameters"]["mass"]
    assert told["value"] == pytest.approx(MASS, abs=4 * told["std"]) and told["std"] < 0.05 * MASS
    again = found.extended.frf(found.freq, form="accelerance", outputs=found.stage.measurement.outputs,
                               inputs=found.stage.measurement.inputs)  # fmt: skip
    assert np.abs(again.H - found.predicted_after[0]).max() < 0.02 * np.abs(found.predicted_after).max()


@pytest.mark.parametrize(("load", "asked"), [(MASS, True), (0.0, False)])
def test_no_mass_is_looked_for_where_what_explains_the_others_explains_all_outputs(monkeypatch, load, asked):
    """An output that hardly shows a mode had seemed to have peaks of its own, and the search took a minute."""
    monkeypatch.setattr(diagnosis, "own_peaks", lambda *_: OUTPUTS.index(LOADED))
    sought = []
    monkeypatch.setattr(diagnosis, "mass_of_sensor", lambda *_: sought.append(True))
    data = loaded(4, load)
    wanted = lambda slug: slug in ("added_mass", "sensor_mass")
    task = diagnosis._Task(simulation(), Deadline(), wanted, lambda _: None)
    diagnosis._beside_own_peaks(data, task, identified(data, simulation(), lambda _: None))
    assert sought == [True] * asked
