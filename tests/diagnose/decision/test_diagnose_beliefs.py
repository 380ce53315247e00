"""What a user holds to be likelier before the data multiplies the odds, and nothing else."""

import math

import numpy as np
import pytest

from modalax.diagnose import diagnose, pipeline
from modalax.diagnose.decision.beliefs import beliefs, believed
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.fitting.explanation import Prior
from modalax.diagnose.pipeline import every_name
from modalax.model.examples import five_dof

MASS = Change("added_mass", ("2",), 1.0, np.ones(3))
SPRING = Change("joint_stiffness", ("2", "3"), 1.0, np.ones(3))


def test_a_belief_multiplies_the_odds_of_a_cause_in_the_modal_domain():
    before = Prior([MASS, SPRING])
    plain = before.of([MASS]) - before.of([SPRING])
    with beliefs({"added_mass": 8.0, "joint_stiffness": 0.5}, every_name()):
        held = before.of([MASS]) - before.of([SPRING])
        assert before.of([]) == math.log(0.5)
    assert held - plain == pytest.approx(math.log(16), rel=1e-12)
    assert believed("added_mass") == 0.0


def test_a_belief_holds_while_a_diagnosis_runs_and_no_longer(monkeypatch):
    monkeypatch.setattr(pipeline, "_diagnosed", lambda *_: (believed("added_mass"), believed("units")))
    frf = five_dof().frf(np.linspace(20.0, 70.0, 60), inputs=["1"])
    assert diagnose(frf, five_dof(), prior={"added_mass": 3.0}) == (math.log(3.0), 0.0)
    assert diagnose(frf, five_dof()) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("prior", "said"),
    [({"gremlin": 2.0}, "prior names 'gremlin'; causes are .*added_mass"), ({"added_mass": 0.0}, "must be above 0"),
     ({"added_mass": math.inf}, "must be above 0")],
)  # fmt: skip
def test_beliefs_that_cannot_be_held_are_refused(prior, said):
    frf = five_dof().frf(np.linspace(20.0, 70.0, 60), inputs=["1"])
    with pytest.raises(ValueError, match=said):
        diagnose(frf, five_dof(), prior=prior)
    assert believed("added_mass") == 0.0
