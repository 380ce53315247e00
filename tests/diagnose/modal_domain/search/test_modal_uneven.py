"""Elements that a matrix shows as one may be several, each off by itself, and what that makes of symmetric ones."""

from collections.abc import Sequence

import numpy as np
import pytest
from frames import modal_damping

from modalax.data import Measurement
from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.causes.within_elements import UnevenElement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.throughout import uneven_patterns, with_more
from modalax.diagnose.modal_domain.search.explain import UNLIKE, far_off, leading
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.model import Structure

FLOORS, HALF = 4, (3.0, 2.4)
NAMES = tuple(f"{k + 1}:+{way}" for k in range(FLOORS) for way in ("X", "Y", "RZ"))


def building(columns: tuple[float, ...], off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of floors on four columns, each column's stiffness off by a part, shape ``(floor, 4)``."""
    K, M = np.zeros((2, 3 * FLOORS, 3 * FLOORS))
    for k in range(FLOORS):
        for part, usual, (x, y) in zip(off[k], columns, ((1, 1), (1, -1), (-1, 1), (-1, -1)), strict=True):
            T = np.array([[1.0, 0.0, -y * HALF[1]], [0.0, 1.0, x * HALF[0]]])
            D = np.zeros((2, 3 * FLOORS))
            D[:, 3 * k : 3 * k + 3] = T
            if k:
                D[:, 3 * k - 3 : 3 * k] = -T
            K += usual * (1 + part) * D.T @ np.diag([4e6, 4.7e6]) @ D
        M[range(3 * k, 3 * k + 3), range(3 * k, 3 * k + 3)] = 8e3, 8e3, 8e3 * (HALF[0] ** 2 + HALF[1] ** 2) / 3
    return K, M


def measured(
    K: np.ndarray, M: np.ndarray, C: np.ndarray, rng: np.random.Generator, freq: np.ndarray | None = None,
    inputs: tuple[int, ...] = (0, 7), names: Sequence[str] = NAMES, noise: float = 0.01,
) -> Measurement:  # fmt: skip
    """Accelerances of all DoFs by two forces, over the lower modes unless told, with noise of known variance."""
    if freq is None:
        top = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.max()) / 2 / np.pi
        freq = np.linspace(0.1 * top, 0.6 * top, 240)
    s = 2j * np.pi * freq[:, None, None]
    forces = np.broadcast_to(np.eye(len(K))[:, inputs], (len(freq), len(K), len(inputs)))
    H = s**2 * np.linalg.solve(K + s * C + s**2 * M, forces)
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal((2, *H.shape)) * [[[[1]]], [[[1j]]]]).sum(axis=0) / np.sqrt(2)
    driven = [names[k] for k in inputs]
    return Measurement(freq, H[None], form="accelerance", outputs=names, inputs=driven, variance=sigma[None] ** 2)


@pytest.mark.parametrize("columns", [(1.0, 1.1, 0.9, 1.05), (1.0,) * 4])
def test_columns_that_are_off_each_by_itself_are_no_cause(columns):
    """A symmetric building shows no twist and no sway across the force, one with columns that are off does."""
    rng = np.random.default_rng(3)
    K, M = building(columns, np.zeros((FLOORS, 4)))
    simulation = Structure(M, modal_damping(M, K, 0.012), K, NAMES)
    K = building(columns, 0.03 * rng.standard_normal((FLOORS, 4)))[0]
    C = modal_damping(M, K, 0.012 * np.exp(0.2 * rng.standard_normal(len(K))))
    data = measured(K, M, C, rng)
    found = diagnose_modes(data, simulation, wanted=lambda slug: slug in ("added_mass", "joint_stiffness"))
    assert found.verdict == "clean"
    assert found.gain.chi2_after < 0.2 * found.gain.chi2_before
    assert found.to_dict()["inaccuracy"]["stiffness"]["value"] < 0.02


