"""Dampers at a place couple modes: they are ranked by the modes that each would give; and joints that relax."""

from types import SimpleNamespace

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain import judged
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.joint_forces import RelaxingJoint
from modalax.diagnose.modal_domain.screen import finite
from modalax.diagnose.modal_domain.stage import run_stage


@pytest.mark.parametrize(("where", "c"), [(0, 300.0), (1, 120.0), (2, 300.0), (4, 120.0)])
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


@pytest.mark.parametrize(("c", "off"), [(0.5, 0.0), (1.2, 0.003)])
def test_a_small_damper_beside_a_delay_is_not_taken_for_dampings_that_are_off(c, off):
    """It makes all dampings 2 to 5 % larger; without the delay's help it shows at once."""
    nominal = simulation()
    M, _, K = chain_off(3, off)
    v = (np.arange(5) == 2) - 1.0 * (np.arange(5) == 3)
    C = np.asarray(nominal.C) + c * np.outer(v, v)
    late = np.exp(-2j * np.pi * FREQ * 1e-4)[:, None, None]
    found = diagnose_modes(as_measured(response(M, C, K, FREQ) * late, FREQ, 3), nominal)
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
        causes=(cause,), probability=p,
        fit=SimpleNamespace(log_evidence=evidence, u=np.zeros(cause.count), covariance=np.eye(cause.count)),
    )  # fmt: skip
    relaxing = one(RelaxingJoint("maxwell_joint", ("a", "b")), 100.0 + ahead, 0.7)
    stage = SimpleNamespace(explanations=[relaxing, one(Change(simple, where), 100.0, 0.3)])
    sets = judged.sets_beyond(stage)
    assert len(sets) == count
    assert sets[0].names == (((simple, where),) if count == 1 else (("maxwell_joint", ("a", "b")),))
    assert sets[0].probability == pytest.approx(1.0 if count == 1 else 0.7)
