"""Supports that are wrong together, as patterns of change and in what the answer tells of them."""

import itertools

import numpy as np
import pytest
from kinds import FEW_OR_ALL

from modalax.data import FRF, Measurement
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.causes.supports import Supports, supports_together
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.model import Structure

TOP = 2 * np.pi * 200.0


def rail(held: dict[int, float], n: int = 12, own: np.ndarray | None = None) -> Structure:
    """Masses in a row on springs to ground; ``own`` adds a stiffness between DoFs 1 and 2."""
    K = np.diag([3e5] * n) + np.diag([-1.5e5] * (n - 1), 1) + np.diag([-1.5e5] * (n - 1), -1)
    K[0, 0] = K[-1, -1] = 1.5e5
    for k, stiffness in held.items():
        K[k, k] += stiffness
    if own is not None:
        K[:2, :2] += own
    M = np.eye(n)
    return Structure(M, 1e-4 * K, K, tuple(f"{k + 1}:+Z" for k in range(n)))


def together(S: Structure) -> list[Supports]:
    c, nodes = coordinates_of(S, S.dofs, S.dofs[:1], TOP), nodes_of(S.dofs)
    found = supports_together(S, c, parts_of(np.asarray(S.K), nodes), nodes, 0.4, 0.1, 0.05)
    return [s for s in found if isinstance(s, Supports)]


def test_any_of_a_few_supports_are_wrong_together_by_the_stiffness_that_they_have():
    held = {0: 2e4, 5: 3e4, 11: 1e4}
    S = rail(held)
    found, c = together(S), coordinates_of(S, S.dofs, S.dofs[:1], TOP)
    groups = [{0, 5, 11}, *map(set, itertools.combinations((0, 5, 11), 2))]
    assert [{S.dofs.index(w) for w in s.where} for s in found] == groups
    assert [s.weight for s in found] == pytest.approx([0.1, *[0.05 / 3] * 3])
    for s, group in zip(found, groups, strict=True):
        A = np.zeros((12, 12))
        for k in group:
            A[k, k] = held[k]
        expected = np.asarray(c.shapes).T @ A @ np.asarray(c.shapes)
        np.testing.assert_allclose(s.pattern, expected, atol=1e-6 * np.abs(expected).max())
    told = found[0].told_each(np.array([-0.5]), np.full((1, 1), 0.01))
    assert [t["where"] for t in told] == [["1:+Z"], ["6:+Z"], ["12:+Z"]]
    for t, stiffness in zip(told, held.values(), strict=True):
        value = t["parameters"]["stiffness"]
        assert (value["value"], value["std"]) == pytest.approx((-0.2 * stiffness, 0.04 * stiffness), rel=1e-6)
    assert found[0].told_as == tuple(("joint_stiffness", (w,)) for w in found[0].where)


def test_of_many_supports_all_or_all_but_one_are_wrong_together():
    assert [len(s.where) for s in together(rail({k: 1e4 for k in range(0, 12, 2)}))] == [6, *[5] * 6]


@pytest.mark.parametrize("held", [{3: 1e4}, dict.fromkeys(range(7), 1e4), {}])
def test_one_support_or_a_bed_under_most_nodes_is_no_group(held):
    assert together(rail(held)) == []


def test_a_cause_at_several_places_is_not_joined_with_one_at_the_same_place():
    S = rail({0: 2e4, 5: 3e4, 11: 1e4})
    every = candidates_of(S, coordinates_of(S, S.dofs, S.dofs[:1], TOP), S.dofs, S.dofs[:1], None, TOP)
    some = next(c for c in every if c.told_as == (("joint_stiffness", ("1:+Z",)), ("joint_stiffness", ("6:+Z",))))
    by_place = {c.where: c for c in every if c.slug == "joint_stiffness" and len(c.told_as) == 1}
    assert some.shares_place([by_place["1:+Z",]]) and by_place["6:+Z",].shares_place([some])
    assert not some.shares_place([by_place["12:+Z",]]) and not by_place["1:+Z",].shares_place([by_place["1:+Z",]])


PLANE = tuple(f"{k}:+{way}" for k in range(1, 9) for way in "XY")
MOUNTS = {0: 4e4, 3: 5e4, 7: 6e4}


def on_mounts(factor=1.0, off=0.0) -> Structure:
    """Eight masses in a row that move along and across it, on three mounts that hold them in both directions."""
    rng = np.random.default_rng(2)
    K, M = np.zeros((16, 16)), np.diag(np.repeat(1 + off / 3 * rng.standard_normal(8), 2))
    for way, stiffness in ((0, 3e5), (1, 2e5)):
        for k in range(7):
            at = [2 * k + way, 2 * k + 2 + way]
            K[np.ix_(at, at)] += stiffness * (1 + off * rng.standard_normal()) * np.array([[1, -1], [-1, 1]])
        for node, held in MOUNTS.items():
            wrong = factor if node == 3 else 1.0
            K[2 * node + way, 2 * node + way] += (1 + 0.2 * way) * held * wrong * (1 + off * rng.standard_normal())
    return Structure(M, 5e-5 * K, K, PLANE)


def test_one_mount_of_several_directions_is_wrong_in_all_of_them():
    found = together(on_mounts())
    nodes = [{int(name.split(":")[0]) for name in s.where} for s in found]
    assert nodes[:4] == [{1, 4, 8}, {1}, {4}, {8}] and [len(s.where) for s in found[:4]] == [6, 2, 2, 2]
    assert [s.weight for s in found] == pytest.approx([0.1, *[0.05 / 6] * 6])


@FEW_OR_ALL
def test_a_mount_that_is_softer_in_all_its_directions_is_named_beside_elements_that_are_off(wanted):
    freq, inputs, rng = np.arange(8.0, 90.0, 0.4), PLANE[2:4], np.random.default_rng(5)
    outputs = tuple(f"{k}:+{way}" for k in (2, 4, 7) for way in "XY")
    H = np.asarray(on_mounts(0.4, 0.01).frf(freq, outputs=outputs, inputs=inputs).H)
    sigma = np.broadcast_to(0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)).max(), H.shape)
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    data = Measurement.from_frfs([FRF(freq, H, variance=sigma**2, outputs=outputs, inputs=inputs)])
    found = diagnose_modes(data, on_mounts(), wanted=wanted)
    assert found.verdict == "named", found.reasons
    told = {c["where"][0]: c["parameters"]["stiffness"] for c in found.causes}
    assert set(told) == {"4:+X", "4:+Y"} and any("same factor" in reason for reason in found.reasons)
    assert told["4:+X"]["value"] == pytest.approx(-0.6 * 5e4, rel=0.1)
    assert told["4:+Y"]["value"] == pytest.approx(-0.6 * 6e4, rel=0.1)
