"""Weights read off a residual, against the noise that made it."""

import numpy as np

from modalax.identify import noise


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
