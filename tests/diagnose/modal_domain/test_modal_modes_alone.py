"""Simulations that are known by their modes alone: at the sensors, as far as they were exported."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from frames import DAMPING, DOFS, FLIP, cantilever, measured

import modalax
from modalax.diagnose.decision.route import Outcome, Task, order, suffices
from modalax.diagnose.modal_domain.diagnosis import ModalDiagnosis
from modalax.diagnose.modal_domain.explain import Explanation
from modalax.diagnose.modal_domain.fit import fit
from modalax.diagnose.modal_domain.modes_alone import modes_alone
from modalax.diagnose.modal_domain.shape_scatter import scatter_told
from modalax.diagnose.modal_domain.stage import identified, setting_of
from modalax.model import ModalModel, poles_from

OUTPUTS, INPUTS = DOFS[::2], (DOFS[4], DOFS[14])
TOP = 2 * np.pi * 330.0


def modes(count: int, turned: complex = 1.0) -> ModalModel:
    """The lowest modes of the cantilever at the measured DoFs, as an engineer exports them."""
    K, M = cantilever()
    w2, phi = scipy.linalg.eigh(K, M)
    phi = (phi * FLIP[:, None]).T[:count] * turned
    poles = poles_from(np.sqrt(w2[:count]) / 2 / np.pi, np.full(count, DAMPING))
    at, into = ([DOFS.index(name) for name in names] for names in (OUTPUTS, INPUTS))
    part = phi[:, into] / (2j * poles.imag)[:, None]
    return ModalModel(poles, phi[:, at], part, outputs=OUTPUTS, inputs=INPUTS)


def receptance(c, s: np.ndarray) -> np.ndarray:
    D = 1 / (c.frequencies**2 + s[:, None] ** 2 + s[:, None] * np.diag(c.damping))
    return np.einsum("fr,or,ir->foi", D, c.outputs, c.inputs)


def test_real_modes_with_a_drive_point_are_coordinates_and_others_are_none():
    known = modes_alone(modes(6))
    assert known is not None
    c, s = known.coordinates(OUTPUTS, INPUTS, TOP), 2j * np.pi * np.linspace(4.0, 330.0, 50)
    H = modes(6).frf(np.abs(s) / 2 / np.pi).H
    np.testing.assert_allclose(receptance(c, s), H, rtol=1e-9, atol=1e-9 * np.abs(H).max())
    elsewhere = modes(6).replace(inputs=("91:+Z", "92:+Z"))
    bent = modes(6).replace(shapes=np.asarray(modes(6).shapes) * np.exp(1j * np.arange(8)))
    assert modes_alone(elsewhere) is None and modes_alone(bent) is None


def test_what_was_not_exported_is_estimated_from_the_measurement():
    data, _ = measured(0, 0.0, noise=1e-3)
    bare = modes_alone(modes(6))
    assert bare is not None
    full, c, found = identified(data, bare, TOP)
    before = bare.coordinates(OUTPUTS, INPUTS, TOP)
    s, H = found.channels.s, found.channels.data.reshape(-1, 8, 2)
    left = [np.linalg.norm(receptance(x, s) * s[:, None, None] ** 2 - H) for x in (before, c)]
    assert left[1] < 0.2 * left[0] and full.exported == 6 < len(full.frequencies)


def test_a_scatter_of_shapes_is_learnt_and_taken_out_before_lines_are_looked_at():
    data, _ = measured(0, 0.0, noise=1e-3)
    bare = modes_alone(modes(6))
    assert bare is not None
    rng = np.random.default_rng(0)
    off = replace(bare, shapes=bare.shapes * (1 + 0.01 * rng.standard_normal(bare.shapes.shape)))
    simulation, c, found = identified(data, off, TOP)
    setting = setting_of(simulation, c, found, 2, TOP)
    assert 3e-3 <= setting.scatter <= 0.03
    null = fit(setting)
    assert null is not None
    told, _ = scatter_told(setting, [Explanation(null, 0.0, 1.0)])
    seen = [np.abs(np.abs(x.outputs[:, 1:5]) - np.abs(bare.coordinates(OUTPUTS, INPUTS, TOP).outputs[:, 1:5])).max()
            for x in (c, told.coordinates)]  # fmt: skip
    assert seen[1] < 0.3 * seen[0] and told.scatter == 0.0
    np.testing.assert_array_equal(told.coordinates.shapes, told.coordinates.outputs)  # all DoFs are measured ones


def test_modes_alone_are_asked_about_by_modes_first_and_no_more_where_they_are_certainly_off():
    task = Task(True, 100.0, 1000, modes_off=True, modes_alone=True)
    assert order(task) == ("modes", "lines")
    off = {"stiffness": {"value": 0.02, "interval": [0.01, 0.03]}, "mass": {"value": 0.0, "interval": [0.0, 0.01]}}
    assert suffices("modes", Outcome("named", 3.0, left=0.0, inaccuracy=off), task)
    assert not suffices("modes", Outcome("named", 3.0, left=0.0, inaccuracy=off), replace(task, modes_alone=False))
    assert not suffices("modes", Outcome("unknown", 3.0, left=0.0, inaccuracy=off), task)


@pytest.mark.slow
def test_a_mass_is_named_beside_modes_that_are_off():
    data, _ = measured(2, 0.02, mass=("6:+Z", 0.15))
    said = modalax.diagnose(data, modes(7))
    assert isinstance(said, ModalDiagnosis)
    answer = said.to_dict()
    assert answer["verdict"] == "named" and answer["causes"][0]["name"] == "added_mass"
    assert answer["causes"][0]["where"] == ["6:+Z"]
    assert any("known by its modes alone" in note for note in answer["notes"])
    predicted = np.asarray(said.extended.frf(said.freq, form="accelerance").H)
    # the mass sits where the shape was told, in the extension where it is corrected
    assert np.linalg.norm(predicted - said.predicted_after[0]) < 0.1 * np.linalg.norm(predicted)