@pytest.mark.parametrize("columns", [pytest.param((1.0, 1.1, 0.9, 1.05), marks=pytest.mark.slow), (1.0,) * 4])
def test_one_of_four_columns_that_is_half_as_stiff_is_named_with_its_storey(columns):
    """As a storey that is softer as a whole it was hardly likelier than elements that are off, and so `clean`."""
    rng, off = np.random.default_rng(5), 0.03 * np.random.default_rng(6).standard_normal((FLOORS, 4))
    off[1, 2] = -0.5
    K, M = building(columns, np.zeros((FLOORS, 4)))
    simulation = Structure(M, modal_damping(M, K, 0.012), K, NAMES)
    K = building(columns, off)[0]
    C = modal_damping(M, K, 0.012 * np.exp(0.2 * rng.standard_normal(len(K))))
    found = diagnose_modes(
        measured(K, M, C, rng), simulation, wanted=lambda slug: slug in ("added_mass", "joint_stiffness")
    )
    (cause,) = found.to_dict()["causes"]
    assert (found.verdict, cause["name"]) == ("named", "joint_stiffness")
    assert {str(where).split(":")[0] for where in cause["where"]} == {"1", "2"}
    told, share = cause["parameters"]["relative_change"], np.array(columns) / np.sum(columns)
    # in the twist a column is strained as in the sways, so that each motion is softer by its share
    assert abs(told["value"] - share @ off[1]) < 3 * told["std"] < 0.06
    assert any("members in parallel" in reason for reason in found.reasons)
    again = found.extended.frf(found.freq, form="accelerance", outputs=NAMES, inputs=[NAMES[0], NAMES[7]])
    assert np.abs(again.H - found.predicted_after[0]).max() < 1e-6 * np.abs(again.H).max()


def test_changes_of_an_element_are_those_of_its_ways_of_being_strained():
    """One of four columns is taken away."""
    T = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 1.0]])
    whole = sum(np.outer(a, a) for x in (1, -1) for y in (1, -1) for a in ([1.0, 0.0, -y], [0.0, 1.0, x]))
    cause = UnevenElement("joint_stiffness", ("1", "2"), 0.4, ways=uneven_patterns(whole[None]))
    A = np.stack([way.ravel() for way in cause.ways], axis=1)
    u = np.linalg.lstsq(A, -(T.T @ T).ravel(), rcond=None)[0] / 0.4
    np.testing.assert_allclose(cause.changes(u)["K"], -T.T @ T, atol=1e-12)
    np.testing.assert_allclose(sum(x * by["K"] for x, by in zip(u, cause.slopes(u), strict=True)), -T.T @ T, atol=1e-12)
    F = np.linalg.inv(np.linalg.cholesky(whole))
    expected = np.linalg.eigvalsh(-F @ T.T @ T @ F.T)
    np.testing.assert_allclose(cause.relative_changes(u), expected, atol=1e-12)
    assert cause.size(u) == pytest.approx(expected[0]) and cause.possible(u) and not cause.possible(3 * u)
    told = cause.told(u, 0.01 * np.eye(6))["relative_change"]
    assert told["value"] == pytest.approx(expected.mean()) and told["std"] == pytest.approx(0.4 * 0.1 / np.sqrt(3))


def heavy(seed: int, floor: int, mass: float) -> tuple[Measurement, Structure]:
    """A building whose columns are off, with a mass on one floor that outweighs it, and as its author has it."""
    rng, columns = np.random.default_rng(seed), (1.0, 1.1, 0.9, 1.05)
    K, M = building(columns, np.zeros((FLOORS, 4)))
    simulation = Structure(M, modal_damping(M, K, 0.012), K, NAMES)
    K = building(columns, 0.03 * rng.standard_normal((FLOORS, 4)))[0]
    C = modal_damping(M, K, 0.012 * np.exp(0.2 * rng.standard_normal(len(K))))
    M = M + np.diag(mass * np.isin(np.arange(len(K)), [3 * floor, 3 * floor + 1]))
    return measured(K, M, C, rng), simulation


@pytest.mark.slow  # by default what it is fitted beside, and such a mass of a chain
def test_beside_them_a_mass_that_outweighs_its_floor_is_named():
    """The two lowest modes are below the band, where the simulation has none: close modes had seemed one."""
    found = diagnose_modes(*heavy(5, 0, 1e5), wanted=lambda slug: slug in ("added_mass", "joint_stiffness"))
    assert found.verdict == "named", found.reasons
    assert [(c["name"], c["where"]) for c in found.causes] in ([("added_mass", [w])] for w in ("1:+X", "1:+Y"))
    told = found.causes[0]["parameters"]["mass"]
    assert abs(told["value"] - 1e5) < 4 * told["std"] < 500


