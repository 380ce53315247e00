"""Rotations are read off the stiffness matrix where names do not tell them: levers, beams, grids, frames."""

import numpy as np
import pytest
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.elements import stiffness_parts
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.turns import directions_of, nodes_in, rotations_of
from modalax.model import Structure

CAR = ("front", "rear", "engine", "seat", "body", "pitch")
ARMS = {"front": -1.2, "rear": 1.4, "engine": -1.1, "seat": 0.3}  # m
SPRINGS = {"front": 22e3, "rear": 25e3, "engine": 180e3, "seat": 30e3}  # N/m
TYRES = {"front": 190e3, "rear": 210e3}
MASSES = np.diag([40.0, 45.0, 120.0, 70.0, 600.0, 800.0])


def lever(name: str) -> np.ndarray:
    """How a spring from a part to the body is strained by each DoF."""
    g = np.zeros(6)
    g[[CAR.index(name), 4, 5]] = 1, -1, -ARMS[name]
    return g


def car(springs: dict[str, float], tyres: dict[str, float]) -> np.ndarray:
    K = sum(k * np.outer(lever(name), lever(name)) for name, k in springs.items())
    for name, k in tyres.items():
        K[CAR.index(name), CAR.index(name)] += k
    K[2, 2] += 9e3
    K[np.ix_([2, 3], [2, 3])] += 5e3 * np.array([[1, -1], [-1, 1]])
    return K


def test_a_body_that_pitches_is_found_whatever_it_is_called():
    K = car(SPRINGS, TYRES)
    assert rotations_of(K) == {5: 4}
    order = np.random.default_rng(0).permutation(6)
    assert rotations_of(K[np.ix_(order, order)]) == {order.tolist().index(5): order.tolist().index(4)}
    nodes = nodes_in(CAR, K)
    assert [m.tolist() for m in nodes.members] == [[0], [1], [2], [3], [4, 5]]
    assert [len(m) for m in nodes_of(CAR).members] == [1] * 6  # the last letter of body is no direction
    parts = stiffness_parts(K, nodes)
    np.testing.assert_allclose(sum(p.full(6) for p in parts), K, atol=1e-6)
    for name, k in SPRINGS.items():
        (own,) = (p for p in parts if len(p.nodes) == 2 and p.full(6)[CAR.index(name), 5])
        np.testing.assert_allclose(own.full(6), k * np.outer(lever(name), lever(name)), atol=1e-6)
    assert sorted(p.matrix[0, 0] for p in parts if len(p.nodes) == 1) == pytest.approx([9e3, 190e3, 210e3])


def test_a_mass_that_no_spring_holds_is_no_rotation():
    """As where a simulation lacks a joint altogether."""
    K = np.pad(car(SPRINGS, TYRES), (0, 1))
    assert rotations_of(K) == {5: 4}
    nodes = nodes_in((*CAR, "seat"), K)
    assert [m.tolist() for m in nodes.members] == [[0], [1], [2], [3], [4, 5], [6]]
    assert rotations_of(np.zeros((3, 3))) == {}


def test_no_rotation_is_seen_where_rows_do_not_show_one():
    chain = np.diag([3.0, 4, 3, 2]) - np.diag([2.0, 2, 1], 1) - np.diag([2.0, 2, 1], -1)
    rng = np.random.default_rng(1)
    spread = rng.standard_normal((6, 6))
    c, s = np.cos(0.4), np.sin(0.4)
    bars = [(0, 1, 1.0, 0.0), (1, 2, c, s), (0, 2, 0.0, 1.0), (2, 3, 1.0, 0.0), (1, 3, 0.0, 1.0), (0, 3, s, c)]
    truss = np.zeros((8, 8))
    for a, b, x, y in bars:
        g = np.zeros(8)
        g[[2 * a, 2 * a + 1, 2 * b, 2 * b + 1]] = x, y, -x, -y
        truss += np.outer(g, g)
    for K in (chain, spread @ spread.T, truss, np.eye(3)):
        assert rotations_of(K) == {}
        assert (nodes_in(tuple(f"part {'abcdefgh'[k]}" for k in range(len(K))), K).axis == -1).all()
    two = car(SPRINGS, TYRES)
    two[0, 5] = two[5, 0] = 0.5 * two[0, 5]  # one row disagrees with the others
    two[0, 0] -= two[0].sum()
    assert rotations_of(two) == {}


