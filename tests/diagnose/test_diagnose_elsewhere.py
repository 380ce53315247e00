"""Causes of the leading set at other places, begun from where they are; and what is fitted before what."""

from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.diagnose.causes.channels import ChannelGain
from modalax.diagnose.causes.joints import CubicStiffness, GapContact, QuadraticDamping
from modalax.diagnose.causes.local import JointStiffness, LocalDamper, TunedMass
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.signals import HumLines
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.search import explain
from modalax.diagnose.search.elsewhere import NEAR, elsewhere, restarted
from modalax.model import Structure

N, TRUE = 6, np.array([0.02, 9.0, 0.02])  # mass, frequency and damping ratio of the oscillator
GAIN, CLAIM = 0.05, 0.004


@pytest.fixture(scope="module")
def compared():
    """A chain with an oscillator at its DoF 3 and a sensor 5 % off, beside the chain without."""
    freq = np.linspace(3.0, 25.0, 240)
    K = 4e3 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    C, names = 2e-4 * K, [str(k + 1) for k in range(N)]
    s = 2j * np.pi * freq[:, None, None]
    mass, w, zeta = TRUE[0], 2 * np.pi * TRUE[1], TRUE[2]
    spring = w**2 + 2 * zeta * w * s
    at = np.zeros((N, N))
    at[2, 2] = 1.0
    H = np.linalg.inv(s**2 * np.eye(N) + s * C + K + s**2 * mass * spring / (s**2 + spring) * at)[:, :, :2]
    H = H * np.array([1.0] * (N - 1) + [1 + GAIN])[:, None]
    sigma, rng = 0.02 * np.abs(H).std(), np.random.default_rng(5)
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    measured = FRF(freq, H, outputs=names, inputs=names[:2], form="receptance", variance=np.full(H.shape, sigma**2))
    return make_comparison(measured, Structure(M=np.eye(N), C=C, K=K, dofs=names))


def with_oscillator(compared, dof, params):
    null = compared.fit([Hypothesis()], 5)[0]
    place = Place((str(dof + 1),), (dof, -1, 0))
    h = null.with_cause(TunedMass(), place, None, params)
    return h.with_cause(ChannelGain(), Place((str(N),), (N - 1, -1, 0)), None, np.array([GAIN]))


@pytest.fixture(scope="module")
def oscillators(compared):
    """Fits of an oscillator at DoF 3, the true one, and at DoF 4."""
    return [compared.fit([with_oscillator(compared, d, TRUE)], 40)[0] for d in (2, 3)]


def test_an_oscillator_is_followed_from_a_wrong_place_to_the_right_one(compared, oscillators):
    """Its mass there is what has the same effect; the fit from there ends where that from the truth does."""
    true, wrong = oscillators
    assert wrong.chi2 > true.chi2 + 100
    starts = elsewhere(compared, wrong)
    first = starts[0]
    assert first.places[0].index[0] == 2 and first.places[1:] == wrong.places[1:]  # promises most; the gain stays
    assert 0.3 < first.params[0][0] / TRUE[0] < 3
    np.testing.assert_array_equal(first.params[0][1:], wrong.params[0][1:])
    assert abs(compared.fit([first], 40)[0].chi2 - true.chi2) < 0.1


def test_lines_that_hum_reaches_are_left_out(compared, oscillators):
    """Three lines far off, which hum explains, change nothing."""
    mask = np.isin(np.arange(compared.problem.data.shape[1]), (60, 61, 120))
    data = np.asarray(compared.problem.data) * np.where(mask, 30.0, 1.0)[:, None, None]
    loud = replace(compared, problem=eqx.tree_at(lambda p: p.data, compared.problem, data), cache={})
    _, wrong = oscillators
    hum = HumLines(mask[: compared.problem.lines], 0.0, 1.0, 9.0, 50.0, 1e-9)
    expected = elsewhere(compared.without(hum.lines), wrong)
    found = elsewhere(loud, replace(wrong, hum=hum))
    assert [h.places for h in found] == [h.places for h in expected] and found
    np.testing.assert_allclose([h.params[0] for h in found], [h.params[0] for h in expected], rtol=1e-9)


def test_places_that_promise_far_less_are_not_fitted(compared, oscillators):
    true, _ = oscillators
    every = [compared.fit([with_oscillator(compared, d, true.params[0])], 40)[0].chi2 for d in range(N) if d != 2]
    assert min(every) > true.chi2 + 2 * NEAR  # noise this small leaves no doubt
    assert elsewhere(compared, true) == []


