"""Changes by few directions against whole matrices."""

import numpy as np
import pytest

from modalax.diagnose.modal_domain.structure.factored import factored


@pytest.fixture
def patterns():
    """A spring, a change between two coordinates, one of full rank and either sign, and none."""
    rng = np.random.default_rng(5)
    b, full, between = rng.standard_normal(6), rng.standard_normal((6, 6)), np.zeros((6, 6))
    between[1, 4] = between[4, 1] = 0.7
    return np.stack([np.outer(b, b), between, full + full.T, np.zeros((6, 6))])


def test_changes_by_their_directions_are_the_whole_matrices(patterns):
    f = factored(patterns)
    parts = np.split(np.arange(len(f.sign)), f.first[1:])
    assert [len(some) for some in parts] == [1, 2, 6, 1]
    for P, some in zip(patterns, parts, strict=True):
        assert f.basis[:, some] * f.sign[some] @ f.basis[:, some].T == pytest.approx(P, abs=1e-13)


def test_what_changes_do_between_responses(patterns):
    rng = np.random.default_rng(6)
    outer, inner = (rng.standard_normal((9, 6, k)) + 1j * rng.standard_normal((9, 6, k)) for k in (4, 2))
    root = rng.uniform(0.5, 2.0, 6)
    expected = np.einsum("fno,pnm,fmi->pfoi", outer, patterns * root * root[:, None], inner)
    assert factored(patterns).scaled(root).between(outer, inner) == pytest.approx(expected, abs=1e-12)
    alone = factored(patterns[:1])
    assert alone.between(outer, inner) == pytest.approx(
        np.einsum("fno,pnm,fmi->pfoi", outer, patterns[:1], inner), abs=1e-12
    )


def test_sums_of_changes_and_what_they_do_to_vectors(patterns):
    rng = np.random.default_rng(7)
    f, sizes = factored(patterns), rng.standard_normal(4)
    assert f.combined(sizes) == pytest.approx(np.tensordot(sizes, patterns, 1), abs=1e-13)
    left, right = (rng.standard_normal((3, 6)) + 1j * rng.standard_normal((3, 6)) for _ in range(2))
    expected = np.einsum("kn,pnm,km->kp", left, patterns, right)
    assert f.summed(f.sign * f.along(left) * f.along(right)) == pytest.approx(expected, abs=1e-12)
    alone = factored(patterns[:1])
    assert alone.summed(alone.sign * alone.along(left) * alone.along(right)) == pytest.approx(expected[:, :1])


def test_no_changes_have_no_directions():
    f = factored(np.zeros((0, 3, 3)))
    assert len(f.first) == len(f.sign) == 0 and not f.combined(np.zeros(0)).any()
