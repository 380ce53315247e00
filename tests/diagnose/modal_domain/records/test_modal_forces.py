"""Forces at one place that depend on frequency: in the modes and on the lines of a chain whose every element is off."""

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.line_forces import LineForce
from modalax.diagnose.modal_domain.causes.places import springs_of
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.on_lines.lines import lines_of
from modalax.diagnose.modal_domain.on_lines.polish import frf_on_lines, slopes_on_lines
from modalax.diagnose.modal_domain.records.forced import screened
from modalax.diagnose.modal_domain.search.force_places import KINDS, line_forces
from modalax.diagnose.modal_domain.stage import run_stage
from modalax.diagnose.modal_domain.structure.nodes import nodes_of

B = np.array([0, 1.0, -1.0, 0, 0])
SKEW = np.zeros((5, 5))
SKEW[1, 2], SKEW[2, 1] = 1.0, -1.0
S = 2j * np.pi * FREQ
STIFF = {
    "gyroscopic": (["2:+Z", "3:+Z"], S[:, None, None] * 20.0 * SKEW),
    "hysteretic_joint": (["2:+Z", "3:+Z"], 1j * 1.5e4 * np.outer(B, B)),
    "maxwell_joint": (["2:+Z", "3:+Z"], (3e4 * 3e-3 * S / (1 + 3e-3 * S))[:, None, None] * np.outer(B, B)),
}
SIZES = {
    "gyroscopic": {"coupling": 20.0},
    "hysteretic_joint": {"loss_stiffness": 1.5e4},
    "maxwell_joint": {"relaxing_stiffness": 3e4, "relaxation_time": 3e-3},
}


@pytest.fixture(scope="module")
def stage():
    return run_stage(
        as_measured(response(*chain_off(7, 0.02), FREQ[::3]), FREQ[::3], 7), simulation(), Deadline(), lambda _: False,
        lambda _: None,
    )  # fmt: skip


def force(c, slug: str) -> LineForce:
    pair = c.shapes[[1, 2]].T
    basis = {"gyroscopic": pair, "sensor_mass": c.outputs[2][:, None]}.get(slug, pair[:, :1] - pair[:, 1:])
    scale = {"gyroscopic": 40.0, "sensor_mass": 0.1}.get(slug, 3e4)
    return KINDS[slug](slug, DOFS[1:3], scale, basis=basis, middle=250.0, row=2 if slug == "sensor_mass" else None)


