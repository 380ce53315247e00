"""Line by line from what the modal domain has named: nothing is searched for again that is explained."""

from functools import cache

import numpy as np
import pytest

from modalax import Measurement, Structure
from modalax.diagnose.causes.channels import ChannelGain, ChannelSign, TimeDelay, Units
from modalax.diagnose.causes.joints import BilinearStiffness
from modalax.diagnose.causes.local import AddedMass, JointStiffness, LocalDamper
from modalax.diagnose.comparison import empty, make_comparison
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.stage import identified
from modalax.diagnose.pipeline import searched
from modalax.diagnose.routes import named_before
from modalax.diagnose.search import explain
from modalax.diagnose.search.look import look
from modalax.diagnose.search.named_before import NamedCause, explained_by, starts_of
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 70.0, 128)
CAUSES = [JointStiffness(), LocalDamper(), AddedMass(), ChannelGain(), ChannelSign(), TimeDelay()]
STIFFNESS = 2500.0
SPRING = NamedCause("joint_stiffness", ("5", "3"), (2400.0,))
MASS = NamedCause("added_mass", ("1",), (0.1,))  # nowhere


def measured(gain=1.0, noise=0.02):
    """The five masses with a spring between the third and the fifth, and the gain of the second output."""
    S, b = five_dof(), np.eye(5)[2] - np.eye(5)[4]
    S = Structure(S.M, S.C, np.asarray(S.K) + STIFFNESS * np.outer(b, b), S.dofs)
    H = np.array(S.frf(FREQ, inputs=("1", "4"), form="mobility").H)[None]
    H[:, :, 1] *= gain
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    rng = np.random.default_rng(1)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(FREQ, H, variance=sigma**2, form="mobility", outputs=S.dofs, inputs=("1", "4"))


@cache
def seen(gain=1.0):
    comparison = make_comparison(measured(gain), five_dof(), "fixed")
    return look(comparison, CAUSES, finite=False)


def test_the_catalogue_has_what_was_named_where_it_was_named():
    comparison = make_comparison(measured(), five_dof(), "fixed")
    null = empty(comparison)
    (h,) = starts_of(comparison, null, [SPRING, NamedCause("channel_gain", ("2",), (0.1,))], CAUSES)
    assert h.names == {("joint_stiffness", ("3", "5")), ("channel_gain", ("2",))}
    assert [p.tolist() for p in h.params] == [[2400.0], [0.1]] and h.freedom == 2
    ways = starts_of(comparison, null, [NamedCause("units", (), ())], [Units()])
    assert sorted(h.places[0].index[0] for h in ways) == [-1, 1]  # one integration more, or one less
    for unknown in (NamedCause("joint_stiffness", ("3", "9"), (1.0,)), NamedCause("gap", ("3", "5"), (1.0, 1.0))):
        assert starts_of(comparison, null, [unknown], CAUSES) == []
    assert starts_of(comparison, null, [], CAUSES) == []


def test_what_explains_the_lines_is_fitted_to_them_and_rivals_are_those_that_explain_as_much():
    first = seen()
    (best, *others), rest = explained_by(first, [SPRING], CAUSES)
    assert rest is not None and best.covariance is not None
    assert abs(best.params[0][0] - STIFFNESS) < 4 * np.sqrt(best.covariance[0, 0])
    assert best.chi2 < 1.1 * first.comparison.problem.samples and rest.p_value > 0.01
    assert len(others) <= 3 and all(h.chi2 > best.chi2 for h in others if h.names != best.names)


def test_a_spring_that_differs_in_push_and_pull_stands_beside_a_spring_that_was_named():
    """FRFs hardly tell the two apart, and no screening by a derivative promised as much of the former."""
    first = seen()
    (best, *others), _ = explained_by(first, [SPRING], [*CAUSES, BilinearStiffness()])
    assert best.names == {("joint_stiffness", ("3", "5"))}
    (alike,) = (h for h in others if h.names == {("bilinear_stiffness", ("3", "5"))})
    assert alike.chi2 == pytest.approx(best.chi2, rel=1e-6)
    ranked = explain.weigh(first, [best, alike])
    prior = BilinearStiffness.prior
    assert ranked[0].best is best and ranked[0].probability == pytest.approx(1 / (1 + prior), rel=1e-3)


def test_a_further_cause_is_looked_for_beside_what_was_named_and_leaves_something():
    first = seen(1.1)
    alone, rest = explained_by(first, [SPRING], CAUSES)
    assert {h.names for h in alone} == {frozenset({("joint_stiffness", ("3", "5"))})}
    assert rest is not None and rest.p_value < 1e-6
    (best, *_), left = explain.beside_named(first, alone, rest, CAUSES)
    assert best.names == {("joint_stiffness", ("3", "5")), ("channel_gain", ("2",))}
    assert left is not None and left.p_value > 0.01


@pytest.mark.parametrize(
    ("gain", "named", "all_again"), [(1.0, SPRING, False), (1.1, SPRING, False), (1.0, MASS, True)]
)
def test_a_search_begins_with_what_was_named_and_ends_there_only_if_all_is_explained(
    gain, named, all_again, monkeypatch
):  # fmt: skip
    calls = []
    singles = explain.singles
    monkeypatch.setattr(explain, "singles", lambda *a: calls.append(1) or singles(*a))
    comparison = make_comparison(measured(gain), five_dof(), "fixed")
    found = searched(comparison, CAUSES, lambda _: None, [named])
    assert found.verdict == "named" and len(calls) == all_again
    assert {c["name"] for c in found.causes} == {"joint_stiffness", *(["channel_gain"] if gain != 1.0 else [])}


def test_data_without_a_mode_says_so_to_the_search_by_modes():
    data = measured()
    noise = np.random.default_rng(2).normal(size=(2, *data.H.shape))
    with pytest.raises(ValueError, match="no mode stands out of the noise in the band"):
        identified(data.replace(H=noise[0] + 1j * noise[1], variance=np.full(data.H.shape, 2.0)), five_dof(), str)


def test_only_what_is_beyond_doubt_is_handed_on():
    def modes(noise):
        return diagnose_modes(measured(noise=noise), five_dof(), wanted=lambda s: s in {c.slug for c in CAUSES})

    (named,) = named_before(modes(0.02))
    assert named.slug == "joint_stiffness" and set(named.where) == {"3", "5"}
    assert named.values == pytest.approx((STIFFNESS,), rel=0.05)
    assert named_before(modes(0.9)) == [] and named_before(None) == []
