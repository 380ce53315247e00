"""Damped steps within bounds, and what the data leaves unknown, against closed forms."""

import numpy as np

from modalax.diagnose.fitting.gauss_newton import covariance_of, damped


def test_what_the_data_does_not_show_has_no_small_error():
    """Two unknowns that act alike: their sum is known, each alone is not."""
    J = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]) * np.array([1e6, 1.0])
    std = np.sqrt(np.diag(covariance_of(J.T @ J)))
    assert (std * np.array([1e6, 1.0]) > 1e4).all()
    A = np.array([[2.0, 0.3], [0.3, 0.05]])
    np.testing.assert_allclose(covariance_of(A), np.linalg.inv(A))
    assert covariance_of(np.diag([4.0, 0.0]))[0, 0] == 0.25 and covariance_of(np.diag([4.0, 0.0]))[1, 1] > 1e9


def test_an_unknown_pushed_against_its_bound_does_not_bend_the_steps_of_the_others():
    """A narrow slanting valley whose bottom lies beyond a bound; at the bound the least is known in closed form."""
    Q, centre = np.array([[1.0, 0.999], [0.999, 1.0]]), np.array([3.0, -3.0])

    def normal(x, moving):
        off = x - centre
        return np.einsum("bi,ij,bj->b", off, Q, off), np.broadcast_to(Q, (len(x), 2, 2)), off @ Q

    low, high = np.array([-np.inf, 0.0]), np.full(2, np.inf)
    x, chi2, _, moving = damped(normal, np.array([[5.0, 0.0], [-4.0, 2.0]]), low, high, 30)
    np.testing.assert_allclose(x, [[3 - 0.999 * 3, 0.0]] * 2, atol=1e-5)
    np.testing.assert_allclose(chi2, 9 * (1 - 0.999**2), rtol=1e-6)
    assert not moving.any()
