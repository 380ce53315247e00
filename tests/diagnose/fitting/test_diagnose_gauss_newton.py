"""Damped steps within bounds, and what the data leaves unknown, against closed forms."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import FRF
from modalax.diagnose.causes.damping import ModalDamping
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.viscoelastic import ZenerJoint
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.fitting.gauss_newton import covariance_of, damped, damped_step
from modalax.diagnose.fitting.hypothesis import Hypothesis, bounds_of, from_search, slopes, to_search
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.search.candidates import start_from
from modalax.model import Structure


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


def test_an_unknown_without_a_slope_stays_where_it_is_and_stops_no_step():
    """However small the damping has become; one that is held stays as well, and the others step without it."""
    A, g = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]]), np.array([2.0, 3.0, 0.0])
    free = np.zeros(3, bool)
    np.testing.assert_allclose(damped_step(A, g, 1e-24, free), [*-np.linalg.solve(A[:2, :2], g[:2]), 0.0])
    np.testing.assert_allclose(damped_step(A, g, 1e-24, np.array([False, True, False])), [-0.5, 0.0, 0.0])


@pytest.fixture(scope="module")
def little_damped():
    """A mode of a chain has a quarter of its damping, where damping ratios are claimed within 30 %."""
    n, freq = 4, np.linspace(4.0, 40.0, 300)
    K = 4e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    value, shapes = np.linalg.eigh(K)
    w, zeta = np.sqrt(value), np.full(n, 0.012)
    damping = lambda z: shapes @ np.diag(2 * z * w) @ shapes.T
    names = [str(k + 1) for k in range(n)]
    s = 2j * np.pi * freq[:, None, None]
    H = np.linalg.inv(s**2 * np.eye(n) + s * damping(zeta * np.array([1, 0.25, 1, 1])) + K)[:, :, :1]
    sigma = 0.02 * np.abs(H).std()
    rng = np.random.default_rng(3)
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    simulation = Structure(M=np.eye(n), C=damping(zeta), K=K, dofs=names, damping_std=0.3)
    measured = FRF(freq, H, outputs=names, inputs=names[:1], form="receptance", variance=np.full(H.shape, sigma**2))
    return make_comparison(measured, simulation)


@pytest.mark.parametrize("linear", [-1.386, -0.9, 0.5])
def test_a_mode_that_lost_most_of_its_damping_is_fitted_from_any_start(little_damped, linear):
    """Also from beyond the bound: a linear step of log 4 down is a quarter left, as steps of logarithms are."""
    mode = Place((2,), (1, -1, 0))
    start = start_from(
        little_damped.fit([Hypothesis()], 20)[0], Trial(ModalDamping(), mode, 0.0, 0.0, np.zeros(1)), [linear]
    )
    found = little_damped.fit([start], 20)[0]
    std = (1 + found.params[0][0]) * np.sqrt(found.covariance[0, 0])
    assert found.reason == "settled" and found.chi2 < 1.1 * little_damped.problem.samples
    assert abs(found.params[0][0] + 0.75) < 3 * std
    if linear < -1:
        np.testing.assert_allclose(start.params[0], np.exp(linear) - 1)


def test_parameters_go_to_the_search_and_back():
    """Plain, logarithm, and logarithm of one and the value; their slopes are those of differences."""
    several = SimpleNamespace(
        parameters=(Parameter("a", ""), Parameter("b", "", 0, 9, log=True), Parameter("c", "", -0.9, relative=True))
    )
    p = np.array([-3.0, 0.2, -0.4])
    u = to_search(several, p)
    np.testing.assert_allclose(u, [-3.0, np.log(0.2), np.log(0.6)])
    np.testing.assert_allclose(from_search(several, u), p)
    np.testing.assert_allclose(from_search(several, jnp.asarray(u)), p)
    step = 1e-6
    np.testing.assert_allclose(slopes(several, p), (from_search(several, u + step) - p) / step, rtol=1e-5)
    low, high = bounds_of([several])
    np.testing.assert_allclose(low[[0, 2]], [-np.inf, np.log(0.1)])
    np.testing.assert_allclose(high, [np.inf, np.log(9), np.inf])
    assert [q.within(-2.0) for q in several.parameters] == [-2.0, 0.0, np.expm1(-2.0)] and several.parameters[2].within(
        -5.0
    ) == -0.9


def test_a_logarithm_that_nothing_bounds_ends_where_powers_of_the_value_are_numbers():
    """A search without an end had moved the time of a relaxation to 1e299 s, and nothing was a number beside it."""
    value = from_search(ZenerJoint(), np.array([1.0, 1e4, 0.5]))
    assert 1e20 < value[1] and np.isfinite(value[1] ** 8)
