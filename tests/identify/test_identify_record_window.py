"""Finite records: their kernels against the sum they stand for, and resonances measured through them."""

import numpy as np
import pytest

from modalax.identify.record_window import RECORDS, record_kernel

T = 2.0
X = np.linspace(0, 1, 200_001)
LAG = {
    "random": 1 - X,
    "padded": np.where(X < 0.5, 1.0, np.where(X == 0.5, 0.5, 0.0)),
    "steady": None,
    # The mean over impulses at u in the burst of whether their response is still seen at u + t.
    "burst_half": np.clip((1 - X) / 0.5, 0, 1),
    "burst_most": np.clip((1 - X) / 0.75, 0, 1),
}


@pytest.mark.parametrize("record", ["padded", "random", "burst_half", "burst_most"])
@pytest.mark.parametrize("decay", [0.05, 1.0, 20.0])
def test_kernel_is_the_transform_of_the_windowed_impulse_response(record, decay):
    pole = -decay + 2j * np.pi * 10.3
    s = 2j * np.pi * np.arange(6, 15) / T * 1.7
    t = T * X
    sums = np.array([np.trapezoid(LAG[record] * np.exp((pole - q) * t), t) for q in s])
    assert np.allclose(record_kernel(s, pole, T, record), sums, rtol=1e-6, atol=1e-9)


def test_hann_kernel_is_that_of_the_tapers_own_autocorrelation():
    n = 2000
    taper = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    lag = np.correlate(taper, taper, "full")[n - 1 :]
    t = np.arange(n) * T / n
    pole = -0.3 + 2j * np.pi * 10.3
    s = 2j * np.pi * np.arange(15, 27) / T
    weights = np.where(t == 0, 0.5, 1.0) * T / n
    sums = np.array([np.sum(weights * lag / lag[0] * np.exp((pole - q) * t)) for q in s])
    assert np.allclose(record_kernel(s, pole, T, "hann"), sums, rtol=2e-3, atol=2e-4)


def test_a_rectangular_block_only_scales_the_residue_on_its_own_lines():
    """Which is why blocks of hits need no kernel of their own: the ratio to a steady state's is one number."""
    pole = -0.1 + 2j * np.pi * 10.3
    s = 2j * np.pi * np.arange(15, 27) / T
    ratio = record_kernel(s, pole, 2 * T, "padded") * (s - pole)
    assert np.allclose(ratio, 1 - np.exp(pole * T), rtol=1e-12)


def test_an_unknown_record_is_refused():
    with pytest.raises(ValueError, match="record is 'flat'"):
        record_kernel(np.ones(1, complex), -1j, 1.0, "flat")
    assert set(RECORDS) == {"steady", "padded", "random", "burst_half", "burst_most", "hann"}
