"""A mast of beams that bend in two planes: every element off, one of them in one plane alone."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.given_elements import softened_elements
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.held_out import last_is_foretold
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import apart, ends_of, parts_of, planes_of
from modalax.model import Structure
from modalax.model.elements import Elements

NODES, LENGTH = 4, 0.5
AXES = ("X", "Y", "Z", "RX", "RY")
DOFS = tuple(f"{k + 1}:+{axis}" for k in range(NODES) for axis in AXES)
STIFF = {"X": 1540.0, "Y": 770.0, "Z": 2.8e7}  # bending along X, along Y; axial


def element(along_x=1.0, along_y=1.0, axial=1.0):
    """Stiffness of one beam over the DoFs of its two nodes."""
    K = np.zeros((10, 10))
    for axis, turn, sign, size in (("X", "RY", 1.0, along_x), ("Y", "RX", -1.0, along_y)):
        a = sign * LENGTH
        b = np.array([[12, 6 * a, -12, 6 * a], [6 * a, 4, -6 * a, 2], [-12, -6 * a, 12, -6 * a], [6 * a, 2, -6 * a, 4]])
        b[np.ix_([1, 3], [1, 3])] *= LENGTH**2
        at = [AXES.index(axis), AXES.index(turn), 5 + AXES.index(axis), 5 + AXES.index(turn)]
        K[np.ix_(at, at)] += size * STIFF[axis] / LENGTH**3 * b
    K[np.ix_([2, 7], [2, 7])] += axial * STIFF["Z"] / LENGTH * np.array([[1, -1], [-1, 1]])
    return K


def mast(sizes, masses):
    """Stiffness and mass of the clamped mast; ``sizes`` are those of :func:`element`, one row a beam."""
    size = len(AXES) * (NODES + 1)
    K, M = np.zeros((size, size)), np.zeros(size)
    for e, (factors, m) in enumerate(zip(sizes, masses, strict=True)):
        at = slice(len(AXES) * e, len(AXES) * (e + 2))
        K[at, at] += element(*factors)
        M[at] += 0.5 * m * np.tile([1.0, 1.0, 1.0, 2e-3, 2e-3], 2)
    return K[5:, 5:], np.diag(M[5:])


def damped(M, K, zeta):
    square, phi = scipy.linalg.eigh(K, M)
    return M @ phi @ np.diag(2 * zeta * np.sqrt(square)) @ phi.T @ M


def simulation():
    K, M = mast(np.ones((NODES, 3)), np.ones(NODES))
    return Structure(M, damped(M, K, np.full(len(K), 0.01)), K, DOFS)


def built(seed, plane, size):
    """FRFs of the mast as built: every beam 1 % off, that between nodes 2 and 3 by ``size`` besides, in one plane."""
    rng = np.random.default_rng(seed)
    sizes = np.repeat(1 + 0.01 * rng.standard_normal((NODES, 1)), 3, axis=1)
    sizes[2, plane] *= size
    return built_of(rng, sizes)


def built_of(rng, sizes):
    """FRFs of a mast with factors on each beam's stiffness in each plane and along it."""
    K, M = mast(sizes, 1 + 0.003 * rng.standard_normal(NODES))
    C = damped(M, K, 0.01 * np.exp(0.1 * rng.standard_normal(len(K))))
    freq = np.linspace(1.5, 90.0, 160)
    s = 2j * np.pi * freq[:, None, None]
    outputs = [k for k, name in enumerate(DOFS) if name[3] in "XY"]
    inputs = [DOFS.index(name) for name in ("4:+X", "4:+Y")]
    H = s**2 * np.linalg.inv(K + s * C + s**2 * M)[:, outputs][:, :, inputs]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean()) * np.ones(H.shape)
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    return Measurement(
        freq, (H + sigma * noise / np.sqrt(2))[None], form="accelerance", outputs=tuple(DOFS[k] for k in outputs),
        inputs=tuple(DOFS[k] for k in inputs), variance=sigma[None] ** 2,
    )  # fmt: skip


