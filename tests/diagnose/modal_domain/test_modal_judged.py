"""What is told of explanations: small causes that the modes cannot do without, and couplings that are none."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from modalax.diagnose.modal_domain import judged
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import Delay, Sign
from modalax.diagnose.modal_domain.causes.joint_forces import PowerLawJoint, RelaxingJoint
from modalax.diagnose.modal_domain.causes.line_forces import SkewCoupling
from modalax.diagnose.modal_domain.fitting.explanation import SECOND, Explanation, Prior
from modalax.diagnose.modal_domain.judged import _in_the_limit, _with_usual_dampers, _without_one_sided, standing_out

SIGN, SPRING = Sign("channel_sign", ("3",), channel=(0, 2)), Change("joint_stiffness", ("1", "2"))
DAMPER, ABSENT = Change("local_damper", ("1", "2")), Change("joint_stiffness", ("1", "5"), absent=True)
SKEW = SkewCoupling("gyroscopic", ("1", "4"), 1.0)


@dataclass(frozen=True)
class Few:
    """The part of a stage that counts here."""

    explanations: list


@dataclass(frozen=True)
class Told(Few):
    """With what was looked for."""

    candidates: list


def explained(*causes, posterior=0.0, probability=0.5, misfit=1.0):
    return Explanation(SimpleNamespace(causes=causes), posterior, probability, misfit)


def couple(misfit=1.1):
    """A sign with a skew coupling beside it, and without, at this misfit."""
    return Few([
        explained(SIGN, SKEW, posterior=20.0, probability=0.9), explained(SIGN, misfit=misfit, probability=0.06),
        explained(SPRING, posterior=-1.0, probability=0.04, misfit=9.0),
    ])  # fmt: skip


@pytest.mark.parametrize("needed", [True, False])
def test_losses_stand_out_where_the_modes_need_them_as_no_inaccuracy_has_them(monkeypatch, needed):
    monkeypatch.setattr(judged, "told_by_size", lambda stage, e: ((SIGN,), (SPRING, DAMPER, ABSENT)))
    monkeypatch.setattr(judged, "needs", lambda stage, e, small: needed)
    monkeypatch.setattr(judged, "_outdone", lambda stage, e, cause: False)
    found = standing_out(None, explained(SIGN, SPRING, DAMPER, ABSENT))
    assert found == ((SIGN, DAMPER, ABSENT) if needed else (SIGN,))


@pytest.mark.parametrize(
    ("one_sided", "misfit", "left_out"), [(True, 1.1, True), (False, 1.1, False), (True, 2.5, False)]
)
def test_a_coupling_that_is_none_does_not_hide_what_explains_the_modes(monkeypatch, one_sided, misfit, left_out):
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: e.causes)
    monkeypatch.setattr(judged, "told_by_size", lambda stage, e: (e.causes, ()))
    monkeypatch.setattr(judged, "_one_sided", lambda stage, e: (SKEW.where,) if one_sided else ())
    found = _without_one_sided(couple(misfit)).explanations
    if not left_out:
        assert len(found) == 3
        return
    assert [e.causes for e in found] == [(SIGN,), (SPRING,)]
    assert sum(e.probability for e in found) == pytest.approx(1.0) and found[0].probability > 0.7


def test_a_coupling_alone_stays(monkeypatch):
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: e.causes)
    monkeypatch.setattr(judged, "_one_sided", lambda stage, e: (SKEW.where,))
    alone = Few([explained(SKEW), explained(misfit=5.0)])
    assert _without_one_sided(alone) is alone


@pytest.mark.parametrize(
    ("even", "std", "told"),
    [(0.3, 0.01, ()), (0.9, 0.01, (SKEW.where,)), (-0.9, 0.01, (SKEW.where,)), (0.9, 0.4, ())],
)
def test_a_coupling_is_one_sided_where_its_symmetric_part_is_sure_and_large(monkeypatch, even, std, told):
    """Of one that acts on one end alone it is as large as the skew part; what elements that are off add is small."""
    e = explained(SKEW)
    e.fit.u = np.array([1.0])
    beside = SimpleNamespace(u=np.array([1.0, even]), covariance=np.diag([1e-4, std**2]))
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: e.causes)
    monkeypatch.setattr(judged, "without_causes", lambda f: f)
    monkeypatch.setattr(judged, "fit", lambda *args, **kwargs: beside)
    assert judged._one_sided(SimpleNamespace(setting=None), e) == told


@pytest.mark.parametrize("alike", [True, False])
def test_an_answer_is_taken_on_to_the_lines_where_it_says_the_same_there(monkeypatch, alike):
    before, after = explained(SPRING, DAMPER), explained(SPRING, DAMPER)
    monkeypatch.setattr(judged, "taken_on", lambda setting, e, measured: after)
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: (SPRING,) if e is after and not alike else e.causes)
    monkeypatch.setattr(judged, "told_by_size", lambda stage, e: ((SPRING,), ()))
    monkeypatch.setattr(judged, "of_the_joint", lambda stage, c: False)
    monkeypatch.setattr(judged, "without_spare", lambda setting, e, spare, measured: (e, spare))
    found, spare = judged.on_its_lines(SimpleNamespace(setting=None, measured=None), before)
    assert found is (after if alike else before)
    assert spare == [DAMPER]  # which may be none there


@pytest.mark.parametrize(("behind", "about"), [(1.0, ()), (40.0, (SPRING,))])
def test_a_small_cause_that_the_modes_need_stays_in_what_the_frfs_are_corrected_by(monkeypatch, behind, about):
    best, plain = explained(SPRING, posterior=behind), explained(posterior=0.0)
    stage = SimpleNamespace(explanations=[best, plain], odd=None, setting=SimpleNamespace(inaccuracy=None))
    off = {"stiffness": 0.01, "mass": 0.01, "damping": 0.1}
    for name, value in {
        "_without_one_sided": lambda s: s, "_with_usual_dampers": lambda s: s,
        "_leading": lambda s: ((), best), "of_the_joint": lambda s, c: False,
        "inaccuracy_of_fit": lambda s, e: off, "told_by_size": lambda s, e: ((), ()), "claims_of": lambda i: {},
        "needs": lambda s, e, small: False, "_at_one_output": lambda s, e: (), "_as_a_factor": lambda s, e: None,
        "_one_sided": lambda s, e: (), "modal_verdict": lambda case: ("clean", ()),
    }.items():  # fmt: skip
        monkeypatch.setattr(judged, name, value)
    found = judged.judge(stage)
    assert found.chosen.causes == about and found.likeliest is best


RELAXES = RelaxingJoint("maxwell_joint", ("1", "2"), 1.0, basis=np.ones((1, 1)), middle=1.0)
POWER = PowerLawJoint("fractional_joint", ("1", "2"), 1.0, basis=np.ones((1, 1)), middle=1.0)


def of_one_joint(power_by, relaxing_by):
    """A power, a relaxing joint and a damper at one place, by so many nats more of the data than the damper."""
    found = {}
    for cause, nats, posterior in ((RELAXES, relaxing_by, -1.0), (POWER, power_by, -2.0), (DAMPER, 0.0, -9.0)):
        u, covariance = np.ones(cause.count), 0.01 * np.eye(cause.count)
        f = SimpleNamespace(causes=(cause,), u=u, covariance=covariance, log_evidence=0.0)
        f.log_evidence = nats - judged.by_data(f, f.causes, cause)
        found[cause.slug] = Explanation(f, posterior, 0.3, 1.0)
    return found


@pytest.mark.parametrize(
    ("power_by", "relaxing_by", "power_told", "relaxing_told"),
    [
        (5.0, 5.0, "local_damper", "local_damper"),
        (7.0, 5.0, "local_damper", "local_damper"),  # a likelier law is told from a damper no better
        (5.0, 7.0, "local_damper", "maxwell_joint"),
        (7.0, 7.0, "fractional_joint", "maxwell_joint"),
    ],
)
def test_a_law_is_told_from_its_limit_where_those_that_are_likelier_are(
    power_by, relaxing_by, power_told, relaxing_told
):
    found = of_one_joint(power_by, relaxing_by)
    stage = Few(list(found.values()))
    for slug, told in (("fractional_joint", power_told), ("maxwell_joint", relaxing_told)):
        assert _in_the_limit(stage, found[slug]).causes[0].slug == told
    assert _in_the_limit(stage, found["local_damper"]) is found["local_damper"]


def test_a_law_that_stands_twice_at_one_place_is_told_from_its_limit_too():
    """Neither of the two is found alone in the place of the other; that had ended in an error."""
    one = of_one_joint(5.0, 5.0)["maxwell_joint"]
    pairs = []
    for causes, nats in (((replace(RELAXES), RELAXES), 2.0), ((DAMPER, RELAXES), 0.0)):
        count = sum(c.count for c in causes)
        f = SimpleNamespace(causes=causes, u=np.ones(count), covariance=0.01 * np.eye(count), log_evidence=nats)
        pairs.append(replace(one, fit=f, log_posterior=nats))
    assert _in_the_limit(Few(pairs), pairs[0]) is pairs[1]


@pytest.mark.parametrize(
    ("large", "leads", "raised"), [(False, "phase", True), (True, "phase", False), (False, "sign", False),
                                   (False, "nothing", True)]
)  # fmt: skip
def test_a_damper_of_usual_size_costs_nothing_where_a_sensors_phase_or_nothing_leads(monkeypatch, large, leads, raised):
    """Beside a spring it is one of a hundred places, and a second cause, where a delay at one of few leads."""
    delay = Delay("time_delay", ("3",), channel=(0, 2))
    beside = {"phase": (SPRING, delay), "sign": (SPRING, SIGN), "nothing": (DAMPER,)}[leads]
    small = () if large else (DAMPER,)
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: tuple(c for c in e.causes if c not in small))
    places = [SPRING, delay, SIGN, replace(DAMPER, weight=99.0), DAMPER]
    stage = Told([explained(*beside, posterior=3.0), explained(SPRING, DAMPER)], places)
    monkeypatch.setattr(judged, "_leading", lambda stage: ((), stage.explanations[0]))
    found = _with_usual_dampers(stage)
    assert (found is stage) == (leads == "sign")
    by_damper = next(e for e in found.explanations if e.causes == (SPRING, DAMPER))
    prior = Prior(places)
    own = prior.of([SPRING]) - prior.of([SPRING, DAMPER])
    assert own == pytest.approx(-np.log(SECOND / (1 - SECOND)) + np.log(100 * len(prior.kinds)))
    assert by_damper.log_posterior == pytest.approx(own if raised else 0.0)
    other = next(e for e in found.explanations if e is not by_damper)
    odds = by_damper.probability / (1 - by_damper.probability)
    if leads != "sign":
        assert odds == pytest.approx(np.exp(by_damper.log_posterior - other.log_posterior))


OFF = {"mass": 0.01, "damping": 0.1}


@pytest.mark.parametrize(("without", "told"), [(0.3, True), (0.05, False)])
@pytest.mark.parametrize("beside", [(), (DAMPER,)])
def test_what_all_elements_would_have_to_be_off_far_more_without_stands_out(monkeypatch, without, told, beside):
    """A spring across a slender rod is small beside what the rod is along itself; what may be none is no matter."""
    best, plain = explained(SPRING, *beside), explained()
    monkeypatch.setattr(judged, "told_by_size", lambda stage, e: ((), (SPRING,) if SPRING in e.causes else ()))
    monkeypatch.setattr(judged, "needs", lambda stage, e, small: False)
    monkeypatch.setattr(
        judged, "inaccuracy_of_fit", lambda stage, e: OFF | {"stiffness": 0.02 if SPRING in e.causes else without}
    )
    assert standing_out(Few([best, plain]), best) == ((SPRING,) if told else ())
