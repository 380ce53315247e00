"""Joints with the higher harmonics of their motion: predictions beside harmonic balance, values beside the truth."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.causes.joints import (
    BilinearStiffness,
    CoulombFriction,
    CubicStiffness,
    ElastoSlip,
    GapContact,
)
from modalax.diagnose.causes.power_laws import IwanJoint
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison, make_comparison, noise_beside, with_noise_beside
from modalax.diagnose.extend import ExtendedSimulation, extend
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.balanced_force import balanced, harmonics_of
from modalax.diagnose.prediction.harmonic_rows import factor_rows, linear_factor
from modalax.diagnose.prediction.harmonics import HIGHEST
from modalax.diagnose.search import harmonics as search
from modalax.diagnose.search.harmonics import fitted_in_full, is_limit, joints_in_full, limit_of
from modalax.diagnose.search.joints_by_force import joints_by_force
from modalax.files import load
from modalax.model.examples import five_dof
from modalax.simulate import joints
from modalax.simulate.harmonic import simulate

FREQ = np.arange(20.0, 70.0, 1.0)  # of all tests, which share their programs
PLACE = ("3", "5")
LEVELS = np.array([1.0, 3.0, 6.0])


def test_of(joint, seed=0, noise=0.02, freq=FREQ, **orders):
    """A virtual test of the five-DoF system with a joint more, noise of ``noise`` times each channel's rms."""
    clean = simulate(five_dof(), [joint], [PLACE], freq, LEVELS, inputs=["1"], **orders)
    keys = jax.random.split(jax.random.key(seed), clean.runs)
    return Measurement.from_frfs([clean.run(r).add_noise(k, noise) for r, k in zip(range(3), keys, strict=True)])


test_of.__test__ = False


def without_joint():
    frf = five_dof().frf(FREQ, inputs=["1"])
    return Measurement.from_frfs([frf.replace(level=jnp.asarray(level)) for level in LEVELS])


def hypothesis(comparison: Comparison, cause, p) -> tuple[Hypothesis, Hypothesis]:
    """The simulation alone, and with a joint at its place, the latter not fitted."""
    structure = five_dof()
    nothing = np.zeros((2, comparison.problem.modal_form.stiffness.shape[0]))
    null = comparison.fit([Hypothesis(theta=nothing)], 1)[0]
    place = Place(PLACE, (*(structure.index(n) for n in PLACE), 0))
    return null, replace(null.with_cause(cause, place, None, np.asarray(p, float)), theta=nothing)


@pytest.mark.parametrize(
    ("cause", "p", "joint", "times"),
    [
        (ElastoSlip(True), [3000.0, 5e-4], joints.ElastoSlip(3000.0, 1.5, -3000.0), {}),
        # at 128 times of a cycle the corner of its force is off by as much as what is asked for
        pytest.param(
            BilinearStiffness(), [3000.0, 0.6], joints.BilinearSpring(4800.0, 1200.0), {"samples": 512},
            marks=pytest.mark.slow,
        ),
    ],
    ids=["slip", "bilinear"],
)  # fmt: skip
def test_prediction_with_harmonics_is_the_harmonic_balance(cause, p, joint, times):
    exact = simulate(five_dof(), [joint], [PLACE], FREQ, LEVELS, inputs=["1"], harmonics=HIGHEST, **times)
    comparison = make_comparison(exact, five_dof(), "fixed")
    null, h = hypothesis(comparison, cause, p)
    theta = jnp.zeros(h.theta.shape)
    extra = linear_factor(h.causes, h.index, (None,), h.params, theta, comparison.problem)
    effect = np.abs(exact.H - comparison.prediction(null)).max()
    one = np.abs(exact.H - comparison.prediction(h)).max()
    full = np.abs(exact.H - comparison.prediction(replace(h, extras=(extra,)))).max()
    assert full < 1e-4 * effect
    assert one > 10 * full


