"""Which hypotheses a further cause is added to."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from modalax.diagnose.causes.joints import ElastoSlip
from modalax.diagnose.causes.local import AddedMass, JointStiffness, TunedMass
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.search import compounds
from modalax.diagnose.search.compounds import Rest, exchanged, one_more_cause

COMPARISON = SimpleNamespace(late=lambda: False, problem=SimpleNamespace(samples=400))
PLACE = Place(("1",), (0, -1, 0))


def ranked(cause, chi2):
    h = Hypothesis(causes=(cause,), places=(PLACE,), extras=(None,), chi2=chi2)
    return Ranked(h.names, h, -chi2 / 2, 0.0)


OSCILLATOR, MASS, SPRING = ranked(TunedMass(), 1350.0), ranked(AddedMass(), 1610.0), ranked(JointStiffness(), 6800.0)


def weighed(found):
    """By chi-square, less ten nats for the further cause."""
    return [Ranked(h.names, h, -h.chi2 / 2 - 10.0, 0.0) for h in found]


def test_the_limit_of_a_law_takes_no_turn_of_another_explanation():
    slip = replace(SPRING.best, causes=(ElastoSlip(False),), chi2=SPRING.best.chi2 + 0.1)
    elsewhere = replace(slip, places=(Place(("2",), (1, -1, 0)),))
    worse = replace(slip, chi2=slip.chi2 + 30.0)
    every = [SPRING.best, slip, elsewhere, worse]
    assert compounds._different(every) == [SPRING.best, elsewhere, worse]


def added_to(monkeypatch, gains, p_value):
    """What a cause is added to, where one gains as much as it promises."""
    asked = []

    def fit_further(comparison, h, trials):
        asked.append(h)
        return [replace(h, chi2=h.chi2 - trials[0].gain)]

    monkeypatch.setattr(compounds, "fit_further", fit_further)
    rests = {
        id(r.best): Rest([SimpleNamespace(gain=g)] if g else [], p_value, Omnibus(p_value, 9.0, "", (0.0, 0.0)))
        for r, g in zip((OSCILLATOR, MASS, SPRING), gains, strict=True)
    }  # fmt: skip
    done = []
    found = one_more_cause(COMPARISON, [OSCILLATOR, MASS, SPRING], lambda h: rests[id(h)], done, weighed)
    assert done == asked
    return asked, found


@pytest.mark.parametrize(
    ("gains", "p_value", "expected"),
    [
        ((8.0, 1200.0, 900.0), 1e-9, [OSCILLATOR, MASS]),  # little helps the first, a damper makes the mass overtake it
        ((300.0, 1200.0, 900.0), 1e-9, [OSCILLATOR]),  # a further cause is taken up by the first
        ((8.0, 100.0, 900.0), 1e-9, [OSCILLATOR]),  # none behind promises to overtake
        ((8.0, 1200.0, 900.0), 0.5, []),  # nothing is left to explain
    ],
)
def test_a_cause_is_added_to_what_it_makes_overtake_the_first(monkeypatch, gains, p_value, expected):
    asked, found = added_to(monkeypatch, gains, p_value)
    assert asked == [r.best for r in expected]
    assert len(found) == len(expected)


@pytest.mark.parametrize(("chi2", "expected"), [(1610.2, 1), (1650.0, 2)])
def test_what_has_been_added_to_is_not_added_to_again(monkeypatch, chi2, expected):
    """With the spring taken away the mass is left, as it was before or fitted to something else."""
    asked, mass, spring = [], MASS.best, SPRING.best
    monkeypatch.setattr(compounds, "fit_together", lambda comparison, starts: [
        replace(h, chi2=chi2 if h.causes == mass.causes else 6800.0) for h in starts
    ])  # fmt: skip
    monkeypatch.setattr(compounds, "fit_further", lambda comparison, h, trials: asked.append(h.causes) or [])
    both = Hypothesis(
        causes=(*mass.causes, *spring.causes), places=(PLACE, PLACE), extras=(None, None), params=((1.0,), (1.0,))
    )
    out = exchanged(COMPARISON, both, lambda h: [], 3, [mass])
    assert len(asked) == expected and asked[0] == spring.causes
    assert [h.causes for h in out] == [spring.causes, mass.causes]
