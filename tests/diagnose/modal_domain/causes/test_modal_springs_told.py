"""Where a simulation tells its elements, they tell between which DoFs it has springs, and how stiff these are."""

import numpy as np
from frames import BENDING, LENGTH, beam

from modalax.diagnose.modal_domain.causes.given_elements import springs_within
from modalax.diagnose.modal_domain.causes.places import springs_of
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.model import Structure
from modalax.model.condense import follow
from modalax.model.elements import Elements, factor_of

NAMES = tuple(f"{p}:+{way}" for p in (1, 2, 3) for way in ("Z", "RY"))
FLIP = np.array([1.0, -1.0] * 3)  # a rotation about y moves a beam along x downwards


def two_beams(kept: int = 6) -> Structure:
    """Three nodes on two beams; of DoFs that are not kept the others are condensed."""
    k, m = beam()
    F, G = np.zeros((2, 6, 4)), np.zeros((2, 6, 4))
    for e in range(2):
        F[e, 2 * e : 2 * e + 4], G[e, 2 * e : 2 * e + 4] = factor_of(k, 4), factor_of(m, 4)
    F, G = F * FLIP[:, None], G * FLIP[:, None]
    K, M = (np.einsum("enr,emr->nm", A, A) for A in (F, G))
    order = [0, 1, 4, 5, 2, 3]  # the middle node last
    K, M, F, G = K[np.ix_(order, order)], M[np.ix_(order, order)], F[:, order], G[:, order]
    names = tuple(NAMES[k] for k in order)
    T = follow(K, np.arange(6) < kept)
    K, M = T.T @ K @ T, T.T @ M @ T
    return Structure(M, 1e-4 * K, K, names[:kept], elements=Elements(F, G, (NAMES[:3:2], NAMES[2::2]), names))


def test_a_beam_is_a_spring_between_the_rotations_of_its_ends_and_none_across_it():
    structure = two_beams()
    found = springs_within(structure, nodes_of(structure.dofs))
    names = {tuple(sorted(structure.dofs[k] for k in pair)): value for pair, value in found.items()}
    assert set(names) == {("1:+RY", "2:+RY"), ("2:+RY", "3:+RY")}
    np.testing.assert_allclose(list(names.values()), BENDING / LENGTH, rtol=1e-9)  # the entry of K is twice as much


def test_no_spring_is_where_a_node_was_condensed():
    structure = two_beams(kept=4)
    assert abs(np.asarray(structure.K)[1, 3]) > 1.0  # which the matrix couples
    assert springs_within(structure, nodes_of(structure.dofs)) == {}
    c = coordinates_of(structure, ("1:+Z",), ("3:+Z",), 500.0)
    every = springs_of(structure, c, nodes_of(structure.dofs), None, 500.0)
    assert all(len(where) == 1 for where, *_ in every)


def test_to_name_all_pairs_that_elements_join_is_to_name_none():
    structure = two_beams()
    c, nodes = coordinates_of(structure, ("1:+Z",), ("3:+Z",), 500.0), nodes_of(structure.dofs)
    every = [(f"{a}:+{way}", f"{b}:+{way}") for a, b in ((1, 2), (2, 3)) for way in ("Z", "RY")]
    weights = [
        {where: weight for where, _, _, weight, _ in springs_of(structure, c, nodes, pairs, 500.0)}
        for pairs in (None, every, every[1:2])
    ]
    assert weights[1] == weights[0]
    assert weights[2]["1:+RY", "2:+RY"] > 5 * weights[0]["1:+RY", "2:+RY"]
