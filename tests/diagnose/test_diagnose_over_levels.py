"""Modes over the force level, beside modes that are set, and what is said of them."""

from dataclasses import replace

import numpy as np
import pytest
import test_diagnose_evidence as plain

from modalax.data.datasets import brake_reuss_beam
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.evidence import Compared, evidence_of
from modalax.diagnose.over_levels import levels_said, over_levels

SIGMA = 1e-6
MOVED = [[(20.0, 0.012), (45.0, 0.01), (140.0, 0.01)], [(20.0, 0.012), (44.8, 0.013), (140.0, 0.01)],
         [(20.0, 0.012), (44.5, 0.017), (140.0, 0.01)]]  # fmt: skip


def levels(modes, level, seed=0):
    """Receptances of the same shapes with other modes at each level, with noise, beside the first modes."""
    H = np.concatenate([plain.frf(m) for m in modes])
    measured = plain.noisy(H, SIGMA, seed)
    return plain.compared(measured, np.broadcast_to(plain.frf(), measured.shape), sigma=SIGMA, level=level)


def told(c):
    return {**evidence_of(c), "over_levels": over_levels(c)}


def test_modes_at_each_level_are_those_that_were_set_within_their_errors():
    found = over_levels(levels(MOVED, [4.0, 1.0, 9.0]))  # in any order of the runs
    assert found["level"] == [1.0, 4.0, 9.0]
    order = [1, 0, 2]
    for k, mode in enumerate(found["modes"]):
        f, zeta = (np.array([MOVED[run][k][j] for run in order]) for j in (0, 1))
        assert (np.abs(np.array(mode["frequency_hz"]) - f) < 4 * np.array(mode["frequency_std_hz"]) + 1e-4 * f).all()
        assert max(mode["frequency_std_hz"]) < 0.01
        assert (np.abs(np.array(mode["damping_ratio"]) / zeta - 1) < 0.02).all()
    assert len(found["modes"]) == 2
    change = [np.linalg.norm(H) for H in np.moveaxis(plain.frf(MOVED[2])[0] - plain.frf(MOVED[1])[0], 1, 0)]
    size = [np.linalg.norm(H) for H in np.moveaxis(plain.frf(MOVED[1])[0], 1, 0)]
    np.testing.assert_allclose(list(found["by_output"].values()), np.divide(change, size), rtol=0.02)


def test_one_measured_mode_near_two_of_the_simulation_is_told_once():
    c = levels(MOVED, [1.0, 4.0, 9.0])
    near = np.concatenate([c.modes, c.modes[:, 1:2] * [[1.001], [1.0]]], axis=1)
    assert len(over_levels(replace(c, modes=near))["modes"]) == len(over_levels(c)["modes"]) == 2


def test_what_is_said_where_nothing_explains_the_data():
    e = told(levels(MOVED, [1.0, 4.0, 9.0]))
    (said,) = levels_said("unknown", e)
    most = max(e["over_levels"]["by_output"], key=e["over_levels"]["by_output"].get)
    assert f"force levels of 1, 4, 9 N differ by more than noise, most at {most} (by " in said
    assert "a mode is at 45, 44.8, 44.5 Hz" in said and ", 1.3, 1.7 %" in said
    assert "at 20" not in said  # which stays
    assert levels_said("named", e) == () == levels_said("unknown", None)


@pytest.mark.parametrize("level", [[np.nan] * 3, [2.0] * 3], ids=["unknown", "all alike"])
def test_nothing_is_said_without_levels(level):
    e = told(levels(MOVED, level))
    assert e["over_levels"] is None and levels_said("unknown", e) == ()


def test_nothing_is_said_of_a_linear_structure():
    assert levels_said("unknown", told(levels([plain.MODES] * 3, [1.0, 4.0, 9.0]))) == ()


@pytest.mark.measured
def test_a_bolted_joint_that_bends_its_peak_is_told_at_every_level(measured):
    """One mode whose frequency falls and rises again and whose damping grows sixfold over four levels."""
    data = brake_reuss_beam(drive_point=True)
    H, near = np.asarray(data.H), np.zeros_like(np.asarray(data.H))
    residuals = (np.sqrt(2) * H / (0.02 * np.abs(H).mean()),) * 2
    c = Compared(
        np.asarray(data.freq), H, near, near, residuals, (Omnibus(0.5, 1.0, "each run", (0.0, 0.0)),) * 2,
        np.asarray(data.level), data.outputs, data.inputs, DERIVATIVES[data.form], np.array([[80.3], [0.002]]),
    )  # fmt: skip
    (mode,) = over_levels(c)["modes"]
    assert len(mode["frequency_hz"]) == len(H) == 4 and max(mode["frequency_std_hz"]) < 0.05
    assert mode["damping_ratio"][-1] > 4 * mode["damping_ratio"][0]
