"""A sensor that is wrong in a way without a name is told as that, and not as an element or a mass at its place."""

import numpy as np
import pytest
from frames import DOFS, measured, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes


def test_a_gain_that_wanders_over_the_lines_gets_no_name_but_its_sensor_is_told():
    data, _ = measured(21, 0.01)
    at, along = data.outputs.index(DOFS[8]), np.linspace(-1.0, 1.0, len(data.freq))
    gain = np.ones(data.H.shape)
    gain[:, :, at] *= (1 + 0.3 * np.sin(4 * along))[:, None]
    answer = diagnose_modes(data.replace(H=data.H * gain, variance=data.variance * gain**2), simulation()).to_dict()
    assert answer["verdict"] == "unknown"
    assert any(f"the FRFs at {DOFS[8]} alone differ" in r for r in answer["reasons"])
    assert f"the sensor at {DOFS[8]}" in answer["advice"] and "supports" not in answer["advice"]


@pytest.mark.slow  # of a smaller mass by default, where a mass stands out beyond the general inaccuracy
def test_a_mass_at_a_sensor_is_no_fault_of_that_sensor():
    data, _ = measured(22, 0.01, mass=(DOFS[8], 0.3))
    found = diagnose_modes(data, simulation())
    assert found.stage.odd is None
    assert [(c["name"], c["where"]) for c in found.to_dict()["causes"]] == [("added_mass", [DOFS[8]])]
