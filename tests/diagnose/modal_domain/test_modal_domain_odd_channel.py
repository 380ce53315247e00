"""A sensor that is wrong in a way without a name is told as that, and not as an element or a mass at its place."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frames import DOFS, measured, simulation

from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.judged import judge
from modalax.diagnose.modal_domain.odd_channel import only_output


def test_a_gain_that_wanders_over_the_lines_gets_no_name_but_its_sensor_is_told():
    data, _ = measured(21, 0.01)
    at, along = data.outputs.index(DOFS[8]), np.linspace(-1.0, 1.0, len(data.freq))
    gain = np.ones(data.H.shape)
    gain[:, :, at] *= (1 + 0.3 * np.sin(4 * along))[:, None]
    answer = diagnose_modes(data.replace(H=data.H * gain, variance=data.variance * gain**2), simulation()).to_dict()
    assert answer["verdict"] == "unknown"
    assert any(f"the FRFs at {DOFS[8]} alone differ" in r for r in answer["reasons"])
    assert f"the sensor at {DOFS[8]}" in answer["advice"] and "supports" not in answer["advice"]


@pytest.mark.parametrize("share", [-0.05, 0.2])
def test_a_force_that_also_acts_elsewhere_is_told_with_its_share_and_has_no_name(share):
    data, _ = measured(23, 0.01, stray=(DOFS[10], share))
    found = diagnose_modes(data, simulation())
    answer, odd = found.to_dict(), found.stage.odd
    assert answer["verdict"] == "unknown", answer["causes"]
    assert odd is not None and (odd.name, odd.force, odd.along) == (DOFS[4], True, DOFS[10])
    assert abs(odd.share / share - 1) < 0.1 and odd.nats > 20.0
    assert any(f"of it also acted at {DOFS[10]}" in r for r in answer["reasons"]), answer["reasons"]
    assert not any("generally off" in r for r in answer["reasons"])  # which stood for the share
    assert f"the force at {DOFS[4]}" in answer["advice"]


def test_a_sensor_that_also_measures_the_rotation_of_its_point_is_told_as_that():
    data, _ = measured(24, 0.01, tilted=(DOFS[8], DOFS[9], 0.03))
    odd = diagnose_modes(data, simulation()).stage.odd
    assert odd is not None and (odd.name, odd.force, odd.along) == (DOFS[8], False, DOFS[9])
    assert abs(odd.share / 0.03 - 1) < 0.15


def test_a_mode_of_one_sensor_is_no_mode_that_the_simulation_lacks():
    """The resonance of a cable or a mount, whose peak is as large as the channel and whose foot is 3 % of it."""
    data, _ = measured(21, 0.0)
    at, s = data.outputs.index(DOFS[8]), 2j * np.pi * np.asarray(data.freq)
    own = 2 * np.pi * 1.07 * float(np.median(data.freq))
    gain = np.ones(data.H.shape, complex)
    gain[:, :, at] *= (1 + 0.03 * own**2 / (s**2 + 0.03 * own * s + own**2))[:, None]
    answer = diagnose_modes(data.replace(H=data.H * gain), simulation()).to_dict()
    assert answer["verdict"] == "unknown", answer["causes"]
    assert any(f"shows at {DOFS[8]} alone" in r for r in answer["reasons"]), answer["reasons"]


def test_a_mode_is_of_one_output_only_if_the_others_show_that_they_have_none():
    rng = np.random.default_rng(3)
    noise = (rng.standard_normal((4, 6, 2)) + 1j * rng.standard_normal((4, 6, 2))) / np.sqrt(2)
    f = SimpleNamespace(residues=noise)
    f.residues[0, 2] += 12.0  # clearly at one output
    f.residues[1, 2] += 1.0  # so weak that others may have as much
    f.residues[2] += 12.0 * rng.standard_normal((6, 1))
    f.residues[3, 2:4] += 12.0  # at two
    assert [only_output(f, k) for k in range(4)] == [2, None, None, None]
    assert only_output(SimpleNamespace(residues=f.residues[:, 2:4]), 0) is None  # of two outputs nobody can tell


def test_a_channel_that_is_hardly_likelier_than_nothing_is_not_told():
    """A clean answer keeps its general inaccuracy and has no advice then."""
    data, _ = measured(22, 0.01)
    found = diagnose_modes(data, simulation())
    assert found.verdict == "clean" and found.stage.odd is None and found.advice is None
    for nats, told in ((2.0, False), (4.0, True)):
        odd = OddChannel(DOFS[4], True, nats, DOFS[10], 0.1)
        judged = judge(replace(found.stage, odd=odd))
        assert (judged.odd is odd, judged.word) == (told, "unknown" if told else "clean")
    assert any("generally off" in r for r in found.reasons)


@pytest.mark.slow  # of a smaller mass by default, where a mass stands out beyond the general inaccuracy
def test_a_mass_at_a_sensor_is_no_fault_of_that_sensor():
    data, _ = measured(22, 0.01, mass=(DOFS[8], 0.3))
    found = diagnose_modes(data, simulation())
    assert found.stage.odd is None
    assert [(c["name"], c["where"]) for c in found.to_dict()["causes"]] == [("added_mass", [DOFS[8]])]
