"""Many sensors: causes are looked for by the leading directions of shapes, and fitted to all in the end."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from frames import heavier, measured, simulation
from test_modal_repeated import measured as measured_ring
from test_modal_repeated import setting_of, uneven

from modalax.diagnose.modal_domain import held_out
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting import narrowed as module
from modalax.diagnose.modal_domain.fitting import state as states
from modalax.diagnose.modal_domain.fitting.narrowed import along_leading, narrowed
from modalax.diagnose.modal_domain.fitting.state import screening_slopes, slopes_at, state_at
from modalax.diagnose.modal_domain.modes.features import Features, chosen, whitener_of
from modalax.diagnose.modal_domain.search import explain as search
from modalax.diagnose.modal_domain.search import steps
from modalax.diagnose.modal_domain.stage import identified, posed


def beam_setting(inputs=2):
    data = measured(2, 0.01, mass=("5:+Z", 0.05), lines=120)[0]
    few = {name: getattr(data, name)[..., :inputs] for name in ("H", "variance")}
    data = data.replace(**few, inputs=data.inputs[:inputs])
    return posed(data, simulation(), identified(data, simulation(), lambda _: None))


def few_of(setting, monkeypatch, leading=2):
    monkeypatch.setattr(module, "LEADING", leading)
    few = narrowed(setting)
    assert few is not None
    return few


@pytest.mark.parametrize(("repeated", "below"), [(False, 0), (True, 0), (True, 1)])
def test_leading_directions_are_some_of_all_turned(repeated, below, monkeypatch):
    """Also where modes of one frequency are the first of all, those ``below`` left out."""
    whole = setting_of(measured_ring(uneven(0.01, 1)), uneven(0.01, 2))[1] if repeated else beam_setting().setting
    f = chosen(whole.features, np.arange(len(whole.features.poles)) >= below)
    whole = replace(whole, features=f, whitener=whitener_of(f))
    assert not below or f.grouped[0]
    assert bool(whole.features.groups) == repeated
    few = few_of(whole, monkeypatch)
    count, width = len(few.features.poles), few.features.width
    assert width == 4 + 2 * (2 + min(2, whole.features.residues.shape[2] - 1)) < whole.features.width
    still = np.zeros(len(whole.inaccuracy.group_of))
    seen, state = few.features, state_at(few, still)
    # all of the directions, turned, are as far from the simulation and know as much of its errors
    o, i = whole.features.residues.shape[1:]
    turned = along_leading(whole.features, whole.coordinates, o - 1, i - 1)
    turned = replace(whole, features=turned, whitener=whitener_of(turned))
    there, here = state_at(whole, still), state_at(turned, still)
    assert np.linalg.norm(here.difference) == pytest.approx(np.linalg.norm(there.difference), rel=1e-5)
    assert np.linalg.norm(state.difference) < np.linalg.norm(there.difference)  # as a part of them is
    A, B = slopes_at(whole, there), slopes_at(turned, here)
    np.testing.assert_allclose(B.T @ B, A.T @ A, rtol=1e-4, atol=1e-5 * np.abs(A.T @ A).max())
    np.testing.assert_allclose(few.whitener @ seen.covariance @ few.whitener.T, np.eye(count * width), atol=1e-6)
    # derivatives along the directions are those of residues over all channels, and those of small steps
    J = slopes_at(few, state)
    with monkeypatch.context() as patch:
        patch.setattr(states, "by_features", lambda t, *_: t)
        np.testing.assert_allclose(J, slopes_at(few, state), rtol=1e-6, atol=1e-9 * np.abs(J).max())
    for k in range(0, len(still), 7):
        step = 1e-6 * (np.arange(len(still)) == k)
        moved = (state_at(few, -step).difference - state_at(few, step).difference) / 2e-6
        np.testing.assert_allclose(J[:, k], moved, atol=2e-4 * np.abs(J[:, k]).max() + 1e-3)


def test_so_many_more_directions_hold_next_to_all_that_very_many_sensors_tell():
    """And where there are hardly more of them, all are kept."""
    setting = beam_setting().setting
    assert narrowed(setting) is None is narrowed(setting, 6)
    whole, some = setting, narrowed(setting, 4)
    assert some is not None and some.features.width == 4 + 2 * (4 + 1) < whole.features.width
    still = np.zeros(len(whole.inaccuracy.group_of))
    told = [np.linalg.norm(slopes_at(x, state_at(x, still)), axis=0) for x in (some, whole)]
    stiffness = whole.inaccuracy.group_of == 0
    assert (told[0] <= told[1] * (1 + 1e-6)).all() and (told[0] > 0.9 * told[1])[stiffness].all()


@pytest.mark.slow
def test_very_many_sensors_are_fitted_by_many_directions_in_the_end(monkeypatch):
    data, _ = measured(2, 0.01, mass=("5:+Z", 0.05), lines=120)
    monkeypatch.setattr(module, "LEADING", 2)
    for part in (search, held_out):
        monkeypatch.setattr(part, "DIRECTIONS", 4)
    found = diagnose_modes(data, simulation())
    assert found.verdict == "named" and found.stage.setting.features.width == 4 + 2 * (4 + 1)
    assert [(c["name"], c["where"]) for c in found.causes] == [("added_mass", ["5:+Z"])]


@pytest.mark.parametrize("inputs", [1, 2])
def test_screening_by_the_directions_is_that_over_all_channels(inputs, monkeypatch):
    task = beam_setting(inputs)
    few = few_of(task.setting, monkeypatch)
    state = state_at(few, np.zeros(len(few.inaccuracy.group_of)))
    G = screening_slopes(few, state, task.candidates)
    monkeypatch.setattr(states, "by_features", lambda t, *_: t)
    np.testing.assert_allclose(G, screening_slopes(few, state, task.candidates), atol=1e-8 * np.abs(G).max())


def test_a_mass_is_named_by_few_directions_and_fitted_to_all(monkeypatch):
    data, plain = heavier()
    monkeypatch.setattr(module, "LEADING", 2)
    steps = []
    found = diagnose_modes(data, simulation(), tell=steps.append)
    assert "fitting the leading ones to all channels" in steps
    assert found.verdict == plain.verdict == "named"
    assert [(c["name"], c["where"]) for c in found.causes] == [("added_mass", ["5:+Z"])]
    assert found.stage.setting.features.values.shape == plain.stage.setting.features.values.shape
    told, other = (f.causes[0]["parameters"]["mass"] for f in (found, plain))
    assert told["value"] == pytest.approx(other["value"], abs=0.3 * other["std"])
    assert 0.6 < told["std"] / other["std"] < 1.7  # the rest that no element explains is learnt from the few


def test_where_the_inaccuracy_is_far_off_and_one_cause_explains_all_no_others_are_fitted_first(monkeypatch):
    data, _ = measured(2, 0.01, mass=("5:+Z", 0.5), lines=120)
    fitted, told = [], []
    attempt = steps.attempt

    def counted(setting, found, causes, *rest, **more):
        fitted.append(causes)
        attempt(setting, found, causes, *rest, **more)

    monkeypatch.setattr(steps, "attempt", counted)
    found = diagnose_modes(data, simulation(), tell=told.append)
    assert [(c["name"], c["where"]) for c in found.causes] == [("added_mass", ["5:+Z"])]
    assert not any(step.startswith("fitting") for step in told)
    first = [causes for causes in fitted if len(causes) == 1][: steps.FITTED]
    assert any(c.slug == "added_mass" and c.where == ("5:+Z",) for (c,) in first)


@pytest.mark.parametrize("known", [1.0, 1e-18], ids=["alike", "a combination that is known far better"])
def test_whitened_features_are_uncorrelated_and_of_unit_variance(known):
    rng = np.random.default_rng(0)
    size = np.geomspace(1e-5, 1.0, 6)
    A = rng.standard_normal((6, 6)) * size[:, None]
    covariance = A @ np.diag([1.0, 1.0, 1.0, 1.0, 1.0, known]) @ A.T
    f = Features(*(np.zeros((1, 1, 1)) for _ in range(4)), np.zeros((1, 6)), covariance)
    W = whitener_of(f)
    kept = 6 if known == 1.0 else 5
    values = np.sort(np.linalg.eigvalsh(W @ covariance @ W.T))
    np.testing.assert_allclose(values[-kept:], 1.0, rtol=1e-5)
    assert (np.abs(np.tril(W, -1)).max() == 0) == (known == 1.0)
    if known == 1.0:
        expected = scipy.linalg.inv(covariance)
        np.testing.assert_allclose(W.T @ W, expected, rtol=1e-7)
