"""An impact window in the modal domain: closed forms, and hidden in a beam that is off."""

import chains_off
import numpy as np
import pytest
from frames import DOFS, measured, simulation
from kinds import few_or_all

from modalax.diagnose.modal_domain.causes.impact_window import impact_windows
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of, modes_of

OUTPUTS, INPUTS = DOFS[::2], (DOFS[4], DOFS[14])


@pytest.fixture(scope="module")
def coordinates():
    return coordinates_of(simulation(), OUTPUTS, INPUTS, 2 * np.pi * 330)


def window_of(c, order=0):
    return impact_windows(c, np.arange(5), order)[0]


def test_a_window_moves_all_poles_by_its_decay_and_keeps_their_residues(coordinates):
    window = window_of(coordinates)
    decay = 3.7
    plain = modes_of(coordinates)
    moved = modes_of(coordinates, **{f"d{k}": v for k, v in window.changes(np.array([decay / window.scale])).items()})
    assert np.allclose(moved.poles, plain.poles - decay, rtol=1e-9)
    size = np.abs(plain.vectors @ coordinates.outputs.T)
    assert np.allclose(np.abs(moved.vectors @ coordinates.outputs.T), size, atol=1e-6 * size.max())
    told = window.told(np.array([decay / window.scale]), np.eye(1))["decay"]
    assert told["value"] == pytest.approx(decay) and told["unit"] == "1/s"


def test_slopes_are_those_of_finite_differences_and_no_window_grows(coordinates):
    window, step = window_of(coordinates), 1e-6
    for kind, slope in window.slopes(np.array([0.7]))[0].items():
        change = window.changes(np.array([0.7 + step]))[kind] - window.changes(np.array([0.7]))[kind]
        assert np.allclose(change / step, slope, atol=1e-4 * np.abs(slope).max())
    assert not any(v.any() for v in window.changes(np.array([-0.5])).values())
    window, R = window_of(coordinates, 2), np.random.default_rng(0).normal(size=(4, 3, 2)) + 0j
    poles = -2.0 + 1j * np.array([20.0, 50.0, 90.0, 200.0])
    change = window.transform(np.array([0.3 + step]), poles, R) - window.transform(np.array([0.3]), poles, R)
    assert np.allclose(change / step, window.transform_slope(np.array([0.3]), poles, R), atol=1e-5)


@few_or_all("exponential_window", "structural_damping", "modal_damping", "hysteretic_joint")
@pytest.mark.parametrize("structure", ["chain", pytest.param("beam", marks=pytest.mark.slow)])
def test_an_impact_window_is_named_where_all_elements_are_off(structure, wanted):
    if structure == "beam":
        data, model = measured(3, 0.01, decay=8.0)[0], simulation()
    else:
        (M, C, K), s = chains_off.chain_off(5, 0.02), 2j * np.pi * chains_off.FREQ[:, None, None] + 8.0
        H = s**2 * np.linalg.inv(s**2 * M + s * C + K)
        data, model = chains_off.as_measured(H, chains_off.FREQ, 5), chains_off.simulation()
    found = diagnose_modes(data, model, wanted=wanted)
    answer = found.to_dict()
    assert (answer["verdict"], [c["name"] for c in answer["causes"]]) == ("named", ["exponential_window"])
    decay = answer["causes"][0]["parameters"]["decay"]
    assert abs(decay["value"] - 8.0) < 4 * decay["std"] + 0.4
    damping = np.asarray(found.extended.base.C) / np.maximum(np.abs(np.asarray(model.C)).max(), 1e-300)
    assert np.abs(damping).max() < 3  # the structure itself has no window
    assert [type(c).__name__ for c in found.extended.causes] == ["ExponentialWindow"]
