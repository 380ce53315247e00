"""Elements that a matrix shows as one may be several, each off by itself, and what that makes of symmetric ones."""

from types import SimpleNamespace

import numpy as np
import pytest
from frames import modal_damping

from modalax.data import Measurement
from modalax.diagnose.modal_domain import explain as search
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fit import fit
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.modal_domain.throughout import uneven_patterns, with_more
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


def measured(K: np.ndarray, M: np.ndarray, C: np.ndarray, rng: np.random.Generator) -> Measurement:
    """Accelerances of all DoFs by two forces over the lower modes, with noise of known variance."""
    top = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.max()) / 2 / np.pi
    freq, inputs = np.linspace(0.1 * top, 0.6 * top, 240), [0, 7]
    s = 2j * np.pi * freq[:, None, None]
    H = s**2 * np.linalg.solve(K + s * C + s**2 * M, np.broadcast_to(np.eye(len(K))[:, inputs], (240, len(K), 2)))
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal((2, *H.shape)) * [[[[1]]], [[[1j]]]]).sum(axis=0) / np.sqrt(2)
    names = [NAMES[k] for k in inputs]
    return Measurement(freq, H[None], form="accelerance", outputs=NAMES, inputs=names, variance=sigma[None] ** 2)


@pytest.mark.parametrize("columns", [(1.0, 1.1, 0.9, 1.05), pytest.param((1.0,) * 4, marks=pytest.mark.slow)])
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


@pytest.mark.parametrize(
    ("uneven", "evidence", "explained", "expected"),
    [
        (True, -298.0, True, True),
        (True, -304.0, True, False),
        (True, -298.0, False, False),
        (False, -298.0, True, False),
    ],
)
def test_a_cause_that_leads_is_weighed_against_elements_that_are_off_unevenly(
    monkeypatch, uneven, evidence, explained, expected
):
    """A leg and a brace to one support, each off by itself, had been a spring there, which the modes are far from."""
    wider = SimpleNamespace()
    monkeypatch.setattr(search, "with_more", lambda setting, null: wider)
    monkeypatch.setattr(search, "fit", lambda setting: SimpleNamespace(log_evidence=evidence, of=setting))
    monkeypatch.setattr(search, "explains", lambda f: f.of is wider and explained)
    best = SimpleNamespace(causes=("a spring",), log_posterior=-302.0)
    prior = SimpleNamespace(of=lambda causes: np.log(0.5))
    assert search._unevenly_off(SimpleNamespace(uneven=uneven), None, best, prior) is expected
    assert not search._unevenly_off(SimpleNamespace(uneven=uneven), None, SimpleNamespace(causes=()), prior)
