"""Effects so large that peaks move by several times their width: finite sizes, not derivatives, tell the place."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from modalax.data import Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.causes.channels import ChannelGain
from modalax.diagnose.causes.local import AddedMass, JointStiffness, LocalDamper
from modalax.diagnose.comparison import empty, make_comparison, with_noise_beside
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.products import Reduced
from modalax.diagnose.screening.score_state import score_state_of
from modalax.model import Structure

COUNT, AT, OUT = 10, 6, 2
NAMES = tuple(str(k + 1) for k in range(COUNT))
FEW = [JointStiffness(), LocalDamper(), AddedMass(), ChannelGain()]


def chain(mass=0.0):
    rng = np.random.default_rng(5)
    M, k = np.diag(rng.uniform(0.8, 1.3, COUNT)), rng.uniform(0.8, 1.3, COUNT + 1) * 4e4
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    square, shapes = scipy.linalg.eigh(K, M)
    C = M @ shapes @ np.diag(0.008 * np.sqrt(square)) @ shapes.T @ M
    M[AT, AT] += mass
    return Structure(M, C, K, list(NAMES))


def measured(lines):
    """A mass of 0.4 kg, a sensor that shows 15 % too little, 1 % noise, and no variances."""
    freq = np.linspace(5.0, 45.0, lines)
    H = np.array(chain(0.4).frf(freq, inputs=("2", "9"), form="accelerance").H)
    H[:, OUT] *= 0.85
    rng = np.random.default_rng(0)
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0, keepdims=True) / 2)
    noisy = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return Measurement(freq, noisy[None], form="accelerance", outputs=NAMES, inputs=("2", "9"))


def masses(lines=80):
    comparison = with_noise_beside(make_comparison(measured(lines), chain()))
    null = comparison.fit([empty(comparison)], 4)[0]
    return screen_all(score_state_of(comparison, null), [AddedMass()]).trials


def test_finite_sizes_put_the_right_place_first_where_the_derivative_does_not():
    trials = masses()
    assert max(trials, key=lambda t: t.gain).place.where == (NAMES[AT],)
    by_derivative = sorted(trials, key=lambda t: -t.linear)
    assert by_derivative[0].place.where != (NAMES[AT],)


def test_every_size_that_is_tried_is_exact():
    """The gain is the chi-square that the start takes away, found by fitting nothing at that start."""
    comparison = with_noise_beside(make_comparison(measured(80), chain()))
    null = comparison.fit([empty(comparison)], 4)[0]
    for t in screen_all(score_state_of(comparison, null), [AddedMass(), JointStiffness()]).trials[:30:7]:
        there = comparison.fit([null.with_cause(t.cause, t.place, None, t.start)], 0)[0]
        assert t.gain == pytest.approx(null.chi2 - there.chi2, rel=1e-6, abs=1e-3)


def test_products_with_the_nuisances_are_made_a_place_at_a_time():
    """They take places times nuisances times samples together: none of that size is held."""
    reduced = Reduced(*[np.zeros(0)] * 7, S=np.zeros(0), T=np.arange(24.0).reshape(3, 2, 1, 2, 2), weight2=np.zeros(0),
                      inner=np.zeros(0), omega=np.zeros(0), level=np.zeros(0))  # fmt: skip
    assert np.array_equal(reduced.nuisances(1, -1), reduced.T[1])
    assert np.array_equal(reduced.nuisances(2, 0), reduced.T[2] - reduced.T[0])
    assert replace(reduced, T=reduced.T[:, :0]).nuisances(2, 0).shape == (0, 1, 2, 2)


@pytest.mark.parametrize("lines", [80, *(pytest.param(n, marks=pytest.mark.slow) for n in (160, 317, 792))])
def test_a_mass_and_a_gain_are_named_with_few_lines_and_with_many(lines):
    said = diagnose(measured(lines), chain(), causes=FEW).to_dict()
    assert said["verdict"] == "named"
    assert {(c["name"], *c["where"]) for c in said["causes"]} == {
        ("added_mass", NAMES[AT]), ("channel_gain", NAMES[OUT]),
    }  # fmt: skip
    mass = next(c for c in said["causes"] if c["name"] == "added_mass")["parameters"]["mass"]
    assert abs(mass["value"] - 0.4) < 4 * mass["std"] < 0.02
