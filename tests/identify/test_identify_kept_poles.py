"""Poles of the diagram that are kept: their error bars know columns that disagree, as where a structure was changed."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import fit
from modalax.identify.refine import HELD

F, ZETA = np.array([60.0, 112.0, 306.0]), np.array([1.5e-4, 1.4e-4, 1.2e-4])  # the last one beyond the band [Hz], [-]


def columns(shift: float) -> FRF:
    """Accelerances of one sensor by three hits, from each of which to the next frequencies rise by a part ``shift``."""
    rng = np.random.default_rng(4)
    freq, size = np.linspace(20.0, 180.0, 8001), rng.normal(size=(3, 3))
    s, H = 2j * np.pi * freq, np.zeros((8001, 1, 3), complex)
    for k in range(3):
        for r, omega in enumerate(2 * np.pi * F * (1 + shift * (k - 1))):
            H[:, 0, k] += s**2 * size[r, k] / (s**2 + 2 * ZETA[r] * omega * s + omega**2)
    noise = rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)
    H += 1e-3 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * noise
    return FRF(freq, H, form="accelerance", outputs=("1",), inputs=("a", "b", "c"))


@pytest.mark.parametrize(("shift", "least", "most"), [(0.0, 0.0, 5e-5), (4e-5, 5e-4, 5e-3)])
def test_error_bars_of_kept_poles_know_columns_that_disagree(shift, least, most):
    found = fit(columns(shift))
    assert found.refined is not None and int(found.refined.reason_code) == HELD
    f, std = np.asarray(found.model.frequency_hz), np.asarray(found.refined.frequency_std_hz)
    assert len(f) == 2 and (least <= std).all() and (std < most).all()
    assert (np.abs(f - F[:2]) < 3 * std + 1e-6).all()
    assert any("inputs disagree" in note for note in found.notes) is (shift > 0)
