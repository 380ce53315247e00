"""Where the force ends, told from noise that resonances raise too."""

import numpy as np
import pytest
from test_check_words import FREQ, STEEP, Bench, accelerance

# Noise grows by 60 dB in 40 Hz from 55 Hz on: by the 10 dB at which the force counts as weak here.
END = 55 + 40 / 6


@pytest.mark.parametrize("times", [0, -2])
def test_the_force_ends_where_the_noise_stays_up(times):
    """Noise of the force stands in proportion to the FRF and rises at each resonance; receptances fall by f^2."""
    H, s = accelerance(), (2j * np.pi * FREQ[:, None, None]) ** times
    of_force = np.median(np.abs(H), axis=1, keepdims=True) / np.median(np.abs(H))
    form = {0: "accelerance", -2: "receptance"}[times]
    found = Bench(H * s, form=form, noise=np.hypot(STEEP, of_force) * np.abs(s)).measured()
    ends = [f.size for f in found if f.what == "force_rolloff"]
    assert len(ends) == 2 and ends == pytest.approx([END, END], abs=4)
    assert {f.what for f in found} == {"force_rolloff"}
