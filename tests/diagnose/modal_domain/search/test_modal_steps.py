"""What a search asks first and what it need not ask: place and form of the leading cause, forces, refits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain import answer, held_out
from modalax.diagnose.modal_domain.fitting import fit as fits
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior, ranked_by
from modalax.diagnose.modal_domain.odd_channels import odd_channel
from modalax.diagnose.modal_domain.search import explain, refitted, starts, steps
from modalax.diagnose.modal_domain.search.screen import couples
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.thresholds import THRESHOLDS

MASS = 0.8  # kg, more than half of what is at its place


def task_of(mass=MASS, seed=3):
    """A chain 1 % off with a mass at its third place, which is compared with the simulation."""
    M, C, K = chain_off(seed, 0.01)
    M[2, 2] += mass
    data = as_measured(response(M, C, K, FREQ), FREQ, 4)
    return posed(data, simulation(), identified(data, simulation(), lambda _: None))


def cause(task, slug, *where):
    return next(c for c in task.candidates if (c.slug, c.where) == (slug, where) and c.pattern is None)


@pytest.fixture(scope="module")
def task():
    return task_of()


@pytest.fixture(scope="module")
def null(task):
    return fits.fit(task.setting)


def test_the_leading_cause_gets_its_place_and_form_before_anything_is_sought_beside_it(task, monkeypatch):
    monkeypatch.setattr(steps, "explains", lambda f: True)  # a neighbour's place explains much of it
    search = steps.Search(task.setting, {}, task.setting, task.candidates)
    beside = cause(task, "added_mass", DOFS[1])
    search.fit((beside,), beside.of_size(1.0), None)
    steps.settled(search, Deadline())
    (best,) = search.best.causes
    assert (best.slug, best.where) == ("added_mass", (DOFS[2],))
    assert all(len(causes) == 1 for causes in search.found)
    assert {c.along for (c,) in search.found if c.where == best.where} > {""}


def test_nothing_is_settled_where_no_cause_or_several_lead_or_time_is_up(task, null):
    search = steps.Search(task.setting, {(): null}, task.setting, task.candidates)
    steps.settled(search, Deadline())
    assert list(search.found) == [()]
    one = cause(task, "added_mass", DOFS[2])
    search.fit((one,), one.of_size(1.0), None)
    steps.settled(search, Deadline(-1.0))
    assert len(search.found) == 2


def test_what_candidates_do_beside_a_fit_is_worked_out_once(task, null, monkeypatch):
    calls = []
    about = steps.about
    monkeypatch.setattr(steps, "about", lambda *a: calls.append(1) or about(*a))
    search = steps.Search(task.setting, {(): null}, task.setting, task.candidates)
    assert search.about(null) is search.about(null) and len(calls) == 1
    search.about(replace(null))
    search.setting = replace(task.setting)
    search.about(null)
    search.asked = task.candidates[:-1]  # as losses of a joint join them
    assert len(search.about(null).candidates) == len(task.candidates) - 1 and len(calls) == 4


@pytest.mark.parametrize(("far", "tried"), [(0.0, True), (explain.MOSTLY, False)])
def test_forces_are_not_tried_where_another_change_explains_most(task, null, far, tried, monkeypatch):
    asked, finite = [], starts.finite
    monkeypatch.setattr(starts, "finite", lambda s, some, *a: asked.extend(some) or finite(s, some, *a))
    share = Prior(task.candidates).each(task.candidates)
    first = next(iter(starts.starts(task.setting, null, task.candidates, share, far)))
    assert (first[0].slug, first[0].where) == ("added_mass", (DOFS[2],))
    assert any(couples(c) for c in asked) == tried


def test_a_fit_that_does_not_lead_below_its_basin_ends(task, null, monkeypatch):
    count, linear_at = [], fits.linear_at
    monkeypatch.setattr(fits, "linear_at", lambda *a: count.append(1) or linear_at(*a))
    far = fits.fit(task.setting, temperatures=(), basin=1e9)
    whole = len(count)
    count.clear()
    short = fits.fit(task.setting, temperatures=(), basin=-1e9)
    assert len(count) == 2 < whole and short.log_evidence < far.log_evidence


def test_explanations_are_fitted_again_only_where_the_setting_has_changed(task, null, monkeypatch):
    one = cause(task, "added_mass", DOFS[2])
    found = {(): null}
    attempt(task.setting, found, (one,), one.of_size(1.0), None)
    monkeypatch.setattr(refitted, "_fitted_again", lambda *a: pytest.fail("nothing has changed"))
    monkeypatch.setattr(refitted, "_asked_beside", lambda bare, setting, e: replace(setting))
    setting, same = refitted.beside_a_factor(task.setting, task.setting, found, Prior(task.candidates))
    assert setting is task.setting and same is found


def test_beside_the_rest_only_what_may_still_lead_is_fitted_again(task, null, monkeypatch):
    prior, one = Prior(task.candidates), cause(task, "added_mass", DOFS[2])
    found = {(): null}
    attempt(task.setting, found, (one,), one.of_size(1.0), None)
    best = found[(one,)]
    others = [cause(task, "local_damper", name) for name in DOFS[:3]]
    near, far, last = ((one, c) for c in others)
    found[near] = replace(best, causes=near, log_evidence=best.log_evidence - 1.0)
    found[far] = replace(best, causes=far, log_evidence=best.log_evidence - 3 * refitted.FAR)
    found[last] = replace(best, causes=last, log_evidence=best.log_evidence - 4 * refitted.FAR)
    again = []
    monkeypatch.setattr(refitted, "learnt_rest", lambda setting, *a: (setting, 1.0))
    monkeypatch.setattr(
        refitted, "attempt", lambda s, new, causes, *a, **k: again.append(causes) or new.update({causes: best})
    )
    assert ranked_by(found, prior)[0].causes == (one,)
    refitted.beside_the_rest(task.setting, found, prior, lambda: False)
    assert set(again) == {(one,), near, ()} and len(again) == 3
    # what leads is not lost where it has no fit there
    monkeypatch.setattr(refitted, "attempt", lambda s, new, causes, *a, **k: new.update({(): null}))
    for step in (refitted.beside_the_rest, refitted.rest_anew):
        setting, same = step(replace(task.setting, rest=0.01), found, prior, lambda: False)
        assert same is found and setting.rest == 0.01


def test_the_general_inaccuracy_alone_is_not_fitted_without_a_block_where_it_is_far_off(task, null):
    away = replace(null, chi2=2 * explain.UNLIKE * null.state.difference.size)
    assert held_out._without(SimpleNamespace(), away, SimpleNamespace()) is away


@pytest.mark.parametrize("left", [0.5, 20.0])
def test_no_odd_channel_is_asked_for_where_the_structure_is_settled_and_all_channels_are_off(
    task, null, left, monkeypatch
):
    one, asked = cause(task, "added_mass", DOFS[2]), []
    monkeypatch.setattr(odd_channel, "fit", lambda *a, **k: asked.append(1))
    monkeypatch.setattr(odd_channel, "_left_beside", lambda W, r: left * len(r))
    best = replace(null, causes=(one,), u=np.ones(1))
    for misfit, tried in ((0.9, left < odd_channel.UNLIKE), (3.0, True)):
        asked.clear()
        explanations = [Explanation(best, 0.0, 1.0, misfit), Explanation(null, -1e3, 0.0, 50.0)]
        assert odd_channel.odd_channel(task.setting, explanations, DOFS[:4], DOFS[:1]) is None
        assert bool(asked) == tried


def test_what_is_detectable_is_the_median_of_an_even_choice_of_places(task, null, monkeypatch):
    stage = SimpleNamespace(setting=task.setting, candidates=task.candidates)
    told = SimpleNamespace(stage=stage, chosen=SimpleNamespace(fit=null))
    every = answer.ModalDiagnosis.smallest_detectable.fget(told)
    monkeypatch.setattr(answer, "PLACES", 2)
    few, counted = [], answer.errors_of
    monkeypatch.setattr(answer, "errors_of", lambda s, f, some: few.extend(some) or counted(s, f, some))
    some = answer.ModalDiagnosis.smallest_detectable.fget(told)
    assert some.keys() == every.keys() and max(sum(c.slug == slug for c in few) for slug in some) <= 2
    whole = dict(zip(task.candidates, counted(task.setting, null, task.candidates), strict=True))
    for slug, value in some.items():
        chosen = [whole[c] * c.scale for c in few if c.slug == slug]
        assert value == pytest.approx(np.nanmedian(chosen) * (THRESHOLDS.stands_out + THRESHOLDS.power))


def test_where_the_inaccuracy_explains_all_and_nothing_promises_more_no_finite_change_is_tried(monkeypatch):
    """Some twenty fits from the simulation as it is took half of the time where nothing is wrong among many sensors."""
    task = task_of(mass=0.0)
    null = fits.fit(task.setting)
    share = Prior(task.candidates).each(task.candidates)
    monkeypatch.setattr(starts, "finite", lambda *a: pytest.fail("nothing promises anything"))
    assert list(starts.starts(task.setting, null, task.candidates, share)) == []
    assert list(starts.starts(task.setting, null, [], np.zeros(0))) == []
    # what is likelier before the data, or where much is left, is worth it
    for likelier in (share + 20.0, None):
        tried = []
        monkeypatch.setattr(starts, "finite", lambda setting, some, *a, tried=tried: tried.append(some) or tuple(
            np.full((2, len(some)), 1e3)))  # fmt: skip
        if likelier is None:
            monkeypatch.setattr(starts, "explains", lambda f: False)
        list(starts.starts(task.setting, null, task.candidates, share if likelier is None else likelier))
        assert tried


@pytest.mark.parametrize(("slugs", "fitted"), [((), 1), (("added_mass",), 3)])
def test_where_no_cause_is_needed_only_what_is_hardly_less_likely_is_fitted_again(slugs, fitted, task, null):
    causes = tuple(cause(task, slug, DOFS[2]) for slug in slugs)
    first = Explanation(replace(null, causes=causes, chi2=1.0), 0.0, 0.9)
    others = [Explanation(null, -behind, 0.05) for behind in (4.0, 10.0, 20.0)]
    assert len(refitted.near_the_first([first, *others], 12.0)) == fitted
    assert len(refitted.near_the_first([first, replace(others[0], log_posterior=-2.0)], 12.0)) == 2


def test_what_linear_scores_favour_at_all_is_fitted_from_where_the_inaccuracy_stands(monkeypatch):
    task = task_of(mass=0.2)
    null = fits.fit(task.setting)
    assert starts.explains(null)
    monkeypatch.setattr(starts, "PROMISING", np.inf)
    asked = list(starts.starts(task.setting, null, task.candidates, Prior(task.candidates).each(task.candidates)))
    assert 0 < len(asked) <= starts.NEXT
    assert all(u == 0.0 and start is not None and start.causes == () for _, u, start in asked)
    assert ("added_mass", (DOFS[2],)) in {(c.slug, c.where) for c, _, _ in asked}
