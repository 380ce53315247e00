"""Beams whose ends turn against their nodes: the change of stiffness, and a cantilever told where it gives way."""

import frames
import numpy as np
import pytest
from frames import DOFS, ELEMENTS, FLIP
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.connections import flexible_ends
from modalax.diagnose.modal_domain.causes.given_elements import told_parts
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import parts_of
from modalax.model import Structure
from modalax.model.elements import Elements

HIGHEST = 2 * np.pi * 230.0


def giving_way(element: int, end: int, spring: float, stiffness: np.ndarray | None = None) -> np.ndarray:
    """Stiffness of the cantilever, one end of an element joined to its node by a rotational spring [N m/rad].

    The end's own rotation is a DoF more, which is condensed out; the element may be off by a factor.
    """
    stiffness = np.ones(ELEMENTS) if stiffness is None else stiffness
    without = stiffness.copy()
    without[element] = 0.0
    K, _ = frames.cantilever(without)
    size = len(K) + 3
    every = np.zeros((size, size))  # the two clamped DoFs first, the end's own rotation last
    every[2:-1, 2:-1] = K
    at = [2 * element + k for k in range(4)]
    node, at[1 + 2 * end] = at[1 + 2 * end], size - 1
    every[np.ix_(at, at)] += stiffness[element] * frames.beam()[0]
    every[np.ix_([node, size - 1], [node, size - 1])] += spring * np.array([[1, -1], [-1, 1]])
    a, b, d = every[2:-1, 2:-1], every[2:-1, -1], every[-1, -1]
    return FLIP[:, None] * (a - np.outer(b, b) / d) * FLIP


def ends(S: Structure):
    nodes = nodes_of(DOFS)
    parts = parts_of(np.asarray(S.K), nodes) if S.elements is None else told_parts(S, nodes)
    return flexible_ends(parts, nodes, DOFS, coordinates_of(S, DOFS[::2], DOFS[-2:-1], HIGHEST), 0.4)


@pytest.mark.parametrize("spring", [30.0, 2000.0])
@pytest.mark.parametrize(("element", "end", "where"), [
    (0, 0, ("1:+RY",)), (0, 1, None), (3, 0, ("3:+RY", "4:+RY")), (3, 1, ("4:+RY", "3:+RY")),
])  # fmt: skip
def test_an_end_that_gives_way_is_the_element_with_its_rotation_condensed_out(element, end, where, spring):
    S = frames.simulation()
    own = frames.beam()[0][1, 1]
    share = own / (own + spring)
    c = coordinates_of(S, DOFS[::2], DOFS[-2:-1], HIGHEST)
    change = giving_way(element, end, spring) - np.asarray(S.K)
    (one,) = [e for e in ends(S) if e.where == where] or [None]
    if where is None:  # of a clamped element the free end turns against the others; as a spring to ground it is known
        assert one is None
        return
    expected = c.shapes.T @ change @ c.shapes
    np.testing.assert_allclose(share / 0.4 * one.matrix, expected, atol=1e-6 * np.abs(expected).max())
    told = one.told(np.array([share / 0.4]), np.array([[0.01]]))["rotational_stiffness"]
    assert told["value"] == pytest.approx(spring, rel=1e-6) and told["unit"] == "N m/rad"
    assert told["std"] == pytest.approx(0.1 * 0.4 * own / share**2, rel=1e-6)
    error = one.variance_beside(np.array([share / 0.4]), {"stiffness": 1e-4})
    K = giving_way(element, end, spring, np.where(np.arange(ELEMENTS) == element, 1 + 1e-4, 1.0))
    stiffer, _ = frames.cantilever(np.where(np.arange(ELEMENTS) == element, 1 + 1e-4, 1.0))
    more = np.trace(K - FLIP[:, None] * stiffer * FLIP) / np.trace(change) - 1  # beside the element that is stiffer
    assert np.sqrt(error).item() == pytest.approx(share / 0.4 * more, rel=1e-3)
    assert not one.signed and one.size(np.array([1.0])) == pytest.approx(-0.4)


def test_springs_supports_and_points_without_directions_have_no_ends():
    nodes = nodes_of(("1:+Z", "1:+RY", "2:+Z", "2:+RY"))
    torsion = Part((0, 1), np.array([1, 3]), np.array([[2.0, -2.0], [-2.0, 2.0]]))
    support = Part((0,), np.array([0, 1]), np.diag([3.0, 1.0]))
    S = Structure(np.eye(4), 1e-3 * np.eye(4), np.diag([9.0, 8.0, 7.0, 6.0]), ("1:+Z", "1:+RY", "2:+Z", "2:+RY"))
    c = coordinates_of(S, S.dofs[:1], S.dofs[:1], 10.0)
    assert flexible_ends([torsion, support], nodes, S.dofs, c, 0.4) == []
    loose = nodes_of(("a", "b", "c", "d"))
    assert flexible_ends([Part((0,), np.array([0]), np.eye(1))], loose, S.dofs, c, 0.4) == []


