"""A diagnosis whose time is up gives the best answer so far."""

from dataclasses import replace

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose import pipeline
from modalax.diagnose.causes import catalogue
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.decision.route import Outcome, Task
from modalax.diagnose.decision.sets import as_stated
from modalax.diagnose.decision.verdict import verdict
from modalax.diagnose.pipeline import line_by_line
from modalax.diagnose.search.explain import check_imitations
from modalax.model import Structure


def test_a_share_of_the_time_that_is_left():
    whole = Deadline(1000.0)
    assert 599.0 < whole.part(0.6).end - (whole.end - 1000.0) < 601.0
    assert not whole() and Deadline(0.0).part(0.5)()
    assert not Deadline().part(0.5)()


CHAIN = 1e4 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1))
ASKED = [c for c in catalogue() if c.slug in ("added_mass", "joint_stiffness", "channel_gain")]


def measured():
    """FRFs of three masses, the second a fifth too heavy."""
    true = Structure(np.diag([1.0, 1.2, 1.0]), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"])
    freq, rng = np.linspace(8.0, 32.0, 64), np.random.default_rng(0)
    H = np.asarray(true.frf(freq, outputs=["a", "b", "c"], inputs=["a"]).H)[None]
    sigma = 0.01 * np.abs(H).mean() * np.ones(H.shape)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return Measurement(freq, H + sigma * noise, outputs=["a", "b", "c"], inputs=["a"], variance=sigma**2)


def test_a_search_line_by_line_ends_with_its_time():
    simulation = Structure(np.eye(3), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"])
    found = line_by_line(measured(), simulation, "fixed", ASKED, lambda _: None, Deadline(0.0))
    assert any("time was up" in reason for reason in found.reasons)
    assert found.verdict in ("clean", "named", "ambiguous", "unknown")
    assert np.isfinite(found.gain.chi2_after)


def test_what_was_not_compared_with_causes_beside_the_catalogue_is_not_named():
    simulation = Structure(np.eye(3), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"])
    found = line_by_line(measured(), simulation, "fixed", ASKED, lambda _: None)
    assert found.verdict == "named"
    for late, word in ((NEVER, "named"), (Deadline(0.0), "ambiguous")):
        checked = check_imitations(found.found, [], late)
        word_now, reasons = verdict(checked.ranked, checked.leftover)
        assert word_now == word
        assert any("beside the catalogue" in reason for reason in reasons) == (word == "ambiguous")


def test_several_unlike_causes_are_not_named_where_the_search_for_them_was_cut_short():
    simulation, data = Structure(np.eye(3), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"]), measured()
    H, variance = np.array(data.H), np.array(data.variance)
    H[:, :, 2], variance[:, :, 2] = 1.1 * H[:, :, 2], 1.1**2 * variance[:, :, 2]
    found = line_by_line(data.replace(H=H, variance=variance), simulation, "fixed", ASKED, lambda _: None)
    assert found.verdict == "named" and {c["name"] for c in found.causes} == {"added_mass", "channel_gain"}
    cut = replace(found.found, comparison=replace(found.found.comparison, late=Deadline(0.0)))
    again = pipeline.told(cut, lambda _: None)
    assert again.verdict == "ambiguous" and again.causes == as_stated("ambiguous", found.causes)
    assert any("before other sets of causes had been tried" in reason for reason in again.reasons)


def test_modes_that_cannot_be_compared_are_told(monkeypatch):
    """Line by line answers then; why modes did not is not lost."""

    def fails(*_, **__):
        raise np.linalg.LinAlgError("no root")

    monkeypatch.setattr(pipeline, "diagnose_modes", fails)
    simulation, said = Structure(np.eye(3), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"]), []
    assert pipeline.in_modal_domain(measured(), simulation, None, NEVER, said.append) is None
    assert said == ["modes could not be compared: no root"]


@pytest.mark.parametrize("before", [True, False])
def test_lines_have_all_the_time_where_what_modes_say_is_known_and_they_are_heard_in_the_end(monkeypatch, before):
    late, given, asked = Deadline(1000.0), [], []

    def at_one_place(*args):
        return args[-1]() and None if before else None

    def lines(*args, **_):
        given.append(args[5])
        late.stop()
        return Outcome("unknown", 1.3)

    monkeypatch.setattr(pipeline, "task_of", lambda *_: Task(True, 15.0, 2000, modes_off=True))
    monkeypatch.setattr(pipeline, "claim_compared", lambda task: False)
    monkeypatch.setattr(pipeline, "at_one_place", at_one_place)
    monkeypatch.setattr(pipeline, "in_modal_domain", lambda *_: asked.append(1) or Outcome("clean", 1.0, 0.3))
    monkeypatch.setattr(pipeline, "line_by_line", lines)
    monkeypatch.setattr(pipeline, "outcome_of", lambda found: found)
    monkeypatch.setattr(pipeline, "outcome_beside_few", lambda found, task, late: found)
    simulation = Structure(np.eye(3), 2e-4 * CHAIN, CHAIN, ["a", "b", "c"])
    found = pipeline.by_routes(measured(), simulation, "auto", None, lambda _: None, late, False)
    assert found.verdict == ("clean" if before else "unknown")
    assert len(asked) == (1 if before else 0)
    assert (given[0] is late) is before
