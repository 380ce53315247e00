"""Dampers at a place couple modes: they are ranked by the modes that each would give; and joints that relax."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation
from kinds import FEW_OR_ALL, few_or_all

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain import diagnosis, judged
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.joint_forces import PowerLawJoint, RelaxingJoint
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import Fit, fit
from modalax.diagnose.modal_domain.search.force_places import as_limits
from modalax.diagnose.modal_domain.search.screen import finite
from modalax.diagnose.modal_domain.stage import identified, posed, run_stage

KINDS = ("local_damper", 0.2), ("joint_stiffness", 5.0)


@pytest.mark.parametrize(("where", "c"), [
    pytest.param(0, 300.0, marks=pytest.mark.slow), pytest.param(1, 120.0, marks=pytest.mark.slow), (2, 300.0),
    pytest.param(4, 120.0, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_strong_damper_ranks_first_before_any_fit(where, c):
    """Mode by mode up to eleven of the 15 places had ranked before that of a damper of a fifth of critical."""
    M, C, K = chain_off(3, 0.003)
    C = C + c * np.diag(np.arange(5) == where)
    measurement = as_measured(response(M, C, K, FREQ), FREQ, 3)
    stage = run_stage(measurement, simulation(), Deadline(), lambda slug: slug == "local_damper", lambda text: None)
    dampers = [x for x in stage.candidates if x.slug == "local_damper"]
    assert len(dampers) == 15  # to ground, and between any two
    distance, size = finite(stage.setting, dampers)
    k = int(np.argmin(distance))
    assert dampers[k].where == (DOFS[where],)
    assert 0.5 * c < size[k] * dampers[k].scale < 1.5 * c


def joined_by(c, between, seed=7):
    """FRFs of a chain 1 % off with a damper between two masses, of which the second has no sensor."""
    M, C, K = chain_off(seed, 0.01)
    v = np.eye(5)[between[0]] - np.eye(5)[between[1]]
    outputs = tuple(k for k in range(5) if k != between[1])
    return as_measured(response(M, C + c * np.outer(v, v), K, FREQ), FREQ, seed, outputs)


@few_or_all("hysteretic_joint", "maxwell_joint", "fractional_joint")
@pytest.mark.parametrize(("c", "between"), [
    pytest.param(3e3, (2, 1), marks=pytest.mark.slow), pytest.param(5e4, (3, 2), marks=pytest.mark.slow),
    pytest.param(1e4, (3, 2), marks=pytest.mark.slow), (5e4, (1, 0)),
])  # fmt: skip
def test_a_damper_that_holds_two_points_together_is_named_with_its_size(c, between, wanted):
    """It couples modes until those that it damps are gone; joints that relax lead to it."""
    found = diagnose_modes(joined_by(c, between), simulation(), wanted=wanted)
    assert found.verdict == "named", found.reasons
    assert [(x["name"], x["where"]) for x in found.causes] == [("local_damper", sorted(DOFS[k] for k in between))]
    (size,) = found.causes[0]["parameters"].values()
    assert abs(size["value"] - c) < 4 * size["std"] < 0.6 * c


@dataclass(frozen=True)
class Told:
    """What an answer must have for another place of a sensor to be weighed against it."""

    verdict: str
    stage: SimpleNamespace
    after: SimpleNamespace
    reasons: tuple[str, ...] = ()
    moved: object = None


def test_a_sensor_is_elsewhere_only_if_nothing_that_is_named_explains_as_much(monkeypatch):
    """What holds two points together has one move as the other."""
    data = joined_by(5e4, (2, 1))
    measured = identified(data, simulation(), lambda _: None)
    plain = fit(posed(data, simulation(), measured).setting).log_evidence

    def told(verdict, more):
        explanation = SimpleNamespace(log_posterior=plain + 1000.0 + more)
        return Told(verdict, SimpleNamespace(explanations=[explanation]), SimpleNamespace(p_value=0.5))

    monkeypatch.setattr(diagnosis, "other_places", lambda *_: {DOFS[2]: DOFS[1]})
    task, there = diagnosis._Task(simulation(), Deadline(), lambda _: True, lambda _: None), told("clean", 0.0)
    for ahead, verdict, stays in ((50.0, "named", True), (-50.0, "named", False), (50.0, "unknown", False)):
        here = told(verdict, ahead)
        answers = {data.outputs: here}
        monkeypatch.setattr(diagnosis, "_diagnosed", lambda m, *_, own=answers, **__: own.get(m.outputs, there))
        found, left = diagnosis._elsewhere(data, task, measured)
        assert (found is None) is stays and (not stays or left is here)
        assert stays or (found.verdict, found.moved.told()[0]["where"]) == ("named", [DOFS[2], DOFS[1]])


@pytest.mark.slow  # by default how it is weighed
def test_a_sensor_that_moves_as_another_point_is_where_it_says_if_a_damper_joins_them(monkeypatch):
    monkeypatch.setattr(diagnosis, "other_places", lambda *_: {DOFS[2]: DOFS[1]})
    found = diagnose_modes(joined_by(5e4, (2, 1)), simulation())
    told = {x["name"] for x in (*found.causes, *(c for one in found.alternatives for c in one))}
    assert "local_damper" in told <= {"local_damper", "hysteretic_joint"}  # either may hold them together
    assert all(x["where"] == [DOFS[1], DOFS[2]] for x in found.causes)


@pytest.mark.parametrize(("kind", "more"), [(RelaxingJoint, -200.0), (PowerLawJoint, 200.0)])
def test_a_joint_between_a_spring_and_a_damper_has_their_size_in_its_limits(kind, more):
    """Slow to relax, or of order 0, it is a spring; relaxing at once, or of order 1, a damper."""
    joint = kind("maxwell_joint", ("a",), 3.0, basis=np.ones((1, 1)), middle=20.0)
    spring, damper = Change("joint_stiffness", ("a",), 0.5), Change("local_damper", ("a",), 0.1)
    stiff, lossy = np.array([2.0, -more]), np.array([2.0, more])
    assert joint.as_limit(stiff, spring) == pytest.approx(2.0 * 3.0 / 0.5, rel=0.05)
    c = joint.as_limit(lossy, damper) * damper.scale
    Z = 2.0 * 3.0 * complex(joint.unit(lossy, np.array([20j]))[0, 0, 0])
    assert c * 20.0 == pytest.approx(abs(Z), rel=0.05)


@pytest.mark.parametrize(("size", "beside", "count"), [(40.0, True, 2), (40.0, False, 1), (0.5, True, 0)])
def test_a_spring_is_tried_where_a_damper_holds_two_points(size, beside, count):
    """Of the same force at the mean frequency of the modes, in place of the damper and alone."""
    b = np.ones(1)
    damper, spring = (Change(slug, ("a", "b"), s, direction=b) for slug, s in KINDS)
    mass = Change("added_mass", ("c",), direction=b)
    causes = (mass, damper) if beside else (damper,)
    u = np.array([0.3, size] if beside else [size])
    state = SimpleNamespace(modes=SimpleNamespace(poles=np.array([-1 + 20j, -1 + 80j, 500j])), pairs=np.array([0, 1]))
    made = Fit(causes, np.zeros(2), u, np.ones(1), 0.0, np.eye(len(u)), 0.0, np.ones(1), state)
    found = as_limits([made], [mass, damper, spring])
    assert [len(own) for own, *_ in found] == [2, 1][2 - count :] * bool(count)
    for own, sizes, start in found:
        assert own[-1] is spring and sizes[-1] == pytest.approx(40.0 * size * 0.2 / 5.0, rel=1e-3)
        assert (start is None) is (beside and len(own) == 1)


@FEW_OR_ALL
@pytest.mark.parametrize(("c", "off"), [(0.5, 0.0), pytest.param(1.2, 0.003, marks=pytest.mark.slow)])
def test_a_small_damper_beside_a_delay_is_not_taken_for_dampings_that_are_off(c, off, wanted):
    """It makes all dampings 2 to 5 % larger; without the delay's help it shows at once."""
    nominal = simulation()
    M, _, K = chain_off(3, off)
    v = (np.arange(5) == 2) - 1.0 * (np.arange(5) == 3)
    C = np.asarray(nominal.C) + c * np.outer(v, v)
    late = np.exp(-2j * np.pi * FREQ * 1e-4)[:, None, None]
    found = diagnose_modes(as_measured(response(M, C, K, FREQ) * late, FREQ, 3), nominal, wanted=wanted)
    assert found is not None and found.verdict == "named", found.reasons
    told = {(cause["name"], tuple(cause["where"])): cause["parameters"] for cause in found.causes}
    assert set(told) == {("time_delay", ()), ("local_damper", (DOFS[2], DOFS[3]))}
    for key, size in zip(sorted(told), (c, 1e-4), strict=True):
        (value,) = told[key].values()
        assert abs(value["value"] - size) < 4 * value["std"] < 0.4 * size