@pytest.mark.slow  # by default what may be off by itself of an element
def test_planes_that_are_each_off_by_a_factor_of_their_own_are_no_cause():
    """An element's bending in two planes, its twist and its axial stiffness are known with errors of their own."""
    rng = np.random.default_rng(2)
    data = built_of(rng, 1 + 0.03 * rng.standard_normal((NODES, 3)))
    said = diagnose_modes(data, simulation()).to_dict()
    assert said["verdict"] == "clean" and not said["causes"]
    low, high = said["inaccuracy"]["stiffness"]["interval"]
    assert low < 0.03 < high


def test_what_may_be_off_by_itself_of_an_element():
    K, M = mast(np.ones((NODES, 3)), np.ones(NODES))
    nodes = nodes_of(DOFS)
    part = next(p for p in parts_of(K, nodes) if {0, 1} == set(p.nodes))
    kinds = [{DOFS[k][2:] for k in p.dofs} for p in apart(part, nodes)]
    assert sorted(map(sorted, kinds)) == [["+RX", "+Y"], ["+RY", "+X"], ["+Z"]]
    np.testing.assert_allclose(sum(p.full(len(K)) for p in apart(part, nodes)), part.full(len(K)), atol=1e-9 * K.max())
    lump = Part(
        (0,), np.flatnonzero(nodes.of_dofs == 0), np.diag([2.0, 2.0, 2.0, 0.1, 0.2][: (nodes.of_dofs == 0).sum()])
    )
    kinds = [{DOFS[k][2:] for k in p.dofs} for p in apart(lump, nodes, mass=True)]
    assert {"+X", "+Y", "+Z"} in kinds and len(kinds) == 3
    beam = Part((0,), lump.dofs, lump.matrix + 0.1 * np.outer([1, 0, 0, 0, 1], [1, 0, 0, 0, 1]))
    kinds = [{DOFS[k][2:] for k in p.dofs} for p in apart(beam, nodes, mass=True)]  # what moves along X also turns
    assert sorted(map(sorted, kinds)) == [["+RX"], ["+RY", "+X", "+Y", "+Z"]]
    turns = Part((0,), lump.dofs[3:], np.diag([0.1, 0.2]))
    assert [len(p.dofs) for p in apart(turns, nodes, mass=True)] == [1, 1]
    assert len(apart(planes_of(part, nodes)[0], nodes)) == 1
    local = Part((), part.dofs, part.matrix)  # a plate's stiffness about a node, whichever of its DoFs it couples
    assert apart(local, nodes) == [local]


def test_a_beam_has_two_planes_and_is_told_at_displacements():
    K, _ = mast(np.ones((NODES, 3)), np.ones(NODES))
    nodes = nodes_of(DOFS)
    part = next(p for p in parts_of(K, nodes) if {0, 1} == set(p.nodes))
    planes = planes_of(part, nodes)
    assert {frozenset(DOFS[k][2:] for k in p.dofs) for p in planes} == {
        frozenset({"+X", "+RY"}),
        frozenset({"+Y", "+RX"}),
    }
    assert {DOFS[k] for k in ends_of(part, nodes)} == {"1:+X", "2:+X"}
    told = {tuple(sorted(DOFS[k] for k in ends_of(p, nodes))) for p in planes}
    assert told == {("1:+X", "2:+X"), ("1:+Y", "2:+Y")}
    both = sum(p.full(len(K)) for p in planes)[np.ix_(part.dofs, part.dofs)]
    axial = [k for k, dof in enumerate(part.dofs) if DOFS[dof].endswith("+Z")]
    left = part.matrix - both
    left[np.ix_(axial, axial)] = 0.0
    assert np.abs(left).max() < 1e-9 * np.abs(both).max()
    assert planes_of(planes[0], nodes) == []  # one piece


