"""Few coordinates of a large structure hold what its modes become once elements change, and where a mass may sit."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from frames import beam, modal_damping

from modalax.data import Measurement
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain import stage
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.given_elements import (
    changed_by_elements,
    mass_patterns,
    softened_elements,
    stiffness_patterns,
)
from modalax.diagnose.modal_domain.causes.groups import group_factors
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import _pieces, forces_of_errors, inaccuracy_of
from modalax.diagnose.modal_domain.fitting.throughout import with_groups
from modalax.diagnose.modal_domain.search import explain
from modalax.diagnose.modal_domain.search.refitted import _same
from modalax.diagnose.modal_domain.stage import _forces, identified, posed
from modalax.diagnose.modal_domain.structure.coordinates import _about, coordinates_of
from modalax.diagnose.modal_domain.structure.enriched import ritz_basis
from modalax.diagnose.modal_domain.structure.turns import nodes_in
from modalax.model import Structure
from modalax.model.condense import follow
from modalax.model.elements import Elements, factor_of
from modalax.model.groups import Groups

COUNT = 40  # elements of a free beam
SIZE = 2 * (COUNT + 1)
TOP = 2 * np.pi * 12.0
PLACES = [np.arange(2 * e, 2 * e + 4) for e in range(COUNT)]


def free_beam(stiffness: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    K, M = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    k, m = beam()
    for at, a, b in zip(PLACES, stiffness, mass, strict=True):
        K[np.ix_(at, at)] += a * k
        M[np.ix_(at, at)] += b * m
    return K, M


def changed() -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of all elements, one of them gross."""
    rng = np.random.default_rng(3)
    stiffness, mass = 0.02 * rng.standard_normal(COUNT), 0.01 * rng.standard_normal(COUNT)
    stiffness[17] = 0.6
    return stiffness, mass


