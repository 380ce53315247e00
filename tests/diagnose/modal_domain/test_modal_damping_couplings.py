"""Damping by modes couples the simulation's modes where the structure's shapes are others, those above the band too."""

import numpy as np
from frames import DOFS, simulation

from modalax.diagnose.modal_domain.coordinates import coordinates_of
from modalax.diagnose.modal_domain.inaccuracy import NEAR, inaccuracy_of


def test_the_highest_mode_of_the_band_is_coupled_with_those_above():
    s, top = simulation(), 2 * np.pi * 330
    c = coordinates_of(s, DOFS[::2], (DOFS[6],), top)
    a = inaccuracy_of(s, c, top)
    patterns = a.patterns[a.groups.index("damping between modes")]
    last = int((c.frequencies < top).sum()) - 1
    assert np.flatnonzero(np.abs(patterns[:, last]).sum(axis=0)).max() == min(last + NEAR, c.size - 1)
