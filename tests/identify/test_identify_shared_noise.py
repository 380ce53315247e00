"""Noise that all outputs share: told from noise of their own and from misfit, and counted by error bars and modes."""

import numpy as np
import pytest

from modalax.identify import fit
from modalax.identify.host import refine_on_host
from modalax.identify.residues import residues
from modalax.identify.shared_noise import shared_noise
from modalax.model import ModalModel

NAMES = list("abcdef")
SIZE = 0.03  # of the noise, relative to each sample
MODEL = ModalModel.from_real_modes(
    [20.0, 45.0], [0.02, 0.01], [[1.0, 0.8, 0.6, 0.4, 0.2, 0.1], [1.0, 0.3, -0.6, -0.9, -0.5, -0.2]], [1.0, 1.0], NAMES
)
CLEAN = MODEL.frf(np.arange(10.0, 60.0, 0.125), inputs=["a"], form="accelerance")


def circular(rng, shape):
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def measured(seed, part):
    """FRFs of which noise of the force makes a part of the noise's variance, and the outputs the rest."""
    rng = np.random.default_rng(seed)
    lines = len(CLEAN.freq)
    noise = np.sqrt(part) * circular(rng, (lines, 1, 1)) + np.sqrt(1 - part) * circular(rng, (lines, len(NAMES), 1))
    H = np.asarray(CLEAN.H)
    return CLEAN.replace(H=H * (1 + SIZE * noise), variance=(SIZE * np.abs(H)) ** 2)


def test_shared_noise_is_told_from_that_of_outputs():
    """Of 6 outputs it counts 6 times; three quarters of it 4.75 times, the largest eigenvalue of its covariance.

    Their mean over 20 draws is within 3 %. Noise of the outputs' own is never told.
    """
    response = np.asarray(CLEAN.H) / np.abs(CLEAN.H) / SIZE
    counts = {p: [_counts(measured(k, p), response) for k in range(20)] for p in (0.0, 0.75, 1.0)}
    assert counts[0.0] == [1.0] * 20
    assert np.mean(counts[0.75]) == pytest.approx(4.75, rel=0.03)
    assert counts[1.0] == pytest.approx([6.0] * 20, rel=1e-6)


def _counts(frf, response):
    return shared_noise(response, (np.asarray(frf.H) - np.asarray(CLEAN.H)) / np.sqrt(np.asarray(frf.variance)))


def test_misfit_is_no_shared_noise():
    """A third mode that the model lacks, and a frequency that is off, beside noise of the outputs' own."""
    frf = measured(0, 0.0)
    sigma = np.sqrt(np.asarray(frf.variance))
    off = MODEL.replace(poles=MODEL.poles * 1.01)
    one = ModalModel.from_real_modes([20.0], [0.02], np.asarray(MODEL.shapes[:1]).real, [1.0], NAMES)
    for other in (off, one):
        made = np.asarray(other.frf(frf.freq, inputs=["a"], form="accelerance").H)
        assert shared_noise(made / sigma, (np.asarray(frf.H) - made) / sigma) == 1.0


@pytest.mark.parametrize("part", [0.0, 1.0])
def test_error_bars_know_shared_noise(part):
    """40 refinements: standardised errors are of root mean square 1, within 4 of its standard deviations."""
    start, z = residues(CLEAN, MODEL.poles), []
    true = np.concatenate([MODEL.frequency_hz, MODEL.damping_ratio])
    for seed in range(40):
        found = refine_on_host(measured(seed, part), start)
        got = np.concatenate([found.model.frequency_hz, found.model.damping_ratio])
        z.append((got - true) / np.concatenate([found.frequency_std_hz, found.damping_std]))
    assert abs(np.sqrt(np.mean(np.square(z))) - 1) < 4 / np.sqrt(2 * np.size(z))


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_shared_noise_makes_no_modes_and_no_window(seed):
    found = fit(measured(seed, 1.0))
    assert np.asarray(found.model.frequency_hz)[np.asarray(found.inside)] == pytest.approx([20, 45], rel=2e-3)
    assert any("noise of all outputs is common" in note for note in found.notes)
    assert not any("window" in note for note in found.notes)
