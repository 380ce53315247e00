"""What the data show beside the verdict, each number against a closed form."""

from dataclasses import replace

import numpy as np
import pytest

from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.evidence import (
    Compared,
    band,
    by_channel,
    by_level,
    by_mode,
    evidence_of,
    hilbert,
    homogeneity,
    local_pole,
    reciprocity,
    whiteness,
)

FREQ = np.linspace(5, 100, 1200)
S = 2j * np.pi * FREQ[:, None, None]
MODES = [(20.0, 0.012), (45.0, 0.01), (140.0, 0.01)]
SHAPES = np.array([[1.0, 0.6, 0.3], [0.5, -1.0, 0.7], [0.2, 0.4, 1.0]])
NAMES, TEST = ("a", "b", "c"), Omnibus(0.5, 1.0, "each run", (0.0, 0.0))


def frf(modes=MODES, shapes=SHAPES):
    """Receptance at three outputs to forces at the first two."""
    parts = [np.outer(p, p[:2]) / (S**2 + 4 * np.pi * f * z * S + (2 * np.pi * f) ** 2) for (f, z), p in
             zip(modes, shapes, strict=True)]  # fmt: skip
    return sum(parts)[None]


def compared(measured, before, after=None, sigma=1e-6, level=None):
    after = before if after is None else after
    residuals = tuple(np.sqrt(2) * (measured - p) / sigma for p in (before, after))
    level = np.full(len(measured), np.nan) if level is None else np.array(level)
    modes = np.array([m for m in MODES if m[0] < FREQ[-1]]).T
    return Compared(FREQ, measured, before, after, residuals, (TEST, TEST), level, NAMES, NAMES[:2], 0, modes)


def noisy(H, sigma=1e-6, seed=0):
    rng = np.random.default_rng(seed)
    return H + sigma / np.sqrt(2) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))


@pytest.mark.parametrize("kind", ["reciprocity", "homogeneity", "band"])
def test_chances_are_even_under_noise_and_nil_where_the_assumption_fails(kind):
    H = np.repeat(frf(), 2, 0)
    wrong = {
        "reciprocity": lambda M: M * np.array([[1.0, 1.1], [1.0, 1.0], [1.0, 1.0]]),
        "homogeneity": lambda M: M * np.array([1.0, 1.05])[:, None, None, None],
        "band": lambda M: M * (1 + 0.1 * (FREQ > 30))[:, None, None],
    }[kind]
    test = {"reciprocity": reciprocity, "homogeneity": homogeneity, "band": lambda c: band(c, c.before)}[kind]
    found = [test(compared(noisy(H, seed=k), H)) for k in range(40)]
    assert 0.3 < np.mean([f["p_value"] for f in found]) < 0.7
    assert np.mean([f["chi2"] / f["freedom"] for f in found]) == pytest.approx(1.0, abs=0.35)
    broken = noisy(wrong(H))
    assert test(compared(broken, H))["p_value"] < 1e-6


def test_tests_without_data_for_them_are_none():
    c = replace(compared(noisy(frf()), frf()), inputs=("x", "b"))
    assert reciprocity(c) is None and homogeneity(c) is None
    assert evidence_of(replace(c, freq=np.zeros(0))) is None


def test_whiteness_is_two_sided():
    assert whiteness(replace(TEST, whiteness=(0.1, -1.959964)))["p_value"] == pytest.approx(0.05, abs=1e-6)


def test_a_local_pole_is_that_of_the_mode():
    for f, z in MODES[:2]:
        start = 2 * np.pi * f * 1.02 * (-0.02 + 1j)
        pole = local_pole(compared(frf(), frf()), frf()[0].reshape(len(FREQ), -1), start)
        assert abs(pole) / 2 / np.pi == pytest.approx(f, rel=1e-5)
        assert -pole.real / abs(pole) == pytest.approx(z, rel=2e-3)


def test_errors_of_modes_are_those_of_the_simulation():
    before = frf([(20.4, 0.009), *MODES[1:]], SHAPES)
    rows = by_mode(compared(frf(), before, frf()))
    assert [round(r["frequency_hz"]) for r in rows] == [20, 45]
    first, second = rows
    assert first["frequency_error_before"] == pytest.approx(0.02, abs=1e-4)
    assert first["damping_error_before"] == pytest.approx(-0.25, abs=0.01)
    assert first["peak_error_db_before"] == pytest.approx(20 * np.log10(0.012 * 20**2 / (0.009 * 20.4**2)), abs=0.1)
    assert abs(first["frequency_error_after"]) < 1e-9 and first["chi2_after"] is None  # the residual is 0
    assert abs(second["frequency_error_before"]) < 1e-3


