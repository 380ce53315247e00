"""Hausman's test of bandwidth dependence: as many false alarms as promised, and power against a joint that slips."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax import FRF
from modalax.identify.bandwidth import bandwidth_test
from modalax.model.examples import five_dof
from modalax.simulate import harmonic_balance
from modalax.simulate.joints import ElastoSlip

BAND, LEVEL = (31.0, 45.0), 0.05
FREQ = np.arange(100, 351) * 0.2


def noisy(H, key):
    variance = 2 * LEVEL**2 * (jnp.abs(H) ** 2 + 1e-6 * jnp.max(jnp.abs(H)) ** 2)
    a, b = jax.random.normal(key, (2, *H.shape))
    return FRF(FREQ, H + (a + 1j * b) * jnp.sqrt(variance / 2), variance=variance)


def run(paper, H, count):
    keys = jax.random.split(jax.random.key(5), count)
    return [bandwidth_test(noisy(H, key), paper.poles, 36.8, BAND) for key in keys]


def bent(force):
    """The five-DoF system with a joint that slips, at a force."""
    law = ElastoSlip(9.8e3, 2.4, -9.8e3)
    return harmonic_balance(five_dof(), [law], [["3", "5"]], FREQ, force, inputs=["1"]).frf_values()[0]


@pytest.mark.slow
def test_a_linear_mode_is_rejected_as_often_as_promised(paper):
    tests = run(paper, paper.frf(FREQ, inputs=["1"]).H, 60)
    p = np.array([float(t.p_value) for t in tests])
    assert np.mean([bool(t.valid) for t in tests]) > 0.9
    # of 60 tests at 10 %, 13 or more are rejected with a probability of 0.7 %
    assert 1 <= np.sum(p < 0.1) <= 13
    assert 0.3 < np.mean(p) < 0.7  # six standard deviations of the mean of 60 even numbers are 0.22
    # the differences scatter as said
    z = np.array([jnp.log(t.frequency_hz[1] / t.frequency_hz[0]) / t.difference_std[0] for t in tests])
    assert 0.7 < z.std() < 1.4


@pytest.mark.slow
def test_a_slipping_joint_is_seen(paper):
    tests = run(paper, bent(2.0), 5)
    assert all(float(t.p_value) < 1e-3 for t in tests)
    # softer where only the peak is looked at, as the review found with LSCF
    assert all(float(t.frequency_hz[1]) < float(t.frequency_hz[0]) for t in tests)


def test_messages_say_what_is_needed(paper):
    frf = paper.frf(FREQ, inputs=["1"])
    with pytest.raises(ValueError, match="needs the variance"):
        bandwidth_test(frf, paper.poles, 36.8, BAND)
    with pytest.raises(ValueError, match="holds all 251 lines"):
        bandwidth_test(frf.replace(variance=1e-12), paper.poles, 36.8, (20.0, 70.0))
