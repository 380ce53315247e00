"""The automatic fit on measured structures, beside what others published."""

import numpy as np
import pytest

from modalax.data.datasets import uliege_plane
from modalax.identify import fit, lscf

# Natural frequencies [Hz] by those who made the test, with a PolyMAX of their own.
PUBLISHED = np.array(
    [18.843, 40.122, 87.852, 89.652, 97.071, 105.200, 118.013, 125.214, 125.584, 129.952, 135.276, 143.372, 166.266]
)


@pytest.mark.measured
def test_all_published_modes_of_the_aeroplane_are_poles_of_one_order(measured):
    """A quarter of the hits; of its 32 poles of little damping 13 are the published ones, each another."""
    frf = uliege_plane().frf
    table = lscf(frf.drop([name for k, name in enumerate(frf.inputs) if k % 4]).band(12.0, 180.0), 60)
    poles = np.asarray(table.poles[0])[np.asarray(table.valid[0])]
    frequency, damping = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    frequency = frequency[(poles.imag > 0) & (damping > 0) & (damping < 0.015)]
    near = np.abs(frequency[None, :] / PUBLISHED[:, None] - 1).argmin(axis=1)
    assert len(set(near)) == len(PUBLISHED) and len(frequency) < 40
    off = np.abs(frequency[near] / PUBLISHED - 1)
    # Measured: 0.11 % at most but for one of the pair at 125 Hz, whose modes are 0.3 % apart.
    assert np.sort(off)[-2] < 1.5e-3 and off.max() < 4e-3


@pytest.mark.slow
@pytest.mark.measured
def test_all_published_modes_of_the_aeroplane_are_found(measured):
    """No frequency is given; each published mode has one of its own within 0.15 %, two pairs of them close."""
    found = fit(uliege_plane().frf, band=(12.0, 180.0))
    frequency = np.asarray(found.model.frequency_hz)[np.asarray(found.inside)]
    near = np.abs(frequency[None, :] / PUBLISHED[:, None] - 1).argmin(axis=1)
    assert len(set(near)) == len(PUBLISHED)
    # Measured: 0.083 % at most, at 129.95 Hz, which an independent pLSCF has 0.13 % off.
    np.testing.assert_allclose(frequency[near], PUBLISHED, rtol=1.5e-3)
    assert len(frequency) <= len(PUBLISHED) + 2  # one more, at 55.3 Hz, is weak but stands in hits on the wing