def test_a_measured_mode_is_told_once():
    """A simulated mode at 42 Hz that the measurement does not show; its local fit ends at 45 Hz as well."""
    c = compared(frf(), frf())
    c = replace(c, modes=np.array([[20.0, 42.0, 45.0], [0.012, 0.01, 0.01]]))
    pole = local_pole(c, c.measured[0].reshape(len(FREQ), -1), 2 * np.pi * 42.0 * complex(-0.01, 1.0))
    assert pole is not None and abs(abs(pole) / (2 * np.pi) - 45.0) < 1e-3
    assert [round(r["frequency_hz"]) for r in by_mode(c)] == [20, 45]


def test_a_mode_in_channels_of_unlike_units_and_noise_is_found_where_it_is():
    """The second output in other units, with most of the noise: as large as the others, it would pull the mode."""
    gain, sigma = np.array([1.0, 1e4, 1.0])[:, None], 1e-7 * np.array([1.0, 4e6, 1.0])[:, None]
    H = noisy(frf() * gain, sigma)
    rows = by_mode(compared(H, frf() * gain, sigma=sigma))
    assert [round(r["frequency_hz"]) for r in rows] == [20, 45]
    assert max(abs(r["frequency_hz"] / f - 1) for r, (f, _) in zip(rows, MODES, strict=False)) < 1e-5


def test_noise_at_a_line_is_no_mode():
    """A mode that the simulation has and no channel sees."""
    c = compared(noisy(frf()), frf(), sigma=1e-6)
    for f in np.linspace(60.0, 80.0, 41):
        assert local_pole(c, c.whitened(c.measured[0]), 2 * np.pi * f * complex(-0.001, 1.0)) is None


def test_channels_and_levels_hold_their_share_of_the_residual():
    gain = np.ones((1, 1, 3, 2))
    gain[..., 1, 0] = 2.0
    H = np.repeat(frf(), 2, 0)
    c = compared(noisy(H * gain), H, H * gain, level=[2.0, np.nan])
    rows = by_channel(c)
    assert [(r["output"], r["input"]) for r in rows][:4] == [("a", "a"), ("b", "a"), ("c", "a"), ("a", "b")]
    size = (np.abs(H[:, :, 1, 0]) ** 2).mean() / 1e-12
    assert rows[1]["chi2_before"] == pytest.approx(size, rel=0.05) and rows[0]["chi2_before"] < 1.2
    assert rows[1]["chi2_after"] == pytest.approx(1.0, abs=0.1)
    assert rows[1]["frac_before"] == pytest.approx(1.0, abs=1e-2)  # a gain does not show in it
    assert [r["level"] for r in by_level(c)] == [2.0, None]


def test_the_hilbert_transform_misses_nothing_of_a_linear_structure_and_much_of_a_stiffening_one():
    c = compared(frf(), frf())
    assert hilbert(c, frf()[0]) < 1e-5
    f, zeta, cubic, amplitude = 45.0, 0.01, 3e9, []
    for w in 2 * np.pi * FREQ:  # the lower branch of |x|^2 ((k - w^2 + 3/4 k3 |x|^2)^2 + (c w)^2) = 1
        k, loss = (2 * np.pi * f) ** 2 - w**2, 4 * np.pi * zeta * f * w
        roots = np.roots([cubic**2, 2 * cubic * k, k**2 + loss**2, -1.0])
        amplitude.append(min(r.real for r in roots if abs(r.imag) < 1e-9 * abs(r) and r.real > 0))
    w = S.imag[:, 0, 0]
    bent = 1 / ((2 * np.pi * f) ** 2 - w**2 + cubic * np.array(amplitude) + 4j * np.pi * zeta * f * w)
    assert hilbert(c, bent[:, None, None]) > 0.01
    assert hilbert(replace(c, modes=np.array([[20.0], [1e-4]])), frf()[0]) is None
    uneven = np.sort(FREQ + np.random.default_rng(0).uniform(0, 0.05, len(FREQ)))
    assert hilbert(replace(c, freq=uneven), frf()[0]) is None
