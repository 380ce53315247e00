"""Elements read off a stiffness matrix: against elements that were put together by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import modalax
from modalax.model import Structure
from modalax.model.condense import follow, rigid_motions
from modalax.model.elements import Elements, elements_of, factor_of

POINTS = np.random.default_rng(3).uniform(-1, 1, (5, 3))
NODE = np.repeat(np.arange(5), 6)
ROTATION = np.tile(np.arange(6) > 2, 5)
RIGID = rigid_motions(np.repeat(POINTS, 6, axis=0), np.tile(np.tile(np.eye(3), (2, 1)), (5, 1)), ROTATION)


def free_element(*nodes: int, seed: int) -> np.ndarray:
    """A stiffness between nodes that resists every motion but the rigid ones, over all DoFs."""
    rng = np.random.default_rng(seed)
    dofs = np.flatnonzero(np.isin(NODE, nodes))
    strain = scipy.linalg.null_space(RIGID[dofs].T)
    out = np.zeros((30, 30))
    out[np.ix_(dofs, dofs)] = strain @ np.diag(rng.uniform(1, 100, strain.shape[1])) @ strain.T
    return out


def test_elements_of_a_frame_come_out_exactly():
    ends = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (1, 3)]
    own = [free_element(*e, seed=k) for k, e in enumerate(ends)]
    support = np.zeros((30, 30))
    support[12:15, 12:15] = np.diag([3.0, 5.0, 7.0])
    found = elements_of(sum(own) + support, NODE, RIGID)
    assert found is not None
    by_nodes = {e.nodes: e for e in found}
    assert set(by_nodes) == {*ends, (2,)}
    for nodes, matrix in [*zip(ends, own, strict=True), ((2,), support)]:
        e = by_nodes[nodes]
        np.testing.assert_allclose(e.matrix, matrix[np.ix_(e.dofs, e.dofs)], atol=1e-10)
        np.testing.assert_allclose(factor_of(e.matrix) @ factor_of(e.matrix).T, e.matrix, atol=1e-10)


def test_rods_of_three_directions_part_as_well():
    moves = ~ROTATION
    K, truth = np.zeros((30, 30)), {}
    for a, b, k in ((0, 1, 4.0), (1, 2, 9.0), (0, 2, 2.0)):
        u = (POINTS[b] - POINTS[a]) / np.linalg.norm(POINTS[b] - POINTS[a])
        row = np.zeros(30)
        row[6 * a : 6 * a + 3], row[6 * b : 6 * b + 3] = -u, u
        K += k * np.outer(row, row)
        truth[a, b] = k
    keep = moves & (NODE < 3)
    found = elements_of(K[np.ix_(keep, keep)], NODE[keep], RIGID[keep])
    assert found is not None
    stiffness = {e.nodes: float(np.trace(e.matrix)) / 2 for e in found}
    assert stiffness == pytest.approx(truth)


def test_an_element_of_three_nodes_does_not_part():
    assert elements_of(free_element(0, 1, 2, seed=1) + free_element(2, 3, seed=2), NODE, RIGID) is None


def test_followers_follow_statically():
    K = free_element(0, 1, seed=1) + free_element(1, 2, seed=2) + np.eye(30)
    kept = np.arange(30) < 20
    T = follow(K, kept)
    np.testing.assert_allclose((K @ T)[~kept], 0.0, atol=1e-10)
    np.testing.assert_array_equal(T[kept], np.eye(20))


def test_a_structure_keeps_its_elements_in_a_file(tmp_path):
    F, G = np.random.default_rng(0).normal(size=(2, 3, 4, 2))
    K, M = np.einsum("enr,emr->nm", F, F), np.einsum("enr,emr->nm", G, G)
    told = Elements(F, G, [("a", "b"), ("b", "c"), ("d", "d")])
    structure = Structure(M, 0 * M, K, list("abcd"), elements=told)
    modalax.save(structure, tmp_path / "s.npz")
    back = modalax.load(tmp_path / "s.npz")
    assert back.elements.places == told.places
    np.testing.assert_array_equal(back.elements.stiffness, F)
    np.testing.assert_array_equal(back.elements.mass, G)
    assert structure.replace(C=K).elements is told
    further = Elements(F, G, [("a", "b"), ("b", "c"), ("d", "d")], ["c", "b", "x", "a"])
    small = Structure(M[:2, :2], 0 * M[:2, :2], K[:2, :2], ["a", "b"], elements=further)
    modalax.save(small, tmp_path / "small.npz")
    assert modalax.load(tmp_path / "small.npz").elements.dofs == ("c", "b", "x", "a")
    assert structure.replace(K=2 * K).elements is None
    assert structure.replace(dofs=list("wxyz")).elements is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((jnp.zeros((2, 4)), jnp.zeros((1, 4, 6)), []), "need .element, DoF, column"),
        ((jnp.zeros((2, 4, 6)), jnp.zeros((1, 4, 6)), [("a", "b")]), "1 places for 2 elements"),
    ],
)
def test_elements_that_cannot_be_are_refused(arguments, said):
    with pytest.raises(ValueError, match=said):
        Elements(*arguments)


def test_elements_of_another_structure_are_refused():
    with pytest.raises(ValueError, match="over 4 DoFs, the structure has 3"):
        Structure(np.eye(3), np.eye(3), np.eye(3), elements=Elements(np.zeros((1, 4, 6)), np.zeros((1, 4, 6)), ["ab"]))
    with pytest.raises(ValueError, match="over 4 DoFs, of which 2 are named"):
        Elements(np.zeros((1, 4, 6)), np.zeros((1, 4, 6)), ["ab"], ["a", "b"])
    other = Elements(np.zeros((1, 4, 6)), np.zeros((1, 4, 6)), ["ab"], list("abcd"))
    with pytest.raises(ValueError, match="know no DoF e of the structure"):
        Structure(np.eye(2), np.eye(2), np.eye(2), ["a", "e"], elements=other)
