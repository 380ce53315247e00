"""Files of kinds that laboratories hand over and nobody tunes for: ``python experiments/identify/strange_files.py``.

Every kind is a measurement file made here from a modal model that is known: records with leakage, windows left
uncorrected, very low and very high damping, sixty modes, double poles, uneven and coarse lines, bands far from 0 Hz,
wrong forms, conjugation, dead channels, NaN lines, loud noise, and so on. Each is written, loaded, fitted and checked
unattended. Printed are the modes in band found, missed and false, deviations in stated standard deviations, flags of
modes that are off, remarks, and the findings of the check, to be looked at and judged.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scipy.optimize
import scipy.signal
from threadpoolctl import threadpool_limits

import modalax
from modalax.identify import Fit, fit, residues
from modalax.identify.noise import smooth_variance
from modalax.identify.quality import gains_of

jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}
KINDS: dict[str, Callable[[np.random.Generator], tuple[dict[str, Any], np.ndarray]]] = {}


def kind(function: Callable[[np.random.Generator], tuple[dict[str, Any], np.ndarray]]) -> Callable:
    """Put a maker of a file among the kinds; it returns the arrays of the file and the true poles."""
    KINDS[function.__name__.replace("_", " ")] = function
    return function


class System:
    """Modes of frequency ``f`` [Hz] and damping ``zeta`` with real shapes of unit modal mass ``(n, dof)``."""

    def __init__(self, rng: np.random.Generator, f: Any, zeta: Any, dof: int = 5):
        self.f = np.asarray(f, float)
        self.zeta = np.broadcast_to(np.asarray(zeta, float), self.f.shape)
        self.shapes = rng.normal(size=(len(self.f), dof))
        w = 2 * np.pi * self.f
        self.poles = -self.zeta * w + 1j * w * np.sqrt(1 - self.zeta**2)

    def frf(self, s: np.ndarray, outputs: int = 3, inputs: int = 1, form: str = "accelerance") -> np.ndarray:
        """FRFs ``(f, o, i)`` at the Laplace variable s."""
        H = np.zeros((len(s), outputs, inputs), complex)
        for p, x in zip(self.poles, self.shapes, strict=True):
            residue = np.outer(x[:outputs], x[:inputs]) / (2j * p.imag)
            H += residue / (s - p)[:, None, None] + residue.conj() / (s - p.conj())[:, None, None]
        return H * s[:, None, None] ** POWER[form]


def noisy(rng: np.random.Generator, H: np.ndarray, part: float) -> np.ndarray:
    """FRFs with circular noise, a part of each channel's root mean square."""
    size = part * np.sqrt(np.mean(np.abs(H) ** 2, axis=0, keepdims=True))
    return H + size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)


def lines(freq: np.ndarray) -> np.ndarray:
    return 2j * np.pi * np.asarray(freq)


def file(freq: np.ndarray, H: np.ndarray, form: str = "accelerance", **more: Any) -> dict[str, Any]:
    names = {"outputs": [f"{k + 1}Z" for k in range(H.shape[1])], "inputs": [f"{k + 1}Z" for k in range(H.shape[2])]}
    return {"freq": np.asarray(freq), "H": H[None], "form": form, **names, **more}


FIVE = (18.0, 41.0, 43.5, 77.0, 103.0)


@kind
def plain(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.02)), system.poles


@kind
def two_hundred_lines_of_one_FRF(rng):
    system, f = System(rng, (22.0, 47.0, 71.0), 0.015), np.arange(10, 90, 0.4)
    return file(f, noisy(rng, system.frf(lines(f), 1), 0.02)), system.poles


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
def damping_of_a_hundredth_per_cent(rng):
    system, f = System(rng, FIVE, 1e-4), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.002)), system.poles


@kind
def damping_of_a_hundredth_per_cent_seen_finely(rng):
    system, f = System(rng, (101.0, 103.2), 1e-4), np.arange(100, 105, 0.004)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def damping_of_fifteen_per_cent(rng):
    system, f = System(rng, (20.0, 42.0, 65.0), 0.15), np.arange(2, 120, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.01)), system.poles


@kind
def damping_of_fifteen_and_of_a_half_per_cent(rng):
    system, f = System(rng, (20.0, 35.0, 42.0, 65.0), (0.15, 0.005, 0.12, 0.01)), np.arange(2, 120, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.01)), system.poles


@kind
def sixty_modes(rng):
    f0 = np.sort(rng.uniform(30, 970, 60))
    system, f = System(rng, f0, np.exp(rng.uniform(np.log(0.001), np.log(0.008), 60)), 8), np.arange(10, 1000, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 8, 2), 0.005)), system.poles


