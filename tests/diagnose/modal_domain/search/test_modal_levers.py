"""A machine on isolators: springs that act on one body at levers, of which a matrix shows the sum."""

import numpy as np
import pytest
from frames import modal_damping
from test_modal_uneven import measured

from modalax.diagnose.modal_domain.causes.within_elements import OneMember
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import apart, parts_of, planes_of
from modalax.model import Structure

BODY = ("X", "Y", "Z", "RX", "RY", "RZ")
NAMES = (*(f"1:+{way}" for way in BODY), *(f"{node}:+{way}" for node in (2, 3) for way in "XYZ"))
FEET = [(0.52, 0.3, -0.35), (0.5, -0.33, -0.35), (-0.48, 0.31, -0.35), (-0.55, -0.32, -0.35)]  # m
FOOT = (1.6e5, 1.9e5, 4.2e5)  # N/m
PARTS = {2: ((0.4, 0.05, 0.45), 14.0, 60.0), 3: ((-0.5, 0.3, 0.3), 9.0, 85.0)}  # place [m], mass [kg], frequency [Hz]


def at_lever(way: int, point: tuple[float, float, float]) -> np.ndarray:
    """Displacement of a point of the body in one direction by the six motions of the body."""
    n = np.eye(3)[way]
    return np.concatenate([n, np.cross(point, n)])


