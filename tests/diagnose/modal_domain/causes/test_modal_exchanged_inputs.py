"""Two points of a roving hammer exchanged, where every element of the simulation is off."""

import chains_off
import numpy as np
import pytest

from modalax.diagnose.modal_domain.causes.channel_faults import channel_faults
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes


def test_exchanged_hits_are_named_where_every_element_is_off():
    H = chains_off.response(*chains_off.chain_off(5, 0.02), chains_off.FREQ)[:, :, [0, 3, 2, 1, 4]]
    data = chains_off.as_measured(H, chains_off.FREQ, 5, outputs=(0, 2), inputs=(0, 1, 2, 3))
    found = diagnose_modes(data, chains_off.simulation())
    assert found.verdict == "named"
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", ["2:+Z", "4:+Z"])]
    assert found.gain.chi2_after < 2  # judged on lines, as no column foretells one of those exchanged


@pytest.mark.parametrize("kept", [[True, False, True], [False, True, True], [True, True, False]])
def test_faults_of_inputs_keep_their_places_among_those_that_are_left(kept):
    kept = np.array(kept)
    names = [name for name, k in zip("abc", kept, strict=True) if k]
    for fault in channel_faults(("1", "2"), ("a", "b", "c"), 100.0):
        own = fault.among(kept)
        if not fault.at_inputs or not fault.where:
            assert own is fault
        elif set(fault.where) <= set(names):
            numbers = own.channel if fault.slug == "channel_swap" else own.channel[1:]
            assert tuple(names[k] for k in numbers) == fault.where
        else:
            assert own is None