@kind
def double_poles_two_inputs(rng):
    system, f = System(rng, (30.0, 50.0, 50.02, 80.0), 0.005, 6), np.arange(10, 100, 0.1)
    return file(f, noisy(rng, system.frf(lines(f), 6, 2), 0.005)), system.poles


@kind
def double_poles_one_input(rng):
    system, f = System(rng, (30.0, 50.0, 50.1, 80.0), 0.005, 6), np.arange(10, 100, 0.1)
    return file(f, noisy(rng, system.frf(lines(f), 6), 0.005)), system.poles


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
def zoom_at_two_kilohertz(rng):
    system, f = System(rng, (1700.0, 2011.0, 2030.0, 2034.0, 2071.0, 2300.0), 0.0008), np.arange(2000, 2100, 0.05)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def ultrasonic_zoom(rng):
    system, f = System(rng, (51200.0, 51320.0, 51900.0), 2e-4), np.arange(51000, 52000, 1.25)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def sensors_at_nodes(rng):
    system, f = System(rng, FIVE, 0.01, 6), np.arange(5, 125, 0.125)
    system.shapes[1, 1:] *= 1e-3
    system.shapes[3, :2] *= 1e-3
    return file(f, noisy(rng, system.frf(lines(f), 6, 2), 0.01)), system.poles


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
def free_structure_on_cords(rng):
    system, f = System(rng, (1.2, 2.1, 33.0, 61.0, 97.0), (0.08, 0.05, 0.004, 0.003, 0.004)), np.arange(0, 125, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.005)), system.poles


@kind
def rigid_bodies_and_a_far_mode(rng):
    system, f = System(rng, (0.01, 33.0, 61.0, 400.0), (0.5, 0.004, 0.003, 0.004)), np.arange(1, 100, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.005)), system.poles


@kind
def no_mode_in_band(rng):
    system, f = System(rng, (18.0, 103.0), 0.01), np.arange(35, 75, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def modes_at_both_ends(rng):
    system, f = System(rng, (20.1, 50.0, 79.95), 0.01), np.arange(20, 80, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def softening_spring(rng):
    """One-term harmonic balance of a cubic spring, the other modes linear."""
    system, f = System(rng, FIVE, 0.01, 4), np.arange(5, 125, 0.125)
    H, w = system.frf(lines(f), 4), 2 * np.pi * f
    w0, zeta = 2 * np.pi * 77.0, 0.01
    linear = 1 / (w0**2 - w**2 + 2j * zeta * w0 * w)
    peak = 1 / (2 * zeta * w0**2)
    a, sweep = 0.0, np.zeros_like(w, complex)
    for k in range(len(w)):
        for _ in range(60):
            bent = w0**2 * (1 - 0.02 * (a / peak) ** 2)
            sweep[k] = 1 / (bent - w[k] ** 2 + 2j * zeta * w0 * w[k])
            a = 0.5 * (a + abs(sweep[k]))
    H += -(w**2)[:, None, None] * np.outer(system.shapes[3], system.shapes[3, :1]) * (sweep - linear)[:, None, None]
    return file(f, noisy(rng, H, 0.002)), system.poles


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
def complex_modes(rng):
    system, f = System(rng, FIVE, 0.02), np.arange(5, 125, 0.125)
    H = np.zeros((len(f), 5, 1), complex)
    for p, x in zip(system.poles, system.shapes + 0.7j * rng.normal(size=system.shapes.shape), strict=True):
        residue = np.outer(x, x[:1]) / (2j * p.imag)
        s = lines(f)[:, None, None]
        H += s**2 * (residue / (s - p) + residue.conj() / (s - p.conj()))
    return file(f, noisy(rng, H, 0.01)), system.poles


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
def exact(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, system.frf(lines(f))), system.poles


@kind
def two_hundred_outputs(rng):
    system, f = System(rng, FIVE, 0.01, 200), np.arange(5, 125, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 200), 0.05)), system.poles


@kind
def few_lines(rng):
    system, f = System(rng, (30.0,), 0.02), np.arange(27, 33, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 2), 0.01)), system.poles


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
def pair_a_third_of_a_bandwidth_apart(rng):
    system, f = System(rng, (30.0, 50.0, 50.33, 80.0), 0.01, 6), np.arange(10, 100, 0.05)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.02)), system.poles


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
def modes_that_overlap(rng):
    system, f = System(rng, np.sort(rng.uniform(80, 420, 40)), 0.01, 12), np.arange(100, 400, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 12, 2), 0.01)), system.poles


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
def mode_between_two_lines(rng):
    system, f = System(rng, (30.06, 60.0, 90.06), (2e-4, 0.01, 2e-4)), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def strong_beside_weak(rng):
    system, f = System(rng, (40.0, 41.0, 80.0), (0.01, 0.003, 0.01), 4), np.arange(5, 125, 0.125)
    system.shapes[1] *= 0.03
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.002)), system.poles


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


