"""A rigid block whose six motions are its DoFs, on stiff feet and soft mounts; names tell no nodes or directions."""

import numpy as np
import pytest
import scipy.linalg
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose.modal_domain.causes.places import read_within
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.model import Structure

BLOCK = ("X", "Y", "Z", "RX", "RY", "RZ")
FEET, FLOOR = ("A1", "A2", "A3", "A4"), ("B1", "B2", "B3", "B4")
DOFS = (*BLOCK, *FEET, *FLOOR)
AT = np.array([[0.55, 0.38], [0.52, -0.4], [-0.6, 0.37], [-0.57, -0.41]])  # m, of the feet
FOOT, MOUNT = np.full(4, 3e8), np.array([1.3e6, 1.1e6, 1.4e6, 1.2e6])  # N/m
BEAM, GROUND = np.array([1.5e6, 1.9e6, 2.1e6, 1.7e6]), np.array([9e6, 8e6, 1.1e7, 9.5e6])
SIDE = np.array([2.0e6, 1.6e6, 9e5])  # of the block to ground along X and Y, and about Z
MASS = np.array([310.0, 310.0, 310.0, 15.0, 23.0, 27.0, *[3.0] * 4, 18.0, 20.0, 22.0, 24.0])
RING = ((0, 1), (1, 3), (3, 2), (2, 0))


def stiffness(foot, mount, beam, ground, side):
    rows = []
    for k, (x, y) in enumerate(AT):
        b = np.zeros(14)
        b[[2, 3, 4, 6 + k]] = 1.0, y, -x, -1.0
        rows.append((foot[k], b))
        rows.append((mount[k], np.eye(14)[6 + k] - np.eye(14)[10 + k]))
        rows.append((ground[k], np.eye(14)[10 + k]))
        rows.append((beam[k], np.eye(14)[10 + RING[k][0]] - np.eye(14)[10 + RING[k][1]]))
    rows += [(k, np.eye(14)[j]) for k, j in zip(side, (0, 1, 5), strict=True)]
    return sum(k * np.outer(b, b) for k, b in rows)


def damped(M, K, zeta):
    square, phi = scipy.linalg.eigh(K, M)
    return M @ phi @ np.diag(2 * zeta * np.sqrt(square)) @ phi.T @ M


def simulation():
    M, K = np.diag(MASS), stiffness(FOOT, MOUNT, BEAM, GROUND, SIDE)
    return Structure(M, damped(M, K, 0.01), K, DOFS)


def measured(soft, off=0.02, seed=0):
    """Accelerances with one mount softer by a factor and all elements off, masses by a third of it."""
    rng = np.random.default_rng(seed)
    values = [a * (1 + off * rng.standard_normal(len(a))) for a in (FOOT, MOUNT, BEAM, GROUND, SIDE)]
    values[1][2] = soft * MOUNT[2]
    K, M = stiffness(*values), np.diag(MASS * (1 + off / 3 * rng.standard_normal(14)))
    C = damped(M, K, 0.01 * np.exp(0.2 * rng.standard_normal(14)))
    outputs, inputs = ("X", "Z", "RX", "RY", "A1", "A3", "B2", "B4"), ("X", "Z", "A2")
    rows, columns = ([DOFS.index(n) for n in names] for names in (outputs, inputs))
    freq = np.linspace(6.0, 120.0, 500)
    s = 2j * np.pi * freq[:, None, None]
    H = (np.linalg.inv(K + s * C + s**2 * M) * s**2)[:, rows][:, :, columns]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return Measurement(
        freq, (H + sigma * noise)[None], form="accelerance", outputs=outputs, inputs=inputs, variance=sigma[None] ** 2
    )


@FEW_OR_ALL
def test_a_soft_mount_behind_a_stiff_foot_is_named(wanted):
    """Two hundred times as stiff is the foot, whose error of 2 % is larger than the mount."""
    said = diagnose_modes(measured(0.58), simulation(), wanted=wanted).to_dict()
    (cause,) = said["causes"]
    assert said["verdict"] == "named" and (cause["name"], set(cause["where"])) == ("joint_stiffness", {"A3", "B3"})
    change = cause["parameters"]["stiffness"]
    assert abs(change["value"] + 0.42 * MOUNT[2]) < 3 * change["std"] < 0.3 * MOUNT[2]


@pytest.mark.parametrize("names", [DOFS, tuple(f"block {n}" if n in BLOCK else n for n in DOFS)])
def test_rods_to_a_body_are_read_off_where_their_direction_is_not_told(names):
    K = stiffness(FOOT, MOUNT, BEAM, GROUND, SIDE)
    nodes = nodes_of(names)
    assert [len(m) for m in nodes.members] == [6, *[1] * 8]
    parts = parts_of(K, nodes)
    np.testing.assert_allclose(sum(p.full(14) for p in parts), K, rtol=1e-12, atol=1e-3)
    feet = [p for p in parts if len(p.nodes) == 2 and len(p.dofs) == 4]
    for k, p in enumerate(feet):
        assert np.linalg.eigvalsh(p.matrix)[-1] == pytest.approx(FOOT[k] * (2 + (AT[k] ** 2).sum()), rel=1e-9)
    mounts = {tuple(sorted(names[j] for j in p.dofs)): p.matrix[0, 0] for p in parts if len(p.dofs) == 2}
    assert [mounts[pair] for pair in zip(FEET, FLOOR, strict=True)] == pytest.approx(list(MOUNT), rel=1e-9)


def test_letters_are_directions_of_one_body_only_where_it_turns():
    assert [len(m) for m in nodes_of(("X", "Y", "Z", "tip")).members] == [1, 1, 1, 1]
    assert [len(m) for m in nodes_of(("x", "rz", "y", "tip")).members] == [3, 1]


def test_letters_before_a_number_are_directions_where_a_number_has_several():
    beam = nodes_of(("z1", "ry1", "z2", "ry2", "uz_3", "rotY3"))
    assert [m.tolist() for m in beam.members] == [[0, 1], [2, 3], [4, 5]] and beam.axis.tolist() == [2, 4] * 3
    assert [len(m) for m in nodes_of(("x1", "x2", "x3")).members] == [1, 1, 1]
    assert nodes_of(("x1", "x2", "x3")).axis.tolist() == [-1, -1, -1]


def test_a_spring_that_nothing_passes_by_has_its_own_stiffness_whatever_else_cannot_be_read_off():
    """Between the block's motions and its feet other ways lead, so that an entry there may be of several elements."""
    K = stiffness(FOOT, MOUNT, BEAM, GROUND, SIDE)
    found = read_within(K, [], set())
    assert [found[frozenset((6 + k, 10 + k))] for k in range(4)] == pytest.approx(list(MOUNT), rel=1e-12)
    assert found[frozenset((2, 6))] == K[6, 6]
