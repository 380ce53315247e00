"""What is left of single resonances at the end of records of hits."""

import numpy as np
import pytest

from modalax.check import Records
from modalax.check.ring_down import cut_short

FS, SAMPLES, HIT = 512.0, 512, 20
SIZES = np.array([1.0, 30.0])  # of an acceleration: the high mode is loud, and dies away first


def ringing(left, tone=0.0, hits=2):
    """Hits of one sample on two modes at 12 and 90 Hz, ``left`` of which is there at the end of the block."""
    rng, time = np.random.default_rng(0), (np.arange(SAMPLES) - HIT) / FS
    decay = -np.log(np.array([left, 1e-4])) / time[-1]
    swings = np.exp(-decay[:, None] * time) * np.sin(2 * np.pi * np.array([[12.0], [90.0]]) * time)
    x = np.where(time > 0, SIZES @ swings, 0.0) + 1e-3 * rng.normal(size=(hits, SAMPLES))
    x += tone * np.sin(2 * np.pi * 50 * time + 2 * np.pi * rng.random((hits, 1)))
    force = np.zeros((hits, SAMPLES))
    force[:, HIT] = 1.0
    return Records(force, x[:, :, None], FS, ("a",), kind="hits")


@pytest.mark.parametrize("left", [0.2, 0.5])
def test_a_slow_mode_beside_loud_ones_is_left_at_the_end(left):
    (found,) = cut_short(ringing(left))
    assert found.what == "record_too_short" and "resonance at 12" in found.evidence
    assert found.size == pytest.approx(left, rel=0.05)


@pytest.mark.parametrize("hits", [1, 3])
@pytest.mark.parametrize("tone", [0.0, 0.02, 2.0])
def test_noise_and_a_steady_tone_are_no_part_of_a_response(tone, hits):
    assert list(cut_short(ringing(1e-3, tone, hits))) == []
