"""Heavy oscillators split a mode into two, far apart: where and how they are sought."""

from dataclasses import replace

import numpy as np
import pytest
from chains_off import FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.modal_domain.causes.change import own_sizes
from modalax.diagnose.modal_domain.causes.further_causes import MissingMode, TunedMass
from modalax.diagnose.modal_domain.fitting.attempts import key_of
from modalax.diagnose.modal_domain.fitting.discrepancy import learnt_rest
from modalax.diagnose.modal_domain.fitting.explanation import Prior
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.fitting.state import state_at
from modalax.diagnose.modal_domain.search import beside_modes
from modalax.diagnose.modal_domain.search.beside_modes import causes_beside_modes
from modalax.diagnose.modal_domain.search.oscillators import (
    _a_mode_instead,
    _heavy,
    _modes,
    acting_alike,
    alike,
    attached,
    attached_beside,
    oscillators,
)
from modalax.diagnose.modal_domain.search.refitted import rest_anew
from modalax.diagnose.modal_domain.stage import identified, posed

MASS, TUNED, LOSS = 0.3, 37.0, 0.015  # kg, Hz, damping ratio: a sixth of the modal mass there


def with_oscillator(seed, signs=1.0):
    """A chain that is off and carries the oscillator, its sensors times ``signs``."""
    M, C, K = (np.pad(A, (0, 1)) for A in chain_off(seed, 0.02))
    v, w = np.array([0.0, 0, 1, 0, 0, -1]), 2 * np.pi * TUNED
    M[5, 5] = MASS
    H = response(M, C + 2 * LOSS * w * MASS * np.outer(v, v), K + w**2 * MASS * np.outer(v, v), FREQ)
    data = as_measured(H * signs, FREQ, seed)
    return posed(data, simulation(), identified(data, simulation(), lambda _: None))


@pytest.fixture(scope="module", params=[1, 2])
def task(request):
    return with_oscillator(request.param)


@pytest.fixture(scope="module")
def turned():
    return with_oscillator(1, np.array([1, -1, 1, 1, 1])[:, None])


def test_each_mass_is_tuned_so_that_one_mode_is_where_one_is_too_many(task):
    cause = next(c for c in task.candidates if isinstance(c, TunedMass) and c.where == ("3:+Z",))
    near_to = 2 * np.pi * 41.0
    trials = _heavy(task.setting, cause, near_to)
    assert len(trials) > 7
    c, apart = task.coordinates, []
    for u in trials:
        values = np.linalg.eigvalsh(np.diag(c.frequencies**2) + cause.changes(u)["K"])
        apart.append(np.abs(np.sqrt(np.maximum(values, 0.0)) / near_to - 1).min())
    assert np.count_nonzero(np.array(apart) < 1e-9) >= 5  # compliance at that frequency itself
    assert max(apart) < 0.05  # and on either side