def test_a_stop_that_is_hardly_touched_has_a_force_of_its_own_and_ordinary_slopes():
    """A little wider, the stop is not touched at all, and nothing is a multiple of no force; slopes by differences."""
    p, omega, level = np.array([8000.0, 3e-4]), np.full(2, 300.0), np.full(2, 2.0)
    free = p[1] * np.array([1.0002, 1.5])  # nearly touched, and well beyond
    orders = harmonics_of(GapContact(), p)
    G = np.tile(1e-6 * (1 + 0.3j) / np.array(orders), (2, 1))
    start = np.where(np.array(orders) == 1, free[:, None] + 0j, 0.0)

    def force(p):
        return balanced(GapContact(), p, G, free, omega, start)[0]

    found, slopes, sound, _ = balanced(GapContact(), p, G, free, omega, start)
    made = factor_rows(GapContact(), p, found, slopes[:2], sound, G[:, 0], free, omega, level)
    nearly = made[0] + p @ made[1:3]
    assert made[3].tolist() == [1, 0]
    np.testing.assert_allclose(nearly[0], found[0] / level[0], rtol=1e-9)
    assert 0.5 < abs(nearly[1]) < 2  # a factor
    for k, step in enumerate(np.diag(1e-7 * p)):
        by_differences = (force(p + step) - force(p - step))[0] / (2 * step[k]) / level[0]
        np.testing.assert_allclose(made[1 + k, 0], by_differences, rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "p"), [(ElastoSlip(False), [3000.0, 5e-4]), (CoulombFriction(), [2.0])], ids=["slip", "friction"]
)
def test_the_extended_simulation_predicts_a_joint_as_it_was_fitted(cause, p, tmp_path):
    data = without_joint()
    comparison = make_comparison(data, five_dof(), "fixed")
    _, h = hypothesis(comparison, cause, p)
    theta = jnp.zeros(h.theta.shape)
    extra = np.asarray(linear_factor(h.causes, h.index, (None,), h.params, theta, comparison.problem))
    full = replace(h, extras=(extra,), theta=np.zeros(h.theta.shape))
    extended = extend(comparison, full)
    extended.save(tmp_path / "extended.npz")
    found = load(tmp_path / "extended.npz")
    expected = comparison.prediction(full)
    one = np.abs(comparison.prediction(h) - expected).max()
    for run, level in enumerate(LEVELS):
        again = np.asarray(found.predict(level, FREQ).H)
        assert np.abs(again - expected[run]).max() < 1e-6 * np.abs(expected).max() < 1e-2 * one
    by_itself = make_comparison(data, found, "fixed")
    held = by_itself.prediction(Hypothesis(theta=np.zeros(h.theta.shape)))
    np.testing.assert_allclose(held, expected, atol=1e-6 * np.abs(expected).max())


def test_friction_is_predicted_at_the_instants_at_which_it_is_fitted():
    """The extended simulation holds the motion of the fit, which a few harmonics miss, and follows the slip force."""
    freq, level = FREQ[::5], LEVELS[1]
    frf = five_dof().frf(freq, inputs=["1"]).replace(level=jnp.asarray(level))
    comparison = make_comparison(Measurement.from_frfs([frf]), five_dof(), "fixed")
    _, h = hypothesis(comparison, CoulombFriction(), [2.0])
    extra = linear_factor(h.causes, h.index, (None,), h.params, jnp.zeros(h.theta.shape), comparison.problem)
    full = replace(h, extras=(np.asarray(extra),))
    expected, extended = comparison.prediction(full)[0], extend(comparison, full)
    assert np.abs(np.asarray(extended.predict(level, freq).H) - expected).max() < 1e-9 * np.abs(expected).max()

    def size(p):
        H = eqx.tree_at(lambda e: e.params, extended, (p,)).predict(level, freq).H
        return jnp.sum(jnp.abs(H) ** 2)

    p, step = jnp.array([2.0]), 1e-2
    value, slope = jax.value_and_grad(size)(p)
    assert float(value) == pytest.approx(float(np.sum(np.abs(expected) ** 2)), rel=1e-9)
    assert float(slope[0]) == pytest.approx(float(size(p + step) - size(p - step)) / (2 * step), rel=2e-2)


@pytest.mark.slow
def test_predictions_with_harmonics_follow_the_parameters():
    """Derivatives by the implicit function theorem beside differences."""
    comparison = make_comparison(without_joint(), five_dof(), "fixed")
    _, h = hypothesis(comparison, ElastoSlip(False), [3000.0, 5e-4])
    extended = replace(extend(comparison, h), harmonics=(5,))
    freq = FREQ[::5]

    def size(p):
        H = eqx.tree_at(lambda e: e.params, extended, (p,)).predict(3.0, freq).H
        return jnp.sum(jnp.abs(H) ** 2)

    p = jnp.array([3000.0, 5e-4])
    slope = jax.grad(size)(p)
    for k, step in enumerate((1.0, 1e-7)):
        move = step * np.eye(2)[k]
        assert slope[k] == pytest.approx(float(size(p + move) - size(p - move)) / (2 * step), rel=1e-3)