@pytest.mark.parametrize("explained, order", [(2000.0, ["pairs", "harmonics"]), (1e5, ["harmonics", "pairs"])])
@pytest.mark.parametrize("settled", [True, False])
def test_pairs_come_before_harmonics_that_can_change_nothing(monkeypatch, explained, order, settled):
    """One harmonic is exact to 1 %: of a chi-square of 2,000 that is 0.2, of 100,000 it is 10."""
    asked = []
    lone = Hypothesis(causes=(CubicStiffness(),), places=(Place(("1",), (0, -1, 0)),), extras=(None,), chi2=500.0)
    ranked = [Ranked(lone.names, lone, -250.0, 1.0)]

    def pairs(look, comparison, fitted, ranked, rest):
        asked.append("pairs")
        return [*fitted, lone], ranked, settled

    def harmonics(look, comparison, fitted, ranked):
        asked.append("harmonics")
        return fitted, ranked

    monkeypatch.setattr(explain, "both_at_once", pairs)
    monkeypatch.setattr(explain, "in_full", harmonics)
    look = SimpleNamespace(null=SimpleNamespace(chi2=500.0 + explained))
    assert explain.with_harmonics_or_pairs(look, None, [lone], ranked, None)[2] == settled
    assert asked == (order[:1] if settled and order[0] == "pairs" else order)


@pytest.mark.parametrize("changed, order", [(False, ["pairs"]), (True, ["pairs", "pairs"])])
def test_pairs_that_promise_nothing_are_weighed_again_only_beside_new_harmonics(monkeypatch, changed, order):
    asked = []
    lone = Hypothesis(causes=(CubicStiffness(),), places=(Place(("1",), (0, -1, 0)),), extras=(None,), chi2=500.0)

    def pairs(look, comparison, fitted, ranked, rest):
        asked.append("pairs")
        return fitted, ranked, False

    monkeypatch.setattr(explain, "both_at_once", pairs)
    monkeypatch.setattr(explain, "in_full", lambda _, __, fitted, ranked: ([*fitted] if changed else fitted, ranked))
    look, ranked = SimpleNamespace(null=SimpleNamespace(chi2=500.0)), [Ranked(lone.names, lone, -250.0, 1.0)]
    explain.with_harmonics_or_pairs(look, None, [lone], ranked, None)
    assert asked == order


def spring_at(null, dof, stiffness=500.0):
    return null.with_cause(JointStiffness(), Place((str(dof + 1),), (dof, -1, 0)), None, np.array([stiffness]))


@pytest.fixture(scope="module")
def claimed():
    """A chain with a spring at its DoF 3 whose modes are off as claimed; fits of a spring at each DoF."""
    freq, rng = np.linspace(3.0, 22.0, 120), np.random.default_rng(3)
    K = 4e3 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    names, s = [str(k + 1) for k in range(N)], 2j * np.pi * freq[:, None, None]
    w2, shapes = np.linalg.eigh(K)
    own = shapes @ np.diag(w2 * np.exp(2 * CLAIM * rng.standard_normal(N))) @ shapes.T
    own[2, 2] += 900.0
    H = np.linalg.inv(s**2 * np.eye(N) + s * 2e-4 * K + own)[:, :, :1]
    sigma = 0.01 * np.abs(H).std()
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    measured = FRF(freq, H, outputs=names, inputs=names[:1], form="receptance", variance=np.full(H.shape, sigma**2))
    simulation = Structure(M=np.eye(N), C=2e-4 * K, K=K, dofs=names, frequency_std=CLAIM, damping_std=0.02)
    comparison = make_comparison(measured, simulation)
    null = comparison.fit([Hypothesis()], 40)[0]
    return comparison, null, comparison.fit([spring_at(null, dof) for dof in range(N)], 160)


def test_other_places_are_fitted_again_from_the_modes_beside_the_leading_one(claimed):
    """Fits that were caught where the modes are ten claimed deviations off leave them."""
    comparison, null, springs = claimed
    best = min(springs, key=lambda h: h.chi2)
    assert best.places[0].index[0] == 2
    others = [h for h in springs if h is not best]
    far = np.full_like(best.theta, 10.0)
    caught = [replace(h, theta=far, chi2=comparison.chi2(replace(h, theta=far))) for h in others]
    damper = null.with_cause(LocalDamper(), best.places[0], None, np.array([1.0]))
    elsewhere_too = null.with_cause(LocalDamper(), others[0].places[0], None, np.array([1.0]))
    damper, elsewhere_too = (replace(h, chi2=1e12) for h in (damper, elsewhere_too))
    found = restarted(comparison, best, [*caught, damper, elsewhere_too])
    assert [h.names for h in found] == [h.names for h in (*caught, damper)]  # another cause at another place is not
    assert max(h.chi2 / before.chi2 for h, before in zip(found, caught, strict=False)) < 0.5


