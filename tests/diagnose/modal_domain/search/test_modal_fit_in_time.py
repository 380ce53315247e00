"""Fits end where they are once time is up, and an interrupt ends all of it."""

from dataclasses import replace
from functools import cache

import numpy as np
from frames import DOFS, measured, simulation

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain.fitting import fit as fits
from modalax.diagnose.modal_domain.search import explain as search
from modalax.diagnose.modal_domain.search.explain import explain
from modalax.diagnose.modal_domain.stage import Posed, identified, posed


@cache
def heavy() -> Posed:
    """A beam with a mass that outweighs it, and what it is compared with."""
    data, _ = measured(25, 0.01, mass=(DOFS[8], 0.3))
    return posed(data, simulation(), identified(data, simulation(), lambda _: None))


def test_a_fit_ends_where_it_is_once_time_is_up(monkeypatch):
    """Where nothing explains the modes a fit goes on for seconds, and a search holds a hundred of them."""
    task = heavy()
    steps, linear_at = [], fits.linear_at
    monkeypatch.setattr(fits, "linear_at", lambda *a: steps.append(1) or linear_at(*a))
    whole, count = fits.fit(task.setting), len(steps)
    steps.clear()
    short = fits.fit(replace(task.setting, late=Deadline(-1.0)))
    assert len(steps) <= 3 * len(fits.TEMPERATURES) + 1 < count
    assert np.isfinite(short.log_evidence) and short.log_evidence < whole.log_evidence
    setting, _, found = explain(task.setting, task.candidates[:3], Deadline(-1.0))
    assert found and setting.late is NEVER  # what is fitted to the answer afterwards takes the time that it needs


def test_stopping_a_part_of_the_time_stops_all_of_it():
    late = Deadline(100.0)
    part, other = late.part(0.5), late.part(0.5)
    assert not (late() or part() or other())
    part.stop()
    assert part() and late() and not other()


def test_what_leads_is_fitted_to_its_end_though_time_is_up():
    """A fit cut short says less than it knows, and an odd channel that was not cut would be told in its place."""
    task = heavy()
    cut = fits.fit(replace(task.setting, late=Deadline(-1.0)))
    setting, _, found = explain(task.setting, task.candidates[:3], Deadline(-1.0))
    best = found[0].fit
    whole = fits.fit(setting, best.causes, best, best.u, temperatures=())
    assert cut.log_evidence + 100 < best.log_evidence and whole.log_evidence < best.log_evidence + 1


def test_no_further_causes_are_looked_for_where_levels_tell_of_a_joint(monkeypatch):
    """Asked where one cause does not explain the modes: two would stand for a part of the joint, in a minute."""
    task = heavy()
    asked: list[int] = []
    enough = lambda setting, explanations: asked.append(len(explanations)) or True
    steps = lambda search, late: asked.append(0)
    monkeypatch.setattr(search, "_all_steps", steps)
    for explained, expected in ((True, [0]), (False, [1])):
        monkeypatch.setattr(search, "explains", lambda f, explained=explained: explained)
        asked.clear()
        assert search.explain(task.setting, task.candidates[:1], Deadline(), enough=enough)[2]
        assert [min(n, 1) for n in asked] == expected