def test_an_element_that_is_strained_in_one_way_has_no_end_of_its_own():
    """A spring at a lever is strained by the rotation too; what gives way there is that spring again."""
    nodes, strain = nodes_of(("1:+Z", "1:+RY", "2:+Z", "2:+RY")), np.array([1.0, 0.3, -1.0, 0.2])
    S = Structure(np.eye(4), 1e-3 * np.eye(4), np.diag([9.0, 8.0, 7.0, 6.0]), ("1:+Z", "1:+RY", "2:+Z", "2:+RY"))
    c = coordinates_of(S, S.dofs[:1], S.dofs[:1], 10.0)
    of = lambda matrix: flexible_ends([Part((0, 1), np.arange(4), matrix)], nodes, S.dofs, c, 0.4)
    assert of(5 * np.outer(strain, strain)) == []
    assert len(of(5 * np.outer(strain, strain) + np.outer(strain[::-1], strain[::-1]))) == 2


def test_parts_of_no_node_or_of_three_have_no_ends():
    nodes, S = nodes_of(DOFS), frames.simulation()
    c = coordinates_of(S, DOFS[:2], DOFS[:1], HIGHEST)
    clamped = next(p for p in parts_of(np.asarray(S.K), nodes) if len(p.nodes) == 1 and len(p.dofs) == 2)
    assert len(flexible_ends([clamped], nodes, DOFS, c, 0.4)) == 1
    for other in ((), (0, 1, 2)):
        assert flexible_ends([Part(other, clamped.dofs, clamped.matrix)], nodes, DOFS, c, 0.4) == []


def test_elements_that_are_told_have_ends_too():
    S, nodes = frames.simulation(), nodes_of(DOFS)
    part = next(p for p in parts_of(np.asarray(S.K), nodes) if set(p.nodes) == {2, 3})
    values, vectors = np.linalg.eigh(part.matrix)
    F = np.zeros((1, len(DOFS), 4))
    F[0, part.dofs] = vectors * np.sqrt(np.maximum(values, 0.0))
    told = S.replace(elements=Elements(F, np.zeros((1, len(DOFS), 1)), [("3:+Z", "4:+Z")]))
    read = {e.where: e for e in ends(S)}
    for e in ends(told):
        np.testing.assert_allclose(e.pattern, read[e.where].pattern, atol=1e-9 * np.abs(e.pattern).max())
        np.testing.assert_allclose(np.abs(e.factor), np.abs(read[e.where].factor), atol=1e-6 * np.abs(e.factor).max())
    assert {e.where for e in ends(told)} == {("3:+RY", "4:+RY"), ("4:+RY", "3:+RY")}


def measured(element: int, end: int, spring: float, off: float) -> Measurement:
    rng = np.random.default_rng(5)
    K = giving_way(element, end, spring, 1 + off * rng.standard_normal(ELEMENTS))
    M = frames.cantilever(None, 1 + off / 3 * rng.standard_normal(ELEMENTS))[1]
    M = FLIP[:, None] * M * FLIP
    C = frames.modal_damping(M, K, frames.DAMPING * np.exp(10 * off * rng.standard_normal(len(K))))
    freq, inputs = np.linspace(1.5, 230.0, 160), [DOFS.index("8:+Z"), DOFS.index("5:+Z")]
    s = 2j * np.pi * freq[:, None, None]
    H = s**2 * np.linalg.inv(K + s * C + s**2 * M)[:, ::2][:, :, inputs]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean()) * np.ones(H.shape)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return Measurement(
        freq, (H + sigma * noise)[None], form="accelerance", outputs=DOFS[::2],
        inputs=tuple(DOFS[k] for k in inputs), variance=sigma[None] ** 2,
    )  # fmt: skip


@FEW_OR_ALL
@pytest.mark.parametrize(("element", "end", "off"), [(0, 0, 0.01), pytest.param(4, 1, 0.01, marks=pytest.mark.slow)])
def test_where_a_beam_gives_way_is_named_beside_elements_that_are_off(element, end, off, wanted):
    rigid = frames.beam()[0][1, 1]
    found = diagnose_modes(
        measured(element, end, rigid / 2, off), frames.simulation(), late=Deadline(300.0), wanted=wanted
    )
    assert found is not None and found.verdict == "named", found.reasons
    (cause,) = found.causes
    node = f"{element + 1}:+RY"
    assert cause["name"] == "joint_stiffness" and node in cause["where"]
    turns = "turns against its clamp" if element == 0 else f"turns against its node at {cause['where'][0]}"
    assert any(turns in reason for reason in found.reasons)
    told = cause["parameters"]["rotational_stiffness"]
    assert abs(told["value"] - rigid / 2) < 3 * told["std"] < 0.6 * rigid
    assert found.gain.chi2_after < 1.1 < found.gain.chi2_before
    assert found.inaccuracy["stiffness"]["value"] < 0.01


def test_an_exact_simulation_that_is_clamped_too_rigidly_is_named_without_a_search_line_by_line(monkeypatch):
    """Lines have no such cause, and would search for others for minutes."""
    asked = []
    monkeypatch.setattr("modalax.diagnose.pipeline.line_by_line", lambda *a, **k: asked.append(1))
    rigid = frames.beam()[0][1, 1]
    found = diagnose(measured(0, 0, 3 * rigid, 0.0), frames.simulation())
    assert found.verdict == "named" and not asked
    assert [(c["name"], c["where"]) for c in found.causes] == [("joint_stiffness", ["1:+RY"])]
    told = found.causes[0]["parameters"]["rotational_stiffness"]
    assert abs(told["value"] - 3 * rigid) < 4 * told["std"] < 0.2 * rigid
