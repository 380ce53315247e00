"""Matrices of hundreds of DoFs take memory as their square, not as their cube."""

import tracemalloc

import numpy as np

from modalax.model import Structure


def test_modes_of_a_long_chain_need_little_memory():
    n, k = 240, 1e6
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    chain = Structure(np.eye(n), 1e-5 * K, K)
    tracemalloc.start()
    model = chain.modal()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * 16 * n**2  # an array of all modes by all pairs of DoFs takes 240 times 16 n^2
    exact = 2 * np.sqrt(k) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    np.testing.assert_allclose(2 * np.pi * np.asarray(model.frequency_hz), exact, rtol=1e-9)
    # Residue of mode r at DoF 1: shape squared over modal mass, in closed form.
    wanted = 2 / (n + 1) * np.sin(np.arange(1, n + 1) * np.pi / (n + 1)) ** 2
    residue = model.shapes[:, 0] * model.participation[:, 0] * 2j * np.imag(model.poles)
    np.testing.assert_allclose(np.real(residue), wanted, rtol=1e-6)
