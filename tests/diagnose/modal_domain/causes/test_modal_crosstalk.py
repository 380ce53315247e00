"""A channel that hears another in the modal domain: its slope, and hidden in a beam that is off."""

import chains_off
import numpy as np
import pytest
from frames import DOFS, measured, simulation

from modalax.diagnose.modal_domain.causes.channel_faults import leaking_channels
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes

OUTPUTS = DOFS[::2]


def test_its_slope_is_that_of_finite_differences():
    leak, R = leaking_channels(OUTPUTS)[1], np.random.default_rng(0).normal(size=(4, len(OUTPUTS), 2)) + 0j
    change = leak.transform(np.array([0.3 + 1e-6]), R[:, 0, 0], R) - leak.transform(np.array([0.3]), R[:, 0, 0], R)
    assert np.allclose(change / 1e-6, leak.transform_slope(np.array([0.3]), R[:, 0, 0], R), atol=1e-8)
    assert np.flatnonzero(np.abs(change).max(axis=(0, 2))).tolist() == [0]  # the first hears the second
    assert np.allclose(change[:, 0] / 1e-6, leak.scale * R[:, 2], atol=1e-8)


@pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])
def test_a_channel_that_hears_another_is_no_gain_where_all_elements_are_off(structure):
    if structure == "beam":
        data, model, own, other = measured(4, 0.01)[0], simulation(), 2, 6
    else:
        H = chains_off.response(*chains_off.chain_off(5, 0.02), chains_off.FREQ)
        data, model, own, other = chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.simulation(), 0, 3
    H = np.array(data.H)
    H[:, :, own] += 0.07 * H[:, :, other]
    answer = diagnose_modes(data.replace(H=H), model).to_dict()
    assert answer["verdict"] == "named"
    where = [data.outputs[own], data.outputs[other]]
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("crosstalk", where)]
    share = answer["causes"][0]["parameters"]["share"]
    assert abs(share["value"] - 0.07) < 4 * share["std"] < 0.02