def test_its_place_leads_and_a_start_near_it_is_found_from_either_mode(task):
    poles = np.abs(task.setting.features.poles) / 2 / np.pi
    for number in np.argsort(np.abs(poles - TUNED))[:2]:
        extra = next(c for c in task.candidates if isinstance(c, MissingMode) and c.freed == number)
        found = oscillators(task.setting, task.candidates, extra)
        places = list(dict.fromkeys(cause.where for cause, _ in found[len(found) // 2 :]))  # the light ones come first
        assert places[0] == ("3:+Z",)
        mass, w, _ = next(c.values(u) for c, u in found[len(found) // 2 :] if c.where == ("3:+Z",))
        assert 0.4 * MASS < mass < 2.5 * MASS and abs(w / (2 * np.pi * TUNED) - 1) < 0.15


@pytest.mark.parametrize("explained", [False, True])
def test_it_is_sought_though_another_cause_leads_that_explains_nothing(task, explained):
    """Beside elements that are off, one of these may come nearer to the modes than what is too many."""
    setting, poles = task.setting, np.abs(task.setting.features.poles) / 2 / np.pi
    number = int(np.argmin(np.abs(poles - TUNED)))
    extra = next(c for c in task.candidates if isinstance(c, MissingMode) and c.freed == number)
    mass = next(c for c in task.candidates if c.slug == "added_mass" and c.where == ("1:+Z",))
    own = fit(setting, (extra,), None, np.zeros(extra.count))
    ahead = replace(own, causes=(mass,), log_evidence=own.log_evidence + 50.0, chi2=1.0 if explained else 1e9)
    found = {(extra,): own, (mass,): ahead}
    attached(setting, found, task.candidates, Prior(task.candidates), lambda: False)
    tried = {c.where for causes in found for c in causes if isinstance(c, TunedMass)}
    assert (("3:+Z",) in tried) is not explained


def test_from_a_place_that_leads_those_that_act_alike_are_fitted_until_none_is_likelier(task):
    """Beside what else is off, its own place may seem poor before it is fitted."""
    at = {c.where[0]: c for c in task.candidates if isinstance(c, TunedMass)}
    u = np.array([1.0, np.log(2 * np.pi * TUNED / at["3:+Z"].middle) / at["3:+Z"].width, 0.0])
    assert len(alike(task.setting, list(at.values()), at["1:+Z"], u)) == 4
    wrong = fit(task.setting, (at["1:+Z"],), None, u)
    found = {(at["1:+Z"],): wrong}
    acting_alike(task.setting, found, task.candidates, Prior(task.candidates), lambda: True)
    assert list(found) == [(at["1:+Z"],)]
    acting_alike(task.setting, found, task.candidates, Prior(task.candidates), lambda: False)
    best = max(found.values(), key=lambda f: f.log_evidence)
    assert best.causes[0].where == ("3:+Z",) and best.log_evidence > wrong.log_evidence + 20
    assert abs(best.causes[0].values(best.u)[0] / MASS - 1) < 0.15


def test_a_fault_of_a_channel_shows_beside_the_mode_that_is_too_many(turned):
    """Neither by itself comes near to the measured modes."""
    pairs = causes_beside_modes(turned.setting, turned.candidates, 400)
    assert {(c.slug, c.where) for c in pairs[0][1]} <= {(f"channel_{k}", ("2:+Z",)) for k in ("sign", "gain")}
    free = [c for c in turned.candidates if c.freed is not None]
    assert {modes for modes, fault, _ in pairs if not fault} == {(mode,) for mode in free}
    assert abs(abs(pairs[0][0][0].pole) / 2 / np.pi / TUNED - 1) < 0.15
    assert {c.kind for _, other, _ in pairs for c in other} >= {"", "K", "M"}
    over = replace(turned.setting, late=lambda: True)
    assert [other for _, other, _ in causes_beside_modes(over, turned.candidates, 400)] == [()] * len(free)


def test_nothing_is_paired_where_no_trial_has_all_modes(turned, monkeypatch):
    def lacking(*args):
        raise np.linalg.LinAlgError("fewer modes than measured")

    monkeypatch.setattr(beside_modes, "distances", lambda setting, shrink, trials, causes: np.full(len(trials), np.nan))
    assert causes_beside_modes(turned.setting, turned.candidates, 6) == []
    monkeypatch.setattr(beside_modes, "tolerance", lacking)
    assert causes_beside_modes(turned.setting, turned.candidates, 6) == []


def test_modes_are_tried_beside_a_mass_that_is_taken_away(turned):
    setting, u = turned.setting, np.array([0.8, 0.1, 0.0])
    cause = next(c for c in turned.candidates if isinstance(c, TunedMass) and c.where == ("3:+Z",))
    mass = next(c for c in turned.candidates if c.slug == "added_mass" and c.where == ("1:+Z",))
    whole = -1.0 / float(np.linalg.eigvalsh(mass.matrix).max())
    for size in (0.5 * whole, 2.0 * whole):  # beyond all that is there no mode is one, and none is infinite
        ((poles, residues),) = _modes(setting, cause, [u], ((mass,), np.array([size])))
        assert np.isfinite(poles).all() and np.isfinite(residues).all() and (poles.real < 0).all()


def test_it_is_sought_together_with_a_fault_of_a_channel(turned):
    """What a turned sensor does to all modes hides which mode is too many, and where the oscillator is."""
    setting, candidates, prior = turned.setting, turned.candidates, Prior(turned.candidates)
    at = next(c for c in candidates if isinstance(c, TunedMass) and c.where == ("1:+Z",))
    wrong = fit(setting, (at,), None, np.array([0.3, 0.0, 0.0]), temperatures=(3.0,))
    found = {(at,): wrong}
    attached_beside(setting, found, candidates, prior, lambda: True)
    assert list(found) == [(at,)]
    attached_beside(setting, found, candidates, prior, lambda: False)
    best = max(found.values(), key=lambda f: f.log_evidence)
    k = next(k for k, c in enumerate(best.causes) if isinstance(c, TunedMass))
    assert best.causes[k].where == ("3:+Z",) and {c.where for c in best.causes} == {("2:+Z",), ("3:+Z",)}
    assert abs(best.causes[k].values(best.u[own_sizes(best.causes, k)])[0] / MASS - 1) < 0.15
    # nothing is sought where one or two causes explain the modes, of which none is a mode too many
    again = {key_of(best.causes): best}
    attached_beside(setting, again, [c for c in candidates if not isinstance(c, TunedMass)], prior, lambda: False)
    assert not any(isinstance(c, TunedMass) for causes in list(again)[1:] for c in causes)


def test_what_made_a_mode_too_many_is_sought_beside_a_cause_that_explains_all_else(turned):
    setting, candidates, prior = turned.setting, turned.candidates, Prior(turned.candidates)
    sign = next(c for c in candidates if c.slug == "channel_sign" and c.where == ("2:+Z",))
    poles = np.abs(setting.features.poles) / 2 / np.pi
    extra = next(c for c in candidates if c.freed == int(np.argmin(np.abs(poles - TUNED))))
    both = fit(setting, (sign, extra), None, np.zeros(sign.count + extra.count))
    oscillators_only = [c for c in candidates if isinstance(c, TunedMass)]
    for left, asked in ((1.0, candidates), (1e9, oscillators_only)):  # whether it explains all that is measured or not
        found = {key_of(both.causes): replace(both, chi2=left)}
        attached_beside(setting, found, asked, prior, lambda: False)
        best = max(found.values(), key=lambda f: f.log_evidence)
        assert {(c.slug, c.where) for c in best.causes} == {("channel_sign", ("2:+Z",)), ("tuned_mass", ("3:+Z",))}
    # and where a mode too many that leads by itself leaves hardly more
    alone = fit(setting, (extra,), None, np.zeros(extra.count))
    for behind, sought in ((0.0, True), (50.0, False)):
        ahead = replace(alone, chi2=1.0, log_evidence=both.log_evidence + behind)
        found = {(extra,): ahead, key_of(both.causes): both}
        attached_beside(setting, found, candidates, prior, lambda: False)
        assert any(isinstance(c, TunedMass) for causes in found for c in causes) is sought


def test_a_mode_of_no_oscillator_is_tried_in_the_place_of_one_beside_another_cause():
    """Found while a gain was unknown, an oscillator hides that its mode has the shape of none."""
    w, s = 2 * np.pi * 50.0, 2j * np.pi * FREQ[:, None, None]
    shapes = np.outer([0.4, -0.3, 0.2, 0.5, -0.4], [0.3, 0.6, -0.4, 0.5, 0.2])
    H = response(*chain_off(1, 0.02), FREQ) + shapes * s**2 / (w**2 + 2 * LOSS * w * s + s**2)
    data = as_measured(H * np.array([1, 1.3, 1, 1, 1])[:, None], FREQ, 1)
    task = posed(data, simulation(), identified(data, simulation(), lambda _: None))
    gain = next(c for c in task.candidates if c.slug == "channel_gain" and c.where == ("2:+Z",))
    at = next(c for c in task.candidates if isinstance(c, TunedMass) and c.where == ("3:+Z",))
    u = np.array([0.3 / gain.scale, 0.1, np.log(w / at.middle) / at.width, 0.0])
    wrong = replace(fit(task.setting, (gain, at), None, u), chi2=1.0)
    found, asked = {key_of(wrong.causes): wrong}, (task.setting, task.candidates, Prior(task.candidates))
    _a_mode_instead(asked[0], found, *asked[1:], lambda: True)
    assert list(found) == [key_of(wrong.causes)]
    attached_beside(asked[0], found, *asked[1:], lambda: False)
    best = max(found.values(), key=lambda f: f.log_evidence)
    assert {c.slug for c in best.causes} == {"channel_gain", "missing_mode"}
    assert abs(next(c.pole for c in best.causes if isinstance(c, MissingMode)).imag / w - 1) < 0.01
    count = len(found)
    attached_beside(asked[0], found, *asked[1:], lambda: False)
    assert len(found) == count  # where no oscillator leads none is tried


def test_the_rest_is_learnt_anew_about_what_leads(turned):
    """About what explained nothing it is as large as may be, and lines are then fitted by it."""
    setting, candidates, prior = turned.setting, turned.candidates, Prior(turned.candidates)
    at = next(c for c in candidates if isinstance(c, TunedMass) and c.where == ("3:+Z",))
    sign = next(c for c in candidates if c.slug == "channel_sign" and c.where == ("2:+Z",))
    u = np.array([0.0, np.sqrt(MASS / at.scale), np.log(2 * np.pi * TUNED / at.middle) / at.width, 0.0])
    wide, size = learnt_rest(setting, [fit(setting, (at,), None, u[1:])], [0.0])
    assert size > 0.02
    found = {key_of((sign, at)): fit(wide, (sign, at), None, u)}
    setting, again = rest_anew(wide, found, prior, lambda: False)
    assert setting.rest < 0.1 * size and list(again) == list(found)


def test_modes_that_are_tried_hold_what_is_found_already(turned):
    """A mass that was added and a sensor that points the other way, to the precision of proportional damping."""
    setting = turned.setting
    cause = next(c for c in turned.candidates if isinstance(c, TunedMass) and c.where == ("3:+Z",))
    mass = next(c for c in turned.candidates if c.slug == "added_mass" and c.where == ("1:+Z",))
    sign = next(c for c in turned.candidates if c.slug == "channel_gain" and c.where == ("2:+Z",))
    u, kept = np.array([0.8, 0.1, 0.0]), np.array([0.7, -2.0 / sign.scale])
    ((poles, residues),) = _modes(setting, cause, [u], ((mass, sign), kept))
    exact = state_at(setting, np.zeros(len(setting.inaccuracy.group_of)), (cause, mass, sign), np.append(u, kept))
    assert np.allclose(np.abs(poles), np.abs(exact.modes.poles[: len(poles)]), rtol=2e-3)
    assert np.allclose(residues, exact.residues[: len(poles)], atol=0.02 * np.abs(exact.residues).max())
