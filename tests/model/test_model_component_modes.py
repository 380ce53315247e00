"""Large matrices on few DoFs: against the full ones, held or floating, with massless DoFs; and what is refused."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

from modalax.model.component_modes import reduce_to_points
from modalax.model.condense import condense, node_pairs

N = 400
HZ = 2 * np.pi


def chain(ground: float = 0.0):
    """Masses of 1 kg in a row, springs of 1e6 N/m between them, the first on a spring to the ground."""
    K = scipy.sparse.lil_matrix(1e6 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)))
    K[0, 0], K[-1, -1] = 1e6 + ground, 1e6
    return scipy.sparse.eye(N, format="csc"), K.tocsc()


@pytest.mark.parametrize("ground", [0.0, 1e6], ids=["free", "held"])
def test_frfs_are_those_of_all_dofs(ground):
    M, K = chain(ground)
    keep, top = [3, 150, 398], 12.0
    small = reduce_to_points(M, K, keep, up_to_hz=top)
    assert small.rigid == (ground == 0) and small.dynamic and small.change < 1e-8
    assert len(keep) < len(small.M) < 60 and small.kept[keep].all()
    at = [int(small.kept[:k].sum()) for k in keep]
    for f in (0.07, 3.3, 7.9, 11.8):
        w = HZ * f
        full = np.linalg.inv((K - w**2 * M).toarray() + 1e-3j * w * K.toarray())[np.ix_(keep, keep)]
        reduced = np.linalg.inv(small.K - w**2 * small.M + 1e-3j * w * small.K)[np.ix_(at, at)]
        assert np.abs(reduced - full).max() < 3e-3 * np.abs(full).max()
    np.testing.assert_allclose(small.motion[small.kept], np.eye(len(small.M)), atol=1e-12)
    np.testing.assert_allclose(small.motion.T @ (M @ small.motion), small.M, rtol=1e-9, atol=1e-9)
    value = scipy.linalg.eigh(small.K, small.M, eigvals_only=True)
    r = np.arange(len(value))
    exact = np.sqrt(4e6) * np.sin(r * np.pi / (2 * N) if ground == 0 else (2 * r + 1) * np.pi / (2 * (2 * N + 1)))
    wanted = exact < HZ * top
    np.testing.assert_allclose(np.sqrt(np.abs(value[wanted])), exact[wanted], rtol=1e-7, atol=1e-3)


def test_a_mass_added_to_a_kept_dof_is_that_added_to_the_full_matrices():
    M, K = chain(1e6)
    small = reduce_to_points(M, K, [200], up_to_hz=12.0)
    at = int(small.kept[:200].sum())
    heavier, m = M.toarray(), small.M.copy()
    heavier[200, 200] += 50.0
    m[at, at] += 50.0
    full = scipy.linalg.eigh(K.toarray(), heavier, eigvals_only=True, subset_by_index=[0, 7])
    np.testing.assert_allclose(scipy.linalg.eigh(small.K, m, eigvals_only=True)[:8], full, rtol=2e-3)


def test_every_other_dof_without_mass_follows():
    M, K = chain(1e6)
    M = scipy.sparse.diags(np.where(np.arange(N) % 2, 1.0, 0.0)).tocsc()
    small = reduce_to_points(M, K, [1, 301], up_to_hz=8.0)
    odd = np.arange(N) % 2 == 1
    dense = K.toarray()
    guyan = dense[np.ix_(odd, odd)] - dense[np.ix_(odd, ~odd)] @ np.linalg.solve(
        dense[np.ix_(~odd, ~odd)], dense[np.ix_(~odd, odd)]
    )
    wanted = np.sqrt(np.linalg.eigvalsh(guyan)[: len(small.eigenvalue)])
    np.testing.assert_allclose(np.sqrt(small.eigenvalue), wanted, rtol=1e-9)
    assert small.kept[odd].sum() == small.kept.sum()  # amplitudes are told by DoFs that move with mass


def test_what_cannot_be_reduced_is_said():
    M, K = chain()
    with pytest.raises(ValueError, match="0 of 400 DoFs are to be kept"):
        reduce_to_points(M, K, [])
    with pytest.raises(ValueError, match="the mass matrix is not positive"):
        reduce_to_points(0 * M, K, [1])
    loose = scipy.sparse.block_diag([K, 0.0]).tocsc()
    with pytest.raises(ValueError, match="neither mass nor stiffness"):
        reduce_to_points(scipy.sparse.block_diag([M, 0.0]).tocsc(), loose, [1], up_to_hz=5.0)


def test_dofs_that_follow_one_by_one_follow_as_all_at_once():
    """A grid, of which every third point is heavy: Guyan's transformation is the same in any order."""
    side = 12
    line = scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    K = 1e5 * scipy.sparse.kronsum(line, line).toarray() + 1e3 * np.eye(side**2)
    M = np.diag(np.where(np.arange(side**2) % 3, 1e-9, 1.0))
    small = condense(M, K, up_to_hz=20.0)
    heavy = np.arange(side**2) % 3 == 0
    assert (small.kept == heavy).all()
    inner = np.linalg.solve(K[np.ix_(~heavy, ~heavy)], K[np.ix_(~heavy, heavy)])
    np.testing.assert_allclose(small.K, K[np.ix_(heavy, heavy)] - K[np.ix_(heavy, ~heavy)] @ inner, atol=1e-7)
    np.testing.assert_allclose(small.motion[~heavy], -inner, atol=1e-12)


def test_pairs_of_nodes_are_those_that_an_element_joins_sparse_or_dense():
    K = np.array([[2.0, 0, -1, 0], [0, 2, 0, -1], [-1, 0, 2, 0.5], [0, -1, 0.5, 2]])
    nodes, ways, kept = ["a", "a", "b", "b"], ["X", "Y", "X", "Y"], np.array([True, True, True, False])
    for A in (K, scipy.sparse.csr_matrix(K)):
        assert node_pairs(A, nodes, ways, kept) == [(0, 2)]
        assert node_pairs(A, nodes, ways, np.ones(4, bool)) == [(0, 2), (1, 3)]
