"""Simulations without damping, as finite-element models are: damping is measured, and its lack is no cause."""

import numpy as np
import pytest
import scipy.linalg

from modalax.data import Measurement
from modalax.diagnose.pipeline import diagnose
from modalax.diagnose.undamped import with_damping
from modalax.model import ModalModel, Structure
from modalax.model.mode_table import ModeTable

DOFS = tuple(f"{k}:+Z" for k in range(1, 7))
MASSES = np.array([1.0, 1.4, 0.9, 1.7, 1.2, 1.1])  # kg
SPRINGS = np.array([5e4, 9e4, 1.2e5, 7e4, 1.1e5, 8e4, 6e4])  # N/m, the first and the last to ground
FREQ = np.linspace(12.0, 115.0, 300)
RATIO = 0.013


def matrices(masses: np.ndarray, springs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    B = np.eye(7, 6) - np.eye(7, 6, -1)
    return np.diag(masses), B.T @ np.diag(springs) @ B


def undamped(**more) -> Structure:
    M, K = matrices(MASSES, SPRINGS)
    return Structure(M, np.zeros_like(K), K, DOFS, **more)


def measured(
    springs: np.ndarray = SPRINGS, masses: np.ndarray = MASSES, scatter: float = 0.2, seed: int = 3
) -> Measurement:  # fmt: skip
    """Accelerances of the chain, modes damped by 1.3 % or about that, noise of known variance."""
    rng = np.random.default_rng(seed)
    M, K = matrices(masses, springs)
    w2, P = scipy.linalg.eigh(K, M)
    zeta = RATIO * np.exp(scatter * rng.standard_normal(6))
    C = M @ P @ np.diag(2 * zeta * np.sqrt(w2)) @ P.T @ M
    s = 2j * np.pi * FREQ[:, None, None]
    H = (np.linalg.inv(K + s * C + s**2 * M) * s**2)[:, :5][:, :, [0, 3]]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return Measurement(
        FREQ, H[None], form="accelerance", outputs=DOFS[:5], inputs=(DOFS[0], DOFS[3]), variance=sigma[None] ** 2
    )  # fmt: skip


def said_of(found) -> list[str]:
    return [reason for reason in found.reasons if "has no damping" in reason]


def test_a_right_simulation_without_damping_is_clean_and_its_damping_is_the_measured_one():
    """It had ended as unknown after all of its time, with a record that is too short, as that widens peaks as well."""
    found = diagnose(measured(), undamped())
    assert found.verdict == "clean" and not found.causes, found.reasons
    assert len(said_of(found)) == 1
    M, K = matrices(MASSES, SPRINGS)
    _, P = scipy.linalg.eigh(K, M)
    w = np.sqrt(scipy.linalg.eigvalsh(K, M))
    ratios = np.diag(P.T @ np.asarray(found.extended.base.C) @ P) / 2 / w
    assert np.all(np.abs(np.log(ratios / RATIO)) < 4 * 0.2)
    assert found.gain.chi2_after < 1.1


@pytest.mark.parametrize("off", [pytest.param(0.0, marks=pytest.mark.slow), 0.01])
def test_a_soft_spring_is_found_beside_damping_that_nobody_stated(off):
    rng = np.random.default_rng(7)
    springs, masses = SPRINGS * (1 + off * rng.standard_normal(7)), MASSES * (1 + off / 3 * rng.standard_normal(6))
    springs[3] *= 0.7
    found = diagnose(measured(springs, masses), undamped())
    assert found.verdict == "named" and len(said_of(found)) == 1, found.reasons
    assert [(c["name"], set(c["where"])) for c in found.causes] == [("joint_stiffness", {DOFS[2], DOFS[3]})]
    told = found.causes[0]["parameters"]["stiffness"]
    assert abs(told["value"] + 0.3 * SPRINGS[3]) < 4 * told["std"] + 3 * off * SPRINGS[3]


def modal_model() -> ModalModel:
    M, K = matrices(MASSES, SPRINGS)
    w2, P = scipy.linalg.eigh(K, M)
    return ModalModel.from_real_modes(np.sqrt(w2) / 2 / np.pi, np.zeros(6), P.T, np.ones(6), DOFS)


def test_a_modal_model_without_damping_gets_that_of_the_structure_that_it_was_made_of():
    modal, said = with_damping(measured(), modal_model())
    structure, same = with_damping(measured(), undamped())
    np.testing.assert_allclose(modal.damping_ratio, structure.modal().damping_ratio, rtol=1e-6)
    assert said == same != ""


@pytest.mark.slow  # what it is given by default
def test_a_modal_model_without_damping_agrees_with_what_it_was_made_of():
    found = diagnose(measured(), modal_model())
    assert found.verdict == "clean" and len(said_of(found)) == 1, found.reasons


def test_modes_alone_tell_the_damping_as_well():
    M, K = matrices(MASSES, SPRINGS)
    w2, P = scipy.linalg.eigh(K, M)
    table = ModeTable.of(np.sqrt(w2) / 2 / np.pi, RATIO * np.array([1, 1.1, 0.9, 1, np.nan, 1]), P.T, DOFS)
    simulation, said = with_damping(table, undamped())
    ratios = np.diag(P.T @ np.asarray(simulation.C) @ P) / 2 / np.sqrt(w2)
    np.testing.assert_allclose(ratios, RATIO, rtol=1e-6)
    assert "1.3 %" in said
    found = diagnose(table, undamped())
    assert found.verdict == "clean" and len(said_of(found)) == 1, found.reasons


def test_a_simulation_with_damping_keeps_it():
    """Also if only one part of it damps, and if the damping is hysteretic."""
    M, K = matrices(MASSES, SPRINGS)
    one = np.zeros_like(K)
    one[0, 0] = 0.5
    for simulation in (Structure(M, one, K, DOFS), Structure(M, 0 * K, K, DOFS, D=1e-3 * K)):
        same, said = with_damping(measured(), simulation)
        assert same is simulation and said == ""


def test_massless_degrees_of_freedom_and_free_bodies_get_no_damping_of_their_own():
    M, K = matrices(MASSES, SPRINGS * np.array([0, 1, 1, 1, 1, 1, 0]))
    M[5, 5] = 0.0
    simulation, said = with_damping(measured(), Structure(M, 0 * K, K, DOFS))
    C = np.asarray(simulation.C)
    assert said and np.all(np.isfinite(C)) and np.linalg.eigvalsh(C).min() > -1e-9 * np.abs(C).max()
    np.testing.assert_allclose(C @ np.ones(6), 0.0, atol=1e-3 * np.abs(C).max())
