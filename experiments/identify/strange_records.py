"""Files whose measurement is unusual: records, forms, channels, lines, noise, units, a structure that changes."""

import numpy as np
import scipy.signal
from strange_base import FIVE, KINDS, POWER, System, file, kind, lines, noisy


def _blocks(rng, system, fs, n, blocks, burst=1.0, window=None, outputs=3):
    """FRFs by H1 from blocks of random force, on for a part of each, the response carried from block to block."""
    total = n * (blocks + 1)
    on = (np.arange(total) % n) < burst * n
    force = rng.normal(size=total) * on
    F = np.fft.rfft(force, 4 * total)
    s = lines(np.fft.rfftfreq(4 * total, 1 / fs))
    response = np.fft.irfft(system.frf(s, outputs)[..., 0] * F[:, None], axis=0)[:total]
    w = np.ones(n) if window is None else scipy.signal.get_window(window, n)
    cut = lambda a: np.fft.rfft(a.reshape(blocks + 1, n, -1)[1:] * w[:, None], axis=1)
    X, Y = cut(force), cut(response + 0.01 * response.std(axis=0) * rng.normal(size=response.shape))
    H = np.sum(Y * X.conj(), axis=0) / np.sum(np.abs(X) ** 2, axis=0)
    return np.fft.rfftfreq(n, 1 / fs), H[:, :, None]


def _random(rng, zeta, lines_of_block, blocks, **how):
    system = System(rng, FIVE, zeta)
    f, H = _blocks(rng, system, 512, lines_of_block, blocks, **how)
    use = (f > 3) & (f < 130)
    return file(f[use], H[use]), system.poles


KINDS |= {
    "burst random with leakage": lambda rng: _random(rng, 0.004, 1024, 40, burst=0.7),
    "burst random without leakage": lambda rng: _random(rng, 0.02, 2048, 30, burst=0.5),
    "random with hann window": lambda rng: _random(rng, 0.008, 2048, 60, window="hann"),
}


@kind
def exponential_window_uncorrected(rng):
    system, f = System(rng, FIVE, 0.003), np.arange(5, 125, 0.25)
    decay = 2.0
    return file(f, noisy(rng, system.frf(lines(f) + decay), 0.005)), system.poles - decay


@kind
def exponential_window_stated(rng):
    system, f = System(rng, FIVE, 0.003), np.arange(5, 125, 0.25)
    return file(f, noisy(rng, system.frf(lines(f) + 2.0), 0.005), added_decay=2.0), system.poles


@kind
def exponential_window_over_a_weak_low_mode(rng):
    """Of records of 1 s 2 % is left at the end; the lowest mode is weak in accelerance."""
    system, f = System(rng, (6.9, 43.2, 121.1, 237.3), 0.003), np.arange(3.0, 300.0)
    return file(f, noisy(rng, system.frf(lines(f) + 3.9), 0.01)), system.poles - 3.9


def _called_accelerance(rng, form):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f), form=form), 0.01)), system.poles


KINDS |= {
    "mobility called accelerance": lambda rng: _called_accelerance(rng, "mobility"),
    "receptance called accelerance": lambda rng: _called_accelerance(rng, "receptance"),
}


@kind
def sensors_of_three_kinds(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = np.concatenate([system.frf(lines(f), form=k)[:, j : j + 1] for j, k in enumerate(POWER)], axis=1)
    return file(f, noisy(rng, H, 0.01)), system.poles


@kind
def conjugated(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f), 3, 2), 0.01).conj()), system.poles


