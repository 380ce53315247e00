"""Joints with the higher harmonics of their motion: predictions beside harmonic balance, values beside the truth."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.causes.joints import BilinearStiffness, CubicStiffness, ElastoSlip
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison, make_comparison, with_noise_beside
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.harmonics import linear_factor
from modalax.diagnose.search.harmonics import HIGHEST, fitted_in_full, joints_in_full
from modalax.model.examples import five_dof
from modalax.simulate import joints
from modalax.simulate.harmonic import simulate

FREQ = np.arange(20.0, 70.0, 0.5)
PLACE = ("3", "5")
LEVELS = np.array([1.0, 3.0, 6.0])


def test_of(joint, seed=0, noise=0.02, **orders):
    """A virtual test of the five-DoF system with a joint more, noise of ``noise`` times each channel's rms."""
    clean = simulate(five_dof(), [joint], [PLACE], FREQ, LEVELS, inputs=["1"], **orders)
    keys = jax.random.split(jax.random.key(seed), clean.runs)
    return Measurement.from_frfs([clean.run(r).add_noise(k, noise) for r, k in zip(range(3), keys, strict=True)])


test_of.__test__ = False


def hypothesis(comparison: Comparison, cause, p) -> tuple[Hypothesis, Hypothesis]:
    """The simulation alone, and with a joint at its place, the latter not fitted."""
    structure = five_dof()
    nothing = np.zeros((2, comparison.problem.modal_form.stiffness.shape[0]))
    null = comparison.fit([Hypothesis(theta=nothing)], 1)[0]
    place = Place(PLACE, (*(structure.index(n) for n in PLACE), 0))
    return null, replace(null.with_cause(cause, place, None, np.asarray(p, float)), theta=nothing)


@pytest.mark.parametrize(
    ("cause", "p", "joint"),
    [
        (ElastoSlip(False), [3000.0, 5e-4], joints.ElastoSlip(3000.0, 1.5)),
        (BilinearStiffness(), [3000.0, 0.6], joints.BilinearSpring(4800.0, 1200.0)),
    ],
    ids=["slip", "bilinear"],
)
def test_prediction_with_harmonics_is_the_harmonic_balance(cause, p, joint):
    exact = simulate(five_dof(), [joint], [PLACE], FREQ, LEVELS, inputs=["1"], harmonics=5, samples=80)
    comparison = make_comparison(exact, five_dof(), "fixed")
    null, h = hypothesis(comparison, cause, p)
    theta = jnp.zeros(h.theta.shape)
    extra = linear_factor(h.causes, h.index, (None,), h.params, theta, comparison.problem, 5)
    effect = np.abs(exact.H - comparison.prediction(null)).max()
    one = np.abs(exact.H - comparison.prediction(h)).max()
    full = np.abs(exact.H - comparison.prediction(replace(h, extras=(extra,)))).max()
    assert full < 1e-4 * effect
    assert one > 10 * full


def test_a_slipping_joint_is_found_within_its_error_bars():
    structure = five_dof()
    k = float(-structure.K[2, 4])
    pulls = []
    for seed in range(3):
        data = test_of(joints.ElastoSlip(k, 4.0, -k), seed, harmonics=HIGHEST)
        comparison = with_noise_beside(make_comparison(data, structure, "fixed"))
        null, h = hypothesis(comparison, ElastoSlip(True), [k, 4.0 / k])
        full = fitted_in_full(comparison, null, h)
        std = np.sqrt(np.diag(full.covariance))
        pulls.append((np.array([full.params[0][0], np.log(full.params[0][1])]) - [k, np.log(4.0 / k)]) / std)
        assert full.fidelity < 1e-3
        assert std[1] < 3e-3
    assert np.abs(pulls).max() < 3


def test_harmonics_tell_a_bilinear_spring_from_a_spring():
    data = test_of(joints.BilinearSpring(5000.0, 1000.0), noise=0.002, harmonics=HIGHEST)
    comparison = with_noise_beside(make_comparison(data, five_dof(), "fixed"))
    null, h = hypothesis(comparison, BilinearStiffness(), [3000.0, 0.3])
    one = comparison.fit([h], 30)[0]
    (full,) = joints_in_full(comparison, null, [one])
    assert full.chi2 < one.chi2 - 25
    assert full.freedom == one.freedom + 1
    value, std = full.params[0], np.sqrt(np.diag(full.covariance))
    assert abs(value[0] - 3000.0) < 3 * std[0]
    assert abs(value[1] - 2 / 3) < 3 * std[1]


def test_weak_joints_are_left_as_they_are():
    data = test_of(joints.CubicSpring(1e7), noise=0.05)
    comparison = with_noise_beside(make_comparison(data, five_dof(), "fixed"))
    null, h = hypothesis(comparison, CubicStiffness(), [1e7])
    assert joints_in_full(comparison, null, [comparison.fit([h], 30)[0]]) == []
