"""The virtual test bench: what is measured on a linear structure is its FRF, and what a channel does to it is seen."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from modalax.model import Structure
from modalax.simulate import harmonic_balance
from modalax.simulate.bench import Bench, Sensor, butterworth
from modalax.simulate.joints import CubicSpring
from modalax.simulate.procedures import hammer_test, multisine_test, random_test, stepped_test, sweep_test

OMEGA = 2 * np.pi * 20.0
STRUCTURE = Structure([[1.0]], [[2 * 0.03 * OMEGA]], [[OMEGA**2]], ["m"])
KEY = jax.random.key(3)
PERIOD = {"band": (10.0, 40.0), "period": 2.0, "periods": 1, "skip": 2}


def bench(**changes):
    return Bench(STRUCTURE, **({"fs": 128.0, "inputs": ["m"]} | changes))


def exact(measured):
    return np.asarray(STRUCTURE.frf(measured.freq, form=measured.form).H)


def error(measured):
    H = exact(measured)
    return np.abs(np.asarray(measured.H)[0] - H).max() / np.abs(H).max()


def test_multisine_measures_the_frf():
    measured = multisine_test(bench(), KEY, 2.0, **PERIOD)
    # the cubic between samples at 26 steps a cycle of 40 Hz; measured 1e-5 to 4e-5
    assert error(measured) < 1e-4
    assert measured.form == "accelerance" and float(measured.level[0]) == 2.0


def test_gain_delay_and_filter_of_a_sensor_are_in_the_frf():
    sensor = Sensor(gain=1.1, delay=1.5e-3, lowpass=60.0, order=2)
    plain, through = (multisine_test(bench(response_sensor=s), KEY, 2.0, **PERIOD) for s in (Sensor(), sensor))
    b, a = scipy.signal.butter(2, 2 * np.pi * 60.0, analog=True)
    s = 2j * np.pi * np.asarray(plain.freq)
    expected = 1.1 * np.exp(-s * 1.5e-3) * np.polyval(b, s) / np.polyval(a, s)
    ratio = np.asarray(through.H / plain.H)[0, :, 0, 0]
    assert np.abs(ratio - expected).max() < 1e-3


@pytest.mark.parametrize("high", [False, True])
def test_filters_are_those_of_scipy(high):
    b, a = scipy.signal.butter(3, 2 * np.pi * 25.0, "high" if high else "low", analog=True)
    s = 2j * np.pi * np.array([1e-3, 5.0, 25.0, 90.0])
    expected = np.polyval(b, s) / np.polyval(a, s)
    assert np.abs(np.asarray(butterworth(jnp.asarray(s), 25.0, 3, high)) - expected).max() < 1e-12


def test_noise_shows_as_variance_and_force_noise_lowers_h1():
    quiet = random_test(bench(), KEY, 1.0, band=(10.0, 40.0), duration=64.0, block=4.0)
    loud = random_test(bench(force_sensor=Sensor(noise=1.0)), KEY, 1.0, band=(10.0, 40.0), duration=64.0, block=4.0)
    ratio = np.abs(np.asarray(loud.H) / np.asarray(quiet.H)).mean()
    # force of 1 N in 30 Hz against noise of 1 N in 64 Hz: H1 falls by 1 / (1 + 30/64) = 0.681
    assert ratio == pytest.approx(1 / (1 + 30 / 64), abs=0.04)
    assert np.mean(np.asarray(loud.variance)) > 3 * np.mean(np.asarray(quiet.variance))


def test_sweeps_up_and_down_measure_the_frf():
    for start, stop in ((5.0, 45.0), (45.0, 5.0)):
        assert (
            error(sweep_test(bench(), KEY, 1.0, start=start, stop=stop, rate=8.0, tail=3.0, band=(10.0, 40.0))) < 2e-4
        )


def test_hammer_measures_the_frf():
    measured = hammer_test(bench(), KEY, 20.0, contact=0.012, block=4.0, hits=2, band=(10.0, 40.0))
    assert error(measured) < 1e-3


def test_a_hardening_spring_raises_the_frequency_with_the_level():
    held = Bench(STRUCTURE, [CubicSpring(1e8)], [["m"]], fs=128.0, inputs=["m"])
    measured = multisine_test(held, KEY, [0.1, 12.0], **PERIOD)
    peaks = np.asarray(measured.freq)[np.abs(np.asarray(measured.H))[:, :, 0, 0].argmax(axis=1)]
    assert peaks[0] == pytest.approx(20.0, abs=0.5) and peaks[1] > peaks[0] + 0.5


STEPS = {"block": 1.0, "settle": 3.0, "repeats": 4}
LINES, PUSH = np.arange(18.0, 26.0), 10.0


@pytest.mark.parametrize("sweep", [pytest.param("up", marks=pytest.mark.slow), "down"])
def test_stepped_sine_through_sensors_is_the_branch_of_harmonic_balance_times_their_response(sweep):
    joint = {"joints": [CubicSpring(4e8)], "places": [["m"]]}
    accelerometer = Sensor(gain=0.95, delay=8e-4, noise=0.5, lowpass=60.0, highpass=0.5, order=2)
    load_cell = Sensor(gain=1.02, delay=2e-4)
    held = bench(force_sensor=load_cell, response_sensor=accelerometer, **joint)
    measured = stepped_test(held, KEY, PUSH, LINES, downward=sweep == "down", **STEPS)
    balanced = harmonic_balance(
        STRUCTURE, freq=LINES, level=PUSH, inputs=["m"], harmonics=7, samples=256, sweep=sweep, **joint
    )
    s = 2j * np.pi * LINES
    b, a = scipy.signal.butter(2, 2 * np.pi * 60.0, analog=True)
    response = 0.95 * np.exp(-s * 8e-4) * np.polyval(b, s) / np.polyval(a, s) * s / (s + np.pi)
    expected = np.asarray(balanced.frf_values("accelerance"))[0, :, 0, 0] * response / (1.02 * np.exp(-s * 2e-4))
    size = np.abs(expected)
    # two branches: only going up does the resonance last to the last line
    assert (size[-1] > 0.9 * size.max()) == (sweep == "up")
    off, sigma = np.asarray(measured.H)[0, :, 0, 0] - expected, np.sqrt(np.asarray(measured.variance)[0, :, 0, 0])
    # noise, as large as it is said to be: measured 4e-4 of the peak, and 1.0 to 1.2 of what is said
    assert np.max(np.abs(off)) < 1e-3 * size.max()
    assert 0.5 < np.sqrt(np.mean(np.abs(off) ** 2) / np.mean(sigma**2)) < 2


def test_same_key_same_records_other_key_others():
    noisy, force = bench(response_sensor=Sensor(noise=0.1)), np.zeros((1, 1024, 1))
    first, again, other = (noisy.record(k, force).response for k in (KEY, KEY, jax.random.key(4)))
    assert np.array_equal(first, again) and not np.allclose(first, other)
    assert np.std(np.asarray(first)) == pytest.approx(0.1, rel=0.3)


def test_unusable_input_is_refused():
    with pytest.raises(ValueError, match="2 sensors for 1 channels"):
        bench(force_sensor=[Sensor(), Sensor()])
    with pytest.raises(ValueError, match="needs \\(run, t, i\\)"):
        bench().record(KEY, np.zeros((5, 1)))
    with pytest.raises(ValueError, match="9.25 periods of 18.5 Hz"):
        stepped_test(bench(), KEY, 1.0, [18.0, 18.5], block=0.5, settle=1.0)
    with pytest.raises(ValueError, match="holds 12.8 samples"):
        multisine_test(bench(), KEY, 1.0, band=(10.0, 40.0), period=0.1)
