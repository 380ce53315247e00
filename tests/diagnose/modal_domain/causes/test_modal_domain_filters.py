"""Filters of sensors in the modal domain, against scipy's, finite differences, and hidden in a beam that is off."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from modalax.diagnose.modal_domain import judged
from modalax.diagnose.modal_domain.causes.channel_faults import Delay
from modalax.diagnose.modal_domain.causes.sensor_filters import SensorFilter, sensor_filters

OMEGA = 2 * np.pi * np.linspace(10.0, 90.0, 9)
FILTERS = {f.form: f for f in sensor_filters(("a", "b"), OMEGA[0], OMEGA[-1]) if f.where == ("b",)}


@pytest.mark.parametrize("form", ["low", "butterworth", "high"])
def test_a_filter_is_a_butterworth_filter_of_the_corner_that_is_told(form):
    f, H = FILTERS[form], np.ones((9, 2, 1), complex)
    told = f.told(np.array([0.8]), np.array([[0.01]]))
    corner = told["high_pass_corner" if form == "high" else "low_pass_corner"]
    order = 2 if form == "butterworth" else 1
    b, a = scipy.signal.butter(order, 2 * np.pi * corner["value"], "high" if form == "high" else "low", analog=True)
    expected = scipy.signal.freqs(b, a, worN=OMEGA)[1]
    got = f.transform(np.array([0.8]), 1j * OMEGA, H)
    assert np.abs(got[:, 1, 0] - expected).max() < 1e-12
    assert np.array_equal(got[:, 0], H[:, 0])
    assert corner["std"] == pytest.approx(corner["value"] * 0.1 / 0.8, rel=1e-12)


@pytest.mark.parametrize("form", ["low", "butterworth", "high"])
@pytest.mark.parametrize("u", [0.0, 0.7])
def test_its_slope_is_that_of_finite_differences(form, u):
    rng = np.random.default_rng(3)
    poles, R = -2.0 + 1j * OMEGA, rng.normal(size=(9, 2, 1)) + 1j * rng.normal(size=(9, 2, 1))
    f, step = FILTERS[form], 1e-6
    change = f.transform(np.array([u + step]), poles, R) - f.transform(np.array([u]), poles, R)
    slope = f.transform_slope(np.array([u]), poles, R)
    assert np.abs(change / step - slope).max() < 1e-5 * np.abs(slope).max()


def test_no_filter_has_a_negative_corner():
    H = np.ones((9, 2, 1), complex)
    for f in FILTERS.values():
        assert np.array_equal(f.transform(np.array([-0.5]), 1j * OMEGA, H), H)
        assert not f.transform_slope(np.array([-0.5]), 1j * OMEGA, H).any()


@pytest.mark.parametrize(
    ("ahead", "width", "count"), [(0.3, 1.0, 1), (-2.0, 1.0, 1), (4.0, 1.0, 2), (4.0, np.exp(4.0), 1)]
)
def test_a_filter_that_the_data_do_not_tell_from_a_delay_counts_as_that_delay(ahead, width, count, monkeypatch):
    monkeypatch.setattr(judged, "standing_out", lambda _, e: e.causes)
    one = lambda cause, evidence, p, std: SimpleNamespace(
        causes=(cause,), probability=p, log_posterior=evidence,
        fit=SimpleNamespace(log_evidence=evidence, u=np.zeros(1), covariance=np.array([[std**2]])),
    )  # fmt: skip
    # a filter whose usual size is so much narrower that its size is known so much less well beside it
    filtered = one(SensorFilter("sensor_filter", ("b",), channel=(0, 1)), 100.0 + ahead, 0.05, 0.01 * width)
    stage = SimpleNamespace(
        explanations=[one(Delay("time_delay", ("b",), channel=(0, 1)), 100.0, 0.95, 0.01), filtered]
    )
    sets = judged.sets_beyond(stage)
    assert len(sets) == count and sets[0].names == (("time_delay", ("b",)),)
    assert sets[0].probability == pytest.approx(1.0 if count == 1 else 0.95)