def test_rigid_friction_sticks_where_its_force_suffices(tmp_path):
    """The displacement across the joint is none as long as the force that this takes is below that of friction."""
    force, level, structure = 2.0, 3.0, five_dof()
    ExtendedSimulation(
        structure, (jnp.array([force]),), (jnp.array([0.0]),), jnp.zeros((2, 5)), (None,), (CoulombFriction(),),
        (Place(PLACE, (2, 4, 0)),), structure.dofs, ("1",), float(FREQ[0]), (5,),
    ).save(tmp_path / "extended.npz")  # fmt: skip
    found = np.asarray(load(tmp_path / "extended.npz").predict(level, FREQ).H)[..., 0]
    full = np.asarray(structure.frf(FREQ, inputs=["1", *PLACE]).H)
    free, joint = full[..., 0], full[..., 1] - full[..., 2]
    drive, motion = joint[:, 2] - joint[:, 4], free[:, 2] - free[:, 4]
    stuck = free - joint * (motion / drive)[:, None]
    sticks = level * np.abs(motion / drive) < force
    assert 10 < sticks.sum() < 40
    np.testing.assert_allclose(found[sticks], stuck[sticks], atol=1e-6 * np.abs(stuck).max())
    slips = level * np.abs(motion / drive) > 1.5 * force
    assert np.abs(found[slips] - stuck[slips]).max(axis=1).min() > 1e-3 * np.abs(stuck[slips]).max(axis=1).min()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])  # another draw of the noise
def test_a_slipping_joint_is_found_within_its_error_bars(seed):
    structure = five_dof()
    k = float(-structure.K[2, 4])
    data = test_of(joints.ElastoSlip(k, 4.0, -k), seed, harmonics=HIGHEST)
    comparison = with_noise_beside(make_comparison(data, structure, "fixed"))
    null, h = hypothesis(comparison, ElastoSlip(True), [k, 4.0 / k])
    full = fitted_in_full(comparison, null, h)
    std = np.sqrt(np.diag(full.covariance))
    pull = (np.array([full.params[0][0], np.log(full.params[0][1])]) - [k, np.log(4.0 / k)]) / std
    assert full.fidelity < 1e-3
    assert std[1] < 3e-3
    assert np.abs(pull).max() < 3


@pytest.mark.slow  # by default of a strong one, from an asymmetry that one harmonic left anywhere
def test_harmonics_tell_a_bilinear_spring_from_a_spring():
    data = test_of(joints.BilinearSpring(5000.0, 1000.0), noise=0.002, harmonics=HIGHEST)
    comparison = with_noise_beside(make_comparison(data, five_dof(), "fixed"))
    null, h = hypothesis(comparison, BilinearStiffness(), [3000.0, 0.3])
    one = comparison.fit([h], 30)[0]
    (full,) = joints_in_full(comparison, null, [one])
    assert full.chi2 < one.chi2 - 25
    assert full.freedom == one.freedom + 1
    value, std = full.params[0], np.sqrt(np.diag(full.covariance))
    assert abs(value[0] - 3000.0) < 3 * std[0]
    assert abs(value[1] - 2 / 3) < 3 * std[1]


@pytest.fixture(scope="module")
def strong_bilinear():
    data = test_of(joints.BilinearSpring(30000.0, 500.0), noise=0.002, harmonics=HIGHEST)
    return with_noise_beside(make_comparison(data, five_dof(), "fixed"))


def test_a_strong_bilinear_spring_is_found_from_an_asymmetry_that_one_harmonic_left_anywhere(strong_bilinear):
    comparison = strong_bilinear
    null, h = hypothesis(comparison, BilinearStiffness(), [15000.0, 0.3])
    one = comparison.fit([h], 30)[0]
    assert one.chi2 > 10 * comparison.problem.samples
    full = fitted_in_full(comparison, null, replace(one, params=(np.array([one.params[0][0], 3.0]),)))
    assert full.chi2 < 1.1 * comparison.problem.samples
    value, std = full.params[0], np.sqrt(np.diag(full.covariance))
    assert abs(value[0] - 15250.0) < 3 * std[0]
    assert abs(value[1] - 14750 / 15250) < 3 * std[1]


def test_laws_are_fitted_in_full_where_a_force_explains_what_nothing_else_does(strong_bilinear):
    """A strong bilinear spring is no spring by its FRFs, and one harmonic of it is."""
    comparison = strong_bilinear
    null, h = hypothesis(comparison, BilinearStiffness(), [3000.0, 0.3])
    causes = [BilinearStiffness()]
    (best,) = joints_by_force(comparison, null, causes, null)
    assert best.parts == h.parts
    assert best.fidelity is not None
    assert best.chi2 < 1.1 * comparison.problem.samples
    assert joints_by_force(comparison, null, causes, best) == []


