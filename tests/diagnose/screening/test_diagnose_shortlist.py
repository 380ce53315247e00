"""Which of very many places are worth a look, against what is exact."""

import itertools

import numpy as np
import pytest
from chains import comparison_of, grid, sprung

from modalax.diagnose.causes.channels import ChannelGain, ChannelSwap
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.causes.local import JointStiffness, LocalDamper
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.screening import shortlist as many
from modalax.diagnose.screening.local_elements import score
from modalax.diagnose.screening.products import at_places, ends


@pytest.mark.parametrize("claimed", [False, True])
def test_gain_of_free_springs_and_dampers_is_that_of_the_elements(claimed):
    """Two runs, so four unknowns at each place: their normal equations by hand from the elements' own products."""
    structure = grid(8, claimed)
    comparison, state = comparison_of(structure, sprung(grid(8, False), 2, 5, 2e3))
    every, reduced = comparison.scene.pairs(), state.reduced[True]
    a, b = ends(every)
    found = many.gains_at(reduced, many.sketch(reduced, state.sides[True].nuisance), a, b)
    at = at_places(reduced, every)
    w, runs = reduced.omega, reduced.S.shape[0]
    for k in range(len(every)):
        changes = []
        for Z, run in itertools.product((np.ones_like(w), 1j * w), range(runs)):
            y = np.zeros(at.S.shape[1:], complex)
            y[run] = -Z[:, None] * at.motion[k]
            changes.append(y)
        p = np.array([np.sum(np.real(y.conj() * at.S[k])) for y in changes])
        gram = np.array([[np.sum(np.real(y.conj() * z) * at.N[k]) for z in changes] for y in changes])
        across = np.array(
            [[np.sum(np.real(y.conj() * t)) for t in reduced.nuisances(at.a[k], at.b[k])] for y in changes]
        ).reshape(len(p), -1)
        if across.size:
            gram = gram - across @ reduced.inner @ across.T
        # the nuisances leave some directions a hundred-thousandth of their length, and the ridge is 1e-9 of that length
        assert found[k] == pytest.approx(p @ np.linalg.solve(gram, p), rel=1e-3)


def test_a_spring_alone_explains_no_more_than_free_springs_and_dampers():
    structure = grid(8, True)
    comparison, state = comparison_of(structure, sprung(grid(8, False), 2, 5, 2e3))
    every, reduced = comparison.scene.pairs(), state.reduced[True]
    free = many.gains_at(reduced, many.sketch(reduced, state.sides[True].nuisance), *ends(every))
    at = at_places(reduced, every)
    for cause in (JointStiffness(), LocalDamper()):
        square, product, _ = score(cause, reduced, at, [cause.grid(comparison.scene, p)[:1] for p in every], False)
        alone = np.array([float(p[0] ** 2 / s[0]) for s, p in zip(square, product, strict=True)])
        # the change by the least strength that is tried differs from the derivative by a part in a thousand
        assert (alone <= 1.01 * free + 0.01).all()


def test_few_lines_and_random_sums_find_the_place_among_many(monkeypatch):
    structure = grid(46, False)
    comparison, state = comparison_of(structure, sprung(structure, 3, 11, 2e3), lines=160)
    every = comparison.scene.pairs()
    assert len(every) == 46 * 47 // 2
    monkeypatch.setattr(many, "MANY", 100)
    monkeypatch.setattr(many, "KEPT", 20)
    monkeypatch.setattr(many, "LINES", 40)
    monkeypatch.setattr(many, "SUMS", 12)
    few = many.sketch(state.reduced[True], state.sides[True].nuisance)
    kept = [every[k].index[:2] for k in many.shortlist(state.reduced[True], few, every)]
    assert len(kept) == 20 and (3, 11) in kept


def test_an_exchange_of_outputs_is_among_those_kept(monkeypatch):
    structure = grid(12, False)
    comparison, _ = comparison_of(structure, structure)
    expected = np.asarray(comparison.problem.data)
    data = expected.copy()
    data[:, :, [4, 9]] = data[:, :, [9, 4]]
    weight = np.asarray(comparison.problem.weight)
    every = [Place((), (a, b, 0)) for a, b in itertools.combinations(range(12), 2)]
    monkeypatch.setattr(many, "MANY", 10)
    monkeypatch.setattr(many, "KEPT", 1)
    kept = many.likely_swaps(data, weight, weight * (data - expected), every)
    assert [every[k].index[:2] for k in kept] == [(4, 9)]


def test_only_places_between_many_dofs_and_swaps_are_shortlisted(monkeypatch):
    """A sensor's number is no DoF's: every sensor is looked at, however many."""
    structure = grid(12, False)
    comparison, state = comparison_of(structure, sprung(structure, 2, 5, 2e3))
    monkeypatch.setattr("modalax.diagnose.screening.score_state.MANY", 10)
    monkeypatch.setattr("modalax.diagnose.screening.shortlist.MANY", 10)
    monkeypatch.setattr("modalax.diagnose.screening.shortlist.KEPT", 5)
    kept = []
    for cause in (ChannelGain(), JointStiffness(), Gyroscopic(), ChannelSwap()):
        places = cause.places(comparison.scene)
        kept.append((len(places), len(state.nearest(cause, places))))
    assert kept == [(12, 12), (78, 5), (66, 5), (66, 5)]
