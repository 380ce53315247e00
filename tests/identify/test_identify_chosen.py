"""Modes picked, dropped and added by frequency, and channels left out."""

import jax
import numpy as np
import pytest

from modalax.identify import fit
from modalax.identify.chosen import Choice, choice_of, chosen_poles
from modalax.model.examples import five_dof

TRUE = np.asarray(five_dof().modal().frequency_hz)
BAND = (20.0, 70.0)


@pytest.fixture(scope="module")
def frf():
    return five_dof().frf(np.linspace(*BAND, 251), inputs=["1"]).add_noise(jax.random.key(0), 0.01)


@pytest.fixture(scope="module")
def plain(frf):
    return fit(frf, refine=False)


def found(result) -> np.ndarray:
    return np.asarray(result.model.frequency_hz)[np.asarray(result.inside)]


def test_picked_modes_are_fitted_alone(frf):
    result = fit(frf, refine=False, pick=[float(TRUE[3]) * 1.005, float(TRUE[0])])
    np.testing.assert_allclose(found(result), TRUE[[0, 3]], rtol=2e-3)


def test_a_dropped_mode_is_gone_and_the_others_stay(frf, plain):
    result = fit(frf, refine=False, drop=[float(TRUE[1])])
    np.testing.assert_allclose(found(result), np.delete(found(plain), 1), rtol=1e-12)


def test_an_added_mode_is_there(frf, plain):
    result = fit(frf, refine=False, add=[47.0])
    assert len(found(result)) == len(found(plain)) + 1
    assert np.abs(found(result) - 47.0).min() < 1e-9


def test_what_cannot_be_chosen(plain):
    table, poles = plain.table, plain.model.poles
    with pytest.raises(ValueError, match="no mode within 2% of 47 Hz to drop; modes found: "):
        chosen_poles(Choice(drop=[47.0]), poles, table)
    with pytest.raises(ValueError, match="modes found"):
        chosen_poles(Choice(pick=[47.0]), poles, table)
    with pytest.raises(ValueError, match="every mode is dropped"):
        chosen_poles(Choice(drop=[float(f) for f in np.asarray(plain.model.frequency_hz)]), poles, table)
    with pytest.raises(ValueError, match="add names 90 Hz; the band is 20 to 70 Hz"):
        choice_of(None, None, [90.0], BAND)
    with pytest.raises(ValueError, match="pick names nan Hz"):
        choice_of([float("nan")], None, None, BAND)
    with pytest.raises(ValueError, match="drop has nothing to do"):
        choice_of([30.0], [40.0], None, BAND)


@pytest.mark.slow
def test_picked_modes_are_refined_with_error_bars(frf):
    result = fit(frf, pick=[float(f) for f in TRUE])
    std = np.asarray(result.refined.frequency_std_hz)
    assert (std > 0).all() and (np.abs(found(result) - TRUE) < 5 * std).all()


def test_channels_are_left_out(frf):
    left = frf.drop(["2", "4"])
    assert left.outputs == ("1", "3", "5") and left.inputs == ("1",)
    np.testing.assert_array_equal(left.H, frf.H[:, [0, 2, 4]])
    with pytest.raises(ValueError, match="no channel named '9' to leave out"):
        fit(frf, without=["9"])
    with pytest.raises(ValueError, match="no channel named '9' to leave out; there are 1, 2, 3, 4, 5"):
        frf.drop(["9"])
    with pytest.raises(ValueError, match="without 1 there are 4 outputs and 0 inputs left"):
        frf.drop(["1"])