def test_elements_that_are_told_have_their_planes_too():
    S = simulation()
    values, vectors = np.linalg.eigh(element())
    F = np.zeros((1, len(DOFS), 10))
    F[0, 5:15] = vectors * np.sqrt(np.maximum(values, 0.0))
    S = S.replace(elements=Elements(F, np.zeros((1, len(DOFS), 1)), [("2:+Z", "3:+Z")]))
    c = coordinates_of(S, DOFS[:2], DOFS[:1], 2 * np.pi * 90.0)
    whole, *planes = softened_elements(S, c, 0.4)
    assert [p.where for p in planes] == [("2:+X", "3:+X"), ("2:+Y", "3:+Y")] and all(p.piece for p in planes)
    assert not whole.piece
    for p, sizes in zip(planes, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), strict=True):
        shapes = c.everywhere[5:15]
        expected = shapes.T @ element(*sizes) @ shapes
        np.testing.assert_allclose(p.pattern, expected, atol=1e-9 * np.abs(whole.pattern).max())


def test_a_piece_that_joins_no_two_dofs_of_one_direction_is_no_place():
    """Two pieces of three DoFs, one of which has all its DoFs at one end."""
    nodes = nodes_of(DOFS)
    one, two = np.ones((3, 1)), np.array([[1.0], [1.0], [-1.0]])
    F = np.zeros((1, len(DOFS), 2))
    F[0, [DOFS.index(f"1:+{a}") for a in "XYZ"], 0] = one[:, 0]
    F[0, [DOFS.index(n) for n in ("1:+RX", "1:+RY", "2:+RX")], 1] = two[:, 0]
    S = simulation().replace(elements=Elements(F, np.zeros((1, len(DOFS), 1)), [("1:+X", "2:+RX")]))
    whole, *planes = softened_elements(S, coordinates_of(S, DOFS[:2], DOFS[:1], 2 * np.pi * 90.0), 0.4)
    assert [p.where for p in planes] == [("1:+RX", "2:+RX")]
    part = Part((0, 1), np.flatnonzero(F[0].any(axis=1)), F[0, F[0].any(axis=1)] @ F[0, F[0].any(axis=1)].T)
    assert sorted(len(ends_of(p, nodes)) for p in planes_of(part, nodes)) == [0, 2]


@pytest.mark.parametrize(("other", "told"), [(1.0, True), (0.2, True), (0.05, False), (0.0, False)])
def test_a_column_is_foretold_where_the_others_see_its_modes_too(other, told):
    """Two modes; of the second the first input sees a part of what the last one does, a tenth of it being enough."""
    none = np.zeros((2, 4))
    residues = np.ones((2, 3, 2), complex)
    residues[1, :, 0] *= other
    f = Features(np.array([-1 + 1j, -1 + 2j]), residues, np.ones((2, 3, 2)), residues[:, None], none, np.eye(8))
    assert last_is_foretold(f) is told
    turned = replace(f, residues=residues[..., ::-1])
    assert last_is_foretold(turned)  # the first input then sees all of it


@FEW_OR_ALL
def test_an_element_wrong_in_one_plane_is_told_with_its_plane(wanted, plane=1, size=0.5):
    found = diagnose_modes(built(3, plane, size), simulation(), late=Deadline(200.0), wanted=wanted)
    said = found.to_dict()
    assert said["verdict"] == "named" and [c["name"] for c in said["causes"]] == ["joint_stiffness"]
    assert set(said["causes"][0]["where"]) == {f"2:+{AXES[plane]}", f"3:+{AXES[plane]}"}
    # Along Y only the second input tells of it: its column is not held out.
    assert said["gain"]["held_out"].startswith("every fourth") and said["gain"]["chi2_after"] < 1.3
    told = said["causes"][0]["parameters"]["relative_change_in_plane"]
    assert abs(told["value"] - (size - 1)) < 3 * np.hypot(told["std"], 0.01)
