"""Fits of laws that become others as their strength grows."""

import numpy as np
import pytest

from modalax.diagnose.causes.joints import CoulombFriction, CubicStiffness, ElastoSlip
from modalax.diagnose.causes.power_laws import IwanJoint
from modalax.diagnose.search.force_fit import _limits_first

SLIP, IWAN = np.array([1e6, 1e-6]), np.array([1e6, 1e-6, 0.5])


@pytest.mark.parametrize(
    ("misfits", "order"),
    [
        ([1500.0, 1600.0, 3000.0], [1, 0, 2]),  # friction first, as it is about as near as the slip
        ([1500.0, 3100.0, 2000.0], [0, 2, 1]),  # not where it misses twice as much
        ([1500.0, 1400.0, 1450.0], [1, 2, 0]),
        ([1500.0, None, 1450.0], [2, 0]),  # nobody looks for friction
    ],
)
def test_a_law_comes_after_its_limit_where_that_is_about_as_near(misfits, order):
    causes = [ElastoSlip(False), CoulombFriction(), CubicStiffness()]
    starts = [SLIP, np.array([1.0]), np.array([1e9])]
    sized = [(m, 2 * m, k, [p]) for k, (m, p) in enumerate(zip(misfits, starts, strict=True)) if m is not None]
    assert [k for *_, k, _ in _limits_first(sized, causes)] == order


def test_a_spring_of_the_simulation_that_slips_has_no_such_limit():
    causes = [ElastoSlip(True), CoulombFriction(), IwanJoint()]
    sized = [(1500.0, 3e3, 0, [SLIP]), (1600.0, 3e3, 1, [np.array([1.0])]), (1550.0, 3e3, 2, [IWAN])]
    assert [k for *_, k, _ in _limits_first(sized, causes)] == [0, 1, 2]