def judge(found: Fit, poles: np.ndarray) -> str:
    """Modes in band that are found, missed and false, and the largest deviations in stated ones.

    Of a missed mode stands by how much it would have raised twice the log-likelihood, and what chance gives.
    """
    freq = np.asarray(found.frf.freq)
    f, zeta = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    true = np.flatnonzero((f >= freq[0]) & (f <= freq[-1]))
    inside = np.flatnonzero(np.asarray(found.inside))
    own, own_zeta = (np.asarray(a)[inside] for a in (found.model.frequency_hz, found.model.damping_ratio))
    std = np.stack([np.asarray(a)[inside] for a in (found.refined.frequency_std_hz, found.refined.damping_std)], 1)
    reach = np.maximum(zeta * f, 0.5 * np.median(np.diff(freq)))[true]
    apart = np.abs(own[None] - f[true][:, None]) / reach[:, None]
    rows, columns = scipy.optimize.linear_sum_assignment(np.minimum(apart, 5.0)) if apart.size else ([], [])
    pairs = [(r, c) for r, c in zip(rows, columns, strict=True) if apart[r, c] < 2]
    told = [f"{len(pairs)} of {len(true)} modes"]
    missed = np.delete(np.arange(len(true)), [r for r, _ in pairs])
    gain, chance = gains_of(smooth_variance(found.frf), residues(found.frf, poles))
    told += [f"missed {f[true][r]:.5g} Hz, gain {gain[true[r]]:.0f} ({chance[true[r]]:.0f} by chance)" for r in missed]
    for c in np.delete(np.arange(len(inside)), [c for _, c in pairs]):
        told.append(
            f"FALSE {own[c]:.5g} Hz {100 * own_zeta[c]:.3g} % grade {float(found.grade[inside[c]]):.2f} "
            f"{'; '.join(found.flags[inside[c]])}"
        )
    for r, c in pairs:
        error = np.array([own[c] - f[true][r], own_zeta[c] - zeta[true][r]])
        z = error / np.maximum(std[c], 1e-300)
        if np.abs(z).max() > 3 or not np.isfinite(z).all():
            told.append(
                f"{f[true][r]:.5g} Hz off by {error[0]:+.2g} Hz ({z[0]:+.1f} std), damping {100 * own_zeta[c]:.3g} for "
                f"{100 * zeta[true][r]:.3g} % ({z[1]:+.1f} std), grade {float(found.grade[inside[c]]):.2f} "
                f"{'; '.join(found.flags[inside[c]])}"
            )
    return "\n    ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the names of the kinds to take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-fit", action="store_true", help="only the check")
    parser.add_argument("--no-check", action="store_true", help="only the fit")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, make) in enumerate(KINDS.items()):
            if args.only in name:
                one(name, make(np.random.default_rng([args.seed, number])), Path(folder) / f"{number}.npz", args)


def one(name: str, made: tuple[dict[str, Any], np.ndarray], path: Path, args: argparse.Namespace) -> None:
    """Write, load, fit and check one file."""
    arrays, poles = made
    np.savez(path, **arrays)
    print(f"\n== {name}: {' x '.join(map(str, arrays['H'].shape[1:]))}", flush=True)
    began = time.process_time()
    try:
        measured = modalax.load(path)
        if not args.no_fit:
            found = fit(measured)
            answer = found.to_dict()
            print(f"  fit: {judge(found, poles)}")
            noise = float(found.noise)
            print(f"  unexplained {100 * answer['unexplained']:.3g} %, noise {100 * noise:.3g} %")
            for note in found.notes:
                print(f"  note: {note}")
            print(f"  {time.process_time() - began:.1f} CPU s")
    except ValueError as error:
        print(f"  fit: ValueError: {error}")
    if args.no_check:
        return
    began = time.process_time()
    try:
        for f in modalax.check(modalax.load(path)):
            print(f"  check: {f.what} {f.where} {f.size} {f.unit} sure {f.sure:.2f}: {f.evidence}")
        print(f"  {time.process_time() - began:.1f} CPU s")
    except ValueError as error:
        print(f"  check: ValueError: {error}")


if __name__ == "__main__":
    sys.exit(main())
