"""Simulations of which modes alone are known, wrong in every element as most are."""

import numpy as np
import pytest
import scipy.linalg
from chains_off import DOFS as CHAIN
from chains_off import MASSES, SPRINGS, as_measured, response
from chains_off import simulation as chain
from frames import DOFS, FLIP, cantilever, measured, simulation
from kinds import few_or_all

import modalax
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.between_modes import between_modes
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.on_lines.further_modes import residual_terms
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of, modes_of
from modalax.diagnose.modal_domain.structure.modes_only import flexibility_above, modes_only
from modalax.model import ModalModel, Structure

MODES = 8  # of the beam's sixteen, five of them in the band


def beam_modes(count=MODES, dofs=DOFS, **claims):
    """The lowest modes of the beam as its author has it, at some of its degrees of freedom."""
    s = simulation()
    values, phi = scipy.linalg.eigh(np.asarray(s.K), np.asarray(s.M))
    rows = [DOFS.index(name) for name in dofs]
    w = np.sqrt(values[:count])
    made = ModalModel.from_real_modes(w / 2 / np.pi, np.full(count, 0.01), phi[rows, :count].T, np.ones(count), dofs)
    return made.replace(**claims)


def test_a_modal_model_of_a_structure_is_its_real_modes_of_unit_modal_mass():
    s = chain()
    found = modes_only(s.modal())
    values, phi = scipy.linalg.eigh(np.asarray(s.K), np.asarray(s.M))
    np.testing.assert_allclose(found.frequencies, np.sqrt(values), rtol=1e-10)
    np.testing.assert_allclose(found.damping, np.diag(phi.T @ np.asarray(s.C) @ phi), rtol=1e-8)
    np.testing.assert_allclose(np.abs(found.shapes), np.abs(phi), rtol=1e-8, atol=1e-10)


def test_rigid_bodies_and_further_modes_that_residual_terms_tell_are_modes_too():
    """Of a free chain, and of one whose upper modes are given as their flexibility."""
    K, M = np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * 1e5, np.diag([1.0, 2.0, 1.5])
    free = Structure(M, 1e-5 * K, K, ("1:+X", "2:+X", "3:+X"))
    found = modes_only(free.modal())
    assert found.frequencies[0] == 0.0 and not free.modal().fitted
    noise = np.random.default_rng(0).standard_normal((3, 3)) * 1e-9
    assert free.modal().replace(upper=noise).fitted
    assert free.modal().replace(upper=1e-9j * np.eye(3)).fitted
    np.testing.assert_allclose(np.abs(found.shapes[:, 0]), 1 / np.sqrt(4.5), rtol=1e-8)
    s = chain()
    values, phi = scipy.linalg.eigh(np.asarray(s.K), np.asarray(s.M))
    upper = (phi[:, 3:] / values[3:]) @ phi[:, 3:].T
    w = np.sqrt(values[:3])
    cut = ModalModel.from_real_modes(w / 2 / np.pi, np.full(3, 0.01), phi[:, :3].T, np.ones(3), s.dofs)
    found = modes_only(cut.replace(upper=upper))
    static = (found.shapes / found.frequencies**2) @ found.shapes.T
    np.testing.assert_allclose(static, np.linalg.inv(np.asarray(s.K)), rtol=1e-8)


def test_complex_modes_and_modes_without_a_drive_point_are_none():
    K, M = np.diag([2e4, 5e4]) + 1e4, np.eye(2)
    C = np.array([[90.0, 0.0], [0.0, 1.0]])
    assert modes_only(Structure(M, C, K, ("1:+X", "2:+X")).modal()) is None
    half = chain().modal()
    assert modes_only(half.replace(inputs=tuple(f"9{k}:+X" for k in range(5)))) is None


@pytest.mark.parametrize("count", [6, 10])
def test_modes_above_the_last_are_as_flexible_as_those_of_a_beam(count):
    r"""Simply supported: :math:`\phi_s=\sqrt2\sin s\pi x` and :math:`\omega_s=(s\pi)^2`, summed far enough."""
    x, every = np.linspace(0.05, 0.95, 19), np.arange(1, 2000)
    phi, w = np.sqrt(2) * np.sin(np.outer(x, every) * np.pi), (every * np.pi) ** 2
    exact = (phi[:, count:] ** 2 / w[count:] ** 2).sum(axis=1)
    told = flexibility_above(w[:count].astype(float), phi[:, :count])
    assert 0.6 < np.median(told / exact) < 1.3