def beam(n: int, planes: bool) -> tuple[np.ndarray, list[str], list[str]]:
    """A cantilever of unequal elements, bending or also stretching; names that tell directions and that do not."""
    kinds, plain = (["x", "z", "r"], ["+X", "+Z", "+RY"]) if planes else (["z", "r"], ["+Z", "+RY"])
    d, K = len(kinds), np.zeros((len(kinds) * (n + 1),) * 2)
    for k in range(n):
        L, EI = 0.1 + 0.02 * k, 20.0 + k
        b = EI / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L * L, -6 * L, 2 * L * L],
                                  [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L * L, -6 * L, 4 * L * L]])  # fmt: skip
        at = [d * k + d - 2, d * k + d - 1, d * (k + 1) + d - 2, d * (k + 1) + d - 1]
        K[np.ix_(at, at)] += b
        if planes:
            at = [d * k, d * (k + 1)]
            K[np.ix_(at, at)] += 1e5 / L * np.array([[1, -1], [-1, 1]])
    keep = slice(d, None)
    nodes = range(1, n + 1)
    return K[keep, keep], [f"b{k}{kind}" for k in nodes for kind in kinds], [f"{k}:{w}" for k in nodes for w in plain]


@pytest.mark.parametrize("planes", [False, True])
def test_unnamed_rotations_of_beams_make_the_elements_of_named_ones(planes):
    K, names, plain = beam(6, planes)
    assert (nodes_of(tuple(names)).axis < 0).any()
    aim = stiffness_parts(K, nodes_of(tuple(plain)))
    short = [name.replace("z", "w").replace("r", "t").replace("x", "u") for name in names]
    ahead = [f"{name[-1]}_{name[1:-1]}" for name in short]
    for some in (names, short, ahead):
        nodes = nodes_in(tuple(some), K)
        assert [len(m) for m in nodes.members] == [3 if planes else 2] * 6
        found = {p.nodes: p for p in stiffness_parts(K, nodes)}
        assert set(found) == {p.nodes for p in aim}
        for p in aim:
            np.testing.assert_allclose(found[p.nodes].full(len(K)), p.full(len(K)), atol=1e-6 * K.max())


def test_directions_stay_unknown_where_names_or_rows_do_not_tell_them():
    K, names, _ = beam(5, False)
    axis = np.full(len(K), -1)
    assert directions_of(tuple(names), axis, K) is not None
    assert directions_of(tuple("abcdefghij"), axis, K) is None  # no nodes
    assert directions_of(tuple(f"b{k}" for k in range(10)), axis, K) is None
    assert directions_of(tuple(f"b{k}z" for k in range(10)), axis, K) is None  # every node has one DoF
    assert directions_of(tuple(names), axis, K + 0.1 * np.diag(np.diag(K))) is None  # the ground holds every row
    both = axis.copy()
    both[0] = 2  # z is read as a displacement in one name and in no other
    assert directions_of(tuple(names), both, K) is None
    turned = np.where([name.endswith("r") for name in names], 2, -1)  # what is called a displacement is none
    assert directions_of(tuple(names), turned, K) is None


@FEW_OR_ALL
def test_a_soft_mount_at_a_lever_is_named_beside_springs_that_are_off(wanted):
    rng = np.random.default_rng(3)
    off = lambda of: {name: k * (1 + 0.02 * rng.standard_normal()) for name, k in of.items()}
    springs, M = off(SPRINGS), MASSES * (1 + 0.005 * rng.standard_normal(6))
    lost = 0.3 * SPRINGS["engine"]
    K = car(springs | {"engine": springs["engine"] - lost}, off(TYRES))
    C, freq = 2e-4 * K + 0.3 * M, np.linspace(0.3, 14.0, 500)
    s = 2j * np.pi * freq[:, None, None]
    H = np.linalg.inv(s**2 * M + s * C + K)[:, :, [0, 2]]
    sigma = 0.005 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    data = Measurement(
        freq, H[None], form="receptance", outputs=CAR, inputs=("front", "engine"), variance=sigma[None] ** 2
    )
    plain = car(SPRINGS, TYRES)
    author = Structure(MASSES, 2e-4 * plain + 0.3 * MASSES, plain, CAR)
    found = diagnose_modes(data, author, wanted=wanted)
    assert not [c for c in found.stage.candidates if c.where == ("pitch",) and c.piece]  # that would be a spring again
    said = found.to_dict()
    (cause,) = said["causes"]
    assert cause["probability"] > 0.99
    assert said["verdict"] == "named" and (cause["name"], set(cause["where"])) == (
        "joint_stiffness",
        {"engine", "body"},
    )
    value = cause["parameters"]["relative_change"]
    assert abs(value["value"] + 0.3) < 3.5 * value["std"] < 0.1