@pytest.mark.parametrize("simple", ["joint_stiffness", "local_damper"])
@pytest.mark.parametrize(("ahead", "where", "count"), [(5.0, ("a", "b"), 1), (7.0, ("a", "b"), 2), (5.0, ("a",), 2)])
def test_a_joint_that_relaxes_counts_as_what_the_data_do_not_tell_it_from(simple, ahead, where, count, monkeypatch):
    """Six nats are what 3.5 standard deviations of the relaxation are worth; elsewhere it is another joint."""
    monkeypatch.setattr(judged, "standing_out", lambda _, e: e.causes)
    one = lambda cause, evidence, p: SimpleNamespace(
        causes=(cause,), probability=p, log_posterior=evidence,
        fit=SimpleNamespace(log_evidence=evidence, u=np.zeros(cause.count), covariance=np.eye(cause.count)),
    )  # fmt: skip
    relaxing = one(RelaxingJoint("maxwell_joint", ("a", "b")), 100.0 + ahead, 0.7)
    stage = SimpleNamespace(explanations=[relaxing, one(Change(simple, where), 100.0, 0.3)])
    sets = judged.sets_beyond(stage)
    assert len(sets) == count
    assert sets[0].names == (((simple, where),) if count == 1 else (("maxwell_joint", ("a", "b")),))
    assert sets[0].probability == pytest.approx(1.0 if count == 1 else 0.7)
