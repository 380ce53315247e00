"""Causes that touch every channel, or one mode, in a beam whose every element is off."""

import numpy as np
import pytest
from frames import measured, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes


def told(data) -> dict:
    found = diagnose_modes(data, simulation())
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert again.H.shape == found.predicted_after[0].shape
    return found.to_dict()


def test_wrong_units_are_named():
    data, _ = measured(11, 0.02)
    s = 2j * np.pi * np.asarray(data.freq)[:, None, None]
    answer = told(data.replace(H=np.asarray(data.H) / s, variance=np.asarray(data.variance) / np.abs(s) ** 2))
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("units", [])]


@pytest.mark.parametrize("factor", [1 / 9.80665, -1.0, 1000.0])
def test_a_factor_on_all_frfs_is_named_and_no_mass_and_stiffness_that_are_off_alike(factor):
    data, _ = measured(20, 0.02)
    answer = told(data.replace(H=np.asarray(data.H) * factor, variance=np.asarray(data.variance) * factor**2))
    assert answer["verdict"] == "named", answer["reasons"]
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("force_gain", [])]
    gain = answer["causes"][0]["parameters"]["gain"]
    assert abs(gain["value"] - (factor - 1)) < 4 * gain["std"] < 0.1 * abs(factor)


def test_the_mass_of_all_sensors_is_one_cause():
    S, off = simulation(), 0.01
    M = np.asarray(S.M).copy()
    data, K = measured(22, off)
    at = [S.dofs.index(name) for name in data.outputs]
    M[at, at] += 0.004
    C = np.asarray(S.C)
    freq, inputs = np.asarray(data.freq), [S.dofs.index(name) for name in data.inputs]
    s = 2j * np.pi * freq[:, None, None]
    H = np.linalg.inv(K + s * C + s**2 * M)[:, at][:, :, inputs] * s**2
    rng, sigma = np.random.default_rng(22), np.sqrt(np.asarray(data.variance)[0])
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    answer = told(data.replace(H=(H + sigma * noise)[None]))
    assert answer["verdict"] == "named", answer["reasons"]
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("added_mass", [name]) for name in data.outputs]
    assert any("added_mass at 8 places" in r for r in answer["reasons"])
    for cause in answer["causes"]:
        mass = cause["parameters"]["mass"]
        assert abs(mass["value"] - 0.004) < 3 * mass["std"] < 0.002


def test_noise_that_all_sensors_share_is_no_cause():
    """It makes one error of each line, which tells less of a pole than as much noise of every sensor by itself."""
    data, _ = measured(21, 0.0, lines=400, noise=0.002)
    rng, H = np.random.default_rng(8), np.asarray(data.H)
    line = (rng.standard_normal((1, 400, 1, 2)) + 1j * rng.standard_normal((1, 400, 1, 2))) / np.sqrt(2)
    variance = np.asarray(data.variance) + 0.1**2 * np.abs(H) ** 2
    answer = told(data.replace(H=H * (1 + 0.1 * line), variance=variance))
    assert answer["verdict"] == "clean", answer["causes"]
    assert any("noise of all outputs is common" in note for note in answer["notes"])


def test_a_delay_of_all_sensors_is_named_as_one():
    data, _ = measured(12, 0.02)
    turn = np.exp(-2j * np.pi * np.asarray(data.freq) * 2e-4)[:, None, None]
    answer = told(data.replace(H=np.asarray(data.H) * turn))
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("time_delay", [])]
    delay = answer["causes"][0]["parameters"]["delay"]
    assert delay["value"] == pytest.approx(2e-4, abs=5 * delay["std"])
    assert delay["std"] < 1e-5


def test_the_damping_of_one_mode_stands_out_beyond_what_is_usual():
    data, _ = measured(13, 0.005, damping=(3, 4.0))
    answer = told(data)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("modal_damping", [3])]
    assert answer["causes"][0]["parameters"]["relative_change"]["value"] == pytest.approx(3.0, rel=0.2)


@pytest.mark.parametrize("off", [pytest.param(0.01, marks=pytest.mark.slow), 0.03])
def test_an_attached_oscillator_is_named_at_its_place(off):
    data, _ = measured(14, off, oscillator=("7:+Z", 0.02, 75.0, 0.01))
    answer = told(data)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("tuned_mass", ["7:+Z"])]
    values = answer["causes"][0]["parameters"]
    for name, true in (("mass", 0.02), ("frequency", 75.0), ("damping_ratio", 0.01)):
        assert values[name]["value"] == pytest.approx(true, abs=5 * values[name]["std"])
        assert values[name]["std"] < 0.2 * true


@pytest.mark.parametrize("off", [pytest.param(0.01, marks=pytest.mark.slow), 0.03])
def test_a_mode_that_the_simulation_has_not_is_named(off):
    data, _ = measured(15, off, extra=150.0)
    answer = told(data)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("missing_mode", [])]
    frequency = answer["causes"][0]["parameters"]["frequency"]
    assert frequency["value"] == pytest.approx(150.0, abs=5 * frequency["std"])
    assert answer["gain"]["chi2_after"] < 0.01 * answer["gain"]["chi2_before"]


@pytest.mark.parametrize("off, share", [pytest.param(0.01, 1.0, marks=pytest.mark.slow), (0.02, 1.0), (0.02, 0.4)])
def test_hysteretic_damping_is_named_by_the_phases_of_residues(off, share):
    data, _ = measured(16, off, hysteretic=share)
    answer = told(data)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("structural_damping", [])]
    found = answer["causes"][0]["parameters"]["share"]
    assert found["value"] == pytest.approx(share, abs=4 * found["std"])
    assert found["std"] < 0.1