@pytest.mark.parametrize("kinds", ["x rx", "y ry", "x rx y ry"])
def test_rotations_called_after_their_plane_are_read_as_those_across_it(kinds):
    """As in a rotor whose bending in two planes has the same matrices, though a turn about x moves y the other way."""
    K1, _, _ = beam(6, False)
    kinds = kinds.split()
    K = np.zeros((6 * len(kinds),) * 2)
    names = tuple(f"s{k}{kind}" for k in range(6) for kind in kinds)
    for plane in range(len(kinds) // 2):
        at = [len(kinds) * k + 2 * plane + way for k in range(6) for way in range(2)]
        K[np.ix_(at, at)] = K1
    parts = stiffness_parts(K, nodes_of(names))
    assert min(np.linalg.eigvalsh(p.matrix)[0] for p in parts) < -1e-3 * K.max()  # not as they are called
    nodes = nodes_in(names, K)
    parts = stiffness_parts(K, nodes)
    assert len(parts) == 6 and [len(m) for m in nodes.members] == [len(kinds)] * 6
    np.testing.assert_allclose(sum(p.full(len(K)) for p in parts), K, atol=1e-9 * K.max())
    assert min(np.linalg.eigvalsh(p.matrix)[0] for p in parts) > -1e-9 * K.max()
    proper = nodes_of(tuple(f"{k}:+{way}" for k in range(6) for way in ("Z", "RY")))
    assert (
        nodes_in(tuple(f"{k}:+{way}" for k in range(6) for way in ("Z", "RY")), K1).axis.tolist()
        == proper.axis.tolist()
    )


def space_frame(count):
    """Stiffness of a row of beams that point anywhere in space, clamped at the first end, over six DoFs a node."""
    rng = np.random.default_rng(4)
    K, parts = np.zeros((6 * (count + 1),) * 2), []
    for e in range(count):
        along = rng.uniform(0.3, 1.0, 3)
        L = np.linalg.norm(along)
        x = along / L
        y = np.cross([0.0, 0, 1], x)
        y /= np.linalg.norm(y)
        own = np.zeros((12, 12))
        for move, turn, sign, EI in ((1, 5, 1, 50.0 + e), (2, 4, -1, 80.0)):
            at, a = [move, turn, move + 6, turn + 6], sign * L
            b = [[12, 6 * a, -12, 6 * a], [6 * a, 4 * L * L, -6 * a, 2 * L * L], [-12, -6 * a, 12, -6 * a],
                 [6 * a, 2 * L * L, -6 * a, 4 * L * L]]  # fmt: skip
            own[np.ix_(at, at)] += EI / L**3 * np.array(b)
        for move, k in ((0, 1e5 / L), (3, 40 / L)):
            own[np.ix_([move, move + 6], [move, move + 6])] += k * np.array([[1, -1], [-1, 1]])
        T = np.kron(np.eye(4), np.stack([x, y, np.cross(x, y)]))
        full = np.zeros_like(K)
        full[6 * e : 6 * e + 12, 6 * e : 6 * e + 12] = T.T @ own @ T
        parts.append(full[6:, 6:])
    return parts


STYLES = {
    "plain": lambda k, a: f"{k}:+{('X', 'Y', 'Z', 'RX', 'RY', 'RZ')[a]}",
    "u and rot": lambda k, a: f"N{k}-{('UX', 'UY', 'UZ', 'ROTX', 'ROTY', 'ROTZ')[a]}",
    "components": lambda k, a: f"{k}.{a + 1}",
    "t and r": lambda k, a: f"{k}-{'TR'[a // 3]}{a % 3 + 1}",
    "theta": lambda k, a: f"node{k} {('x', 'y', 'z', 'thetax', 'thetay', 'thetaz')[a]}",
    "letters ahead": lambda k, a: f"{('u', 'v', 'w', 'phix', 'phiy', 'phiz')[a]}{k}",
    "axes exchanged": lambda k, a: f"{('a', 'b', 'c', 'g', 'i', 'h')[a]}{k}",
    "signs behind": lambda k, a: f"P{k}{('X', 'Y', 'Z', 'RX', 'RY', 'RZ')[a]}+",
    "numbers alone": lambda k, a: f"{6 * k + a}",
}


@pytest.mark.parametrize("style", STYLES)
def test_beams_in_space_are_read_whatever_their_dofs_are_called(style):
    parts = space_frame(4)
    K, names = sum(parts), tuple(STYLES[style](k, a) for k in range(1, 5) for a in range(6))
    nodes = nodes_in(names, K)
    assert [len(m) for m in nodes.members] == [6] * 4
    found = [p.full(24) for p in stiffness_parts(K, nodes)]
    assert len(found) == 4
    for own in parts:
        assert min(np.abs(some - own).max() for some in found) < 1e-7 * np.abs(own).max()


def test_letters_that_count_chains_are_no_directions():
    """Two chains that are joined at one place; the ground holds no mass, or every mass, of the second."""
    for held in (0.0, 0.3):
        K = np.zeros((12, 12))
        for chain in range(2):
            for k in range(5):
                at = [2 * k + chain, 2 * k + 2 + chain]
                K[np.ix_(at, at)] += (1 + 0.1 * k) * np.array([[1, -1], [-1, 1]])
        K += np.diag([0.0, held] * 6)
        K[0, 0] += 1
        K[np.ix_([4, 5], [4, 5])] += 0.5 * np.array([[1, -1], [-1, 1]])
        for names in (
            [f"{side}{k}" for k in range(6) for side in "LR"],
            [f"{k}.{n}" for k in range(6) for n in (1, 2)],
        ):
            assert (nodes_in(tuple(names), K).axis == -1).all()
