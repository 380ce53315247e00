"""Mains hum beside a simulation that is off: seen on lines only, and not where there is none."""

import chains_off
import numpy as np
import pytest
from frames import measured, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.records.mains import mains_hum, near_mains


@pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])
def test_hum_is_named_where_all_elements_are_off(structure):
    if structure == "beam":
        data, model, tones = measured(6, 0.01, lines=327)[0], simulation(), (50.0, 150.0)
    else:
        freq, model, tones = np.arange(12.0, 161.0, 0.5), chains_off.simulation(), (50.0, 150.0)
        H = chains_off.response(*chains_off.chain_off(5, 0.02), freq)
        data = chains_off.as_measured(H, freq, 5)
    H = np.array(data.H)
    rng = np.random.default_rng(1)
    for f in tones:
        k = int(np.abs(data.freq - f).argmin())
        H[:, k] += 0.5 * np.abs(H).max() * np.exp(2j * np.pi * rng.random(H[:, k].shape))
    answer = diagnose_modes(data.replace(H=H), model).to_dict()
    assert (answer["verdict"], [c["name"] for c in answer["causes"]]) == ("named", ["mains_hum"])
    assert answer["causes"][0]["probability"] > 0.95
    assert any("50" in reason and "hum" in reason for reason in answer["reasons"])
    assert answer["gain"]["chi2_after"] < 1.2  # of the lines without it


def test_a_residual_of_noise_alone_is_not_looked_at_for_hum():
    data, _ = measured(6, 0.01, lines=327)
    noise = np.random.default_rng(2).normal(size=(1, 327, 8, 2)) + 0j
    assert mains_hum(data, np.asarray(data.freq), noise) is None
    freq = np.arange(45.0, 125.0, 0.5)
    assert {50.0, 60.0, 100.0, 120.5} <= set(freq[near_mains(freq, freq > 0)]) <= {*freq} - {46.0, 55.0, 75.0, 112.0}


def test_beside_a_joint_hum_must_stand_in_the_lowest_level():
    """A joint that jumps at a line of the highest level looks like hum there; hum is there at each level."""
    data, _ = measured(6, 0.01, lines=327)
    k = int(np.abs(data.freq - 150.0).argmin())
    spikes = 0.5 * np.abs(data.H).max() * np.exp(2j * np.pi * np.random.default_rng(3).random(data.H[0, k].shape))
    for runs, seen in (([0, 1], True), ([1], False)):
        H = np.repeat(np.array(data.H), 2, axis=0)
        residual = np.ones(H.shape, complex)
        for run in runs:
            H[run, k] += spikes
            residual[run, k] = 100.0
        both = data.replace(H=H, variance=np.repeat(data.variance, 2, axis=0), level=np.array([1.0, 3.0]))
        assert (mains_hum(both, np.asarray(data.freq), residual, joint=True) is not None) is seen
    assert mains_hum(both, np.asarray(data.freq), residual) is not None
