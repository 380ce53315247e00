"""Causes that touch every channel, or one mode, in a chain or a beam whose every element is off."""

from collections.abc import Callable

import chains_off
import numpy as np
import pytest
import scipy.linalg
from frames import measured, simulation
from kinds import few_or_all

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.model import Structure

EITHER = pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])


def sound(structure: str, seed: int) -> tuple[Measurement, Structure]:
    """Accelerances of a structure whose every element is 2 % off, and what its author has of it."""
    return (measured(seed, 0.02)[0], simulation()) if structure == "beam" else chain(chains_off.chain_off(5, 0.02))


def chain(matrices: tuple, more: np.ndarray | float = 0.0) -> tuple[Measurement, Structure]:
    """Accelerances of a chain, ``more`` added, and what its author has of it."""
    H = chains_off.response(*matrices, chains_off.FREQ) + more
    return chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.simulation()


def told(
    data: Measurement, model: Structure | None = None, wanted: Callable[[str], bool] = lambda _: True
) -> dict:  # fmt: skip
    found = diagnose_modes(data, model or simulation(), wanted=wanted)
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert again.H.shape == found.predicted_after[0].shape
    return found.to_dict()


@EITHER
def test_wrong_units_are_named(structure):
    data, model = sound(structure, 11)
    s = 2j * np.pi * np.asarray(data.freq)[:, None, None]
    answer = told(data.replace(H=np.asarray(data.H) / s, variance=np.asarray(data.variance) / np.abs(s) ** 2), model)
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("units", [])]


@few_or_all("force_gain", "units")
@pytest.mark.parametrize(
    ("structure", "factor"),
    [
        ("chain", 1 / 9.80665),
        ("beam", -1.0),
        pytest.param("beam", 1 / 9.80665, marks=pytest.mark.slow),
        pytest.param("beam", 1000.0, marks=pytest.mark.slow),
    ],
)
def test_a_factor_on_all_frfs_is_named_and_no_mass_and_stiffness_that_are_off_alike(structure, factor, wanted):
    data, model = sound(structure, 20)
    data = data.replace(H=np.asarray(data.H) * factor, variance=np.asarray(data.variance) * factor**2)
    answer = told(data, model, wanted)
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


@few_or_all("structural_damping")
def test_noise_that_all_sensors_share_is_no_cause(wanted):
    """It makes one error of each line, which tells less of a pole than as much noise of every sensor by itself."""
    data, _ = measured(21, 0.0, lines=400, noise=0.002)
    rng, H = np.random.default_rng(8), np.asarray(data.H)
    line = (rng.standard_normal((1, 400, 1, 2)) + 1j * rng.standard_normal((1, 400, 1, 2))) / np.sqrt(2)
    variance = np.asarray(data.variance) + 0.1**2 * np.abs(H) ** 2
    answer = told(data.replace(H=H * (1 + 0.1 * line), variance=variance), wanted=wanted)
    assert answer["verdict"] == "clean", answer["causes"]
    assert any("noise of all outputs is common" in note for note in answer["notes"])


@few_or_all("sensor_filter", "force_gain")
@EITHER
def test_a_delay_of_all_sensors_is_named_as_one(structure, wanted):
    data, model = sound(structure, 12)
    turn = np.exp(-2j * np.pi * np.asarray(data.freq) * 2e-4)[:, None, None]
    answer = told(data.replace(H=np.asarray(data.H) * turn), model, wanted)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("time_delay", [])]
    delay = answer["causes"][0]["parameters"]["delay"]
    assert delay["value"] == pytest.approx(2e-4, abs=5 * delay["std"])
    assert delay["std"] < 1e-5


@few_or_all("modal_damping", "structural_damping", "hysteretic_joint", "sensor_filter")
def test_the_damping_of_one_mode_stands_out_beyond_what_is_usual(wanted):
    data, _ = measured(13, 0.005, damping=(3, 4.0))
    answer = told(data, wanted=wanted)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("modal_damping", [3])]
    assert answer["causes"][0]["parameters"]["relative_change"]["value"] == pytest.approx(3.0, rel=0.2)


@pytest.mark.slow  # by default at a chain of fewer modes than are measured, among what a small chain shows
@pytest.mark.parametrize("off", [0.01, 0.03])
def test_an_attached_oscillator_is_named_at_its_place(off):
    data, _ = measured(14, off, oscillator=("7:+Z", 0.02, 75.0, 0.01))
    answer = told(data)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("tuned_mass", ["7:+Z"])]
    values = answer["causes"][0]["parameters"]
    for name, true in (("mass", 0.02), ("frequency", 75.0), ("damping_ratio", 0.01)):
        assert values[name]["value"] == pytest.approx(true, abs=5 * values[name]["std"])
        assert values[name]["std"] < 0.2 * true


@pytest.mark.parametrize(
    ("structure", "hz", "off"),
    [
        ("chain", 75.0, 0.02),
        pytest.param("beam", 150.0, 0.01, marks=pytest.mark.slow),
        pytest.param("beam", 150.0, 0.03, marks=pytest.mark.slow),
    ],
)
def test_a_mode_that_the_simulation_has_not_is_named(structure, hz, off):
    """A block of lines that hides all of the beam's lowest, narrow peak is foretold as well as the others know it."""
    if structure == "beam":
        found = diagnose_modes(measured(15, off, extra=hz)[0], simulation())
    else:
        shape, s, w = (
            np.array([0.9, -1.2, 0.2, -0.3, -0.2]),
            2j * np.pi * chains_off.FREQ[:, None, None],
            2 * np.pi * hz,
        )
        more = s**2 * np.outer(shape, shape) / (s**2 + 2 * 0.01 * w * s + w**2)
        found = diagnose_modes(*chain(chains_off.chain_off(5, off), more))
    assert [(c["name"], c["where"]) for c in found.causes] == [("missing_mode", [])]
    frequency = found.causes[0]["parameters"]["frequency"]
    assert frequency["value"] == pytest.approx(hz, abs=5 * frequency["std"])
    assert found.gain.chi2_unforeseen < 1.2  # beyond the errors of what was fitted to the other lines
    assert found.gain.chi2_after < (0.1 if structure == "beam" else 0.01) * found.gain.chi2_before


@pytest.mark.parametrize("share", [pytest.param(1.0, marks=pytest.mark.slow), 0.4])
@pytest.mark.parametrize(
    ("structure", "off"),
    [("chain", 0.02), *(pytest.param("beam", off, marks=pytest.mark.slow) for off in (0.01, 0.02))],
)
@few_or_all("structural_damping", "modal_damping", "exponential_window", "hysteretic_joint")
def test_hysteretic_damping_is_named_by_the_phases_of_residues(structure, off, share, wanted):
    if structure == "beam":
        answer = told(measured(16, off, hysteretic=share)[0], wanted=wanted)
    else:
        M, C, K = chains_off.chain_off(5, off)
        w2, P = scipy.linalg.eigh(K, M)
        lossy = M @ P @ np.diag(1j * np.diag(P.T @ C @ P) * np.sqrt(w2)) @ P.T @ M
        answer = told(*chain((M, (1 - share) * C, K + share * lossy)), wanted)
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("structural_damping", [])]
    found = answer["causes"][0]["parameters"]["share"]
    assert found["value"] == pytest.approx(share, abs=4 * found["std"])
    assert found["std"] < 0.1