def frequencies(K: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Elastic ones in the band, relative to the highest."""
    square = scipy.linalg.eigh(K, M, eigvals_only=True)
    return np.sqrt(square[(square > 1.0) & (square < TOP**2)])


def test_a_ritz_basis_holds_the_modes_of_a_changed_structure():
    K, M = free_beam(np.ones(COUNT), np.ones(COUNT))
    stiffness, mass = changed()
    true = free_beam(1 + stiffness, 1 + mass)
    exact = frequencies(*true)
    k, m = beam()
    w, shapes, inside = ritz_basis(K, M, [(at, k) for at in PLACES], [(at, m) for at in PLACES], TOP, 42)
    plain = scipy.linalg.eigh(K, M)[1][:, :42]
    errors = []
    for B in (shapes, plain):
        found = frequencies(B.T @ true[0] @ B, B.T @ true[1] @ B)
        errors.append(np.abs(found / exact - 1).max())
    assert len(exact) > 4 and inside == len(exact) + 2  # two modes of a rigid body
    assert errors[0] < 1e-4 < 8 * errors[0] < errors[1]
    np.testing.assert_allclose(shapes.T @ M @ shapes, np.eye(len(w)), atol=1e-7)
    np.testing.assert_allclose(shapes.T @ K @ shapes, np.diag(w**2), atol=1e-6 * w[-1] ** 2)


def test_about_some_nodes_a_basis_moves_as_the_whole_structure_does():
    K, M = free_beam(np.ones(COUNT), np.ones(COUNT))
    k, m = beam()
    parts = [(at, k) for at in PLACES], [(at, m) for at in PLACES]
    one = np.ones(COUNT)
    softer = free_beam(np.where(np.arange(COUNT) == 17, 0.3, one), one)
    heavier = free_beam(one, np.where(np.arange(COUNT) == 17, 4.0, one))
    errors = {}
    for exact in ((), PLACES[17]):
        w, shapes, _ = ritz_basis(K, M, *parts, TOP, 42, np.eye(SIZE)[:, list(exact)])
        assert len(w) == 42 + len(exact)
        np.testing.assert_allclose(shapes.T @ M @ shapes, np.eye(len(w)), atol=1e-7)
        errors[len(exact)] = [
            np.abs(frequencies(*(shapes.T @ A @ shapes for A in changed)) / frequencies(*changed) - 1).max()
            for changed in (softer, heavier)
        ]
    assert (np.array(errors[4]) < 1e-7).all() and (np.array(errors[0]) > 100 * np.array(errors[4])).all(), errors


@pytest.fixture(scope="module")
def condensed() -> Structure:
    """The beam with displacements alone, whose rotations follow; its elements know of these."""
    K, M = free_beam(np.ones(COUNT), np.ones(COUNT))
    M = np.diag(np.where(np.arange(SIZE) % 2 == 0, np.diag(M), 0.0))  # lumps that do not resist turning
    kept = np.arange(SIZE) % 2 == 0
    T = follow(K, kept)
    names = [f"{p + 1}:+{way}" for p in range(COUNT + 1) for way in ("Z", "RY")]
    F, G = np.zeros((COUNT, SIZE, 6)), np.zeros((COUNT + 1, SIZE, 6))
    for out, at in zip(F, PLACES, strict=True):
        out[at] = factor_of(beam()[0])
    for p in range(COUNT + 1):
        G[p, 2 * p, 0] = np.sqrt(M[2 * p, 2 * p])
    told = Elements(F, G, [(names[at[0]], names[at[2]]) for at in PLACES], names)
    k, m = T.T @ K @ T, T.T @ M @ T
    return Structure(m, 1e-5 * k, k, np.array(names)[kept].tolist(), elements=told)


def test_what_follows_an_element_follows_otherwise_once_it_is_softer(condensed, monkeypatch):
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 42)
    c = coordinates_of(condensed, ("3:+Z", "20:+Z"), ("3:+Z",), TOP)
    stiffness, mass = changed()
    mass = np.append(mass, 0.0)
    assert c.size == 44 and c.everywhere.shape == (SIZE, 44) and c.shapes.shape == (COUNT + 1, 44)  # one is driven
    K, _ = free_beam(1 + stiffness, np.ones(COUNT))
    _, whole = free_beam(np.ones(COUNT), np.ones(COUNT))
    lumps = np.diag(whole)[::2] * (1 + mass)
    soft = follow(K, np.arange(SIZE) % 2 == 0)
    exact = frequencies(soft.T @ K @ soft, np.diag(lumps))
    patterns = stiffness_patterns(condensed, c), mass_patterns(condensed, c)
    assert patterns[0] is not None and patterns[1] is not None
    own = np.diag(c.frequencies**2) + np.tensordot(stiffness, patterns[0], 1)
    found = frequencies(own, np.eye(c.size) + np.tensordot(mass, patterns[1], 1))
    assert len(exact) > 3
    np.testing.assert_allclose(found, exact, rtol=2e-4)
    # the extended simulation is exact: the gross error as a cause, all others as the general inaccuracy
    cause = softened_elements(condensed, c, 0.4)[17]
    rest = np.where(np.arange(COUNT) == 17, 0.0, stiffness)
    dK, dM = changed_by_elements(condensed, {"stiffness": rest, "mass": mass}, [(cause, np.array([0.6 / 0.4]))])
    again = frequencies(np.asarray(condensed.K) + dK, np.asarray(condensed.M) + dM)
    np.testing.assert_allclose(again, exact, rtol=1e-8)


def test_a_mass_may_sit_at_a_node_that_is_not_kept():
    """Two masses on a rigid arm: the second follows the first, but to its own mass there is a place."""
    names = [f"{p}:+{way}" for p in (1, 2, 3) for way in "XZ"]
    F, G = np.zeros((2, 6, 6)), np.zeros((3, 6, 6))
    F[0, [0, 2], 0] = F[0, [1, 3], 1] = 100.0, -100.0
    F[1, [2, 4], 0] = F[1, [3, 5], 1] = 1e5, -1e5
    for p in range(3):
        G[p, [2 * p, 2 * p + 1], [0, 1]] = 1.0
    K, M = (np.einsum("enr,emr->nm", A, A) for A in (F, G))
    T = follow(K, np.arange(6) < 4)
    told = Elements(F, G, [("1:+Z", "2:+Z"), ("2:+Z", "3:+Z")], names)
    k, m = T.T @ K @ T, T.T @ M @ T
    structure = Structure(m, 1e-4 * k, k, names[:4], elements=told)
    c = coordinates_of(structure, ("1:+Z",), ("2:+Z",), 200.0)
    every = candidates_of(structure, c, ("1:+Z",), ("2:+Z",), None, 200.0)
    places = [x.where[0] for x in every if x.slug == "added_mass" and x.pattern is not None]
    assert sorted(str(p).split(":")[0] for p in places) == ["1", "2", "3"]
    lump = next(x for x in every if x.slug == "added_mass" and x.where[0] in ("3:+X", "3:+Z"))
    dK, dM = changed_by_elements(structure, {"stiffness": np.zeros(2), "mass": np.zeros(3)}, [(lump, np.array([0.5]))])
    np.testing.assert_allclose(dK, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.trace(dM), 2 * 0.5 * lump.scale, rtol=1e-6)  # as it moves with node 2


def test_a_group_of_elements_of_a_condensed_model_is_softer_exactly(condensed):
    at = np.arange(COUNT) < 7
    share = np.einsum("enr,emr->nm", *2 * [np.asarray(condensed.elements.stiffness)[at]])
    # told over the DoFs that are kept it is exact to first order, as what follows them follows by other ratios
    for own, off, error in ((share, 0.3, 1e-9), (_seen(condensed, share), 0.03, 3e-4)):
        K, _ = free_beam(np.where(at, 1 - off, 1.0), np.ones(COUNT))
        T = follow(K, np.arange(SIZE) % 2 == 0)
        known = condensed.replace(groups=Groups(["half"], own[None]))
        c = coordinates_of(known, ("3:+Z", "20:+Z"), ("3:+Z",), TOP)
        (cause,) = group_factors(known, c)
        still = {"stiffness": np.zeros(COUNT), "mass": np.zeros(COUNT + 1)}
        dK, _ = changed_by_elements(known, still, [(cause, np.array([-off / cause.scale]))])
        apart = np.abs(np.asarray(known.K) + dK - T.T @ K @ T).max() / np.abs(np.asarray(known.K)).max()
        assert apart < error


def _seen(structure, share):
    """A share of the stiffness as the DoFs that are kept see it."""
    told = structure.elements
    K = np.einsum("enr,emr->nm", *2 * [np.asarray(told.stiffness)])
    T = follow(K, np.isin(told.dofs, structure.dofs))
    return T.T @ share @ T


def test_errors_of_all_elements_are_exact_as_forces(monkeypatch):
    """Forces of errors that are known make the basis move as all elements do, and not only about some nodes."""
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 30)
    data, simulation = measured_beam(0.3)
    c = coordinates_of(simulation, data.outputs, data.inputs, TOP)
    rng, nodes = np.random.default_rng(1), nodes_in(simulation.dofs, np.asarray(simulation.K))
    patterns = inaccuracy_of(simulation, c, TOP)
    off = {name: 0.05 * rng.standard_normal(len(patterns.patterns[k])) for k, name in enumerate(("stiffness", "mass"))}
    K, M = np.array(simulation.K), np.array(simulation.M)
    for A, name in ((K, "stiffness"), (M, "mass")):
        for p, size in zip(_pieces(A.copy(), nodes, name == "mass"), off[name], strict=True):
            A[np.ix_(p.dofs, p.dofs)] += size * p.matrix
    squares, shapes = scipy.linalg.eigh(K, M, subset_by_index=[0, 5])
    acting = forces_of_errors(simulation, off, shapes, squares)
    dK, dM = K - np.asarray(simulation.K), M - np.asarray(simulation.M)
    np.testing.assert_allclose(acting, dK @ shapes - dM @ shapes * squares, atol=1e-9 * np.abs(acting).max())
    errors = []
    for extra in (None, acting):
        B = coordinates_of(simulation, data.outputs, data.inputs, TOP, (), extra).shapes[:, :-1]
        found = scipy.linalg.eigh(B.T @ K @ B, B.T @ M @ B, eigvals_only=True)[:6]
        errors.append(np.abs(np.sqrt(found / squares) - 1).max())
    assert errors[1] < 1e-8 < 1e-6 < errors[0], errors


@pytest.mark.parametrize("many", ["outputs", "inputs"])
def test_few_shapes_hold_what_gives_way_at_the_forces(many, monkeypatch):
    """Without it some per cent of the motion at the force was missing beside 60 sensors, three deviations of noise."""
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 30)
    _, simulation = measured_beam(1.0)
    channels = [simulation.dofs[0:SIZE:8], (simulation.dofs[6], simulation.dofs[41])]
    outputs, inputs = (tuple(one) for one in (channels if many == "outputs" else channels[::-1]))
    rows, columns = ([simulation.index(name) for name in some] for some in (outputs, inputs))
    M, K = np.asarray(simulation.M), np.asarray(simulation.K)
    left = []
    for driven in (2, 0):
        monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.DRIVEN", driven)
        c = coordinates_of(simulation, outputs, inputs, TOP)
        assert c.size == 31 + driven
        for w in TOP * np.array([0.21, 0.72]):
            whole = np.linalg.solve(K - w**2 * M, np.eye(len(K)))[np.ix_(rows, columns)]
            own = (c.outputs / (c.frequencies**2 - w**2)) @ c.inputs.T
            left.append(np.linalg.norm(own - whole) / np.linalg.norm(whole))
    assert max(left[:2]) < 1e-5 < 30 * max(left[:2]) < min(left[2:]), left


def test_where_nothing_stands_out_a_large_simulation_is_made_exact_about_what_elements_are_off_by(monkeypatch):
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 30)
    data, simulation = measured_beam(1.0)
    posed, made = stage.posed, []
    monkeypatch.setattr(stage, "posed", lambda *a: made.append(a[3:]) or posed(*a))
    found = diagnose_modes(data, simulation, wanted={"joint_stiffness", "added_mass"}.__contains__)
    assert found.verdict == "clean" and len(made) == 2
    about, errors = made[1]
    assert about == () and errors.shape[1] >= len(found.stage.setting.features.poles)
    assert found.stage.setting.coordinates.size > 33 and found.stage.coordinates is found.stage.setting.coordinates
    assert found.to_dict()["gain"]["chi2_after"] < 1.1


def measured_beam(softer: float) -> tuple[Measurement, Structure]:
    """Accelerances of a beam on two springs whose elements are 1 % off, one of them far softer, and its simulation."""
    names = [f"{p + 1}:+{way}" for p in range(COUNT + 1) for way in ("Z", "RY")]
    turn, held, rng = np.array([1.0, -1.0] * (COUNT + 1)), np.zeros(SIZE), np.random.default_rng(5)
    held[[0, 2 * COUNT]] = 300.0

    def matrices(stiffness: np.ndarray, mass: np.ndarray) -> list[np.ndarray]:
        K, M = free_beam(stiffness, mass)
        K = K + np.diag(held)
        return [turn[:, None] * A * turn for A in (M, modal_damping(M, K, 0.01), K)]

    stiffness, mass = (1 + off * rng.standard_normal(COUNT) for off in (0.01, 0.0033))
    stiffness[17] *= softer
    M, C, K = matrices(stiffness, mass)
    freq = np.linspace(0.5, 12.0, 200)
    s, outputs, inputs = 2j * np.pi * freq[:, None, None], np.arange(0, SIZE, 16), [4, 40]
    H = (s**2 * np.linalg.inv(K + s * C + s**2 * M))[None][..., outputs, :][..., inputs]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    error = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    outputs, inputs = (tuple(names[k] for k in which) for which in (outputs, inputs))
    H = H + sigma * error / np.sqrt(2)
    data = Measurement(freq, H, form="accelerance", outputs=outputs, inputs=inputs, variance=sigma**2)
    return data, Structure(*matrices(np.ones(COUNT), np.ones(COUNT)), names)


def test_errors_are_made_exact_where_the_data_have_asked_for_a_factor_as_well(monkeypatch):
    """The sizes of a fit were taken for those of single elements alone, which ended a search with an error."""
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 30)
    data, simulation = measured_beam(1.0)
    setting = posed(data, simulation, identified(data, simulation, lambda _: None)).setting
    wider = with_groups(setting, ("stiffness throughout",))
    f = fit(wider)
    alone = replace(f, sizes=f.sizes[: len(setting.inaccuracy.group_of)])
    acting = _forces(simulation, setting, f)
    assert len(f.sizes) == len(alone.sizes) + 1 and acting.shape[1] >= len(setting.features.poles)
    np.testing.assert_array_equal(acting, _forces(simulation, setting, alone))


@pytest.mark.parametrize("few", [30, pytest.param(42, marks=pytest.mark.slow)])
def test_an_element_of_a_large_simulation_is_told_as_soft_as_it_is(few, monkeypatch):
    """By the shapes kept of it alone, 0.75 +- 0.01 had been told of 0.70 that the element has lost."""
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", few)
    data, simulation = measured_beam(0.3)
    found = diagnose_modes(data, simulation, wanted={"joint_stiffness", "added_mass"}.__contains__)
    assert [(c["name"], sorted(c["where"])) for c in found.causes] == [("joint_stiffness", ["18:+Z", "19:+Z"])]
    change = found.causes[0]["parameters"]["relative_change"]
    assert change["value"] == pytest.approx(-0.7, abs=3 * change["std"]) and change["std"] < 0.015
    assert found.verdict == "named" and found.stage.coordinates is found.stage.setting.coordinates
    assert few < found.stage.coordinates.size < SIZE


def test_the_place_in_a_large_simulation_is_looked_for_though_time_is_up(monkeypatch):
    """After one fit time was up; a mass had been named five nodes from its own with probability 1."""
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.LARGEST", 30)
    up, attempt, settled = [], explain.attempt, explain.settled
    late = lambda self: bool(up) and self is not NEVER

    def first(*args, **more):
        attempt(*args, **more)
        up.append("time")

    def then(search, late):
        assert up and search.setting.late is NEVER is late and not settled(search, late)
        up.append("settled")

    monkeypatch.setattr(Deadline, "__call__", late)
    monkeypatch.setattr(explain, "attempt", first)
    monkeypatch.setattr(explain, "settled", then)
    data, simulation = measured_beam(0.3)
    found = diagnose_modes(data, simulation, wanted={"joint_stiffness", "added_mass"}.__contains__)
    assert up[:2] == ["time", "settled"] and any("time was up" in reason for reason in found.to_dict()["reasons"])
    assert [(c["name"], sorted(c["where"])) for c in found.causes] == [("joint_stiffness", ["18:+Z", "19:+Z"])]


def test_a_cause_is_the_same_among_as_many_alike_only():
    one, other, more = (Change("joint_stiffness", ("1", "2"), size) for size in (1.0, 2.0, 3.0))
    there = [Change("added_mass", ("1",), 1.0), replace(one, scale=5.0), replace(other, scale=6.0)]
    assert [c.scale for c in _same(other, [one, other], there)] == [6.0]
    assert _same(other, [one, other, more], there) == [] == _same(more, [one, other], there)


def test_the_nodes_next_to_those_that_lead_are_exact_too_as_far_as_they_are_few(monkeypatch):
    """A mass had been named one node beside its own, about which the model was not exact."""
    K, _ = free_beam(np.ones(COUNT), np.ones(COUNT))
    names = tuple(f"{p + 1}:+{way}" for p in range(COUNT + 1) for way in ("Z", "RY"))
    at = lambda *nodes: [2 * n + k for n in nodes for k in (0, 1)]
    assert _about(names, K, ("11:+Z", "40:+RY", "not there")) == at(9, 10, 11, 38, 39, 40)
    monkeypatch.setattr("modalax.diagnose.modal_domain.structure.coordinates.NEXT_TO", 11)
    assert _about(names, K, ("11:+Z", "40:+RY")) == at(10, 39)
    assert _about(names, K, ()) == []
