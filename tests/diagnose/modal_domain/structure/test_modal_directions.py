"""A building that sways in two directions which know nothing of each other, each element off by itself in either."""

import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.measured import identify, together
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.elements import stiffness_parts
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.model import Structure

FLOORS = 4
DOFS = tuple(f"{k}:+{d}" for k in range(1, FLOORS + 1) for d in "XY")
INPUTS = DOFS[-2:]


def building(along_x, along_y):
    """Springs from floor to floor, the first from the ground, times these factors; 1 % damping."""
    K, M = np.zeros((8, 8)), np.diag(np.repeat([2.0, 1.9, 1.8, 1.7], 2))
    for start, stiffness, factors in ((0, 3e4, along_x), (1, 2.9e4, along_y)):
        for k, factor in enumerate(factors):
            at = [start + 2 * k] if k == 0 else [start + 2 * k - 2, start + 2 * k]
            K[np.ix_(at, at)] += stiffness * factor * (np.eye(1) if k == 0 else np.array([[1, -1], [-1, 1]]))
    values, V = np.linalg.eigh(K / np.sqrt(np.outer(np.diag(M), np.diag(M))))
    V = np.sqrt(np.diag(M))[:, None] * V
    return Structure(M, V @ np.diag(0.02 * np.sqrt(values)) @ V.T, K, DOFS)


def frequencies(structure, axis):
    """Natural frequencies in one direction."""
    K, M = (np.asarray(A)[axis::2, axis::2] for A in (structure.K, structure.M))
    return np.sort(np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real))


def off(seed, together=None):
    """Factors of a building whose springs are off by 2 %; ``together``: a mode of one frequency in both directions."""
    rng = np.random.default_rng(seed)
    x, y = 1 + 0.02 * rng.standard_normal((2, FLOORS))
    if together is not None:
        a, b = (frequencies(building(x, y), axis)[together] for axis in (0, 1))
        y = y * (a / b) ** 2
    return x, y


def measured(structure, seed=0):
    freq = np.arange(3.0, 45.0, 0.1)
    H = np.asarray(structure.frf(freq, outputs=DOFS, inputs=INPUTS).H)
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    sigma = np.broadcast_to(np.maximum(sigma, 0.02 * sigma.max()), H.shape)
    rng = np.random.default_rng(seed)
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    return Measurement.from_frfs([FRF(freq, H, variance=sigma**2, outputs=DOFS, inputs=INPUTS)])


def test_springs_that_hold_a_node_in_its_own_directions_are_elements_of_their_own():
    parts = stiffness_parts(np.asarray(building(*np.ones((2, FLOORS))).K), nodes_of(DOFS))
    held = [part for part in parts if len(part.nodes) == 1]
    assert [part.dofs.tolist() for part in held] == [[0], [1]] and len(parts) == 2 * FLOORS
    np.testing.assert_allclose([part.matrix[0, 0] for part in held], [3e4, 2.9e4])


@pytest.mark.slow  # by default what its elements are, and which modes it has
@pytest.mark.parametrize("together", [None, 2])
def test_a_building_whose_directions_are_off_by_factors_of_their_own_has_no_cause(together):
    simulation = building(*np.ones((2, FLOORS)))
    found = diagnose_modes(measured(building(*off(3, together))), simulation)
    assert found.verdict == "clean"
    assert found.inaccuracy["stiffness"]["interval"][0] < 0.02 < found.inaccuracy["stiffness"]["interval"][1]


def test_a_pole_for_two_modes_of_one_frequency_is_known_by_its_residues():
    simulation = building(*np.ones((2, FLOORS)))
    c = coordinates_of(simulation, DOFS, INPUTS, 2 * np.pi * 45.0)
    two = identify(measured(building(*off(3, 2))), c)
    shape = len(DOFS), len(INPUTS)
    assert together(two.modes, two.channels, shape).tolist().count(2) == 1
    assert len(two.modes.poles) == 7 and len(two.features.poles) == 8 and two.features.origin.twice.sum() == 1
    plain = identify(measured(building(*off(3))), c)
    assert (together(plain.modes, plain.channels, shape) == 1).all()
