"""Excitations against what they promise: frequency over time, spectrum, impulse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.simulate.excitation import burst, hammer, random, stepped, swept_sine


@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize(("start", "stop"), [(10.0, 40.0), (40.0, 10.0)])
def test_sweep_passes_its_frequencies_when_it_should(start, stop, logarithmic):
    fs, rate = 2000.0, 0.5 if logarithmic else 5.0
    force = np.asarray(swept_sine(start, stop, rate, fs, amplitude=3.0, logarithmic=logarithmic))
    t = np.arange(len(force)) / fs
    up = np.flatnonzero((force[:-1] < 0) & (force[1:] >= 0))
    crossing = t[up] - force[up] / (force[up + 1] - force[up]) / fs
    middle, seen = 0.5 * (crossing[1:] + crossing[:-1]), 1 / np.diff(crossing)
    sign = np.sign(stop - start)
    expected = start * 2 ** (sign * rate * middle) if logarithmic else start + sign * rate * middle
    # one cycle of a running frequency is not quite its value at mid cycle, and crossings are read linearly
    assert np.allclose(seen, expected, rtol=2e-2)
    assert len(force) / fs == pytest.approx(4.0 if logarithmic else 6.0, abs=1 / fs)
    assert np.abs(force).max() == pytest.approx(3.0, rel=1e-3)


def test_stepped_sines_follow_one_another_without_a_jump():
    fs, lines = 500.0, [7.3, 12.9, 4.1]
    force = np.asarray(stepped(lines, 1.3, fs, amplitude=2.0)).reshape(3, -1)
    assert force.shape == (3, 650)
    for line, part in zip(lines, force, strict=True):
        # a sine: the sum of its neighbours is 2 cos(2 pi f / fs) times the sample
        np.testing.assert_allclose(part[2:] + part[:-2], 2 * np.cos(2 * np.pi * line / fs) * part[1:-1], atol=1e-9)
    turns = np.sum(np.array(lines)) * 1.3
    assert force[0, 0] == 0 and np.abs(np.diff(force.ravel())).max() < 2.0 * 2 * np.pi * 12.9 / fs
    after = np.asarray(stepped([*lines, 5.0], 1.3, fs, amplitude=2.0))[3 * 650]
    assert after == pytest.approx(2.0 * np.sin(2 * np.pi * turns), abs=1e-9)


def test_random_has_its_power_in_its_band():
    force = np.asarray(random(jax.random.key(1), 200_000, 1000.0, 50.0, 120.0, rms=4.0))
    assert force.std() == pytest.approx(4.0, rel=0.03)  # 28,000 independent values: 0.6 %
    freq, power = np.fft.rfftfreq(len(force), 1e-3), np.abs(np.fft.rfft(force * np.hanning(len(force)))) ** 2
    assert power[(freq < 49) | (freq > 121)].sum() < 1e-6 * power.sum()
    assert not np.allclose(force, random(jax.random.key(2), 200_000, 1000.0, 50.0, 120.0, rms=4.0))


def test_hammer_pulse_has_its_impulse():
    force = np.asarray(hammer(4000, 10_000.0, peak=50.0, contact=0.004, times=[0.05, 0.25]))
    # a half sine: 2 F T / pi each; 40 samples of it, (pi/40)^2 / 12
    assert force.sum() / 1e4 == pytest.approx(2 * 2 * 50 * 0.004 / np.pi, rel=1e-3)
    assert force[500] == pytest.approx(0, abs=1e-9) and force[520] == pytest.approx(50.0)


def test_burst_ends_in_silence():
    force = np.asarray(burst(jnp.ones(1000), 0.6, ramp=0.05))
    assert not force[601:].any() and force[0] == 0 and force[300] == 1


def test_unusable_input_is_refused():
    with pytest.raises(ValueError, match="must be above 0"):
        swept_sine(0.0, 10.0, 1.0, 100.0)
    with pytest.raises(ValueError, match="line at 0 Hz"):
        stepped([0.0, 5.0], 1.0, 100.0)
    with pytest.raises(ValueError, match="60 Hz at a sampling rate of 100 Hz"):
        swept_sine(10.0, 60.0, 1.0, 100.0)
    with pytest.raises(ValueError, match="is 2 samples long"):
        hammer(100, 1000.0, contact=0.002)
    with pytest.raises(ValueError, match="holds no line"):
        random(jax.random.key(0), 10, 1000.0, 3.0, 4.0)
    with pytest.raises(ValueError, match="share 1.5"):
        burst(jnp.ones(10), 1.5)