def machine(off_feet: np.ndarray, off_parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a body on four feet with two parts on springs, each spring off by a share."""
    K, M = np.zeros((2, 12, 12))
    for point, off in zip(FEET, off_feet, strict=True):
        for way, k in enumerate(FOOT):
            v = at_lever(way, point)
            K[:6, :6] += k * (1 + off[way]) * np.outer(v, v)
    M[range(6), range(6)] = 240.0, 240.0, 240.0, 20.0, 36.0, 42.0
    for (node, (point, mass, hz)), off in zip(PARTS.items(), off_parts, strict=True):
        for way, times in enumerate((1.0, 1.25, 1.7)):
            v, k = np.zeros(12), 3 * node + way
            v[:6], v[k] = at_lever(way, point), -1.0
            K += mass * (2 * np.pi * hz * times) ** 2 * (1 + off[way]) * np.outer(v, v)
            M[k, k] = mass
    return K, M


def asked(seed: int, foot: float = 0.0, part: float = 0.0):
    """The diagnosis of a machine, all of whose springs are 2 % off and one of the feet or of the parts far off."""
    rng = np.random.default_rng(seed)
    K, M = machine(np.zeros((4, 3)), np.zeros((2, 3)))
    simulation = Structure(M, modal_damping(M, K, 0.012), K, NAMES)
    feet, parts = 0.02 * rng.standard_normal((4, 3)), 0.02 * rng.standard_normal((2, 3))
    feet[2, 2] += foot
    parts[1, 1] += part
    K, M = machine(feet, parts)
    C = modal_damping(M, K, 0.012 * np.exp(0.15 * rng.standard_normal(12)))
    hz = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)) / 2 / np.pi
    data = measured(K, M, C, rng, np.linspace(0.5 * hz[0], 1.1 * hz[-1], 500), (2, 6, 10), NAMES, 0.005)
    return diagnose_modes(data, simulation)


def test_springs_between_a_point_and_a_body_are_read_with_their_levers():
    K, _ = machine(np.zeros((4, 3)), np.zeros((2, 3)))
    nodes = nodes_of(NAMES)
    elements = {p.nodes: p for p in parts_of(K, nodes)}
    for node, (point, mass, hz) in PARTS.items():
        element = elements[node - 1, 0]
        springs = {int(p.dofs[p.dofs > 5][0]): p for p in apart(element, nodes)}
        assert len(springs) == 3
        for way, times in enumerate((1.0, 1.25, 1.7)):
            v = np.zeros(12)
            v[:6], v[3 * node + way] = at_lever(way, point), -1.0
            k = mass * (2 * np.pi * hz * times) ** 2
            np.testing.assert_allclose(springs[3 * node + way].full(12), k * np.outer(v, v), atol=1e-9 * k)
        assert len(planes_of(element, nodes)) == 3
    (feet,) = (p for p in elements.values() if len(p.nodes) == 1)
    assert [p is feet for p in apart(feet, nodes)] == [True]


def test_a_beam_is_no_springs_at_levers():
    L = 0.4
    k = np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                  [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])  # fmt: skip
    nodes = nodes_of(("1:+Y", "1:+RZ", "2:+Y", "2:+RZ"))
    (beam,) = parts_of(k, nodes)
    assert [p is beam for p in apart(beam, nodes)] == [True]
    assert planes_of(beam, nodes) == []


def test_a_soft_foot_is_named_with_its_line_of_action():
    x = asked(5, foot=-0.45)
    assert x.verdict == "named", x.reasons
    (cause,) = x.causes
    assert (cause["name"], list(cause["where"])) == ("joint_stiffness", ["1:+Z"])
    told = cause["parameters"]
    truth = {"stiffness": -0.45 * FOOT[2], "offset_x": FEET[2][0], "offset_y": FEET[2][1]}
    for name, value in truth.items():
        assert abs(told[name]["value"] - value) < 3 * told[name]["std"], (name, told[name])
    assert told["stiffness"]["std"] < 0.2 * abs(truth["stiffness"])
    assert max(told[f"offset_{axis}"]["std"] for axis in "xy") < 0.08
    assert any("one of several springs" in reason for reason in x.reasons)


def test_a_soft_spring_at_a_lever_is_named_in_its_own_direction():
    x = asked(6, part=-0.4)
    assert x.verdict == "named", x.reasons
    (cause,) = x.causes
    assert (cause["name"], set(cause["where"])) == ("joint_stiffness", {"3:+Y", "1:+Y"})
    (told,) = cause["parameters"].values()
    assert abs(told["value"] + 0.4) < 3 * max(told["std"], 0.02)


def test_feet_that_are_all_a_little_off_are_no_cause():
    x = asked(7)
    assert x.verdict == "clean", x.reasons


@pytest.mark.parametrize("stiffer", [False, True])
def test_a_spring_among_several_tells_its_stiffness_and_line_of_action(stiffer):
    rng = np.random.default_rng(0)
    n, point, k = np.array([0.1, 0.2, 0.97]), np.array([0.4, -0.3, 0.2]), 3.0
    n /= np.linalg.norm(n)
    moves, ways = rng.standard_normal((6, 6)), rng.standard_normal((6, 9))
    shapes = np.linalg.solve(moves, ways)  # of which these forces make these ways
    cause = OneMember("joint_stiffness", ("1:+Z",), 0.4, ways=ways, moves=moves, factor=moves.T, stiffer=stiffer)
    u = np.linalg.solve(moves.T, np.sqrt(k) * np.concatenate([n, np.cross(point, n)])) / np.sqrt(0.4 / 6)
    A = rng.standard_normal((6, 6))
    covariance, step = A @ A.T, 1e-6
    told, across = cause.told(u, covariance), point - (point @ n) * n
    value = lambda v: np.array([cause.told(v, covariance)[name]["value"] for name in told])
    np.testing.assert_allclose(value(u), [k if stiffer else -k, *across], rtol=1e-9)
    by = np.stack([(value(u + step * e) - value(u - step * e)) / (2 * step) for e in np.eye(6)])
    stds = [v["std"] for v in told.values()]
    np.testing.assert_allclose(stds, np.sqrt(np.einsum("ik,ij,jk->k", by, covariance, by)), rtol=1e-6)
    for e, slope in zip(np.eye(6), cause.slopes(u), strict=True):
        change = (cause.changes(u + step * e)["K"] - cause.changes(u - step * e)["K"]) / (2 * step)
        np.testing.assert_allclose(slope["K"], change, atol=1e-7 * np.abs(change).max())
    np.testing.assert_allclose(shapes.T @ cause.over_dofs(u) @ shapes, cause.changes(u)["K"], atol=1e-9)
    assert cause.possible(u * np.sqrt(0.9 / abs(cause.size(u))))
    assert cause.possible(u * np.sqrt(1.1 / abs(cause.size(u)))) == stiffer