def test_uneven_errors_are_found_beside_a_mass_for_which_errors_of_elements_stood():
    """From these the fit had not come back, so that no group was worth anything."""
    data, simulation = heavy(14, 0, 1e5)
    task = posed(data, simulation, identified(data, simulation, lambda _: None))
    mass = next(c for c in task.candidates if c.where == ("1:+Y",) and c.kind == "M" and c.pattern is not None)
    u = mass.of_size(1e5 / mass.scale)
    setting = with_more(task.setting, fit(task.setting, (mass,), None, u))
    assert setting.inaccuracy.groups[4:] == ("stiffness within",)
    alone = fit(setting, (mass,), None, u)
    assert alone.chi2 < alone.state.difference.size


def test_uneven_changes_hold_every_change_of_parallel_springs():
    rng = np.random.default_rng(0)
    B = rng.standard_normal((3, 4, 5))  # elements of four springs each between five coordinates
    patterns = uneven_patterns(np.einsum("eki,ekj->eij", B, B))
    A = patterns.reshape(len(patterns), -1).T
    for spring in B.reshape(-1, 5):
        change = np.outer(spring, spring).ravel()
        assert np.linalg.norm(A @ np.linalg.lstsq(A, change, rcond=None)[0] - change) < 1e-9
    assert len(uneven_patterns(np.einsum("eki,ekj->eij", B[:, :1], B[:, :1]))) == 0  # single springs


def truss(off: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Stiffness of a plane tower, and its DoFs: legs, braces and rungs of three storeys, each off by a part."""
    place = {(side, k): np.array([3.0 * side, 4.0 * k]) for side in (0, 1) for k in range(4)}
    nodes, members = [(side, k) for k in (1, 2, 3) for side in (0, 1)], []
    for k in range(3):
        low, high = [(side, k) for side in (0, 1)], [(side, k + 1) for side in (0, 1)]
        ends = (low[0], high[0]), (low[1], high[1]), (low[0], high[1]), (low[1], high[0]), (high[0], high[1])
        members += [(*pair, k) for pair, k in zip(ends, (3e7, 2.6e7, 8e6, 1e7, 9e6), strict=True)]
    K = np.zeros((12, 12))
    for (a, b, k), part in zip(members, off, strict=True):
        along, v = place[b] - place[a], np.zeros((6, 2))
        for node, sign in ((a, -1), (b, 1)):
            if node in nodes:
                v[nodes.index(node)] = sign * along / np.linalg.norm(along)
        K += k * (1 + part) * np.outer(v, v)
    return K, [f"{n + 1}:+{way}" for n in range(6) for way in "XY"]


def test_a_leg_and_a_brace_to_one_support_that_are_off_each_by_itself_are_no_spring_there():
    """Far from the simulation one cause that explains the modes led, and uneven elements were not asked for."""
    rng = np.random.default_rng(2)
    (K, names), M = truss(np.zeros(15)), np.diag(np.repeat(np.linspace(900.0, 500.0, 6), 2))
    simulation = Structure(M, modal_damping(M, K, 0.012), K, names)
    K = truss(0.02 * rng.standard_normal(15))[0]
    C = modal_damping(M, K, 0.012 * np.exp(0.2 * rng.standard_normal(12)))
    low, high = np.sort(np.sqrt(np.linalg.eigvals(np.linalg.solve(M, truss(np.zeros(15))[0])).real))[[0, 6]] / 2 / np.pi
    freq = np.linspace(0.6 * low, 1.05 * high, 500)
    data = measured(K, M, C, rng, freq, (0, 9), names, 0.003)
    task = posed(data, simulation, identified(data, simulation, lambda _: None))
    springs = [c for c in task.candidates if c.slug in ("added_mass", "joint_stiffness")]
    null = fit(task.setting, basin=UNLIKE)
    assert far_off(null)
    assert leading(task.setting, null, springs, NEVER, lambda _: None, None)[2] == {}
