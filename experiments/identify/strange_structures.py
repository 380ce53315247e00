"""Files whose modes are unusual: damping, number, distance, place in the band, shapes, a spring that softens."""

import numpy as np
from strange_base import FIVE, System, file, kind, lines, noisy


@kind
def plain(rng):
    system, f = System(rng, FIVE, 0.01), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.02)), system.poles


@kind
def two_hundred_lines_of_one_FRF(rng):
    system, f = System(rng, (22.0, 47.0, 71.0), 0.015), np.arange(10, 90, 0.4)
    return file(f, noisy(rng, system.frf(lines(f), 1), 0.02)), system.poles


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
def complex_modes(rng):
    system, f = System(rng, FIVE, 0.02), np.arange(5, 125, 0.125)
    H = np.zeros((len(f), 5, 1), complex)
    for p, x in zip(system.poles, system.shapes + 0.7j * rng.normal(size=system.shapes.shape), strict=True):
        residue = np.outer(x, x[:1]) / (2j * p.imag)
        s = lines(f)[:, None, None]
        H += s**2 * (residue / (s - p) + residue.conj() / (s - p.conj()))
    return file(f, noisy(rng, H, 0.01)), system.poles


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
def pair_a_third_of_a_bandwidth_apart(rng):
    system, f = System(rng, (30.0, 50.0, 50.33, 80.0), 0.01, 6), np.arange(10, 100, 0.05)
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.02)), system.poles


@kind
def modes_that_overlap(rng):
    system, f = System(rng, np.sort(rng.uniform(80, 420, 40)), 0.01, 12), np.arange(100, 400, 0.25)
    return file(f, noisy(rng, system.frf(lines(f), 12, 2), 0.01)), system.poles


@kind
def mode_between_two_lines(rng):
    system, f = System(rng, (30.06, 60.0, 90.06), (2e-4, 0.01, 2e-4)), np.arange(5, 125, 0.125)
    return file(f, noisy(rng, system.frf(lines(f)), 0.01)), system.poles


@kind
def strong_beside_weak(rng):
    system, f = System(rng, (40.0, 41.0, 80.0), (0.01, 0.003, 0.01), 4), np.arange(5, 125, 0.125)
    system.shapes[1] *= 0.03
    return file(f, noisy(rng, system.frf(lines(f), 4), 0.002)), system.poles
