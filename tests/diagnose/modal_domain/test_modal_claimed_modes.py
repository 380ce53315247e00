"""A simulation whose modes are claimed to be off: its shapes tell whether its elements are off instead."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from chains_off import DOFS, FREQ, MASSES, SPRINGS, ZETA, as_measured, chain_off, matrices, response
from kinds import FEW

from modalax.diagnose import catalogue, diagnose, pipeline
from modalax.diagnose.deadline import NEVER
from modalax.diagnose.decision.route import by_claim, order
from modalax.diagnose.modal_domain.answer import ModalDiagnosis
from modalax.diagnose.modal_domain.claimed_modes import compared, off_by_modes
from modalax.diagnose.modal_domain.fitting.discrepancy import _root
from modalax.diagnose.modal_domain.stage import identified
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.routes import named_beside_claim, task_of
from modalax.model import Structure

CLAIMED = Structure(*matrices(MASSES, SPRINGS, ZETA), DOFS, frequency_std=0.01, damping_std=0.2)
MASS = 0.1  # kg, added at the second mass


def off_mode_by_mode(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The chain with its own shapes, frequencies off by 1 % and dampings by 20 %."""
    rng = np.random.default_rng(seed)
    M, _, K = matrices(MASSES, SPRINGS, ZETA)
    w2, P = scipy.linalg.eigh(K, M)
    w, zeta = np.sqrt(w2) * (1 + 0.01 * rng.standard_normal(5)), ZETA * (1 + 0.2 * rng.standard_normal(5))
    left = M @ P
    return M, left @ np.diag(2 * zeta * w) @ left.T, left @ np.diag(w**2) @ left.T


@pytest.mark.parametrize(
    ("structure", "mass", "elements"),
    [(off_mode_by_mode(7), MASS, False), (chain_off(7, 0.02), 0.0, True), (chain_off(7, 0.02), MASS, True)],
)
def test_elements_that_are_off_bend_shapes_as_no_frequency_does(structure, mass, elements):
    M, C, K = structure
    data = as_measured(response(M + mass * np.outer(np.eye(5)[1], np.eye(5)[1]), C, K, FREQ), FREQ, 7)
    measured = identified(data, CLAIMED, lambda _: None)
    assert compared(data, CLAIMED, measured, NEVER).elements_show is elements
    task = task_of(data, CLAIMED, "auto")
    assert by_claim(task)
    assert order(replace(task, elements_show=elements))[0] == ("modes" if elements else "lines")


def answered(structure, gain, monkeypatch):
    """The answer, its stages in words, and whether places of one force were looked for."""
    M, C, K = structure
    H = response(M, C, K, FREQ)
    H[:, 1] *= gain
    stages, asked = [], []
    monkeypatch.setattr(pipeline, "places_of_one_force", lambda *a: asked.append(1) or ())
    some = [c for c in catalogue() if c.slug in FEW and not c.slug.startswith("element")]
    found = diagnose(as_measured(H, FREQ, 7), CLAIMED, causes=some, progress=stages.append, time=300.0)
    return found, stages, bool(asked)


def test_what_modes_name_beside_modes_as_claimed_is_fitted_to_lines_before_all_else(monkeypatch):
    found, stages, asked = answered(off_mode_by_mode(7), 1.3, monkeypatch)
    assert found.verdict == "named" and not asked
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_gain", [DOFS[1]])]
    gain = found.causes[0]["parameters"]["gain"]
    assert abs(gain["value"] - 0.3) < 4 * gain["std"] < 0.1
    assert not isinstance(found, ModalDiagnosis) and "screening every cause" in " ".join(stages)
    data = as_measured(response(*off_mode_by_mode(7), FREQ), FREQ, 7)
    measured = identified(data, CLAIMED, lambda _: None)
    assert named_beside_claim(compared(data, CLAIMED, measured, NEVER)) == []  # nothing is wrong


def test_two_causes_beside_modes_as_claimed_are_no_elements_that_are_off():
    """A damper beside a gain was taken for elements that are off, which bend shapes alike but far less likely."""
    M, C, K = off_mode_by_mode(7)
    H = response(M + MASS * np.outer(np.eye(5)[1], np.eye(5)[1]), C, K, FREQ)
    H[:, 3] *= 1.3
    data = as_measured(H, FREQ, 7)
    said = compared(data, CLAIMED, identified(data, CLAIMED, lambda _: None), NEVER)
    assert said.explained and not said.elements_show
    named = {(one.slug, one.where): one.values[0] for one in named_beside_claim(said)}
    assert named.keys() == {("added_mass", (DOFS[1],)), ("channel_gain", (DOFS[3],))}
    assert named["added_mass", (DOFS[1],)] == pytest.approx(MASS, rel=0.2)


def test_each_mode_is_off_by_a_frequency_of_its_own_and_by_nothing_else():
    c = coordinates_of(CLAIMED, DOFS[:2], DOFS[:1], 2 * np.pi * FREQ[-1])
    off = off_by_modes(CLAIMED, c, 2 * np.pi * FREQ[-1])
    np.testing.assert_allclose(off.usual, [0.01, 0.2])
    for k, pattern in enumerate(off.patterns[0]):
        changed = np.sqrt(np.diag(np.diag(c.frequencies**2) + 1e-6 * pattern)) / c.frequencies - 1
        np.testing.assert_allclose(changed, 1e-6 * np.eye(c.size)[k], atol=1e-11)
        assert np.count_nonzero(pattern) == 1


def test_a_root_is_found_where_rounding_beside_large_parts_hides_that_all_are_at_least_one():
    a = np.random.default_rng(0).standard_normal((6, 2)) * 1e12
    covariance = np.eye(6) + a @ a.T
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance)
    L = _root(covariance)
    np.testing.assert_allclose(L @ L.T, covariance, rtol=1e-10, atol=1e-10 * covariance.max())
    np.testing.assert_allclose(np.triu(L, 1), 0.0)
