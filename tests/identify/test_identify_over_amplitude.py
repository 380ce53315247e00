"""Modes over the level of the force: against a structure whose modes follow a known curve."""

import equinox as eqx
import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.identify.over_amplitude import carried, over_amplitude
from modalax.identify.smooth_series import smooth

FREQ = np.linspace(15, 45, 91)


def modes_at(level: float) -> tuple[np.ndarray, np.ndarray]:
    """Two modes, of which one softens and gains damping with the root of the force."""
    return np.array([20.0, 35.0 - 0.4 * np.sqrt(level)]), np.array([0.01, 0.01 + 0.002 * np.sqrt(level)])


def response(level: float, noise: float = 0.0) -> FRF:
    f, z = modes_at(level)
    s, w = 2j * np.pi * FREQ[:, None], 2 * np.pi * f
    terms = 1 / (s**2 + 2 * z * w * s + w**2)
    H = np.einsum("fk,ko->fo", terms, np.array([[1.0, 0.5], [0.8, -1.0]]))[:, :, None]
    rng = np.random.default_rng(int(level))
    e = noise * np.sqrt((np.abs(H) ** 2).mean()) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return FRF(FREQ, H + e / np.sqrt(2), form="receptance", level=level)


@pytest.fixture(scope="module")
def found():
    return over_amplitude(Measurement.from_frfs([response(v, 0.01) for v in (9.0, 1.0, 4.0)]))


def test_modes_of_levels_in_between_and_beyond(found):
    np.testing.assert_array_equal(found.level, [1.0, 4.0, 9.0])
    for level in (2.0, 6.0, 16.0):
        (f, z), model = modes_at(level), found.modes(level)
        assert np.abs(np.asarray(model.frequency_hz) / f - 1).max() < 2e-3
        assert np.abs(np.asarray(model.damping_ratio) / z - 1).max() < 0.06
        apart = (np.asarray(model.frequency_hz) - f) / np.asarray(model.frequency_std * model.frequency_hz)
        assert np.abs(apart).max() < 3


def test_frf_of_a_level_that_was_not_measured(found):
    true, linear = np.asarray(response(16.0).H), np.asarray(found.models[0].frf(FREQ).H)
    told = found.frf(16.0)
    missed = np.linalg.norm(np.asarray(told.H) - true)
    assert missed < 0.1 * np.linalg.norm(linear - true)
    assert missed < 3 * np.sqrt(float(np.sum(told.variance)))
    elsewhere = found.frf(16.0, np.array([20.0, 33.4]))
    np.testing.assert_allclose(elsewhere.H, np.asarray(found.modes(16.0).frf([20.0, 33.4]).H))


def test_what_modes_leave_is_carried_where_levels_agree(found):
    """At a measured level it is what its own fit leaves; beside it fades as far as the next level differs."""
    own = np.asarray(found.measured[1].H) - np.asarray(found.models[1].frf(FREQ).H)
    left, power = found.rest(4.0)
    np.testing.assert_allclose(left, own, atol=1e-9 * np.abs(own).max())
    assert power.max() < 1e-9 * np.abs(own).max() ** 2
    between, power = found.rest(6.0)  # independent noise at each level
    assert np.linalg.norm(between) < 0.3 * np.linalg.norm(own)
    assert 0.8 < power.sum() / np.sum(np.abs(own) ** 2) < 1.2
    alike = eqx.tree_at(lambda o: o.measured, found, tuple(m.replace(H=m.H + 0.01) for m in found.measured))
    assert np.abs(alike.rest(6.0)[0] - 0.01).max() < 0.002


def test_a_straight_line_in_a_power_of_the_level_is_found():
    x = np.array([1.0, 4.0, 9.0, 16.0])
    y = np.stack([5 - np.sqrt(x), 2 + 0.3 * np.sqrt(x)], axis=1)
    s = smooth(x, y, np.full(y.shape, 1e-4))
    likeliest = s.settings[np.argmax(s.weights.sum(axis=1))]
    assert likeliest[0] == 0.5
    mean, std = s.at(25.0)
    np.testing.assert_allclose(mean, [0.0, 3.5], atol=0.03)
    assert (std < 0.2).all() and (s.at(6.0)[1] < std).all()


def test_two_points_give_the_chord_and_a_wide_band():
    s = smooth(np.array([1.0, 4.0]), np.array([[1.0], [2.0]]), np.full((2, 1), 1e-3))
    at_ends = [s.at(p) for p in (1.0, 4.0)]
    np.testing.assert_allclose([m[0] for m, _ in at_ends], [1.0, 2.0], atol=0.02)
    mean, std = s.at(2.0)
    assert 1.2 < mean[0] < 1.8 and std[0] > 0.1


def test_modes_are_carried_by_frequency_and_shape():
    poles = [2j * np.pi * np.array(f) for f in ([10.0, 20.0, 20.3], [10.1, 20.2, 20.5, 30.0], [9.9, 20.4])]
    a, b, c = np.eye(3)
    chains = carried(poles, [np.array([a, b, c]), np.array([a, c, b, a]), np.array([a, b])])
    assert chains == [(0, 0, 0), (1, 2, 1)]


@pytest.mark.parametrize("level", [[1.0, 1.0], [np.nan, 2.0]])
def test_levels_that_say_nothing_are_refused(level):
    with pytest.raises(ValueError, match="levels are"):
        over_amplitude(Measurement.from_frfs([response(1.0).replace(level=v) for v in level]))


def test_a_level_below_zero_is_refused(found):
    with pytest.raises(ValueError, match="level is -1"):
        found.modes(-1.0)


def test_what_is_the_same_at_every_level_has_a_narrow_band():
    """Two runs with the same numbers change by nothing; the unit of a quantity must not stand for its change."""
    one = response(1.0)
    same = over_amplitude(Measurement.from_frfs([one, one.replace(level=2.0)]))
    model = same.modes(1.5)
    assert np.asarray(model.frequency_std).max() < 1e-6 and np.asarray(model.damping_std).max() < 1e-6
    np.testing.assert_allclose(same.frf(1.5).H, one.H, rtol=1e-6)


def test_damping_that_would_pass_one_far_beyond_the_levels_stays_below():
    s = 2j * np.pi * FREQ

    def run(level: float) -> FRF:
        w, z = 2 * np.pi * 30.0, 0.01 * np.sqrt(level)
        return FRF(FREQ, (1 / (s**2 + 2 * z * w * s + w**2))[:, None, None], level=level)

    found = over_amplitude(Measurement.from_frfs([run(v) for v in (1.0, 4.0, 9.0)]))
    assert 0.9 < float(found.modes(4e4).damping_ratio[0]) < 1
    assert np.isfinite(np.asarray(found.frf(4e4).variance)).all()


def test_a_level_so_far_away_that_a_mode_has_no_frequency_is_refused(found):
    with pytest.raises(ValueError, match="too far from those measured, 1 to 9 N"):
        found.modes(1e9)