def test_the_sides_of_a_bilinear_spring_are_told_by_their_stiffness():
    """Mirrored, the law has the same FRFs: a spring stiffer in push answers half a cycle later like one in pull."""
    one, other = (
        simulate(five_dof(), [joints.BilinearSpring(*k)], [PLACE], FREQ, LEVELS, inputs=["1"], harmonics=HIGHEST)
        for k in ((5000.0, 1000.0), (1000.0, 5000.0))
    )
    np.testing.assert_allclose(one.H, other.H, rtol=1e-7)
    place = Place(PLACE, (2, 4, 0))
    told = BilinearStiffness().report(np.array([-3000.0, 2 / 3]), place)
    assert told["stiffness_stiffer_side"][0] == pytest.approx(-1000.0)
    assert told["stiffness_softer_side"][0] == pytest.approx(-5000.0)


def test_a_slipping_spring_of_any_stiffness_is_dry_friction():
    """Unless the data know the stiffness, or friction fits worse than the harmonics left out of it explain."""
    place, null = Place(PLACE, (2, 4, 0)), Hypothesis(chi2=10000.0)
    friction = Hypothesis(
        (CoulombFriction(),), (place,), (None,), (np.array([2.0]),), chi2=1100.0, freedom=1.0, fidelity=0.1
    )
    slip = Hypothesis(
        (ElastoSlip(False),), (place,), (None,), (np.array([1e6, 2e-6]),), chi2=1030.0, freedom=2.0,
        covariance=np.diag([4e12, 1.0]),
    )  # fmt: skip
    assert is_limit(slip, friction, null)
    assert not is_limit(friction, slip, null)
    assert not is_limit(replace(slip, covariance=np.diag([4e10, 1.0])), friction, null)
    assert not is_limit(slip, replace(friction, fidelity=0.01), null)


def test_a_spring_that_slips_is_fitted_as_friction_too_where_no_data_bound_its_stiffness(monkeypatch):
    fitted = []

    def in_full(comparison, null, h):
        fitted.append(h.causes[0].slug)
        return replace(h, fidelity=0.1, covariance=np.diag([25e12, 1.0])[: len(h.params[0]), : len(h.params[0])])

    monkeypatch.setattr(search, "fitted_in_full", in_full)
    comparison = make_comparison(without_joint(), five_dof(), "fixed")
    null, h = hypothesis(comparison, ElastoSlip(False), [1e7, 2e-7])
    h = replace(h, chi2=float(comparison.problem.samples), covariance=np.diag([1e8, 1.0]), freedom=2.0)
    null = replace(null, chi2=1e6)
    slip, friction = joints_in_full(comparison, null, [h])
    assert fitted == ["elasto_slip", "coulomb_friction"]
    assert friction.freedom == 1.0
    assert limit_of(replace(slip, covariance=np.diag([1e8, 1.0]))) is None
    assert limit_of(replace(slip, causes=(ElastoSlip(True),))) is None
    assert joints_in_full(comparison, null, [slip, friction]) == []  # once is enough
    iwan = replace(slip, causes=(IwanJoint(),), params=(np.array([1e7, 2e-7, 0.7]),))
    simpler = limit_of(replace(iwan, covariance=np.diag([25e12, 1.0, 1.0])))
    assert simpler.causes[0].slug == "coulomb_friction"
    assert simpler.params[0][0] == pytest.approx(IwanJoint().report(iwan.params[0], iwan.places[0])["slip_force"][0])


def test_noise_is_read_off_the_lines_beside_the_joint():
    """Beside the simulation alone, what it misses about the peaks passes for noise."""
    noise = 0.002
    data = test_of(joints.ElastoSlip(3000.0, 1.5, -3000.0), 0, noise, harmonics=HIGHEST).replace(variance=None)
    comparison = with_noise_beside(make_comparison(data, five_dof(), "fixed"))
    _, h = hypothesis(comparison, ElastoSlip(True), [3000.0, 5e-4])
    again = noise_beside(comparison, h)
    sigma = noise * np.sqrt((np.abs(np.asarray(data.H)) ** 2).mean(axis=1, keepdims=True))
    miss = [np.sqrt(np.mean(np.log(n.sigma / sigma) ** 2)) for n in (comparison.noise, again)]
    assert miss[1] < 0.5 * miss[0]


def test_weak_joints_are_left_as_they_are():
    data = test_of(joints.CubicSpring(1e7), noise=0.05, harmonics=HIGHEST)  # compiled for laws at one place as well
    comparison = with_noise_beside(make_comparison(data, five_dof(), "fixed"))
    null, h = hypothesis(comparison, CubicStiffness(), [1e7])
    assert joints_in_full(comparison, null, [comparison.fit([h], 30)[0]]) == []
