"""Variances that are stated too small: told from noise, traces of a joint and hum, and mended from the lines."""

import numpy as np
import pytest
from frames import measured, simulation

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.measured import identify


def identified(data):
    return identify(data, None)


def test_variances_an_eighth_of_the_noise_are_taken_from_the_lines_instead():
    """Modes, their number and the noise are those that the true variances give."""
    data, _ = measured(5, 0.0, lines=300)
    true = identified(data)
    eighth = identified(data.replace(variance=np.asarray(data.variance) / 8))
    assert true.noise.source == "variances as given"
    assert "too small, where they are by a factor of" in eighth.noise.source
    assert len(eighth.modes.poles) == len(true.modes.poles)
    assert np.median(eighth.noise.sigma / true.noise.sigma) == pytest.approx(1.0, abs=0.08)
    np.testing.assert_allclose(np.abs(eighth.features.poles), np.abs(true.features.poles), rtol=1e-3)


def missing_noise_at_peaks(lines):
    """Noise that follows the response, by one mean variance and by its own."""
    data, _ = measured(6, 0.0, lines=lines, noise=1e-9)
    H, rng = np.asarray(data.H), np.random.default_rng(1)
    sigma = 0.01 * np.abs(H)
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    mean = np.broadcast_to((sigma**2).mean(axis=1, keepdims=True), H.shape)
    return data.replace(H=H, variance=mean), data.replace(H=H, variance=sigma**2)


def test_variances_that_miss_the_noise_at_peaks_alone_make_no_mode():
    """It was a mode of a single line beside a peak."""
    mean, own = (identified(data) for data in missing_noise_at_peaks(350))
    assert "too small, where they are by a factor of" in mean.noise.source
    np.testing.assert_allclose(np.abs(mean.features.poles), np.abs(own.features.poles), rtol=1e-3)


@pytest.mark.slow  # their modes by default
def test_a_diagnosis_under_variances_that_miss_the_noise_at_peaks_is_clean():
    found = diagnose_modes(missing_noise_at_peaks(700)[0], simulation())
    assert found is not None and found.verdict == "clean", found.reasons
    assert any("too small" in note for note in found.notes)


def curve(H, lines):
    """What a slow trace of something else adds: an arc over the lines."""
    return 0.06 * np.abs(H).mean() * np.sin(np.linspace(0, 9, lines))[None, :, None, None]


def hum(H, lines):
    """Single lines far off, every twentieth."""
    return 0.5 * np.abs(H).mean() * (np.arange(lines) % 20 == 0)[None, :, None, None]


@pytest.mark.parametrize("trace", [curve, hum])
def test_what_is_no_noise_does_not_count_as_it(trace):
    lines = 300
    data, _ = measured(7, 0.0, lines=lines, noise=0.002)
    H = np.asarray(data.H)
    found = identified(data.replace(H=H + trace(H, lines)))
    assert found.noise.source == "variances as given"
    assert found.misfit > 1.5
