"""Lines at the mains frequency, in noise alone and beside it."""

import numpy as np
import pytest

from modalax.diagnose.causes.hum_pickup import pickup
from modalax.diagnose.causes.mains_hum import MainsHum, _tail, hums
from modalax.diagnose.causes.missing_modes import MissingMode
from modalax.diagnose.causes.scene import Scene


def test_noise_alone_is_rarely_called_hum():
    freq, live = np.arange(30.0, 210.0, 0.5), np.ones((4, 6, 360), bool)
    rng, values = np.random.default_rng(0), []
    for _ in range(200):
        noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
        values.append(MainsHum().explain(freq, 50.0, noise, live).p_value)
    assert np.mean(np.array(values) < 0.05) < 0.1  # 0.05 nominal
    assert np.mean(np.array(values) < 0.01) < 0.04  # 0.01 nominal


@pytest.mark.parametrize(
    "freq", [np.arange(30.0, 49.93, 0.05), np.r_[30.0:45.0:0.3, 55.0:59.0:0.3]], ids=["ends just below", "has a gap"]
)
def test_no_hum_is_looked_for_where_no_line_is(freq):
    scene = Scene(freq, ("1",), ("1",), ("1",), np.zeros(0), np.zeros(0), np.ones(1), None)
    assert MainsHum().places(scene) == []
    found = MainsHum().explain(freq, 50.0, np.full((3, 4, len(freq)), 9.0 + 0j), np.ones((3, 4, len(freq)), bool))
    assert found.p_value == 1.0 and not found.lines.any()


def test_hum_that_stands_out_is_found_at_its_lines():
    freq, live = np.arange(30.0, 210.0, 0.5), np.ones((4, 6, 360), bool)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
    noise[..., np.isin(freq, (50.0, 100.0, 150.0))] *= 2.0
    found = MainsHum().explain(freq, 50.0, noise, live)
    assert found.p_value < 1e-6
    assert set(freq[found.lines]) >= {50.0, 100.0, 150.0}


def one_source(freq, size, rng, width):
    """Noise of 6 runs and inputs at 9 outputs, and a source at 60 Hz that the outputs share, ``width`` in spacings."""
    noise = rng.normal(size=(6, 9, len(freq))) + 1j * rng.normal(size=(6, 9, len(freq)))
    lines = np.exp(-0.5 * ((freq - 60.0) / (width * np.diff(freq)[0])) ** 2)
    source = (rng.normal(size=6) * np.exp(2j * np.pi * rng.uniform(size=6)))[:, None] * rng.normal(size=9)
    signal = source[..., None] * lines
    return noise + size * signal / np.linalg.norm(signal)


def test_one_source_is_found_where_each_channel_alone_hides_it():
    """At 9 standard deviations over 54 channels the sum of squares is hardly out of its scatter; the rank tells."""
    freq, rng = np.arange(20.0, 110.0, 0.3), np.random.default_rng(3)
    live = np.ones((6, 9, len(freq)), bool)
    found = [MainsHum().explain(freq, 60.0, one_source(freq, 9.0, rng, 0.7), live) for _ in range(20)]
    assert sum(h.p_value < 1e-3 and -h.chi2 > 10 for h in found) >= 18
    assert all(np.abs(freq[h.lines] - 60.0).max() < 1.0 for h in found if h.lines.any())
    wide = [MainsHum().explain(freq, 60.0, one_source(freq, 40.0, rng, 12.0), live) for _ in range(5)]
    assert all(not h.lines.any() for h in wide)  # a resonance, seen by all outputs too


@pytest.mark.parametrize(("step", "known"), [(0.5, np.inf), (0.05, 12.0)], ids=["one offset", "three, from repeats"])
def test_forms_and_offsets_of_a_tone_are_counted_for_what_they_are(step, known):
    """They are much alike: corrected as if each were a test of its own, a chance would be ten times too large."""
    freq, rng, values = np.arange(30.0, 110.0, step), np.random.default_rng(6), []
    live = np.ones((4, 6, len(freq)), bool)
    for _ in range(300):
        noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
        if np.isfinite(known):
            noise /= np.sqrt(rng.gamma(known / 2, 2 / known, live.shape))
        values.append(pickup(freq, 50.0, noise, live, 0.0, known, _tail).p_value)
    assert 0.02 < np.mean(np.array(values) < 0.05) < 0.075


def test_a_mode_narrower_than_the_lines_at_the_mains_frequency_is_hum():
    freq = np.linspace(20.0, 110.0, 301)
    none = np.zeros(0)
    scene = Scene(freq, ("1",), ("1",), ("1",), none, none, np.ones(1), None)
    modes = ((50.1, 1e-3), (100.2, 5e-4), (60.0, 5e-4), (47.0, 1e-3), (50.1, 0.01), (50.25, 1e-3))
    hum = [True, True, True, False, False, False]  # the last is narrow, and highest beside the line that hum reaches
    assert [hums(f, zeta, freq) for f, zeta in modes] == hum
    assert [not MissingMode().fits(np.array([1.0, *m]), scene) for m in modes] == hum


def test_hum_is_judged_by_how_uneven_the_noise_is_elsewhere():
    rng = np.random.default_rng(4)
    freq = np.linspace(20.0, 110.0, 301)
    noise = rng.normal(size=(4, 10, 301)) + 1j * rng.normal(size=(4, 10, 301))
    even = MainsHum().explain(freq, 50.0, noise, np.ones(noise.shape, bool))
    uneven = noise * np.sqrt(rng.gamma(4.0, 0.25, 301))
    assert even.p_value > 0.01
    assert MainsHum().explain(freq, 50.0, uneven, np.ones(noise.shape, bool)).p_value > 0.001
    k = int(np.abs(freq - 50.0).argmin())
    plain, doubted = noise.copy(), uneven.copy()
    for x in (plain, doubted):
        x[..., k] *= 1.7
    assert MainsHum().explain(freq, 50.0, plain, np.ones(noise.shape, bool)).p_value < 1e-4
    assert MainsHum().explain(freq, 50.0, doubted, np.ones(noise.shape, bool)).p_value > 1e-4
