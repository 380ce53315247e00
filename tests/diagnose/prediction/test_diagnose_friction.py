"""Dry friction's steady motion against closed forms: a mass that slides without a stop, and one that is held."""

import numpy as np
import pytest

from modalax.diagnose.prediction.friction import sliding, with_more_instants

MASS, OMEGA, PUSH, COUNT = 2.0, 30.0, 5.0, 48


def mass_alone(limit):
    """Dry friction on a free mass under a sine."""
    h = np.arange(1, COUNT, 2)
    G = -1 / (MASS * (h * OMEGA) ** 2)[None] + 0j
    return sliding(G, PUSH * G[:, 0], np.array([OMEGA]), limit, COUNT)


@pytest.mark.parametrize("share", [0.05, 0.15, 0.3])
def test_sliding_without_stops(share):
    # m x'' = P cos(wt) - f; v is 0 at t0 and half a cycle later: sin(w t0) = -pi F/(2 P); the square wave begins there
    limit = share * PUSH
    begin = np.arcsin(-np.pi * limit / (2 * PUSH))
    found = mass_alone(limit)
    assert found.sound.all()
    np.testing.assert_allclose(
        found.force[0], 4 * limit / np.pi * np.exp(-1j * (np.pi / 2 + begin)), rtol=2e-2
    )  # one harmonic alone is up to 19 % off


def test_a_mass_that_is_held_takes_the_whole_push():
    found = mass_alone(1.001 * PUSH)
    assert found.sound.all()
    np.testing.assert_allclose(found.force[0], PUSH, rtol=1e-9)


@pytest.mark.parametrize("share", [0.05, 0.15, 1.001])
def test_the_slope_by_the_limit(share):
    """That of the force as it is found, by the difference to one found anew with a limit that is a little larger."""
    step = 1e-2 * share * PUSH
    here, there = (mass_alone(share * PUSH + d) for d in (0.0, step))
    assert here.slope[0] == pytest.approx((there.force[0] - here.force[0]) / step, rel=1e-2, abs=1e-9)
    if share > 1:
        assert abs(here.slope[0]) < 1e-9  # what is held takes the push, whatever the limit


def test_too_few_harmonics_are_refused():
    with pytest.raises(ValueError, match="harmonics"):
        sliding(np.zeros((1, 3), complex), np.ones(1, complex), np.ones(1), 1.0, COUNT)


def test_each_motion_is_found_whatever_sticks():
    """Two modes near resonance: each of 400 pushes has a motion, in which friction takes up work."""
    rng, h = np.random.default_rng(3), np.arange(1, COUNT, 2)
    omega = rng.uniform(20.0, 60.0, 400)
    s = 1j * np.outer(omega, h)
    G = sum(1 / (w**2 + 2 * 0.01 * w * s + s**2) for w in (25.0, 41.0))
    u = G[:, 0] * np.exp(rng.uniform(-1.0, 1.0, 400))
    found = sliding(G, u, omega, 1.0, COUNT)
    assert found.sound.all()
    # friction takes up work, of no more than a square wave of its limit
    work = (found.force * (1j * omega * (u - G[:, 0] * found.force)).conj()).real / (omega * np.abs(u))
    assert (work > -1e-9).all() and (np.abs(found.force) < 4 / np.pi + 1e-4).all()
    assert 0.3 < (work > 1e-3).mean() < 0.95  # these slide, the others stick


@pytest.mark.parametrize("share", [0.15, 0.3])
def test_half_as_many_instants_tell_most_of_what_is_missed(share):
    """The closed form of sliding without stops, of which extrapolation leaves at most 0.6 of what 96 instants miss."""
    limit, h = share * PUSH, np.arange(1, 2 * COUNT, 2)
    G = -1 / (MASS * (h * OMEGA) ** 2)[None] + 0j
    coarse, fine = (sliding(G, PUSH * G[:, 0], np.array([OMEGA]), limit, n) for n in (COUNT, 2 * COUNT))
    exact = 4 * limit / np.pi * np.exp(-1j * (np.pi / 2 + np.arcsin(-np.pi * limit / (2 * PUSH))))
    found = with_more_instants(coarse, fine)
    assert found.sound.all() and abs(fine.force[0] - exact) > 2e-3 * abs(exact)
    assert abs(found.force[0] - exact) < 0.6 * abs(fine.force[0] - exact)
