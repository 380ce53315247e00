"""Gram matrices of many channels at once, against the sum written out."""

import numpy as np
import pytest

from modalax._numerics.grams import weighted_grams


@pytest.mark.parametrize("numbers", [1, 100, 10**9], ids=["line by line", "in blocks", "at once"])
def test_gram_matrices_are_the_weighted_sums_of_products_of_columns(numbers):
    rng = np.random.default_rng(0)
    A, weight = rng.normal(size=(23, 5)) + 1j * rng.normal(size=(23, 5)), rng.uniform(size=(3, 23))
    found = weighted_grams(A.real, A.imag, weight, numbers)
    for gram, w in zip(found, weight, strict=True):
        np.testing.assert_allclose(gram, (A.conj().T @ (w[:, None] * A)).real, rtol=1e-12, atol=1e-13)


def test_no_columns_have_an_empty_gram_matrix():
    assert weighted_grams(np.zeros((4, 0)), np.zeros((4, 0)), np.ones((2, 4)), 10).shape == (2, 0, 0)


def test_channels_whose_weights_are_alike_but_for_a_factor_have_the_same_gram_matrix_but_for_it():
    rng = np.random.default_rng(1)
    A, profile = rng.normal(size=(23, 5)) + 1j * rng.normal(size=(23, 5)), rng.uniform(size=23)
    weight = np.array([0.0, 1.0, 3e-7, 2e9])[:, None] * profile
    for gram, w in zip(weighted_grams(A.real, A.imag, weight, 100), weight, strict=True):
        np.testing.assert_allclose(gram, (A.conj().T @ (w[:, None] * A)).real, rtol=1e-11, atol=1e-12 * w.max())
