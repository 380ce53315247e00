"""Records that end before the response has: every length at which they may, beside the fits that brute force makes."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import numpy as np
import pytest

from modalax.data import FRF
from modalax.diagnose.causes.records import CUT, ExponentialWindow, FastSweep, Leakage
from modalax.diagnose.comparison import empty, make_comparison
from modalax.diagnose.decision.detection import detect
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.fitting.residual import laid_out
from modalax.diagnose.screening import record_lengths
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.record_lengths import promising_lengths
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import Trial
from modalax.model import Structure

N, RECORD = 3, 12.137  # degrees of freedom; length of the record [s]
CAUSES = (Leakage(), FastSweep(), ExponentialWindow())
ORDER = {"receptance": 0, "mobility": 1, "accelerance": 2}


@cache
def compared(form="accelerance", record=RECORD, seed=1, noise=0.03, lowest=4.0, **claim):
    """A chain, and its FRFs of impacts whose records are cut off, in noise that is a share of each sample."""
    freq, names = np.linspace(lowest, 40.0, 150), [str(k + 1) for k in range(N)]
    K = 1e4 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    simulation = Structure(M=np.eye(N), C=1e-4 * K + 0.2 * np.eye(N), K=K, dofs=names, **claim)
    s, order = 2j * np.pi * freq, ORDER[form]
    w2, shapes = np.linalg.eigh(K)
    c = np.einsum("dr,de,er->r", shapes, simulation.C, shapes)
    poles = -c / 2 + 1j * np.sqrt(w2 - c**2 / 4)
    H = 0
    for r in range(N):
        for pole in (poles[r], poles[r].conj()):
            lost = 0 if record is None else (pole / s) ** order * np.exp(-(s - pole) * record)
            one = (1 - lost) / (s - pole) / (pole - pole.conj())
            H = H + one[:, None, None] * np.outer(shapes[:, r], shapes[:2, r])
    sigma, rng = noise * np.abs(H), np.random.default_rng(seed)
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    to = (s**order)[:, None, None]
    measured = FRF(freq, H * to, outputs=names, inputs=names[:2], form=form, variance=(sigma * np.abs(to)) ** 2)
    comparison = make_comparison(measured, simulation)
    null = comparison.fit([empty(comparison)], 40)[0]
    return comparison, null, score_state_of(comparison, null)


def looked_through(comparison, null, state):
    return promising_lengths(state.sides[False], comparison.pooled, null.theta * comparison.nuisance.spread)


@pytest.mark.parametrize("form", ORDER)
def test_each_length_takes_from_chi_square_what_its_prediction_does(form):
    comparison, null, state = compared(form)
    lengths, gains, count = looked_through(comparison, null, state)
    place = Leakage().places(comparison.scene)[CUT]
    exact = [null.chi2 - comparison.chi2(null.with_cause(Leakage(), place, None, np.array([1 / T]))) for T in lengths]
    np.testing.assert_allclose(gains, exact, rtol=1e-6, atol=1e-6)
    assert abs(lengths[0] - RECORD) < 0.25 / 36 and gains[0] > 100 and count > 30


def test_a_record_cut_off_between_two_lengths_of_the_grid_is_seen():
    """Noise that is a share of each sample shows its ripple between the resonances only."""
    comparison, null, state = compared()
    trials = screen_all(state, CAUSES).trials
    best = max((t for t in trials if t.cause.slug == "leakage"), key=lambda t: t.gain)
    assert best.ripples and abs(1 / best.start[0] - RECORD) < 0.25 / 36
    assert best.gain > 3 * max(t.gain for t in trials if t is not best)
    seen = detect(trials, state.sides, Omnibus(1.0, 0.0, "", (0.0, 0.0)))
    assert seen.p_values["lengths"] < 1e-9 and seen.anything
    fitted = comparison.fit([null.with_cause(best.cause, best.place, None, best.start)], 40)[0]
    assert abs(1 / fitted.params[0][0] - RECORD) < 4 * RECORD * np.sqrt(fitted.covariance[0, 0])


def test_a_mode_below_the_band_may_ring_on_when_the_record_ends():
    """Those in the band have decayed by then to a hundred-thousandth; the ripple of the first shows in all of it."""
    lengths, gains, _ = looked_through(*compared(lowest=15.0))
    assert abs(lengths[0] - RECORD) < 0.25 / 25 and gains[0] > 100


def test_claimed_modes_that_follow_only_make_it_more():
    comparison, null, state = compared(frequency_std=1e-3, damping_std=0.05)
    lengths, gains, _ = looked_through(comparison, null, state)
    place = Leakage().places(comparison.scene)[CUT]
    start = null.with_cause(Leakage(), place, None, np.array([1 / lengths[0]]))
    assert abs(lengths[0] - RECORD) < 0.25 / 36
    assert null.chi2 - comparison.fit([start], 40)[0].chi2 > gains[0] > 100


def test_under_noise_alone_its_chance_is_no_smaller_than_stated():
    comparison, null, state = compared(record=None)
    live = laid_out(np.where(np.asarray(comparison.problem.weight) > 0, 1 + 1j, 0))
    side, rng, chances = state.sides[False], np.random.default_rng(5), []
    place = Leakage().places(comparison.scene)[CUT]
    for _ in range(250):
        noise = replace(side, value=live * rng.standard_normal(live.shape))
        _, gains, count = promising_lengths(noise, comparison.pooled, null.theta * comparison.nuisance.spread)
        best = Trial(Leakage(), place, gains[0], np.nan, np.ones(1), ripples=count)
        chances.append(detect([best], state.sides, Omnibus(1.0, 0.0, "", (0.0, 0.0))).p_values["lengths"])
    for level in (0.02, 0.1, 0.3):
        assert np.mean(np.array(chances) < level) < level + 3 * np.sqrt(level / len(chances))
    assert min(chances) < 0.2  # yet it says something


def test_where_there_is_little_time_slow_modes_and_long_records_come_first(monkeypatch):
    case = compared()
    lengths, _, count = looked_through(*case)
    monkeypatch.setattr(record_lengths, "WORK", 4.04 * 150 * N * 2)  # enough for one mode at all samples
    few, _, fewer = looked_through(*case)
    assert 0 < fewer < count and few.min() > lengths.max()
    poles, product, _ = record_lengths._of_poles(case[2].sides[False], case[0].pooled, np.zeros((2, N)))
    assert product.shape == (150, 2)
    slowest = 0.5 * (1e-4 * 1e4 * (2 - np.sqrt(2)) + 0.2)  # the first mode's decay [1/s]
    np.testing.assert_allclose(poles.real, -slowest, rtol=1e-9)


def test_a_structure_without_damping_or_modes_in_band_has_no_such_length():
    comparison, null, state = compared()
    form = comparison.problem.modal_form
    still = eqx.tree_at(lambda p: p.modal_form.damping, comparison.pooled, 0 * form.damping)
    assert promising_lengths(state.sides[False], still, 0 * null.theta)[2] == 0
    far = eqx.tree_at(lambda p: p.modal_form.stiffness, comparison.pooled, 100 * form.stiffness)
    assert not len(promising_lengths(state.sides[False], far, 0 * null.theta)[0])


def test_a_mode_that_hardly_decays_asks_for_no_more_lengths_than_there_is_time_for(monkeypatch):
    """All up to where it had decayed were formed before most of them were left out, and took 429 GiB."""
    comparison, null, state = compared()
    form = comparison.problem.modal_form
    still = eqx.tree_at(lambda p: p.modal_form.damping, comparison.pooled, 1e-9 * form.damping)
    monkeypatch.setattr(record_lengths, "LOUD", np.inf)
    monkeypatch.setattr(record_lengths, "WORK", 1e6)
    lengths, _, count = promising_lengths(state.sides[False], still, 0 * null.theta)
    assert 0 < count < 1e6 / 150 and lengths.min() > 1e8
