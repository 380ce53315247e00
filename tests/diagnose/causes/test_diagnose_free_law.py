"""Stiffness and loss over the amplitude as splines: a second route to them, and the way to a file and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from modalax.diagnose.causes.free_law import FreeLaw, free_law_of
from modalax.diagnose.extend import _key

REACH = 2e-4
LAW = FreeLaw(5, REACH)
P = np.random.default_rng(0).normal(size=10)


def by_scipy(values, A):
    spline = CubicSpline(np.r_[0, LAW.knots], np.r_[0, values], bc_type="natural")
    beyond = spline(REACH) + (A - REACH) * spline(REACH, 1)
    return np.where(A <= REACH, spline(A), beyond)


def test_it_is_a_natural_spline_from_zero_and_straight_beyond():
    A = np.linspace(0, 1.5 * REACH, 31).reshape(1, 31, 1)
    got = np.asarray(jax.jit(LAW.impedance)(A, jnp.ones((31, 1)), P))
    np.testing.assert_allclose(got, by_scipy(P[:5], A) + 1j * by_scipy(P[5:], A), rtol=0, atol=1e-13)


def test_its_slope_by_the_amplitude_is_the_splines():
    slope = jax.jit(jax.grad(lambda A: LAW.impedance(A, jnp.ones(()), jnp.asarray(P)).real))(1.3e-4)
    exact = CubicSpline(np.r_[0, LAW.knots], np.r_[0, P[:5]], bc_type="natural")(1.3e-4, 1)
    assert float(slope) == pytest.approx(float(exact), rel=1e-10)


def test_a_file_gives_back_the_same_joint():
    assert free_law_of(_key(LAW)) == LAW == FreeLaw(5, REACH)
    assert free_law_of("CubicStiffness()") is None
