"""Plates are read off a stiffness matrix element by element, and one that is soft is found."""

import numpy as np
import pytest
from plates import element, quads, summed

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.four_cornered import four_cornered
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.diagnose.modal_domain.structure.turns import nodes_in
from modalax.model import Structure

COLUMNS, ROWS = 5, 4
SIZE = 3 * COLUMNS * ROWS
AT = quads(COLUMNS, ROWS)
BENDING, DENSITY = 200.0, 20.0  # [N m], [kg/m^2]
SIDES = 0.15, 0.12  # of an element [m]


def named(first="w", second="rx", third="ry"):
    return tuple(f"{k}{kind}" for k in range(1, COLUMNS * ROWS + 1) for kind in (first, second, third))


def thick(rng):
    """Stiffness of each element: of one shape, with its own thickness."""
    K, _ = element(*SIDES, BENDING, DENSITY)
    return [K * factor for factor in rng.uniform(0.7, 1.4, len(AT))]


def read(K, dofs):
    """Elements by the sorted DoFs that each has."""
    nodes = nodes_in(dofs, K)
    return {tuple(sorted(p.dofs.tolist())): p.full(len(K)) for p in four_cornered(K, nodes)}


@pytest.mark.parametrize("clamped", [False, True])
def test_elements_of_unlike_thickness_are_read_exactly(clamped):
    own = thick(np.random.default_rng(1))
    K = summed(own, AT, SIZE)
    kept = np.arange(SIZE) if not clamped else np.flatnonzero(np.arange(SIZE) // 3 % COLUMNS > 0)
    found = read(K[np.ix_(kept, kept)], tuple(np.array(named())[kept].tolist()))
    whole = [k for k, at in enumerate(AT) if np.isin(at, kept).all()]
    assert len(found) == len(whole) == (9 if clamped else 12)
    for k in whole:
        matrix = found[tuple(np.searchsorted(kept, np.sort(AT[k])).tolist())]
        np.testing.assert_allclose(matrix, summed([own[k]], [AT[k]], SIZE)[np.ix_(kept, kept)], atol=1e-7 * K.max())


def test_slopes_serve_as_rotations():
    """A slope along x turns about y, the other way round; names need not tell."""
    own = thick(np.random.default_rng(2))
    T = np.kron(np.eye(COLUMNS * ROWS), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # w, dw/dx, dw/dy
    K = T @ summed(own, AT, SIZE) @ T.T
    for names in (named("w", "sx", "sy"), named(":+Z", ":+TX", ":+TY")):
        found = read(K, names)
        assert len(found) == len(AT)
        np.testing.assert_allclose(sum(found.values()), K, atol=1e-7 * K.max())


def test_springs_masses_on_them_and_other_thicknesses_stay_what_they_are():
    own = thick(np.random.default_rng(3))
    K = np.pad(summed(own, AT, SIZE), ((0, 1), (0, 1)))
    K[-1, -1] += 5e4
    K[0, 0] += 3e4  # to the ground
    K[21, 21] += 5e4
    K[-1, 21] = K[21, -1] = -5e4
    names = (*named(), "99w")
    parts = parts_of(K, nodes_in(names, K))
    assert sorted(len(p.nodes) for p in parts) == [1, 2, *[4] * 12]
    np.testing.assert_allclose(sum(p.full(len(K)) for p in parts), K, atol=1e-7 * K.max())


def test_no_element_is_made_up_where_the_matrix_is_of_another_kind():
    """Elements of one shape that are unlike, as of another make-up each, are shared out among the nodes instead."""
    rng = np.random.default_rng(4)
    K, _ = element(*SIDES, BENDING, DENSITY)
    values, vectors = np.linalg.eigh(K)
    own = [vectors * (values * rng.uniform(0.5, 2.0, 12)) @ vectors.T for _ in AT]
    whole = summed(own, AT, SIZE)
    parts = parts_of(whole, nodes_in(named(), whole))
    assert not any(p.nodes for p in parts)
    np.testing.assert_allclose(sum(p.full(SIZE) for p in parts), whole, atol=1e-7 * whole.max())


def test_a_soft_element_of_a_plate_is_named():
    """Each node's share of four elements had been off instead, and the answer was ``clean``."""
    rng = np.random.default_rng(5)
    K, M = element(*SIDES, BENDING, DENSITY)
    mass = summed([M] * len(AT), AT, SIZE)
    held = np.zeros((SIZE, SIZE))
    for node in (0, 4, 15, 19):
        held[3 * node, 3 * node] = 2e4

    def plate(factors):
        stiff = summed([K * f for f in factors], AT, SIZE) + held
        return Structure(mass, 2e-5 * stiff, stiff, named())

    factors = 1 + 0.01 * rng.standard_normal(len(AT))
    factors[6] -= 0.4
    freq, inputs = np.linspace(20.0, 230.0, 300), ["2w", "13w"]
    outputs = [f"{k}w" for k in (1, 2, 5, 7, 9, 13, 16, 18, 20)]
    H = np.asarray(plate(factors).frf(freq, form="accelerance", outputs=outputs, inputs=inputs).H)
    sigma = 0.005 * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    variance = np.broadcast_to(sigma**2, H.shape)[None].copy()
    data = Measurement(freq, H[None], form="accelerance", outputs=outputs, inputs=inputs, variance=variance)
    found = diagnose_modes(data, plate(np.ones(len(AT))), wanted={"joint_stiffness"}.__contains__)
    assert found.verdict == "named", found
    (cause,) = found.to_dict()["causes"]
    told = cause["parameters"]["relative_change"]
    corners = {named()[k] for k in AT[6]}
    assert cause["name"] == "joint_stiffness" and set(cause["where"]) <= corners
    assert abs(told["value"] - (factors[6] - 1)) < 4 * told["std"] < 0.2
    named_whole = next(reason for reason in found.reasons if "the element with the corners" in reason)
    assert all(corner in named_whole for corner in sorted(corners) if corner.endswith("w"))
