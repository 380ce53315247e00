"""Causes that act on one sensor, screened on its rows alone and on all."""

import numpy as np
import pytest
from chains import comparison_of, grid

from modalax import Structure
from modalax.diagnose.causes.channels import ChannelSwap, SensorMass
from modalax.diagnose.screening import sensitivities as changes
from modalax.diagnose.screening.screen import screen_cause


@pytest.mark.parametrize("cause", [SensorMass(), ChannelSwap()], ids=lambda c: c.slug)
def test_causes_of_single_sensors_explain_what_they_would_over_all_outputs(cause, monkeypatch):
    structure = grid(8, True)
    loaded = Structure(structure.M + np.diag([0, 0, 0.02, 0, 0, 0, 0, 0]), structure.C, structure.K, structure.dofs)
    comparison, state = comparison_of(structure, loaded, lines=40)
    problem, nuisance, residual = comparison.side(False)[0], comparison.side(False)[1], state.sides[False]
    places = cause.places(comparison.scene)
    assert changes.rows_of(cause, np.array([p.index for p in places]), problem) is not None

    def screened():
        theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))
        return screen_cause(cause, comparison.scene, places, theta, residual, problem, nuisance)

    own = screened()
    monkeypatch.setattr(changes, "rows_of", lambda *_: None)
    monkeypatch.setattr("modalax.diagnose.screening.screen.rows_of", lambda *_: None)
    for one, whole in zip(own, screened(), strict=True):
        np.testing.assert_allclose(one.gain, whole.gain, rtol=1e-9, atol=1e-9)
        assert (one.direction is None) == (whole.direction is None)
        if one.direction is not None:
            np.testing.assert_allclose(one.direction, whole.direction, atol=1e-12 * np.abs(whole.direction).max())
    assert len({round(t.gain, 6) for t in own}) == len(places)  # a gain of its own at each place