@kind
def force_over_motion(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, 1 / noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def amplitudes_only(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, np.abs(noisy(rng, system.frf(lines(f)), 0.01))), system.poles


@kind
def uneven_coarse_lines(rng):
    system = System(rng, FIVE, 0.01)
    f = np.unique(np.concatenate([np.arange(5, 125, 2.0), *[f0 * (1 + np.linspace(-4, 4, 17) / 100) for f0 in FIVE]]))
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def logarithmic_lines(rng):
    system, f = System(rng, FIVE, 0.02), np.geomspace(5, 125, 300)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def dead_channel_of_noise(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    H[:, 2] = 1e-4 * np.abs(H).max() * (rng.normal(size=(len(f), 1)) + 1j * rng.normal(size=(len(f), 1)))
    return file(f, H), system.poles


@kind
def dead_channel_of_zeros(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    H[:, 2] = 0
    return file(f, H), system.poles


@kind
def dead_channel_of_NaN(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    H[:, 2] = np.nan
    return file(f, H), system.poles


@kind
def some_NaN_lines(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(0, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    H[[0, 100, 101]] = np.nan
    return file(f, H), system.poles


@kind
def noise_of_a_fifth(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.2)), system.poles


@kind
def noise_of_a_half(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.5)), system.poles


@kind
def noise_of_a_half_roving(rng):
    system, f = System(rng, FIVE, 0.01, 20), np.arange(5, 125, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 1, 20), 0.5)), system.poles


@kind
def variance_a_hundred_times_too_small(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = system.frf(lines(f))
    power = np.mean(np.abs(H) ** 2, axis=0, keepdims=True) + 0 * np.abs(H)
    return file(f, noisy(rng, H, 0.02), variance=(0.002**2 * power)[None]), system.poles


@kind
def roving_sensor_that_loads(rng):
    f0, f = np.array((18.0, 41.0, 77.0)), np.arange(5, 100, 0.125)
    system = System(rng, f0, 0.006, 12)
    H = np.empty((len(f), 12, 1), complex)
    for o in range(12):
        x = system.shapes[:, o]
        loaded = System(rng, f0 * (1 - 0.002 * x**2), 0.006, 12)
        loaded.shapes = system.shapes
        H[:, o] = loaded.frf(lines(f), 12)[:, o]
    return file(f, noisy(rng, H, 0.01)), system.poles


@kind
def one_sensor_late(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    H[:, 2] *= np.exp(-lines(f) * 5e-4)[:, None]
    return file(f, H), system.poles


@kind
def hum_and_spikes(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = noisy(rng, system.frf(lines(f), 4), 0.01)
    for h in (50.0, 100.0):
        H[np.argmin(np.abs(f - h))] += 0.5 * np.abs(H).max()
    return file(f, H), system.poles


@kind
def transmissibility(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(0.5, 125, 0.125)
    return file(f, noisy(rng, 1 + 0.02 * system.frf(lines(f), 4), 0.005)), system.poles


@kind
def tiny_units(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, 1e-12 * noisy(rng, system.frf(lines(f), form="receptance"), 0.01), "receptance"), system.poles


@kind
def single_precision(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = system.frf(lines(f)).astype(np.complex64)
    return file(f.astype(np.float32), H), system.poles


@kind
def hammer_rectangular_records(rng):
    """Free decays cut off after two seconds."""
    system = System(rng, FIVE, 0.004)
    fs, n = 512, 1024
    full = np.fft.irfft(system.frf(lines(np.fft.rfftfreq(64 * n, 1 / fs)), form="accelerance")[..., 0], axis=0)[:n]
    f, H = np.fft.rfftfreq(n, 1 / fs), np.fft.rfft(full, axis=0)
    use = (f > 3) & (f < 130)
    return file(f[use], noisy(rng, H[use][:, :, None], 0.005)), system.poles


@kind
def filtered_above(rng):
    """An anti-aliasing filter of the sensors ends inside the band."""
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    roll = scipy.signal.freqs(*scipy.signal.bessel(4, 2 * np.pi * 110, analog=True), 2 * np.pi * f)[1]
    return file(f, noisy(rng, system.frf(lines(f), 4) * roll[:, None, None], 0.005)), system.poles


@kind
def receptance_integrated_from_accelerance(rng):
    """Noise of the accelerometers, divided by the square of frequency, buries the first lines."""
    system, f = System(rng, FIVE, 0.01), np.arange(0.125, 125, 0.125)
    H = noisy(rng, system.frf(lines(f)), 0.01)
    return file(f, H / lines(f)[:, None, None] ** 2, "receptance"), system.poles


@kind
def band_with_a_gap(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    f = f[(f < 50) | (f > 70)]
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def negative_frequencies_too(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(-128, 128, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def falling_frequencies(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f[::-1], noisy(rng, system.frf(lines(f)), 0.01)[::-1]), system.poles


@kind
def one_hit_in_g_others_in_metres(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    H = system.frf(lines(f), 3, 3)
    H[:, 1, :] /= 9.81
    return file(f, noisy(rng, H, 0.01)), system.poles


@kind
def noise_alone(rng):
    f = np.arange(5, 125, 0.125)
    H = rng.normal(size=(len(f), 4, 2)) + 1j * rng.normal(size=(len(f), 4, 2))
    return file(f, H), np.array([1j])


@kind
def frequencies_that_drift_over_hits(rng):
    f0, f = np.array(FIVE), np.arange(5, 125, 0.125)
    system = System(rng, f0, 0.006, 9)
    H = np.empty((len(f), 1, 9), complex)
    for i in range(9):
        moved = System(rng, f0 * (1 - 3e-4 * i), 0.006, 9)
        moved.shapes = system.shapes
        H[:, :, i] = moved.frf(lines(f), 1, 9)[:, :, i]
    return file(f, noisy(rng, H, 0.01)), system.poles