def test_a_fit_that_comes_no_lower_is_not_kept(claimed, compared, oscillators):
    comparison, _, springs = claimed
    best = min(springs, key=lambda h: h.chi2)
    others = [h for h in springs if h is not best]
    least = [min([h, *restarted(comparison, best, [h])], key=lambda one: one.chi2) for h in others]
    assert restarted(comparison, best, least) == []
    true, _ = oscillators
    assert restarted(compared, true, [replace(true, chi2=np.inf)]) == []  # modes are exact


def bare(h):
    return replace(h, causes=(), places=(), extras=(), params=(), freedom=0.0)


def joint_at(null, dof, law, params):
    h = null.with_cause(law, Place((str(dof + 1),), (dof, -1, 0)), None, params)
    return h.with_cause(ChannelGain(), Place((str(N),), (N - 1, -1, 0)), None, np.array([GAIN]))


@pytest.fixture(scope="module")
def hardening():
    """A chain with a hardening spring at its DoF 3 and a sensor 5 % off, at three levels, and its true hypothesis."""
    freq, rng, level = np.linspace(3.0, 22.0, 80), np.random.default_rng(7), np.array([1.0, 3.0, 9.0])
    K = 4e3 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    names = [str(k + 1) for k in range(N)]
    s = 2j * np.pi * freq[:, None, None]
    linear = np.linalg.inv(s**2 * np.eye(N) + s * 2e-3 * K + K)[:, :, :1]
    sigma = 0.02 * np.abs(linear).std()

    def compared(H):
        measured = Measurement(
            freq,
            H,
            outputs=names,
            inputs=names[:1],
            form="receptance",
            level=level,
            variance=np.full(H.shape, sigma**2),
        )
        return make_comparison(measured, Structure(M=np.eye(N), C=2e-3 * K, K=K, dofs=names))

    first = compared(np.stack([linear] * 3))
    true = joint_at(first.fit([Hypothesis()], 1)[0], 2, CubicStiffness(), np.array([2e5]))
    H = first.prediction(true)
    comparison = compared(H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)))
    return comparison, comparison.fit([true], 40)[0]


LAWS = (CubicStiffness(), GapContact(), QuadraticDamping(), ChannelGain())


def test_a_joint_beside_another_cause_is_looked_for_at_other_places(hardening):
    """Screened beside the sensor alone, the right place is among those that are about as good."""
    comparison, true = hardening
    wrong = comparison.fit([joint_at(bare(true), 3, LAWS[0], true.params[0])], 40)[0]
    assert wrong.chi2 > true.chi2 + 30
    starts = [h for h in elsewhere(comparison, wrong, LAWS) if h.causes[0] == LAWS[0]]
    assert all(h.causes[1:] == true.causes[1:] and h.extras[0] is None and h.covariance is None for h in starts)
    best = min(comparison.fit(starts, 40), key=lambda h: h.chi2)
    assert best.places == true.places and abs(best.chi2 - true.chi2) < 0.1


def test_a_joint_beside_another_cause_is_looked_for_by_other_laws(hardening):
    """Each law at its best place and at the joint's, where it comes near; one that comes nowhere near is left out."""
    comparison, true = hardening
    gap = comparison.fit([joint_at(bare(true), 2, LAWS[1], np.array([40.0, 0.004]))], 40)[0]
    found = elsewhere(comparison, gap, LAWS)
    cubic = [h for h in found if h.causes[0] == LAWS[0]]
    assert true.places in [h.places for h in cubic]
    assert all(h.freedom == 2 for h in cubic)  # its stiffness and the sensor
    assert not any(h.causes[0] == LAWS[2] for h in elsewhere(comparison, true, LAWS))  # it loses energy


def test_how_exact_a_joint_is_stays_known_where_another_cause_moves(compared, oscillators, hardening):
    oscillator = replace(oscillators[1], fidelity=1e-3, freedom=7.0)
    starts = elsewhere(compared, oscillator)
    assert starts and all(h.fidelity == 1e-3 and h.freedom == 7.0 for h in starts)
    comparison, true = hardening
    starts = elsewhere(comparison, replace(true, fidelity=1e-3), LAWS)
    assert starts and all(h.fidelity is None for h in starts)  # by one harmonic again


def test_a_joint_alone_has_been_looked_for_everywhere(hardening):
    comparison, true = hardening
    alone = replace(true, causes=true.causes[:1], places=true.places[:1], extras=(None,), params=true.params[:1])
    assert elsewhere(comparison, alone, LAWS) == []
