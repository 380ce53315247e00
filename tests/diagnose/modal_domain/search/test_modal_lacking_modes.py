"""Measured modes that the simulation has not: one close to another, also beside a second cause, and several."""

from dataclasses import replace

import numpy as np
import pytest
from chains_off import FREQ, as_measured, chain_off, response, simulation
from kinds import few_or_all

from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.measured import reidentified, told_one_by_one
from modalax.diagnose.modal_domain.search.beside_modes import shortage
from modalax.diagnose.modal_domain.search.lacking_modes import lacking_modes
from modalax.diagnose.modal_domain.stage import identified, posed

BESIDE, DAMPING = 1.011, 0.007  # frequency, relative to that of the chain's third mode, and damping ratio of the mode
SHAPE, FORCE = np.array([0.4, -0.7, 0.5, 0.8, -0.3]), np.array([0.6, 0.2, -0.4, 0.5, 0.7])


def third_mode(seed):
    M, _, K = chain_off(seed, 0.02)
    return np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)[2])


def with_a_mode(seed, gain=1.0, extra=1.0):
    """Accelerances of a chain that is off, of which one sensor has a ``gain``, and a mode ``extra`` times as large."""
    w, s = BESIDE * third_mode(seed), 2j * np.pi * FREQ[:, None, None]
    own = np.outer(SHAPE, FORCE) * s**2 / (w**2 + 2 * DAMPING * w * s + s**2)
    H = response(*chain_off(seed, 0.02), FREQ) + extra * own
    H[:, 1] *= gain
    return as_measured(H, FREQ, seed)


@pytest.fixture(scope="module")
def data():
    return with_a_mode(3, 1.2)


@pytest.fixture(scope="module")
def measured(data):
    return identified(data, simulation(), lambda _: None)


def test_each_of_two_close_modes_is_compared_by_itself(data, measured):
    assert np.count_nonzero(measured.features.grouped) == 2
    apart = told_one_by_one(measured)
    assert apart is not None and not apart.features.grouped.any()
    both = apart.features.poles[np.argsort(np.abs(np.abs(apart.features.poles) - third_mode(3)))[:2]]
    assert np.allclose(np.abs(both), third_mode(3) * np.array([1.0, BESIDE]), rtol=1e-3)
    again = reidentified(apart, np.asarray(data.H), 0.0 * np.asarray(data.H)[0].real)
    assert not again.features.grouped.any() and np.allclose(again.features.poles, apart.features.poles, rtol=1e-6)
    assert told_one_by_one(identified(with_a_mode(3, extra=0.0), simulation(), lambda _: None)) is None


def test_no_more_modes_are_found_again_than_the_simulation_lets_expect(data, measured):
    """What a joint that was taken out leaves about each peak had become modes, as many as a band can hold."""
    H, wave = np.asarray(data.H), np.exp(0.4j * np.sin(np.arange(len(FREQ)) / 3))[:, None, None]
    assert measured.most == 2 * 5 + 12
    own = len(measured.modes.poles)
    found = {n: len(reidentified(replace(measured, most=n), H * wave, 0.0 * H[0].real).modes.poles) for n in (own, 22)}
    assert found[own] <= own < found[22] <= 22


def test_a_simulation_of_fewer_modes_lacks_one(data, measured):
    apart = told_one_by_one(measured)
    task = posed(data, simulation(), apart)
    assert shortage(task.setting) == 1
    found = lacking_modes(task.setting, task.candidates, measured.features)
    best = max(found.values(), key=lambda f: f.log_evidence)
    assert {(c.slug, c.where) for c in best.causes} == {("missing_mode", ()), ("channel_gain", ("2:+Z",))}
    # not where all that is told together is one thing
    assert lacking_modes(task.setting, task.candidates, apart.features) == {}
    others = [c for c in task.candidates if c.freed is None]
    assert lacking_modes(task.setting, others, measured.features) == {}
    whole = with_a_mode(3, extra=0.0)
    assert shortage(posed(whole, simulation(), identified(whole, simulation(), lambda _: None)).setting) == 0


@few_or_all("missing_mode", "tuned_mass")
@pytest.mark.parametrize("gain", [1.0, 1.2])
def test_it_is_named_beside_another_cause_and_alone(gain, wanted):
    found = diagnose_modes(with_a_mode(4, gain), simulation(), wanted=wanted)
    told = {c["name"]: c for c in found.causes}
    assert found.verdict == "named" and set(told) == {"missing_mode"} | ({"channel_gain"} if gain != 1 else set())
    mode = told["missing_mode"]["parameters"]
    for name, true in (("frequency", BESIDE * third_mode(4) / 2 / np.pi), ("damping_ratio", DAMPING)):
        assert abs(mode[name]["value"] - true) < 4 * mode[name]["std"] < 0.2 * true
    assert found.gain.chi2_unforeseen < 1.2 and found.gain.chi2_after < 1e-3 * found.gain.chi2_before
    if gain != 1:
        assert told["channel_gain"]["where"] == ["2:+Z"]
        size = told["channel_gain"]["parameters"]["gain"]
        assert abs(size["value"] - 0.2) < 4 * size["std"] < 0.05


@few_or_all("missing_mode", "tuned_mass")
@pytest.mark.parametrize("gain", [1.0, pytest.param(1.2, marks=pytest.mark.slow)])
def test_several_are_named_each_with_its_frequency(gain, wanted):
    """Beside one that is left free another would be taken for a mode of elements that are all far off."""
    hertz, s = (51.0, 80.0), 2j * np.pi * FREQ[:, None, None]
    H = response(*chain_off(5, 0.02), FREQ)
    for k, w in enumerate(2 * np.pi * np.array(hertz)):
        H += np.outer(np.roll(SHAPE, k), np.roll(FORCE, 2 * k)) * s**2 / (w**2 + 2 * DAMPING * w * s + s**2)
    H[:, 1] *= gain
    data = as_measured(H, FREQ, 5)
    assert shortage(posed(data, simulation(), identified(data, simulation(), lambda _: None)).setting) == 2
    found = diagnose_modes(data, simulation(), wanted=wanted)
    told = [c["parameters"]["frequency"] for c in found.causes if c["name"] == "missing_mode"]
    assert found.verdict == "named" and len(found.causes) == (2 if gain == 1 else 3)
    assert all(abs(f["value"] - true) < 4 * f["std"] < 0.1 for f, true in zip(told, hertz, strict=True))
    assert found.gain.chi2_unforeseen < 1.2
