"""Measured DoFs that the simulation writes otherwise."""

import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.causes.channels import ChannelGain, ChannelSign
from modalax.diagnose.causes.local import AddedMass, JointStiffness
from modalax.diagnose.setup.turned import turned, turned_modes
from modalax.model import Structure
from modalax.model.mode_table import ModeTable

SIMULATED = ("1:+Z", "2:+Z", "3:-Z", "tip")


def measured(outputs, inputs=("1:+Z",), kind=Measurement):
    H = np.arange(1.0, 11.0)[:, None, None] * (1 + np.arange(len(outputs))[:, None]) * np.ones(len(inputs)) + 0j
    H = H if kind is FRF else H[None]
    return kind(np.arange(1.0, 11.0), H, form="receptance", outputs=outputs, inputs=inputs)


@pytest.mark.parametrize("kind", [Measurement, FRF])
def test_a_channel_that_counts_the_other_way_is_turned_and_told(kind):
    before = measured(("1:+Z", "2:-Z", "3:+Z", "tip"), ("2:-Z", "1:Z"), kind)
    after, said = turned(before, SIMULATED)
    assert (after.outputs, after.inputs) == (SIMULATED, ("2:+Z", "1:+Z"))
    signs = np.array([1, -1, -1, 1])[:, None] * np.array([-1, 1])
    np.testing.assert_array_equal(after.H, np.asarray(before.H) * signs)
    assert said == (
        "measured 1:Z is 1:+Z of the simulation, in the same direction",
        "measured 2:-Z is 2:+Z of the simulation, turned", "measured 3:+Z is 3:-Z of the simulation, turned",
    )  # fmt: skip


def test_names_that_are_there_or_are_not_in_either_direction_stay():
    before = measured(("1:+Z", "2:+X", "5:+Z"))
    after, said = turned(before, SIMULATED)
    assert after is before and said == ()
    both = measured(("1:+Z", "1:-Z"))  # two sensors at one place: which is the simulation's is told by its name
    assert turned(both, SIMULATED)[0] is both
    once, _ = turned(measured(("1:Z", "1:-Z")), SIMULATED)  # two that would be one: the second stays and is refused
    assert once.outputs == ("1:+Z", "1:-Z")


def test_shapes_of_modes_alone_are_turned():
    table = ModeTable.of([3.0, 5.0], 0.01, np.array([[1.0, 2.0], [3.0, -1.0]]), ["1:+Z", "2:-Z"])
    after, said = turned_modes(table, SIMULATED)
    assert after.dofs == ("1:+Z", "2:+Z") and len(said) == 1
    np.testing.assert_array_equal(after.shapes, table.shapes * np.array([1, -1]))


def test_a_diagnosis_of_turned_channels_is_that_of_the_others():
    K = np.array([[3e4, -2e4, 0], [-2e4, 4e4, -2e4], [0, -2e4, 2.5e4]])
    M = np.diag([1.0, 2.0, 1.0])
    names = ("1:+Z", "2:+Z", "3:+Z")
    S = Structure(M, 1e-4 * K + 0.2 * M, K, names)
    freq, rng = np.linspace(5.0, 45.0, 240), np.random.default_rng(4)
    H = np.asarray(S.frf(freq, form="receptance", outputs=names, inputs=("1:+Z",)).H)[None]
    sigma = 0.01 * np.abs(H).mean() * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    H[:, :, 1] *= -1
    data = Measurement(
        freq, H, form="receptance", outputs=("1:+Z", "2:-Z", "3:+Z"), inputs=("1:+Z",), variance=sigma**2
    )
    found = diagnose(data, S, causes=[JointStiffness(), AddedMass(), ChannelGain(), ChannelSign()])
    assert found.verdict == "clean", found.reasons
    assert found.to_dict()["reasons"][-1] == "measured 2:-Z is 2:+Z of the simulation, turned"
