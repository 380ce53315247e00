"""Impedances of elements in rows, against each element asked by itself and against closed forms."""

import numpy as np
import pytest

from modalax.diagnose.causes.drift import DriftingSpring
from modalax.diagnose.causes.free_law import FreeLaw
from modalax.diagnose.causes.joints import CubicStiffness, ElastoSlip
from modalax.diagnose.causes.power_laws import IwanJoint
from modalax.diagnose.causes.viscoelastic import FractionalJoint, ZenerJoint
from modalax.diagnose.prediction import impedances as rows
from modalax.diagnose.prediction.impedances import impedances, linear_impedances

OMEGA = np.linspace(60.0, 90.0, 17)


@pytest.mark.parametrize(
    ("cause", "typical"),
    [
        (CubicStiffness(), [1e9]), (ElastoSlip(True), [4e4, 2e-5]), (IwanJoint(), [4e4, 2e-5, 0.5]),
        (FreeLaw(2, 1e-4), [1e3, 2e3, 3e2, 4e2]), (DriftingSpring(), [4e4]), (ZenerJoint(), [4e4, 0.01, 0.5]),
    ],
)  # fmt: skip
def test_trials_in_rows_are_each_trial_by_itself(cause, typical, monkeypatch):
    monkeypatch.setattr(rows, "ROW", 64)
    rng = np.random.default_rng(4)
    A = 1e-4 * rng.uniform(0.1, 1.0, (3, len(OMEGA), 2))
    p = typical * rng.uniform(0.5, 2.0, (5, len(typical)))
    found = impedances(cause, p, OMEGA, A)
    assert found.shape == (5, *A.shape)
    for Z, one in zip(found, p, strict=True):
        if isinstance(cause, ZenerJoint):
            alone = np.asarray(cause.impedance(1j * OMEGA, one))[:, None]
        else:
            alone = np.asarray(cause.impedance(A, OMEGA[:, None], one))
        assert Z == pytest.approx(np.broadcast_to(alone, A.shape), rel=1e-12)


def test_a_trial_may_have_amplitudes_of_its_own():
    A = 1e-4 * np.random.default_rng(5).uniform(0.1, 1.0, (4, 3, len(OMEGA), 1))
    assert impedances(CubicStiffness(), np.array([8e8]), OMEGA, A) == pytest.approx(6e8 * A**2 + 0j, rel=1e-12)


def test_slopes_of_linear_elements_are_those_of_their_formulas():
    c, a = 3.0, 0.4
    Z, slopes = linear_impedances(FractionalJoint(), np.array([[c, a], [0.0, a]]), OMEGA)
    s = 1j * OMEGA
    assert Z == pytest.approx(np.stack([c * s**a, 0 * s]), rel=1e-12)
    by_hand = [np.stack([s**a, size * np.log(s) * s**a], axis=-1) for size in (c, 0.0)]
    assert slopes == pytest.approx(np.stack(by_hand), rel=1e-12)
