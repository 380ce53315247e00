"""The linearised problem, in the space of its unknowns and in that of the features."""

import numpy as np
import pytest
import scipy.stats

from modalax.diagnose.modal_domain.fitting.inaccuracy import Inaccuracy
from modalax.diagnose.modal_domain.fitting.linear import (
    LARGEST,
    ByFeatures,
    ByUnknowns,
    linear_of,
    root_of_information,
)

GROUPS = ("stiffness", "damping")


def inaccuracy(*counts):
    patterns = tuple(np.ones((count, 1, 1)) for count in counts)
    return Inaccuracy(GROUPS, patterns, np.full(2, 0.1), np.full(2, 1e3), (False, False), np.zeros(sum(counts), bool))


@pytest.fixture
def problem():
    """Twelve features, of which nine unknown errors of elements and two causes make what they are."""
    rng = np.random.default_rng(5)
    J = rng.normal(size=(12, 11)) * np.append(np.full(9, 30.0), [200.0, 2.0])
    return J, J @ rng.normal(size=11) * 0.05 + rng.normal(size=12), np.array([0.3, -2.5])


EPSILON = np.array([0.02, 0.4])


@pytest.mark.parametrize("temperature", [1.0, 10.0])
@pytest.mark.parametrize("causes", [0, 1, 2])
def test_both_spaces_tell_what_conditional_normal_distributions_do(problem, causes, temperature):
    J, d, u = problem
    J, u, a = J[:, : 9 + causes], u[:causes], inaccuracy(6, 3)
    S = np.concatenate([np.repeat(EPSILON, [6, 3]), np.maximum(1.0, np.abs(u))])
    features = temperature * np.eye(12) + (J * S**2) @ J.T
    mean = S**2 * (J.T @ np.linalg.solve(features, d))
    covariance = np.eye(len(S)) - (J * S).T @ np.linalg.solve(features, J * S)
    known = 1 - np.diag(covariance)
    for linear in (ByFeatures(a, J, d, u), ByUnknowns(a, J.T @ J, J.T @ d, u)):
        found = linear.solve(EPSILON, temperature)
        assert found.mean == pytest.approx(mean, rel=1e-9)
        assert linear.mean(EPSILON, temperature) == pytest.approx(mean, rel=1e-9)
        assert found.covariance == pytest.approx(covariance[9:, 9:], rel=1e-9)
        assert found.determined == pytest.approx([known[:6].sum(), known[6:9].sum()], rel=1e-9)
        assert linear.known(EPSILON, temperature)[1] == pytest.approx(found.determined, rel=1e-9)
        # the density of the features is that of noise where the mean is, times what the mean costs, times the volume
        density = scipy.stats.multivariate_normal(np.zeros(12), features).logpdf(d)
        left = ((d - J @ mean) ** 2).sum() / temperature + ((mean / S) ** 2).sum()
        noise = -6 * np.log(2 * np.pi * temperature)
        assert -0.5 * left + found.volume + noise == pytest.approx(density, rel=1e-9)


def test_both_spaces_learn_the_same_sizes_and_rises(problem):
    J, d, u = problem
    a, x = inaccuracy(6, 3), np.linspace(-1.0, 1.0, 11)
    few, many = ByFeatures(a, J, d, u), ByUnknowns(a, J.T @ J, J.T @ d, u)
    assert few.learnt(EPSILON, 1.0, 20) == pytest.approx(many.learnt(EPSILON, 1.0, 20), rel=1e-7)
    expected = ((d - J @ x) ** 2).sum() - ((d - 0.1 * J @ x) ** 2).sum()
    assert few.rise(0.1 * x, x) == pytest.approx(expected)
    assert many.rise(0.1 * x, x) == pytest.approx(expected)


def test_the_smaller_space_is_solved(problem):
    J, d, u = problem
    assert isinstance(linear_of(inaccuracy(6, 3), J, d, u), ByUnknowns)
    assert isinstance(linear_of(inaccuracy(6, 3), J[:10], d[:10], u), ByFeatures)


@pytest.mark.parametrize("form", [ByFeatures, ByUnknowns])
def test_sizes_are_learnt_at_the_mean_or_where_a_fit_stands(form):
    """What is known exactly has a size of its own root mean square."""
    x, stands = np.array([0.03, -0.04, 0.2]), np.array([0.3, -0.4, 0.7])
    J = 1e5 * np.eye(3)
    told = (J, J @ x) if form is ByFeatures else (J.T @ J, J.T @ J @ x)
    linear = form(inaccuracy(2, 1), *told, np.zeros(0))
    rms = lambda v: [np.sqrt(np.mean(v[:2] ** 2)), abs(v[2])]
    start = np.full(2, 0.1)
    np.testing.assert_allclose(linear.learnt(start, 1.0, 100), rms(x), rtol=1e-3)
    expected = np.minimum(rms(stands), [LARGEST[g] for g in GROUPS])
    np.testing.assert_allclose(linear.learnt(start, 1.0, 100, stands), expected, rtol=1e-3)


@pytest.mark.parametrize("size", [1.0, 1e10])
def test_the_root_of_an_information_is_found_however_large_that_is(size):
    J, s = size * np.random.default_rng(2).normal(size=(3, 8)), np.linspace(0.5, 1.5, 8)
    L = root_of_information(J, J.T @ J, s)
    assert np.allclose(L, np.tril(L)) and (np.diag(L) > 0).all()
    assert L @ L.T == pytest.approx(np.eye(8) + s[:, None] * (J.T @ J) * s, rel=1e-12, abs=1e-8 * size**2)
    assert np.linalg.slogdet(L)[1] == pytest.approx(0.5 * np.linalg.slogdet(np.eye(3) + (J * s**2) @ J.T)[1])


def test_steep_features_are_left_to_the_space_of_the_unknowns(problem):
    J, d, u = problem
    assert isinstance(linear_of(inaccuracy(6, 3), 1e7 * J[:10], d[:10], u), ByUnknowns)


def test_a_problem_of_no_information_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        ByUnknowns(inaccuracy(1, 1), -np.eye(2) * 1e9, np.zeros(2), np.zeros(0)).solve(EPSILON)
