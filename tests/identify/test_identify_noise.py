"""Weights read off a residual, against the noise that made it."""

import numpy as np
import pytest

from modalax.identify import noise
from modalax.identify.kernels import kernels, residual_terms


def test_channels_of_a_large_set_share_the_course_of_proportional_noise(monkeypatch):
    """Noise a_c (g + b h) with one peak: found within a few per cent, and every output's a multiple of the first's."""
    rng = np.random.default_rng(0)
    lines, outputs, inputs = 600, 40, 2
    size = np.exp(rng.normal(size=(1, outputs, 1)))
    peak = 1 + 50 / (1 + ((np.arange(lines) - 300) / 20) ** 2)[:, None, None]
    H = np.sqrt(size * peak) * np.exp(2j * np.pi * rng.uniform(size=(lines, outputs, inputs)))
    variance = size * (0.01 + 0.003 * peak)
    error = np.sqrt(variance / 2) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    monkeypatch.setattr(noise, "SEVERAL", 0)
    found = noise.sigma_of_error(H, error, proportional=True) ** 2
    assert 0.9 < np.median(found / variance) < 1.1
    assert np.percentile(np.abs(np.log(found / variance)), 95) < 0.25
    assert np.allclose(found / found[:, :1], (found / found[:, :1])[:1])


def test_many_modes_call_for_shared_weights_as_many_samples_do():
    """480,000 samples: of 14 modes channels weigh by themselves, of 112 a step would take minutes."""
    assert not noise.several(480_000, 14)
    assert noise.several(480_000, 112) and noise.several(2**21 + 1, 1)


def test_channels_of_a_large_set_share_all_but_their_size_while_modes_are_sought():
    """Then one basis serves all inputs, whose noise here falls and rises with frequency."""
    rng = np.random.default_rng(1)
    course = np.stack([np.linspace(1, 4, 900), np.linspace(4, 1, 900)], axis=1)[:, None, :]
    error = course * (rng.normal(size=(900, 6, 2)) + 1j * rng.normal(size=(900, 6, 2)))
    H = 100 * np.ones_like(error)
    apart, alike = (noise.sigma_of_error(H, error, modes=modes) for modes in (2, 2000))
    assert alike.shape == H.shape
    assert np.allclose(alike / alike[:, :1, :1], (alike / alike[:, :1, :1])[:1])
    assert np.median(apart[800:, :, 0] / apart[800:, :, 1]) > 2
    assert np.median(alike[800:, :, 0] / alike[:100, :, 0]) < 1.5


def test_what_a_fit_leaves_of_the_noise_around_a_line():
    """Mean power of the residuals of 1,000 least-squares fits, dense around four narrow modes, against the leverage."""
    rng = np.random.default_rng(2)
    s = 2j * np.pi * np.arange(20.0, 220.0)
    poles = 2 * np.pi * np.array([-1 + 118j, -1 + 121j, -2 + 125j, -1 + 129j])
    columns = np.concatenate([residual_terms(s, 0, "complex"), kernels(s, 0, poles, squares=False)], axis=1)
    columns = np.concatenate([columns.real, columns.imag])
    y = rng.normal(size=(2 * len(s), 1000))
    unit = columns / np.linalg.norm(columns, axis=0)
    left = y - unit @ np.linalg.lstsq(unit, y)[0]
    power = np.mean(left.reshape(2, len(s), -1) ** 2, axis=(0, 2))
    # Poles are no unknowns of a linear fit: each column of residues alone, which many channels come to.
    told = noise.left_by_fit(s, 0, poles, (len(s), 32, 1), 1.0)[:, 0, 0]
    near = slice(120, 128)
    window = 8
    seen = np.array([power[max(k - window, 0) : k + window + 1].mean() for k in range(len(s))])
    assert np.min(told) < 0.8 < 0.97 < told[60]
    np.testing.assert_allclose(told, seen, atol=0.05)
    assert abs(told[near].mean() - seen[near].mean()) < 0.04
    assert (noise.left_by_fit(s, 0, poles, (len(s), 33, 1), 1.0) == 1).all()
    one = noise.left_by_fit(s, 0, poles, (len(s), 1, 1), 1.0)
    assert np.sum(1 - one) == pytest.approx((4 + 4 * 4) / 2, rel=0.1)  # all unknowns of one channel, two a line


@pytest.mark.parametrize("shape", [(380, 1, 1), (380, 2, 1), (380, 1, 4), (6000, 1, 1), (40, 1, 1)])
def test_noise_is_a_mean_over_enough_samples(shape):
    """At least 32 of the channels that share it on either side, or an eighth of the lines; a sixtieth of very many."""
    half = noise._window(shape)
    assert half * max(shape[1:]) >= 32 or half == max(8, shape[0] // 8)
    assert half <= max(32 // max(shape[1:]), shape[0] // 60, 8)
