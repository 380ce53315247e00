"""Shapes over all channels, of modes that a simulation lacks, against scipy and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from chains import comparison_of, grid

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.causes.missing_modes import MISSING_MODES, OutOfBand
from modalax.diagnose.extend import _key
from modalax.diagnose.fitting.hypothesis import bounds_of
from modalax.diagnose.screening.patterns import independent, low_rank, screen_pattern, settled_rank


def test_several_far_modes_of_unlike_shapes_are_residual_terms_in_every_channel():
    structure = grid(8, False)
    comparison, state = comparison_of(structure, structure, lines=60)
    runs, lines, n_out, n_in = comparison.problem.weight.shape
    size = np.random.default_rng(2).normal(size=(n_out, n_in))  # of no low rank: as many shapes as inputs
    z = np.zeros((runs, lines, n_out, n_in), complex)
    z += size * (np.asarray(comparison.problem.weight) > 0)
    value = np.moveaxis(np.stack([z.real, z.imag], axis=-1), (2, 3), (0, 1)).reshape(n_out, n_in, -1)
    there = replace(state.sides[True], value=value)
    one, several = (
        screen_pattern(OutOfBand("upper", k), comparison.scene, there, comparison.problem) for k in (False, True)
    )
    everything = float((value**2).sum())
    assert several.gain > 0.99 * everything and one.gain < 0.9 * everything
    sizes = np.zeros((1, 5, 2))
    assert OutOfBand("upper").free_sizes(sizes) == 6 and OutOfBand("both", several=True).free_sizes(sizes) == 20
    keys = [_key(OutOfBand(side, k)) for side in ("upper", "lower", "both") for k in (False, True)]
    assert len(set(keys)) == 6  # they are saved and loaded apart


def test_a_shape_of_rank_one_is_the_best_however_unlike_the_channels_noise_is():
    """Two terms, weights over two decades that no product of an output's and an input's describes; against scipy."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(5, 3, 40, 2)) * 10.0 ** rng.uniform(-1.0, 1.0, (5, 3, 1, 1))
    sizes = np.einsum("ot,it->oit", rng.normal(size=(5, 2)), rng.normal(size=(3, 2)))
    data = np.einsum("oint,oit->oin", columns, sizes) + rng.normal(size=(5, 3, 40))
    gram, right = np.einsum("oint,oinu->oitu", columns, columns), np.einsum("oint,oin->oit", columns, data)

    def explained(a):
        return 2 * np.sum(a * right) - np.einsum("oit,oitu,oiu->", a, gram, a)

    def least(x):
        u, v = x[:10].reshape(5, 2), x[10:].reshape(3, 2)
        return (np.einsum("oint,ot,it->oin", columns, u, v) - data).ravel()

    free = np.linalg.solve(gram, right[..., None])[..., 0]
    start = low_rank(free, gram)
    found = settled_rank(start, gram, right)
    true = np.concatenate([sizes[:, 0].ravel(), (sizes[0] / sizes[0, 0]).ravel()])
    best = np.sum(data**2) - 2 * scipy.optimize.least_squares(least, true, xtol=1e-14, ftol=1e-14).cost
    assert explained(start) < best - 10  # what the unlike weights cost
    assert explained(found) == pytest.approx(best, abs=0.05)
    assert np.linalg.matrix_rank(found[..., 0], tol=1e-9 * np.abs(found).max()) == 1


def test_a_mode_that_a_fit_has_moved_out_of_all_bounds_explains_nothing_and_is_no_error():
    class Gone(PatternCause):
        def shapes(self, scene):
            return np.array([[1e300]])

        def curves(self, s, q):
            return np.zeros((1, len(s)), complex)

    structure = grid(8, False)
    comparison, state = comparison_of(structure, structure, lines=60)
    found = screen_pattern(Gone(), comparison.scene, state.sides[True], comparison.problem)
    assert found.gain == 0 and found.trials == 1
    assert independent(np.eye(3)) == pytest.approx(3) and independent(np.ones((3, 3))) == pytest.approx(1)


@pytest.mark.parametrize("cause", MISSING_MODES, ids=lambda cause: cause.summary)
def test_curves_are_numbers_however_far_a_fit_moves_a_mode(cause):
    """A search without an end had moved a frequency to 1e299 Hz, where its receptance is none, and nothing fitted."""
    s = 2j * np.pi * np.linspace(10.0, 100.0, 7)
    for end in (0, 1):
        u = bounds_of([cause])[end][cause.terms :]
        q = np.array([np.exp(v) if p.log else v for p, v in zip(cause.parameters[cause.terms :], u, strict=True)])
        value = np.asarray(cause.curves(s, q))
        assert np.isfinite(value).all() and np.abs(value).max() > 0