def test_couplings_have_the_variances_of_elements_that_are_each_off():
    """Own changes of a beam's modes over couplings, and what the coordinate of a DoF adds to a shape there."""
    rng = np.random.default_rng(0)
    K0, M0 = cantilever()
    values, phi = scipy.linalg.eigh(K0, M0)
    dK = [phi.T @ (cantilever(1 + 0.02 * rng.standard_normal(8))[0] - K0) @ phi for _ in range(400)]
    own = np.std([np.diag(d)[1:5] / values[1:5] for d in dK])
    pairs = np.triu_indices(4, 1)
    scale = np.sqrt(np.outer(values[1:5], values[1:5]))[pairs]
    between = np.std([d[1:5, 1:5][pairs] / scale for d in dK])
    assert 1.0 < (own / between) ** 2 < 2.5
    c = coordinates_of(modes_only(beam_modes()), ("8:+Z", "3:+Z"), ("8:+Z",), 2 * np.pi * 230)
    assert c.local == 2 and c.spares == 2
    K, M = between_modes(c, 2 * np.pi * 230)
    d = np.einsum("prr->r", K**2)
    np.testing.assert_allclose(d[:5] / c.frequencies[:5] ** 4, 1.5)
    assert not M[:, -4:].any()  # nor of those that stand for further modes, by mass
    coupled = next(p for p in K if p[1, -4] != 0)
    a = 1e-4
    moved = modes_of(c, dK=a * coupled).vectors[1] @ c.outputs.T
    plain = modes_of(c).vectors[1] @ c.outputs.T
    flexible = flexibility_above(c.frequencies[:MODES], c.shapes[[DOFS.index("3:+Z")], :MODES])[0]
    turned = np.abs(moved / moved[0] * plain[0] - plain)[1] * np.sqrt(2 * c.frequencies[1])
    np.testing.assert_allclose(turned, a * c.frequencies[1] * np.sqrt(flexible), rtol=0.01)


def of_single_dofs(c):
    """The flexibility that coordinates of single measured DoFs have, which is a part of what further modes add."""
    rows = slice(c.size - c.spares - c.local, c.size - c.spares)
    return (c.outputs[:, rows] / c.frequencies[rows] ** 2) @ c.inputs[:, rows].T


def test_what_further_modes_add_to_each_frf_is_read_off_the_measurement():
    """The static flexibility of the beam's modes above the eighth, beside modes next to the band that are off."""
    m, _ = measured(3, 0.01, noise=0.001)
    sim = modes_only(beam_modes())
    found = identified(m, sim, lambda _: None)
    setting = posed(m, sim, found).setting
    K, M = cantilever()
    values, phi = scipy.linalg.eigh(K, M)
    phi = FLIP[:, None] * phi
    o, i = ([DOFS.index(name) for name in names] for names in (m.outputs, m.inputs))
    exact = (phi[o, MODES:] / values[MODES:]) @ phi[i, MODES:].T
    told = residual_terms(setting, fit(setting), found) + of_single_dofs(setting.coordinates)
    assert np.linalg.norm(told - exact) < 0.25 * np.linalg.norm(exact)


@few_or_all("added_mass")
def test_a_mass_is_named_beside_elements_that_are_off(wanted):
    m, _ = measured(5, 0.02, mass=("5:+Z", 0.12))
    found = diagnose_modes(m, modes_only(beam_modes(6)), wanted=wanted)
    (cause,) = found.to_dict()["causes"]
    assert found.verdict == "named" and (cause["name"], cause["where"]) == ("added_mass", ["5:+Z"])
    told = cause["parameters"]["mass"]
    assert abs(told["value"] - 0.12) < 3 * told["std"] < 0.06
    assert isinstance(found.extended.base, ModalModel) and any("given as modes" in note for note in found.notes)
    again = np.asarray(found.extended.frf(m.freq, form=m.form, outputs=m.outputs, inputs=m.inputs).H)
    told = found.predicted_after[0]  # without what further modes add it would be 0.11
    assert (np.abs(again - told) / np.abs(told)).mean() < 0.07
    assert not found.extended.base.fitted  # but one of a structure: given back, it is a simulation and no fit


def test_no_cause_is_named_where_elements_are_off_and_nothing_else_is():
    m, _ = measured(6, 0.02)
    said = modalax.diagnose(m, beam_modes()).to_dict()
    assert said["verdict"] == "clean" and 0 < said["inaccuracy"]["stiffness"]["value"] < 0.05


def test_two_sensors_exchanged_are_named_whatever_had_stood_for_them():
    m, _ = measured(7, 0.02)
    swapped = m.replace(H=np.asarray(m.H)[:, :, [1, 0, *range(2, len(m.outputs))]])
    found = diagnose_modes(swapped, modes_only(beam_modes()), wanted={"channel_swap", "added_mass"}.__contains__)
    (cause,) = found.to_dict()["causes"]
    assert found.verdict == "named" and cause["name"] == "channel_swap"
    assert set(cause["where"]) == set(m.outputs[:2])


def test_what_rigid_bodies_add_is_none_of_further_modes():
    """A free chain of which all modes are known; its rigid body alone adds more than fifty times as much."""
    B = np.diff(np.eye(5), axis=0)
    K, M = B.T @ np.diag(SPRINGS[1:5]) @ B, np.diag(MASSES)
    freq = np.linspace(20.0, 110.0, 400)
    m = as_measured(response(M, 2e-5 * K, K, freq), freq, 0, noise=0.001)
    sim = modes_only(Structure(M, 2e-5 * K, K, CHAIN).modal())
    found = identified(m, sim, lambda _: None)
    setting = posed(m, sim, found).setting
    told = residual_terms(setting, fit(setting), found) + of_single_dofs(setting.coordinates)
    assert np.abs(told).max() < 0.02 / (MASSES.sum() * (2 * np.pi * freq[0]) ** 2)
