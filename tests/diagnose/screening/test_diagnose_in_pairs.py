"""Two causes that are found at once, by derivatives alone."""

from functools import cache

import numpy as np
import pytest
from chains import comparison_of, grid, sprung

from modalax import Structure
from modalax.diagnose.causes.channels import ChannelGain, ChannelSign, SensorMass
from modalax.diagnose.causes.joints import ElastoSlip
from modalax.diagnose.causes.local import AddedMass, JointStiffness, TunedMass
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.search import explain
from modalax.diagnose.search.compounds import Leavings
from modalax.diagnose.search.in_pairs import best_pairs
from modalax.diagnose.search.look import look

CAUSES = [AddedMass(), JointStiffness(), TunedMass(), ElastoSlip(False), ChannelGain(), ChannelSign(), SensorMass()]
SPRING, MASS = 1500.0, 0.02  # 0.8 % of a spring, 2 % of a mass


def heavier(structure, k, mass):
    M = np.array(structure.M)
    M[k, k] += mass
    return Structure(M, structure.C, structure.K, structure.dofs)


@cache
def drawn(claimed):
    """A row whose spring and mass are a little off, as screened, and the best pairs."""
    nominal = grid(7, claimed)
    comparison, state = comparison_of(nominal, heavier(sprung(nominal, 1, 4, SPRING), 5, MASS))
    trials = screen_all(state, CAUSES, finite=False).trials
    return nominal, comparison, state, trials, best_pairs(state, trials)


def names(pair):
    return {(t.cause.slug, t.place.where) for t in pair.trials}


TRUTH = {("joint_stiffness", ("2", "5")), ("added_mass", ("6",))}


def test_what_a_pair_promises_is_least_squares():
    """Against changes of the matrices: the chi-square that their best sizes take away, and these sizes."""
    nominal, comparison, _, _, pairs = drawn(False)
    pair = next(p for p in pairs if names(p) == TRUTH)
    data, freq, inputs = comparison.measurement, comparison.measurement.freq, nominal.dofs[:2]
    H = np.asarray(nominal.frf(freq, outputs=nominal.dofs, inputs=inputs).H)
    sigma = np.sqrt(np.asarray(data.variance) / 2)

    def column(changed, size):
        moved = np.asarray(changed.frf(freq, outputs=nominal.dofs, inputs=inputs).H)
        y = ((moved - H) / size / sigma).ravel()
        return np.concatenate([y.real, y.imag])

    columns = [column(sprung(nominal, 1, 4, 1e-2), 1e-2), column(heavier(nominal, 5, 1e-8), 1e-8)]
    r = ((np.asarray(data.H) - H) / sigma).ravel()
    r, D = np.concatenate([r.real, r.imag]), np.stack(columns, axis=1)
    sizes, left, *_ = np.linalg.lstsq(D, r, rcond=None)
    # the smallest size that is screened bends the change by 0.05 %
    assert pair.gain == pytest.approx(r @ r - left[0], rel=1e-3)
    found = {t.cause.slug: t.start[0] for t in pair.trials}
    assert [found["joint_stiffness"], found["added_mass"]] == pytest.approx(sizes, rel=1e-2)


@pytest.mark.parametrize("claimed", [False, True])
def test_the_true_pair_comes_first_and_takes_what_it_promised(claimed):
    """Also where modes may be off; the spring alone leaves the mass, and a fit of both leaves noise."""
    _, comparison, state, trials, pairs = drawn(claimed)
    assert names(pairs[0]) == TRUTH
    fitted = comparison.fit([pairs[0].start(state.hypothesis)], 20)[0]
    assert state.hypothesis.chi2 - fitted.chi2 == pytest.approx(pairs[0].gain, rel=0.03)
    alone = max(t.gain for t in trials)
    assert pairs[0].gain > alone + 30.0


def test_masses_are_added_and_no_cause_is_paired_with_itself():
    _, _, state, trials, pairs = drawn(True)
    assert len(pairs) > 1
    for pair in pairs:
        assert pair.trials[0].place != pair.trials[1].place or pair.trials[0].cause != pair.trials[1].cause
        assert all(t.start[0] > 0 for t in pair.trials if t.cause.parameters[0].lower >= 0)
    assert best_pairs(state, trials[:1]) == []


def test_one_cause_of_a_pair_that_explains_all_stands_alone(monkeypatch):
    """The search of single causes came by another only; beside the right one its partner has no size."""
    nominal, _, _, _, pairs = drawn(False)
    pair = next(p for p in pairs if names(p) == TRUTH)
    comparison, state = comparison_of(nominal, heavier(nominal, 5, MASS))
    seen = look(comparison, CAUSES, finite=False)
    wrong = next(t for t in seen.screening.trials if (t.cause.slug, t.place.where) == ("added_mass", ("3",)))
    fitted = comparison.fit([state.hypothesis.with_cause(wrong.cause, wrong.place, None, np.array([MASS]))], 20)
    monkeypatch.setattr(explain, "best_pairs", lambda *_: [pair])
    rest = Leavings(comparison, seen.null, CAUSES)
    _, ranked, _ = explain.both_at_once(seen, comparison, fitted, explain.weigh(seen, fitted), rest)
    assert ranked[0].names == {("added_mass", ("6",))}
    assert any(len(r.names) == 2 for r in ranked)
