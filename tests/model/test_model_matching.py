"""Points matched to nodes, reductions and pairs of modes against closed forms and rigid-body motion."""

import numpy as np
import pytest
import scipy.linalg

from modalax.data import Geometry
from modalax.model.correlation import correlate
from modalax.model.matching import match
from modalax.model.mode_table import ModeTable
from modalax.model.reduction import guyan, serep

NODES = Geometry(["1", "2", "3"], np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
WAYS = ("X", "Y", "Z", "RX", "RY", "RZ")
DOFS = [f"{n}:+{w}" for n in NODES.nodes for w in WAYS]


def rigid(u, theta) -> np.ndarray:
    """Motion of all DoFs of the model as one rigid body about the origin."""
    return np.concatenate([[*(u + np.cross(theta, p)), *theta] for p in np.asarray(NODES.xyz)])


def test_names_and_their_signs_come_first():
    found = match(["2:+Z", "3:-Y"], DOFS)
    assert found.how == ("name", "name") and found.nodes == ("2", "3")
    motion = np.arange(18.0)
    np.testing.assert_array_equal(found.seen(motion), [motion[8], -motion[13]])


def test_a_point_beside_a_node_moves_as_on_a_rigid_arm():
    """For any rigid motion the point must move by u + theta x p, in any direction."""
    places = Geometry(["a", "b"], np.array([[0.1, 0.3, -0.2], [1.8, 0.0, 0.1]]))
    e = np.array([0.6, 0.0, 0.8])
    found = match(["a:+Z", "b:-Y", "b:+X"], DOFS, places=places, model_places=NODES, directions={"b:+X": e})
    assert found.nodes == ("1", "3", "3") and found.how == ("place",) * 3
    np.testing.assert_allclose(found.distance[:2], [np.sqrt(0.14), np.sqrt(0.05)])
    u, theta = np.array([0.1, -0.2, 0.3]), np.array([0.5, -0.4, 0.2])
    moved = [u + np.cross(theta, p) for p in np.asarray(places.xyz)]
    wanted = [moved[0][2], -moved[1][1], moved[1] @ e]
    np.testing.assert_allclose(found.seen(rigid(u, theta)), wanted, atol=1e-12)
    assert found.report()[0] == "a:+Z -> 1 by place, 374 mm away"


def test_a_table_and_what_cannot_be_matched():
    found = match(["p:+Z"], DOFS, table={"p": "2"})
    assert found.how == ("table",) and found.transform[0].nonzero()[0].tolist() == [8]
    far = Geometry(["a"], np.array([[100.0, 0.0, 0.0]]))
    for words, options in (
        ("node p is neither in the model nor in a table", {}),
        ("to 9, which the model has no directions of", {"table": {"p": "9"}}),
    ):
        with pytest.raises(ValueError, match=words):
            match(["p:+Z"], DOFS, **options)
    with pytest.raises(ValueError, match="nearest node 3 is 98 m away, farther than 0.5 m"):
        match(["a:+Z"], DOFS, places=far, model_places=NODES, farthest=0.5)
    with pytest.raises(ValueError, match="unit vector"):
        match(["a:+Z"], DOFS, places=far, model_places=NODES, directions={"a:+Z": [1.0, 1.0, 0.0]})
    with pytest.raises(ValueError, match="moves along Z, which its node does not have"):
        match(["1:+Z"], ["1:+X", "1:+Y"], table={"1": "1"})


def chain(n: int = 8) -> tuple[np.ndarray, np.ndarray]:
    return np.diag(np.linspace(1.0, 2.0, n)), 1e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))


def test_guyan_is_exact_in_statics_and_serep_in_the_modes_taken():
    M, K = chain()
    kept = [1, 4, 6]
    T = guyan(K, kept)
    force = np.zeros(len(K))
    force[kept] = [3.0, -1.0, 2.0]
    np.testing.assert_allclose(T @ np.linalg.solve(T.T @ K @ T, force[kept]), np.linalg.solve(K, force), rtol=1e-10)
    square, phi = scipy.linalg.eigh(K, M)
    S = serep(phi[:, :3].T, kept)
    np.testing.assert_allclose(scipy.linalg.eigh(S.T @ K @ S, S.T @ M @ S)[0], square[:3], rtol=1e-9)
    np.testing.assert_allclose(S @ phi[kept, 1], phi[:, 1], atol=1e-10)  # a measured shape is expanded
    for call, words in (
        (lambda: guyan(K, [1, 1]), "different positions"), (lambda: serep(phi[:, :4].T, kept), "at most as many"),
        (lambda: guyan(np.diag([0.0, 1.0, 1.0]), [1]), "can still move"),
        (lambda: serep(np.array([[1.0, 0, 1], [2.0, 0, 5]]), [0, 1]), "cannot tell"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            call()


def test_pairs_are_found_out_of_order_and_a_wrong_sign_at_its_sensor():
    M, K = chain()
    square, phi = scipy.linalg.eigh(K, M)
    dofs = [f"{k}:+Z" for k in range(8)]
    shapes = 3.0 * phi[:, [0, 1, 2, 3]].T.copy()
    shapes[:, 5] *= -1
    table = ModeTable.of(np.sqrt(square[:4]) * 1.02, np.nan, shapes, dofs)
    order = [3, 0, 2, 1, 6]
    found = correlate(table, np.sqrt(square[order]), phi[:, order].T)
    assert found.pairs.tolist() == [1, 3, 2, 0]
    np.testing.assert_allclose(found.change, 1 / 1.02 - 1)
    assert found.ecomac.argmax() == 5 and (found.pair_mac < 1).all() and (found.pair_mac > 0.3).all()
    none = correlate(table, np.sqrt(square[[6, 7]]), phi[:, [6, 7]].T, least=0.9)
    assert (none.pairs == -1).all() and np.isnan(none.change).all() and np.isnan(none.pair_mac).all()
    with pytest.raises(ValueError, match="shapes of the model have shape"):
        correlate(table, square[:2], phi.T)