@pytest.mark.parametrize("slug", ["gyroscopic", "hysteretic_joint", "maxwell_joint", "sensor_mass"])
def test_a_force_acts_as_in_the_matrices_and_its_slopes_are_those_of_finite_differences(stage, slug):
    c, s = stage.coordinates, 2j * np.pi * FREQ[::20]
    f, sizes = force(c, slug), np.zeros(len(stage.setting.inaccuracy.group_of))
    u = np.array([0.7, 0.2])[: f.count]
    frf = lambda sizes, u: frf_on_lines(stage.setting, (f,), sizes, u, s, 2)
    Z = np.diag(c.frequencies**2) + s[:, None, None] * c.damping + s[:, None, None] ** 2 * np.eye(c.size)
    plain, with_it = (c.outputs @ np.linalg.inv(A) @ c.inputs.T * s[:, None, None] ** 2 for A in (
        Z, Z + f.basis @ f.stiffness(u, s) @ f.basis.T))  # fmt: skip
    if f.row is not None:
        plain[:, f.row] = with_it[:, f.row]
    expected = plain if f.row is not None else with_it
    assert np.abs(frf(sizes, u) - expected).max() < 1e-9 * np.abs(expected).max()
    H, J = slopes_on_lines(stage.setting, (f,), sizes, u, s, 2)
    assert np.abs(H - expected).max() < 1e-9 * np.abs(expected).max()
    x, n, step = np.concatenate([sizes, u]), len(sizes), 1e-6
    for k in (0, n // 2, *range(n, len(x))):
        moved = np.where(np.arange(len(x)) == k, step, 0.0)
        change = frf((x + moved)[:n], (x + moved)[n:]) - frf((x - moved)[:n], (x - moved)[n:])
        assert np.abs(change / (2 * step) - J[k]).max() <= 1e-4 * np.abs(J[k]).max()


def test_its_place_leads_though_the_inaccuracy_imitates_a_part_of_it():
    lines = FREQ[::3]
    data = as_measured(response(*chain_off(8, 0.02), lines, STIFF["hysteretic_joint"][1]), lines, 8)
    stage = run_stage(data, simulation(), Deadline(), lambda _: False, lambda _: None)
    c, f = stage.coordinates, stage.explanations[0].fit
    springs = springs_of(simulation(), c, nodes_of(DOFS), None, 700.0)
    every = line_forces(c, DOFS, data.outputs, data.inputs, springs, 75.0, 690.0)
    forces = [force for force in every if force.count == 1]
    gain, size = screened(stage.setting, f, forces, lines_of(stage.measured.channels, stage.setting))
    best = int(np.argmax(gain))
    assert (forces[best].slug, list(forces[best].where)) == ("hysteretic_joint", STIFF["hysteretic_joint"][0])
    assert forces[best].scale * size[best] == pytest.approx(1.5e4, rel=0.3)


@pytest.mark.parametrize("slug", ["gyroscopic", *(pytest.param(s, marks=pytest.mark.slow) for s in list(STIFF)[1:])])
def test_it_is_named_with_its_place_and_size(slug):
    where, Z = STIFF[slug]
    lines = FREQ[::2]
    data = as_measured(response(*chain_off(8, 0.02), lines, Z[::2] if Z.ndim == 3 else Z), lines, 8)
    found = diagnose_modes(data, simulation())
    answer = found.to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [(slug, where)]
    for name, true in SIZES[slug].items():
        told = answer["causes"][0]["parameters"][name]
        assert told["value"] == pytest.approx(true, abs=4 * told["std"]) and told["std"] < 0.1 * true
    again = found.extended.frf(found.freq, form="accelerance", outputs=data.outputs, inputs=data.inputs)
    assert np.abs(again.H - found.predicted_after[0]).max() < 0.02 * np.abs(found.predicted_after).max()


def test_a_coupling_that_acts_on_one_end_alone_is_not_skew():
    """A force on the third mass by the velocity of the second, and none back."""
    lines, one_way = FREQ[::2], np.zeros((5, 5))
    one_way[2, 1] = 20.0
    Z = 2j * np.pi * lines[:, None, None] * one_way
    answer = diagnose_modes(as_measured(response(*chain_off(8, 0.02), lines, Z), lines, 8), simulation()).to_dict()
    assert answer["verdict"] == "unknown", answer["causes"]
    assert any("acts on one end more than on the other" in r for r in answer["reasons"]), answer["reasons"]


def test_a_weak_joint_that_loses_energy_is_no_damper():
    lines = FREQ[::2]
    data = as_measured(response(*chain_off(8, 0.02), lines, 4e3j * np.outer(B, B)), lines, 8)
    found = diagnose_modes(data, simulation())
    assert found.verdict == "named"
    assert [(c["name"], c["where"]) for c in found.causes] == [("hysteretic_joint", ["2:+Z", "3:+Z"])]
    told = found.causes[0]["parameters"]["loss_stiffness"]
    assert told["value"] == pytest.approx(4e3, abs=4 * told["std"])


def test_nothing_is_looked_for_where_the_modes_leave_only_noise(monkeypatch):
    monkeypatch.setattr("modalax.diagnose.modal_domain.diagnosis.force_beside", lambda *_: pytest.fail("looked for"))
    data = as_measured(response(*chain_off(9, 0.02), FREQ[::3]), FREQ[::3], 9)
    assert diagnose_modes(data, simulation()).verdict == "clean"
