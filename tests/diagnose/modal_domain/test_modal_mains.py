"""Mains hum beside a simulation that is off: seen on lines only, and not where there is none."""

import numpy as np
from frames import measured, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.mains import mains_hum, near_mains


def test_hum_is_named_where_all_elements_are_off():
    data, _ = measured(6, 0.01, lines=327)  # a line each hertz
    H = np.array(data.H)
    rng = np.random.default_rng(1)
    for f in (50.0, 150.0):
        k = int(np.abs(data.freq - f).argmin())
        H[:, k] += 0.5 * np.abs(H).max() * np.exp(2j * np.pi * rng.random(H[:, k].shape))
    answer = diagnose_modes(data.replace(H=H), simulation()).to_dict()
    assert (answer["verdict"], [c["name"] for c in answer["causes"]]) == ("named", ["mains_hum"])
    assert answer["causes"][0]["probability"] > 0.95
    assert any("50" in reason and "hum" in reason for reason in answer["reasons"])


def test_a_residual_of_noise_alone_is_not_looked_at_for_hum():
    data, _ = measured(6, 0.01, lines=327)
    noise = np.random.default_rng(2).normal(size=(1, 327, 8, 2)) + 0j
    assert mains_hum(data, np.asarray(data.freq), noise) is None
    freq = np.arange(45.0, 125.0, 0.5)
    assert {50.0, 60.0, 100.0, 120.5} <= set(freq[near_mains(freq, freq > 0)]) <= {*freq} - {46.0, 55.0, 75.0, 112.0}
