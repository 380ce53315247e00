"""A joint fitted together with the modes over force levels, on an oscillator that is solved in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose_laws import CUBIC, FREQ, HERTZ, LEVELS, MASS, ZETA, hardening, oscillator

from modalax import Measurement, ModalModel
from modalax.diagnose import catalogue, pipeline
from modalax.diagnose.deadline import NEVER
from modalax.diagnose.joint_laws import compare_laws
from modalax.diagnose.jointed.answer import diagnose_joint, gain_of, joint_comes_first, may_have_joint
from modalax.diagnose.jointed.bent import must_move
from modalax.diagnose.jointed.fits import correlation_length, reach_of, suited

SHARE, LINES = 0.02, 5  # error of each sample over itself, alike over some lines, as no law and no noise has it


def measured(force):
    """An error of the model rather than noise: a share of each sample that changes slowly over the lines."""
    H = np.stack([hardening(np.full(len(FREQ), f), FREQ) for f in force])
    rng = np.random.default_rng(3)
    e = rng.normal(size=(2, len(force), len(FREQ) + LINES))
    e = np.apply_along_axis(np.convolve, 2, e, np.ones(LINES) / np.sqrt(LINES), "same")[:, :, : len(FREQ)]
    H = H * (1 + SHARE / np.sqrt(2) * (e[0] + 1j * e[1]))
    return Measurement(FREQ, H[:, :, None, None], level=np.array(force), outputs=("1",), inputs=("1",))


def test_levels_modes_and_places_decide_whether_it_is_tried():
    data = measured(LEVELS)
    assert suited(data, oscillator()) and may_have_joint(data, oscillator())
    assert not may_have_joint(data, None)
    two = Measurement(FREQ, np.asarray(data.H)[:2], level=[1.0, 2.0], outputs=("1",), inputs=("1",))
    assert not suited(two, oscillator())
    same = data.replace(level=np.array([1.0, 1.0, 2.0]))
    assert not suited(same, oscillator())
    undriven = Measurement(FREQ, data.H, level=data.level, outputs=("1",), inputs=("2",))
    assert not suited(undriven, oscillator())


def test_the_correlation_length_is_that_of_a_known_process():
    rng, rho = np.random.default_rng(0), 0.6
    e = rng.normal(size=(4000, 2)) @ [1, 1j]
    r = [e[0]]
    for x in e[1:]:
        r.append(rho * r[-1] + x)
    assert correlation_length(np.array(r)[None, :, None, None]) == pytest.approx((1 + rho) / (1 - rho), rel=0.25)
    assert correlation_length(e[None, :, None, None]) == pytest.approx(1.0, abs=0.2)


def test_modes_must_move_where_only_a_joint_with_free_modes_explains_the_levels():
    assert must_move(100.0, 1.0, 2.0, 200, 4)  # 69 nats, less 11 for the unknowns
    assert not must_move(100.0, 1.0, 1.1, 200, 4)
    assert not must_move(100.0, 1.0, 2.0, 20, 4)
    assert not must_move(5.0, 1.0, 2.0, 200, 4)  # no joint explains the levels


def test_a_joint_never_comes_first_where_the_simulation_may_move_or_has_more_than_its_modes_in_the_band():
    data = measured(LEVELS)
    assert not joint_comes_first(data, oscillator(0.002).replace(frequency_std=0.002))
    beyond = ModalModel.from_real_modes([HERTZ * 1.002, 2 * HERTZ], [ZETA] * 2, [[1.0], [1.0]], [MASS] * 2, ["1"])
    assert not joint_comes_first(data, beyond)


def test_the_joint_that_comes_first_is_the_answer(monkeypatch):
    """No search about the modes as they are takes place; without a joint it does."""
    data, asked, joint = measured(LEVELS), [], SimpleNamespace(verdict="unknown", causes=[], question="free")
    monkeypatch.setattr(pipeline, "joint_comes_first", lambda *_: True)
    monkeypatch.setattr(pipeline, "diagnose_joint", lambda *_: asked.append("joint") or joint)
    monkeypatch.setattr(pipeline, "line_by_line", lambda *_: pytest.fail("searched line by line"))
    assert pipeline.diagnose(data, oscillator(0.002)) is joint and asked == ["joint"]


@pytest.mark.slow
def test_a_joint_comes_first_where_the_modes_must_move_before_any_joint_explains_the_levels():
    """The modes as they are do beside the true ones; those bent by 0.2 % do not, unless their author claims as much."""
    data = measured(LEVELS)
    assert not joint_comes_first(data, oscillator())
    assert joint_comes_first(data, oscillator(0.002))


def test_reach_is_the_largest_motion_that_was_fitted():
    data = measured(LEVELS)
    expected = np.max(np.array(LEVELS)[:2, None] * np.abs(np.asarray(data.H))[:2, :, 0, 0])
    assert reach_of(data, ("1",), 2) == pytest.approx(expected)


def test_the_gain_is_that_of_gaussian_likelihoods():
    rng = np.random.default_rng(1)
    before, after = 3 * rng.normal(size=(40, 1, 1)) + 0j, rng.normal(size=(40, 1, 1)) + 0j
    gain = gain_of(before, after, "run 3")
    assert gain.chi2_before == pytest.approx((np.abs(before) ** 2).sum() / 80)
    assert gain.log_likelihood_gain == pytest.approx(40 * (gain.chi2_before - gain.chi2_after))


def test_a_run_that_is_held_out_is_predicted():
    data = measured(LEVELS)
    (e,) = compare_laws(data, oscillator(), [[]], place="1", sigma=SHARE * np.abs(np.asarray(data.H)), held_out=[2])
    assert e.samples == 2 * 2 * len(FREQ)
    assert (np.abs(e.residual[:2]) ** 2).sum() == pytest.approx(e.chi2, rel=1e-9)
    assert (np.abs(e.residual[2]) ** 2).sum() > (np.abs(e.residual[1]) ** 2).sum()


@pytest.mark.slow
def test_a_run_that_is_held_out_is_not_fitted():
    data = measured(LEVELS)
    sigma = SHARE * np.abs(np.asarray(data.H))
    other = np.asarray(data.H).copy()
    other[2] *= 0.5
    fits = [
        compare_laws(d, oscillator(), [[]], place="1", sigma=sigma, held_out=[2])[0]
        for d in (data, data.replace(H=other))
    ]
    assert fits[0].chi2 == pytest.approx(fits[1].chi2, rel=1e-8)
    np.testing.assert_allclose(fits[0].residual[:2], fits[1].residual[:2], rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_law_and_prediction_of_a_level_that_was_not_fitted():
    """The simulation's mode is bent by the joint, the errors are a share of each sample: no noise is stated."""
    data = measured(LEVELS)
    found = diagnose_joint(data, oscillator(0.002), catalogue(3), NEVER, lambda _: None)
    assert found is not None
    told = found.to_dict()
    assert told["verdict"] in ("named", "ambiguous")
    assert [(c["name"], c["where"]) for c in told["causes"]] == [("cubic_stiffness", ["1"])]
    k3 = told["causes"][0]["parameters"]["cubic_stiffness"]
    assert abs(k3["value"] - CUBIC) < 3 * k3["std"] < 0.3 * CUBIC
    assert found.chosen.held < 0.2 * found.joints.linear.held
    assert found.joints.free[0].held < 0.5 * found.joints.linear.held
    assert {m["joint"] for m in told["evidence"]["over_amplitude"]} == {"chosen", "free"}
