"""Laws fitted to the force that is measured at one place."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from modalax.data import Measurement
from modalax.diagnose import pipeline
from modalax.diagnose.causes.base import LocalCause
from modalax.diagnose.causes.joints import BilinearStiffness, CoulombFriction, CubicStiffness, ElastoSlip, GapContact
from modalax.diagnose.causes.local import JointStiffness, LocalDamper
from modalax.diagnose.causes.viscoelastic import ZenerJoint
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.route import Task
from modalax.diagnose.decision.verdict import verdict
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.pipeline import at_one_place
from modalax.diagnose.prediction.balanced_force import balanced, harmonics_of
from modalax.diagnose.prediction.impedances import impedances
from modalax.diagnose.prediction.one_harmonic import described
from modalax.diagnose.routes import may_tell_joints
from modalax.diagnose.search import force_fit, one_place
from modalax.diagnose.search.force_fit import fit_to_force, laws_by_force
from modalax.diagnose.search.law_force import force_of, seen_at
from modalax.diagnose.search.look import look
from modalax.diagnose.search.measured_force import measured_forces
from modalax.diagnose.search.one_place import chance_of, explain_force, joint_extra
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate import joints
from modalax.simulate.harmonic import simulate

FREQ = np.arange(20.0, 70.0, 1.0)
PLACE = ("2", "4")


def compared(H, noise_level=0.01):
    """The five masses beside noisy FRFs, and the force that is measured at the best place."""
    rng = np.random.default_rng(0)
    sigma = noise_level * np.sqrt(np.mean(np.abs(H.H) ** 2, axis=(0, 1)))
    noise = rng.standard_normal((2, *H.H.shape)) * sigma / np.sqrt(2)
    noisy: Measurement = H.replace(H=H.H + noise[0] + 1j * noise[1], variance=sigma**2 + np.zeros(H.H.shape))
    comparison = make_comparison(noisy, five_dof(), "fixed")
    force = measured_forces(comparison, comparison.joint_places())[0]
    assert force.place.where == PLACE
    return comparison, force


@cache
def joined(law, *values):
    """FRFs of the five masses with a joint."""
    joint = law(*values)
    return simulate(five_dof(), [joint], [PLACE], FREQ, np.array([1.0, 3.0, 6.0]), inputs=["1"], harmonics=9)


@cache
def hardened():
    """The comparison and the force of a cubic spring."""
    return compared(joined(joints.CubicSpring, 3e10))


@cache
def one_sided():
    """The comparison and the force of a spring that acts on one side only."""
    return compared(joined(joints.BilinearSpring, 60000.0, 0.0), 0.001)


def test_an_elements_force_leaves_what_the_element_leaves_of_all_data():
    s = five_dof()
    e = np.eye(5)[s.index(PLACE[0])] - np.eye(5)[s.index(PLACE[1])]
    stiffer = Structure(s.M, s.C, s.K + 40000.0 * np.outer(e, e), s.dofs)
    comparison, force = compared(Measurement.from_frfs([stiffer.frf(FREQ, inputs=["1"])]))
    fits = laws_by_force(comparison, [LocalDamper(), JointStiffness()], force, 1e6)
    spring = min(fits, key=lambda f: f.chi2)
    assert isinstance(spring.cause, JointStiffness) and spring.params[0] == pytest.approx(40000.0, rel=5e-3)
    nothing = Hypothesis(theta=np.zeros((2, comparison.problem.modal_form.stiffness.shape[0])))
    for fit in fits:  # one complex number a line holds all that five outputs tell
        h = nothing.with_cause(fit.cause, force.place, None, fit.params)
        assert (np.abs(comparison.residual(h)) ** 2).sum() == pytest.approx(fit.chi2, rel=1e-6)


def test_a_law_is_not_followed_beyond_the_time_or_far_behind_another(monkeypatch):
    """A weak spring from a start a third off: fitted to its end, not at all once time is up, and not behind another."""
    comparison, force = hardened()
    seen, start, asked = seen_at(comparison, force, several=False), [np.array([2e10])], []
    follow = force_fit.force_of
    monkeypatch.setattr(force_fit, "force_of", lambda *a, **k: asked.append(a[1]) or follow(*a, **k))

    def tries(**how):
        asked.clear()
        fit = fit_to_force(CubicStiffness(), start, seen, **how)
        assert fit is not None
        return fit, len(asked)

    fit, whole = tries()
    assert fit.params[0] == pytest.approx(3e10, rel=0.1) and whole > 4
    given, least = tries(late=lambda: True)
    assert given.params[0] == pytest.approx(2e10) and given.chi2 > fit.chi2 and least == 3  # the start, in each stage
    behind, some = tries(rival=-1e9)
    assert behind.chi2 >= fit.chi2 and least <= some < whole
    same, as_many = tries(rival=seen.left + np.log1p(np.abs(fit.residual) ** 2).sum())
    assert same.chi2 == fit.chi2 and as_many == whole


@pytest.mark.parametrize(
    ("missed", "chi2", "asked"), [(3e5, 0.0, True), (1e5, 0.0, False), (3e5, 1e9, False), (0, 0, False)]
)
def test_a_law_that_explains_all_elsewhere_is_fitted_where_it_misses_as_much_by_one_harmonic(
    missed, chi2, asked, monkeypatch
):  # fmt: skip
    """A slip of one of two springs in series was named at the other, as the law had not been tried at its own place."""
    comparison, force = hardened()
    seen, law = seen_at(comparison, force, several=False), ElastoSlip(True)
    aside = np.zeros(len(seen.force), bool)
    found = force_fit.ForceFit(law, np.ones(2), seen.left, aside, seen.force, seen.force[None], seen.force[None], seen)
    monkeypatch.setattr(force_fit, "seen_at", lambda *a, **k: seen)
    monkeypatch.setattr(force_fit, "sized", lambda *a: (1.0, 5e5, [np.ones(2)]))
    monkeypatch.setattr(force_fit, "fit_with_modes", lambda *a: found)
    elsewhere = [replace(found, missed=float(missed), chi2=seen.left + chi2)] if missed else []
    fits = laws_by_force(comparison, [law], force, 1e6, seen.left, True, elsewhere)
    assert [(f.cause, f.missed) for f in fits] == ([(law, 5e5)] if asked else [])


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_slopes_of_a_linear_element_are_those_of_differences_at_nothing_too(share):
    """What lasts of a joint that relaxes begins at nothing, where steps in proportion to it told of no slope."""
    comparison, force = hardened()
    seen, law, p = seen_at(comparison, force, several=False), ZenerJoint(), np.array([2e5, 3e-3, share])
    here, slopes = force_of(law, p, seen)[:2]
    assert slopes.shape == (3, len(here))
    for slope, step in zip(slopes, np.diag([1.0, 1e-7, 1e-6]), strict=True):
        there, back = (force_of(law, p + way * step, seen)[0] for way in (1, -1))
        expected = (there - back) / (2 * step.sum())
        np.testing.assert_allclose(slope, expected, atol=1e-5 * np.abs(expected).max())
        assert np.abs(slope).max() > 0


def test_a_place_knows_what_was_fitted_at_those_before(monkeypatch):
    comparison, force = hardened()
    seen = seen_at(comparison, force, several=False)
    start = np.array([2e10])
    fit, asked = fit_to_force(CubicStiffness(), [start], seen, lambda: True), []

    def laws(*given):
        asked.append(list(given[-1]))
        return [fit] if len(asked) == 1 else []

    monkeypatch.setattr(one_place, "measured_forces", lambda *a: [force, force])
    monkeypatch.setattr(one_place, "laws_by_force", laws)
    explain_force(look(_only(comparison, force), ()), [CubicStiffness()])
    assert asked == [[], [fit]]


def test_a_slider_is_followed_with_as_many_harmonics_as_the_data_ask_for():
    """Nine leave more than noise of a force that many more make; where they leave noise, none further is taken."""
    made = simulate(
        five_dof(), [joints.ElastoSlip(6e4, 0.6)], [PLACE], FREQ[1::4], np.array([6.0]), inputs=["1"], harmonics=25,
    )  # fmt: skip
    left = []
    for noise in (3e-5, 1e-3):
        comparison, force = compared(made, noise)
        (fit,) = laws_by_force(comparison, [ElastoSlip(False)], force, 1e6)
        left.append((fit.highest, (fit.chi2 - comparison.problem.samples) / np.sqrt(2 * comparison.problem.samples)))
        assert fit.params == pytest.approx([6e4, 1e-5], rel=1e-3)
    assert [highest for highest, _ in left] == [force_fit.MORE_HARMONICS, 9]
    assert max(abs(excess) for _, excess in left) < 3


def test_dry_friction_is_followed_to_its_end_whatever_else_was_fitted():
    """It begins with few instants, so that it leaves more at first than it will."""
    comparison, force = hardened()
    seen, start = seen_at(comparison, force).telling(15), [np.array([0.2])]
    alone, beside = (fit_to_force(CoulombFriction(), start, seen, rival=r) for r in (np.inf, -1e9))
    assert alone is not None and beside is not None
    assert alone.chi2 == beside.chi2 and (alone.params == beside.params).all()


@pytest.mark.slow
def test_a_law_at_the_force_leaves_what_it_leaves_of_all_data():
    comparison, force = hardened()
    (fit,) = laws_by_force(comparison, [CubicStiffness()], force, 1e6)
    assert fit.params[0] == pytest.approx(3e10, rel=5e-3)
    samples = comparison.problem.samples
    assert fit.chi2 - samples < 4 * np.sqrt(2 * samples)
    found = explain_force(look(_only(comparison, force), ()), [CubicStiffness(), JointStiffness(), ElastoSlip(False)])
    assert found is not None and found.best.causes == (CubicStiffness(),)
    # one complex number a line holds all that the FRFs tell
    assert (np.abs(comparison.residual(found.best)) ** 2).sum() == pytest.approx(fit.chi2, rel=1e-5)
    assert abs(found.best.params[0][0] - 3e10) < 3 * np.sqrt(found.best.covariance[0, 0])
    assert 0.002 < found.leftover.p_value <= 1


@pytest.mark.slow
def test_both_sides_of_a_one_sided_spring_follow_from_its_force():
    comparison, force = one_sided()
    fits = laws_by_force(comparison, [JointStiffness(), BilinearStiffness()], force, 1e6)
    fit = min(fits, key=lambda f: f.chi2)
    assert isinstance(fit.cause, BilinearStiffness)
    mean, asymmetry = fit.params
    assert mean * (1 + asymmetry) == pytest.approx(60000.0, rel=0.02)
    assert mean * (1 - asymmetry) == pytest.approx(0.0, abs=600)
    assert np.isfinite(joint_extra(comparison, fit)).all()


def off(spread=0.002):
    """The five masses with frequencies and dampings off by a claimed spread, and what claims it."""
    s, rng = five_dof(), np.random.default_rng(3)
    root = np.linalg.cholesky(np.asarray(s.M))
    value, V = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, np.asarray(s.K)).T))
    shapes = root @ V
    K = (shapes * value * np.exp(2 * spread * rng.standard_normal(5))) @ shapes.T
    return replace(s, K=K), replace(s, frequency_std=spread, damping_std=2 * spread)  # C as it is: ratios are off too


def beside_claimed_modes(H, claimed, noise_level):
    """FRFs with noise beside a simulation that claims a spread, and the force at the best place."""
    comparison, _ = compared(H, noise_level)
    comparison = make_comparison(comparison.measurement, claimed, "fixed")
    force = measured_forces(comparison, comparison.joint_places())[0]
    assert comparison.nuisance.active and force.place.where == PLACE
    return comparison, force


def test_modes_within_a_claimed_spread_are_fitted_with_the_law():
    true, claimed = off()
    e = np.eye(5)[true.index(PLACE[0])] - np.eye(5)[true.index(PLACE[1])]
    stiffer = replace(true, K=true.K + 40000.0 * np.outer(e, e))
    comparison, force = beside_claimed_modes(Measurement.from_frfs([stiffer.frf(FREQ, inputs=["1"])]), claimed, 0.003)
    fits = laws_by_force(comparison, [JointStiffness()], force, 1e6)
    fit = min(fits, key=lambda f: f.chi2)
    h = Hypothesis(theta=fit.seen.theta).with_cause(fit.cause, force.place, None, fit.params)
    # one complex number a line, and the modal parameters, hold all that five outputs tell
    in_all = (np.abs(comparison.residual(h)) ** 2).sum() + (fit.seen.theta**2).sum()
    assert in_all == pytest.approx(fit.chi2, rel=1e-4)
    assert np.abs(fit.seen.theta[0]).max() > 0.5  # the modes did move
    deviation = np.sqrt(fit.covariance[0, 0])
    assert abs(fit.params[0] - 40000.0) < 3 * deviation
    # the stated deviation is that of all data, with the modes free within their spread
    (full,) = comparison.fit([h], 20)
    assert full.chi2 == pytest.approx(fit.chi2, abs=0.5)
    assert full.params[0][0] == pytest.approx(fit.params[0], abs=0.1 * deviation)
    assert np.sqrt(full.covariance[0, 0]) == pytest.approx(deviation, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "cause"), [(joints.CubicSpring(3e10), CubicStiffness()),
                                              (joints.Gap(30000.0, 3e-5), GapContact())])  # fmt: skip
def test_a_law_beside_modes_within_a_claimed_spread_is_found_with_all_its_harmonics(joint, cause):
    true, claimed = off()
    H = simulate(true, [joint], [PLACE], FREQ, np.array([1.0, 3.0, 6.0]), inputs=["1"], harmonics=9)
    comparison, force = beside_claimed_modes(H, claimed, 0.003)
    found = explain_force(look(_only(comparison, force), ()), [CubicStiffness(), JointStiffness(), GapContact()])
    assert found is not None and found.best.causes == (cause,)
    truth = [float(v) for v in vars(joint).values()]
    for value, deviation, true_value in zip(*_said(found), truth, strict=True):
        assert abs(value - true_value) < 3 * deviation < 0.05 * true_value
    assert 0.002 < found.leftover.p_value <= 1


def _said(found):
    """Parameters of the leading cause and their deviations."""
    h = found.best
    by_search = np.sqrt(np.diag(h.covariance))
    scale = [value if p.log else 1.0 for value, p in zip(h.params[0], h.causes[0].parameters, strict=True)]
    return h.params[0], by_search * scale


@pytest.mark.slow
def test_a_law_that_does_not_come_near_is_no_explanation():
    comparison, force = compared(joined(joints.ElastoSlip, 30000.0, 3.0))
    at = _only(comparison, force)
    assert explain_force(look(at, ()), [CubicStiffness()]) is None
    assert explain_force(look(at, ()), []) is None


def test_harmonics_are_balanced_only_where_they_count(monkeypatch):
    asked = []
    monkeypatch.setattr(one_place, "laws_by_force", lambda *a: asked.append(a[-2]) or [])
    s = five_dof()
    e = np.eye(5)[s.index(PLACE[0])] - np.eye(5)[s.index(PLACE[1])]
    for noise, several in ((0.01, True), (1.0, False)):
        stiffer = Structure(s.M, s.C, s.K + 40000.0 * np.outer(e, e), s.dofs)
        comparison, force = compared(Measurement.from_frfs([stiffer.frf(FREQ, inputs=["1"])]), noise)
        assert explain_force(look(_only(comparison, force), ()), [CubicStiffness(), JointStiffness()]) is None
        assert asked == [several]
        asked.clear()


@pytest.mark.parametrize(
    ("cause", "p"), [(CubicStiffness(), [2e10]), (ElastoSlip(False), [3e4, 3e-5]), (CoulombFriction(), [0.4])]
)
def test_one_harmonic_of_a_joint_solves_its_equation_and_has_its_slopes(cause, p):
    rng = np.random.default_rng(0)
    G = 1e-5 * (rng.standard_normal((2, 6, 1)) - 1j * rng.uniform(0.1, 1.0, (2, 6, 1)))
    free = 1e-4 * (rng.standard_normal((2, 6, 1)) + 1j * rng.standard_normal((2, 6, 1)))
    p, omega = np.array(p), np.linspace(100.0, 200.0, 6)
    at = lambda p, free: described(cause, p, G, free, omega, np.abs(free))
    force, slopes, sound, motion = at(p, free)
    assert sound.all()
    slides = np.abs(motion) > 0
    assert np.abs(motion - (free - G * force)).max() < 1e-8 * np.abs(free).max()
    law = impedances(cause, p, omega, np.where(slides, np.abs(motion), 1.0)) * motion
    # the describing function of a slip after 1 pm is rounded
    assert np.abs(force - law)[slides].max() < (1e-5 if cause.rigid else 1e-7) * np.abs(force).max()
    for k, size in enumerate(p):
        step = 1e-4 * size * np.eye(len(p))[k]
        by_difference = (at(p + step, free)[0] - at(p - step, free)[0]) / (2 * step[k])
        assert np.abs(slopes[k] - by_difference).max() < 1e-3 * np.abs(by_difference).max()
    by_difference = (at(p, free * 1.0001)[0] - at(p, free * 0.9999)[0]) / 2e-4  # nothing, of friction
    assert np.abs(slopes[-1] - by_difference).max() < 1e-3 * np.abs(force).max()


def test_a_balance_across_a_joint_is_harmonic_balance():
    """The force at every line makes of the motion without the joint that of the structure with it."""
    s, found = five_dof(), joined(joints.CubicSpring, 2e11)
    at = [s.index(n) for n in PLACE]
    H = lambda order, dofs: np.asarray(s.frf(FREQ * order, outputs=list(PLACE), inputs=dofs).H)
    cause, p = CubicStiffness(), np.array([2e11])
    orders = harmonics_of(cause, p)
    G = np.stack([h[:, 0, 0] - h[:, 0, 1] - h[:, 1, 0] + h[:, 1, 1] for h in (H(k, list(PLACE)) for k in orders)], 1)
    driven = 3.0 * H(1, ["1"])[:, :, 0]
    free, motion = driven[:, 0] - driven[:, 1], 3.0 * (found.H[1, :, at[0], 0] - found.H[1, :, at[1], 0])
    near = np.where(np.array(orders) == 1, motion[:, None], 0.0)
    force, _, sound, q = balanced(cause, p, G, free, 2 * np.pi * FREQ, near)
    assert sound.mean() > 0.9
    assert np.abs(q[:, 0] - motion)[sound].max() < 1e-6 * np.abs(motion).max()
    assert np.abs(free - G[:, 0] * force - motion)[sound].max() < 1e-6 * np.abs(motion).max()


def test_a_weak_spring_is_named_that_the_chi_square_of_all_samples_does_not_show():
    s, rng = five_dof(), np.random.default_rng(2)
    e = np.eye(5)[s.index(PLACE[0])] - np.eye(5)[s.index(PLACE[1])]
    freq = np.linspace(20.0, 70.0, 2000)
    stiffer = Structure(s.M, s.C, s.K + 1.4 * np.outer(e, e), s.dofs)
    H = np.asarray(stiffer.frf(freq, inputs=["1"], outputs=s.dofs).H)[None]
    sigma = 0.01 * np.sqrt(np.mean(np.abs(H) ** 2)) * np.ones(H.shape)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    data = Measurement(freq, H + sigma * noise, variance=sigma**2, outputs=s.dofs, inputs=["1"])
    comparison = make_comparison(data, s, "fixed")
    force = next(f for f in measured_forces(comparison, comparison.joint_places()) if f.place.where == PLACE)
    seen = look(_only(comparison, force), ())
    assert seen.detection.p_value > THRESHOLDS.alarm
    found = explain_force(seen, [JointStiffness(), LocalDamper()])
    assert found is not None and found.best.causes == (JointStiffness(),)
    places, laws, explained = 15, 2, found.leftover.explained
    assert explained > 20
    assert found.leftover.alarm == pytest.approx(places * laws * scipy.stats.chi2.sf(explained, 1))
    assert verdict(found.ranked, found.leftover)[0] == "named"


def test_the_chance_of_what_a_law_leaves_is_that_of_chi_squares():
    assert chance_of(100.0, 100, 1000.0, 1000) == pytest.approx(0.48, abs=0.03)
    assert chance_of(300.0, 100, 1000.0, 1000) < 1e-9
    assert chance_of(300.0, 100, 3000.0, 1000) == pytest.approx(0.48, abs=0.03)  # noise is larger than stated


def _only(comparison, force):
    return replace(comparison, only=(force.place,))


def test_laws_are_fitted_before_modes_are_asked_though_levels_hide_in_the_noise_of_all_sensors(monkeypatch):
    """Modes had come first, as the FRFs agree from level to level: of 100 masses that took all the time."""
    count = 24
    springs, B = np.linspace(1.6e5, 2.8e5, count + 1), np.eye(count + 1, count) - np.eye(count + 1, count, -1)
    M, K = np.diag(np.linspace(1.3, 0.8, count)), B.T @ np.diag(springs) @ B
    structure = Structure(M, 1e-4 * K + 0.2 * M, K)
    hz = np.sqrt(np.sort(scipy.linalg.eigvalsh(K, M))) / (2 * np.pi)
    exact = simulate(
        structure, [joints.ElastoSlip(400.0, 0.02, 0.0)], [("6", "10")], np.linspace(0.8 * hz[0], 1.05 * hz[4], 150),
        [1.0, 3.0, 9.0], inputs=["3"],
    )  # fmt: skip
    H, rng = np.asarray(exact.H), np.random.default_rng(0)
    sigma = 0.05 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    noise = sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    measured, steps = exact.replace(H=H + noise, variance=sigma**2), []
    assert not may_tell_joints(measured)
    monkeypatch.setattr(pipeline, "explain_force", lambda look, causes: steps.append(len(causes)))
    at_one_place(measured, structure, "auto", Task(True), lambda text: None, Deadline(), lambda: steps.append("modes"))
    linear, all_laws, modes = steps
    assert linear < all_laws and modes == "modes"


@pytest.mark.parametrize(
    ("left", "levels", "answer"),
    [(0.5, 3, "law"), (0.01, 3, "modes"), (0.5, 1, "modes")],
    ids=["law", "worse", "one level"],
)
def test_a_law_that_leaves_noise_comes_before_a_spring_that_damping_goes_with(left, levels, answer, monkeypatch):
    """A one-sided spring looks like one whose damping rises with it, and has no level by which it differs."""
    every = joined(joints.BilinearSpring, 60000.0, 0.0)
    data = every.replace(
        H=every.H[:levels], level=every.level[:levels], variance=1e-16 + np.zeros(every.H[:levels].shape)
    )
    near = SimpleNamespace(leftover=SimpleNamespace(inexact=0.1))
    best = SimpleNamespace(best=SimpleNamespace(causes=(BilinearStiffness(),)))
    law = SimpleNamespace(ranked=[best], leftover=SimpleNamespace(inexact=0.0, p_value=left))
    linear = lambda causes: all(isinstance(c, LocalCause) for c in causes)
    monkeypatch.setattr(pipeline, "explain_force", lambda look, causes: near if linear(causes) else law)
    monkeypatch.setattr(pipeline, "told", lambda found, tell: SimpleNamespace(verdict="named", of="law"))
    for name in ("of_elements", "outcome_of", "surely_foretold"):
        monkeypatch.setattr(pipeline, name, lambda found: True)
    monkeypatch.setattr(pipeline, "all_in_general", lambda modes, task, late: False)
    said = at_one_place(
        data, five_dof(), "auto", Task(True), lambda text: None, Deadline(), lambda: SimpleNamespace(of="modes")
    )
    assert said.of == answer


def test_steps_towards_a_one_sided_spring_go_on_as_long_as_they_gain():
    comparison, force = one_sided()
    fit = fit_to_force(BilinearStiffness(), [np.array([1.8e4, 0.02])], seen_at(comparison, force).telling(15))
    assert fit.params == pytest.approx([3e4, 1.0], rel=0.02)


def test_no_step_begins_where_the_slopes_of_a_force_are_no_numbers(monkeypatch):
    """Modes that had moved out of all bounds had ended a diagnosis in an error of linear algebra."""
    comparison, force = one_sided()
    seen, of = seen_at(comparison, force).telling(15), force_fit.force_of

    def broken(*a, **k):
        f, slopes, sound, moved = of(*a, **k)
        return f, slopes * np.nan, sound, moved

    monkeypatch.setattr(force_fit, "force_of", broken)
    start = np.array([1.8e4, 0.02])
    assert fit_to_force(BilinearStiffness(), [start], seen).params == pytest.approx(start)
