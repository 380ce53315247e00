"""Attached oscillators, modes too many and hysteretic damping, each against a second route."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from frames import DOFS, measured, simulation

from modalax.diagnose.modal_domain.causes.change import Change, shown
from modalax.diagnose.modal_domain.causes.further_causes import (
    MissingMode,
    StructuralDamping,
    TunedMass,
    hysteretic_poles,
)
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import (
    Setting,
    changes_of,
    evidence_of_free,
    free_directions,
    matrices_of,
    pairs_with,
    state_at,
    unseen,
)
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.on_lines.polish import frf_on_lines, slopes_on_lines
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of, modes_of

HIGHEST = 2 * np.pi * 330
OUTPUTS, INPUTS = DOFS[::2], (DOFS[4], DOFS[14])
NO_FEATURES = Features(
    np.zeros(0), *[np.zeros((0, 8, 2))] * 2, np.zeros((0, 1, 8, 2)), np.zeros((0, 5)), np.zeros((0, 0))
)


@pytest.fixture(scope="module")
def setting():
    c = coordinates_of(simulation(), OUTPUTS, INPUTS, HIGHEST)
    return Setting(c, inaccuracy_of(simulation(), c, HIGHEST), NO_FEATURES, np.zeros((0, 0)))


def still(setting):
    return np.zeros(len(setting.inaccuracy.group_of))


def response(setting, causes, u, s):
    c = setting.coordinates
    M, C, K = matrices_of(setting, still(setting), causes, u)
    Z = K + s[:, None, None] * C + s[:, None, None] ** 2 * M
    return shown(causes, u, s, c.outputs @ np.linalg.solve(Z, np.broadcast_to(c.inputs.T, (len(s), *c.inputs.T.shape))))


def oscillator(c, dof="7:+Z"):
    return TunedMass("tuned_mass", (dof,), 0.03, c.shapes[DOFS.index(dof)], middle=500.0, width=0.8,
                     spare=float(c.frequencies[-1]))  # fmt: skip


def test_an_oscillator_far_out_of_all_bounds_is_still_one(setting):
    cause = oscillator(setting.coordinates)
    assert np.isfinite(cause.values(np.array([1.0, 2000.0, -2000.0]))).all()  # as a search may try


def test_an_oscillator_on_the_spare_coordinate_is_one_on_the_structure(setting):
    cause, u = oscillator(setting.coordinates), np.array([0.9, -0.1, 0.3])
    m, w, zeta = cause.values(u)
    S, s = simulation(), 2j * np.pi * np.array([20.0, 75.0, 81.0, 200.0])
    Z = np.asarray(S.K) + s[:, None, None] * np.asarray(S.C) + s[:, None, None] ** 2 * np.asarray(S.M)
    spring, at = w**2 + 2 * zeta * w * s, DOFS.index("7:+Z")
    Z[:, at, at] += m * s**2 * spring / (s**2 + spring)
    rows, columns = ([DOFS.index(n) for n in names] for names in (OUTPUTS, INPUTS))
    np.testing.assert_allclose(response(setting, (cause,), u, s), np.linalg.inv(Z)[:, rows][..., columns], rtol=1e-6)


def test_nothing_is_seen_of_a_spare_coordinate(setting):
    c = setting.coordinates
    modes, s = modes_of(c), 2j * np.pi * np.array([30.0, 150.0])
    assert len(modes.poles) == len(DOFS) + 1
    assert np.abs(modes.vectors[-1] @ c.outputs.T).max() < 1e-12
    rows, columns = ([DOFS.index(n) for n in names] for names in (OUTPUTS, INPUTS))
    aim = np.asarray(simulation().receptance(s.imag, DOFS, DOFS))[:, rows][..., columns]
    np.testing.assert_allclose(response(setting, (), np.zeros(0), s), aim, rtol=1e-6)


def test_derivatives_of_an_oscillator_match_differences(setting):
    cause, u, step = oscillator(setting.coordinates), np.array([0.9, -0.1, 0.3]), 1e-6
    for k, slopes in enumerate(cause.slopes(u)):
        up, down = (changes_of(setting, still(setting), (cause,), u + sign * step * np.eye(3)[k]) for sign in (1, -1))
        for kind in "KC":
            made = slopes.get(kind, 0.0 * up["dK"])
            difference = (up[f"d{kind}"] - down[f"d{kind}"]) / (2 * step)
            np.testing.assert_allclose(made, difference, atol=1e-6 * np.abs(up[f"d{kind}"]).max())


def test_hysteretic_modes_have_the_residues_that_are_told(setting):
    """A single mode: 1/(k (1 + j eta) - w^2) has the residue 1/(2 pole), a viscous one of the same pole 1/(2j Im)."""
    cause = StructuralDamping("structural_damping", ())
    w0, z, every = 200.0, 0.05, np.ones(1)
    viscous_pole, pole = w0 * np.array([-z + 1j * np.sqrt(1 - z**2)]), np.array([1j * w0 * np.sqrt(1 + 2j * z)])
    np.testing.assert_allclose(hysteretic_poles(viscous_pole, 1.0), pole)
    np.testing.assert_allclose(hysteretic_poles(viscous_pole, 0.0), viscous_pole)
    viscous = np.ones((1, 1, 1)) / (2j * viscous_pole.imag)
    np.testing.assert_allclose(cause.at_modes(every, pole, viscous)[0, 0, 0], 1 / (2 * pole[0]))
    np.testing.assert_allclose(cause.at_modes(0 * every, viscous_pole, viscous), viscous)
    c = setting.coordinates
    for share in (1.0, 0.3):
        M, C, K = matrices_of(setting, still(setting), (cause,), share * every)
        np.testing.assert_allclose(C, (1 - share) * c.damping, atol=1e-12)
        np.testing.assert_allclose(np.diag(K).imag[:5], share * np.diag(c.damping)[:5] * c.frequencies[:5])


def test_a_state_has_the_poles_of_its_hysteretic_modes():
    data, model = measured(2, 0.0)[0], simulation()
    setting = posed(data, model, identified(data, model, lambda _: None)).setting
    cause, u = StructuralDamping("structural_damping", ()), np.array([0.8])
    plain, lossy = (state_at(setting, still(setting), *given).modes.poles for given in ((), ((cause,), u)))
    np.testing.assert_allclose(lossy, hysteretic_poles(plain, 0.8))
    assert np.abs(lossy - plain).max() > 0


def test_a_share_of_hysteretic_damping_turns_a_residue_by_its_share(setting):
    """Of 1/(w0^2 (1 + 2j u z) - w^2 + 2j (1 - u) z w0 w), whose residue is one over the derivative at its pole."""
    cause, share, w0, z = StructuralDamping("structural_damping", ()), 0.37, 200.0, 0.02
    pole = np.roots([1, 2 * (1 - share) * z * w0, w0**2 * (1 + 2j * share * z)])
    pole = pole[pole.imag > 0]
    exact = 1 / (2 * pole[0] + 2 * (1 - share) * z * w0)
    viscous_pole = w0 * np.array([-z + 1j * np.sqrt(1 - z**2)])
    viscous, u = np.ones((1, 1, 1)) / (2j * viscous_pole.imag), np.array([share])
    np.testing.assert_allclose(hysteretic_poles(viscous_pole, share), pole)
    assert cause.at_modes(u, pole, viscous)[0, 0, 0] == pytest.approx(exact)
    up, down = (cause.at_modes(u + step, pole, viscous) for step in (1e-6, -1e-6))
    np.testing.assert_allclose(cause.slope_at_modes(u, pole, viscous), (up - down) / 2e-6, rtol=0.05)
    c, s = setting.coordinates, 2j * np.pi * np.linspace(20, 300, 30)
    other = Change("local_damper", ("7:+Z",), 10.0, c.shapes[DOFS.index("7:+Z")])
    sizes = 0.01 * np.cos(np.arange(len(still(setting))))
    x, n = np.concatenate([sizes, [share, 0.5]]), len(sizes)
    _, J = slopes_on_lines(setting, (cause, other), sizes, x[n:], s, 2)
    for k in (n, n + 1, *range(0, n, 9)):
        moved = np.where(np.arange(len(x)) == k, 1e-6, 0.0)
        up, down = (frf_on_lines(setting, (cause, other), y[:n], y[n:], s, 2) for y in (x + moved, x - moved))
        assert np.abs((up - down) / 2e-6 - J[k]).max() < 1e-4 * np.abs(J[k]).max()


def test_the_evidence_of_a_free_mode_is_its_integral(setting):
    """Two features, one of each of two modes, of which the second is free with a flat density."""
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    whitener, off = np.linalg.inv(np.linalg.cholesky(covariance)), np.array([0.3, -0.2])
    features = Features(
        np.array([1j, 2j]), np.ones((2, 1, 1)), np.ones((2, 1, 1)), np.ones((2, 1, 1, 1)), np.zeros((2, 1)), covariance
    )
    given = replace(setting, features=features, whitener=whitener)
    cause = (MissingMode("missing_mode", (), number=1, log_density=np.log(0.7)),)
    free = free_directions(given, cause)
    d = given.triangle @ off
    left = d - free @ (free.T @ d)
    value = np.exp(-0.5 * left @ left + evidence_of_free(given, cause))
    likelihood = lambda v: 0.7 * np.exp(-0.5 * np.sum((whitener @ (off + [0.0, v])) ** 2))
    assert value == pytest.approx(scipy.integrate.quad(likelihood, -5, 5)[0], rel=1e-6)


def test_a_free_mode_takes_no_other_mode_away():
    shapes = np.eye(3)[:, :, None] + 0j
    seen = Features(
        np.array([1.0j, 1.02j, 2.0j]),
        shapes[[0, 2, 1]],
        np.ones((3, 3, 1)),
        shapes[:, None],
        np.zeros((3, 5)),
        np.eye(15),
    )
    cause = (MissingMode("missing_mode", (), number=1),)
    pairs = pairs_with(seen, cause, np.array([1.01j, 2.0j]), shapes[:2])
    np.testing.assert_array_equal(pairs, [0, 0, 1])
    assert unseen(seen, cause, np.array([1.01j, 2.0j]), shapes[:2], pairs) == 0


def test_a_mode_in_place_of_another_is_no_mode_too_many():
    """A predicted mode among the measured ones, of residue 3 over an uncertainty of 1 in one of two channels."""
    units = np.ones((2, 2, 1))
    seen = Features(np.array([1.0j, 2.0j]), units + 0j, units, units[:, None] + 0j, np.zeros((2, 4)), np.eye(8))
    poles, residues = np.array([1.0j, 1.5j, 2.0j, 2.5j]), np.array([1.0, 3.0, 1.0, 7.0])[:, None, None] * [[1], [0]]
    free = (MissingMode("missing_mode", (), number=0),)
    assert unseen(seen, free, poles, residues, np.array([0, 2])) == 9
    assert unseen(seen, (), poles, residues, np.array([0, 2])) == 0


@pytest.mark.slow  # by default where a mass stands out beyond the general inaccuracy
def test_a_mass_is_as_certain_as_told():
    """Elements of the simulation are off, and not only as whole elements: noise alone would be told far too small."""
    data, _ = measured(24, 0.02, mass=("5:+Z", 0.05), lines=120)
    mass = diagnose_modes(data, simulation()).causes[0]["parameters"]["mass"]
    assert abs(mass["value"] - 0.05) < 3 * mass["std"] < 0.003


def test_sizes_of_several_causes_stand_in_one_row(setting):
    cause = oscillator(setting.coordinates)
    spring = Change("joint_stiffness", (DOFS[0],), 100.0, setting.coordinates.shapes[0])
    u = np.array([2.0, 0.9, -0.1, 0.3])
    both = changes_of(setting, still(setting), (spring, cause), u)
    np.testing.assert_allclose(both["dK"], spring.changes(u[:1])["K"] + cause.changes(u[1:])["K"])
    assert replace(spring, where=(DOFS[2],)) != spring
