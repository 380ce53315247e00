"""Which method answers: the order of the two, when the first one suffices, and which of two answers is given."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose import routes
from modalax.diagnose.causes import catalogue
from modalax.diagnose.decision.gain import Gain
from modalax.diagnose.decision.route import (
    Outcome,
    Task,
    by_claim,
    choice,
    claim_compared,
    damping_off,
    elements_surely,
    hardly_off,
    one_place_first,
    order,
    settled,
    suffices,
    surely_foretold,
)
from modalax.diagnose.routes import of_elements, outcome_of, task_of
from modalax.model import Structure

SMALL = Task(has_modes=True, places=15.0, samples=2000)
LARGE = replace(SMALL, places=301.0)
OFF = {"stiffness": {"value": 0.02, "interval": [0.01, 0.03]}, "mass": {"value": 0.0, "interval": [0.0, 0.01]}}
EXACT = {"stiffness": {"value": 1e-4, "interval": [5e-5, 2e-4]}, "mass": {"value": 0.01, "interval": [0.0, 0.02]}}
MAYBE = {"stiffness": {"value": 1e-4, "interval": [0.0, 2e-4]}, "mass": {"value": 1e-4, "interval": [0.0, 2e-3]}}
mass_off = lambda size: {**MAYBE, "mass": {"value": size, "interval": [0.75 * size, 2 * size]}}
damped = lambda least, most=3e-3, value=0.1: {
    **MAYBE, "stiffness": {"value": 1e-4, "interval": [0.0, most]},
    "damping": {"value": value, "interval": [least, 3 * value]},
}  # fmt: skip
SURE = Outcome("named", 1.05, 0.3, 0.9995, 0, EXACT)


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (Task(has_modes=False, places=1e6, samples=10**6, elements_off=True), ("lines",)),
        (SMALL, ("modes", "lines")),
        (replace(SMALL, modes_off=True), ("lines", "modes")),
        (replace(SMALL, modes_off=True, elements_show=True), ("modes", "lines")),
        (replace(SMALL, whole_catalogue=False), ("lines",)),
        (replace(SMALL, whole_catalogue=False, elements_off=True), ("modes", "lines")),
        (replace(LARGE, whole_catalogue=False), ("modes", "lines")),
        (replace(SMALL, samples=400_000, modes_off=True), ("modes", "lines")),  # 15 places times 400,000
        (replace(SMALL, whole_catalogue=False, modes_off=True, groups=True), ("modes", "lines")),
        (replace(LARGE, whole_catalogue=False, known_to_modes=False), ("lines",)),
    ],
    ids=[
        "no matrices",
        "small",
        "modes claimed",
        "modes claimed, elements seen",
        "some causes",
        "elements claimed",
        "many places",
        "many samples",
        "groups",
        "some that modes do not know",
    ],
)
def test_methods_are_tried_in_this_order(task, expected):
    assert order(task) == expected


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (SMALL, True),
        (LARGE, True),  # one force is found in seconds however many places there are,
        (replace(SMALL, modes_off=True), True),
        (replace(LARGE, modes_off=True), False),  # but not where modes move beside each of them
        (replace(SMALL, samples=400_000, modes_off=True), False),
        (replace(SMALL, elements_off=True), False),
        (replace(SMALL, modes_off=True, elements_show=True), False),
        (replace(SMALL, massless=True), False),
        (replace(SMALL, whole_catalogue=False), False),
        (replace(SMALL, has_modes=False), False),
    ],
)
def test_one_force_is_looked_for_first_where_that_is_quick_and_can_be_right(task, expected):
    assert one_place_first(task) is expected


@pytest.mark.parametrize(
    ("found", "task", "expected"),
    [
        (Outcome("clean", 1.05, 0.3, inaccuracy=OFF), SMALL, True),
        (Outcome("clean", 1.05, 0.3, inaccuracy=EXACT), SMALL, False),  # nothing is certainly off
        (Outcome("clean", 1.05, 0.3), SMALL, False),
        (Outcome("unknown", 1.05, 0.3, inaccuracy=OFF), SMALL, False),
        (Outcome("clean", 1.25, 0.3, inaccuracy=OFF), SMALL, False),  # does not predict
        (Outcome("clean", 1.05, 0.009, inaccuracy=OFF), SMALL, False),  # a record that leaks may look like this
        (Outcome("clean", 1.05, 0.3, inaccuracy=OFF), SMALL, True),  # lines take for exact what is surely off
        (
            Outcome("clean", 1.05, 0.009, inaccuracy=mass_off(4e-3)),
            SMALL,
            False,
        ),  # something is left, and mass may not be
        (Outcome("clean", 1.05, 0.009, inaccuracy=EXACT), SMALL, False),
        (Outcome("named", 1.05, 0.009, inaccuracy=OFF), SMALL, True),  # which lines cannot name about such a simulation
        (Outcome("named", 1.25, 0.009, inaccuracy=OFF), SMALL, False),
        (Outcome("named", 1.4, 0.0, inaccuracy=OFF, joint=True), SMALL, True),  # its law leaves its higher harmonics
        (SURE, SMALL, False),
        (replace(SURE, group=True), SMALL, True),  # which lines know nothing of
        (replace(SURE, group=True, held_out=1.3), SMALL, False),
        (Outcome("unknown", 1.05, 0.3, inaccuracy=EXACT, group=True), SMALL, False),
        (replace(SURE, inaccuracy=MAYBE, of_elements=True), SMALL, True),  # lines have no such cause
        (replace(SURE, inaccuracy=MAYBE, of_elements=True), replace(LARGE, samples=10_000), True),
        (replace(SURE, inaccuracy=MAYBE, of_elements=True, probability=0.99), SMALL, False),
        (replace(SURE, inaccuracy=MAYBE), SMALL, False),
        (SURE, replace(SMALL, places=121.0), False),  # lines show a smaller thing beside it,
        (replace(SURE, inaccuracy=damped(0.005)), replace(SMALL, places=121.0), True),  # if all else is exact
        (replace(SURE, inaccuracy=OFF), replace(SMALL, places=121.0), True),
        (SURE, replace(LARGE, samples=10_000), True),  # mass may be off
        (replace(SURE, inaccuracy=MAYBE), replace(LARGE, samples=10_000), False),
        (replace(SURE, inaccuracy=MAYBE), replace(LARGE, samples=50_000), True),
        (Outcome("clean", 1.05, 0.3, inaccuracy=OFF, scaled=True), SMALL, False),  # all FRFs are larger, as by a leak
        (Outcome("clean", 1.05, 0.3, throughout={"mass": {"value": 0.01}}, scaled=True), SMALL, False),
        (replace(SURE, probability=0.99), replace(SMALL, places=121.0), False),
        (replace(SURE, alternatives=1), replace(SMALL, places=121.0), False),
        (replace(SURE, verdict="ambiguous"), replace(SMALL, places=121.0), False),
        (replace(SURE, held_out=1.3), replace(SMALL, places=121.0), False),
        (Outcome("named", 1.05, 0.3, inaccuracy=damped(0.02)), SMALL, True),  # lines take the dampings as exact
        (Outcome("named", 1.05, 0.3, inaccuracy=damped(0.005)), SMALL, False),
        (Outcome("named", 1.05, 0.3, inaccuracy=damped(0.02, 1e-3)), SMALL, False),  # it may be one damper
        (Outcome("named", 1.05, 0.009, inaccuracy=damped(0.02)), SMALL, False),
        (Outcome("clean", 1.05, 0.3, inaccuracy=damped(0.02)), SMALL, False),  # a window may have added them
        (Outcome("clean", 1.05, 0.3, inaccuracy=damped(0.2)), SMALL, True),  # so far off they are in general
        (Outcome("clean", 1.05, 0.009, inaccuracy=damped(0.2)), SMALL, False),
        (Outcome("unknown", 9.0, 0.0), LARGE, True),
        (Outcome("unknown", 9.0, 0.0), replace(SMALL, elements_off=True), True),
        (Outcome("unknown", 9.0, 0.0, inaccuracy=MAYBE), LARGE, False),  # lines may show what modes do not
        (Outcome("unknown", 9.0, 0.0, inaccuracy=MAYBE), replace(LARGE, elements_off=True), True),
        (Outcome("unknown", 9.0, 0.0, inaccuracy=MAYBE), replace(LARGE, places=5001.0), True),  # would take too long
        (Outcome("unknown", 9.0, 0.0, inaccuracy=OFF), LARGE, True),
        (Outcome("clean", 1.0, 0.3, inaccuracy=MAYBE), LARGE, False),  # lines see smaller things,
        (Outcome("clean", 1.0, 0.3, inaccuracy=MAYBE), replace(LARGE, samples=50_000), True),  # but would take too long
        (Outcome("clean", 1.0, 0.3, inaccuracy=damped(0.02)), LARGE, True),
        (Outcome("clean", 1.0, 0.3, inaccuracy=damped(0.002, value=0.009)), LARGE, False),  # one small thing rather
        (Outcome("clean", 1.0, 0.3, inaccuracy=damped(0.002, value=0.011)), LARGE, True),
        (Outcome("clean", 1.0, 0.3, inaccuracy=MAYBE), replace(LARGE, elements_off=True), True),
        (Outcome("clean", 1.04, 1e-9, inaccuracy=MAYBE), LARGE, False),  # something is left that is no mode
        (Outcome("clean", 1.0, 0.3, inaccuracy=mass_off(4e-4)), SMALL, False),  # or one mass is
        (Outcome("clean", 1.0, 0.3, inaccuracy=mass_off(4e-3)), SMALL, True),
    ],
)
def test_the_modal_domain_suffices_where_nothing_is_left_to_explain(found, task, expected):
    assert suffices("modes", found, task) is expected


@pytest.mark.parametrize(
    ("verdict", "held_out", "given"),
    [("named", 1.2, "lines"), ("named", 1.5, "modes"), ("unknown", 1.0, "modes"), ("ambiguous", 1.51, "modes")],
)
def test_line_by_line_suffices_where_its_answer_predicts(verdict, held_out, given):
    found = Outcome(verdict, held_out)
    assert suffices("lines", found, SMALL) is (verdict == "named")
    assert choice({"lines": found, "modes": Outcome("named", 0.9)}) == given


@pytest.mark.parametrize(("unforeseen", "given"), [(1.04, "lines"), (1.6, "modes"), (float("nan"), "modes")])
def test_a_block_that_hides_a_peak_is_no_reason_against_lines_that_foretell_it_within_their_errors(unforeseen, given):
    """A joint and a mass, of a misfit of 15 deviations, had been \"clean\" as either answer missed that peak."""
    lines, modes = Outcome("ambiguous", 3.8, unforeseen=unforeseen), Outcome("clean", 2.7, unforeseen=1.04)
    assert suffices("lines", lines, SMALL) is (given == "lines")
    assert choice({"lines": lines, "modes": modes}) == given


@pytest.mark.parametrize(
    ("missed", "within", "told"),
    [(0.5, 1.04, 1.04), (9.0, 1.04, math.nan), (0.0, math.nan, math.nan), (0.5, 5.0, math.nan)],
)  # fmt: skip
def test_what_errors_of_the_fit_miss_in_a_block_is_taken_from_the_fit_to_all(missed, within, told):
    gain = Gain("some lines", 1.6, 3.8, 10.0, 1.0, missed, within)
    found = SimpleNamespace(
        verdict="named", causes=[], tests=(None, SimpleNamespace(p_value=0.5)), gain=gain, alternatives=[]
    )
    assert outcome_of(found).unforeseen == pytest.approx(told, nan_ok=True)
    assert outcome_of(found).held_out == 3.8
    modal = SimpleNamespace(**{**vars(found), "gain": replace(gain, chi2_unforeseen=1.2)})
    assert outcome_of(modal).unforeseen == 1.2


@pytest.mark.parametrize("modes", [Outcome("unknown", 1.0), Outcome("named", 1.7), Outcome("named", 1.6)])
def test_an_answer_of_the_modal_domain_must_predict_better_than_one_line_by_line(modes):
    assert choice({"lines": Outcome("named", 1.6), "modes": modes}) == "lines"


@pytest.mark.parametrize(("lines", "expected"), [(1.4, "modes"), (1.15, "lines"), (1.01, "lines")])
def test_lines_that_predict_little_of_what_modes_do_are_no_explanation(lines, expected):
    found = {"lines": Outcome("named", lines), "modes": Outcome("clean", 1.05, 0.009, inaccuracy=OFF)}
    assert choice(found) == expected
    assert choice({**found, "modes": Outcome("unknown", 1.05)}) == "lines"


@pytest.mark.parametrize(
    ("verdict", "inaccuracy", "expected"),
    [("named", OFF, "modes"), ("ambiguous", OFF, "modes"), ("named", EXACT, "lines"), ("clean", OFF, "lines"),
     ("unknown", OFF, "lines")],
)  # fmt: skip
def test_lines_that_explain_nothing_tell_nothing_of_a_simulation_that_is_certainly_off(verdict, inaccuracy, expected):
    modes = Outcome(verdict, 9.0, inaccuracy=inaccuracy)
    assert choice({"lines": Outcome("unknown", 3.0), "modes": modes}) == expected
    assert choice({"lines": Outcome("named", 1.2), "modes": modes}) == "lines"


@pytest.mark.parametrize(("held_out", "expected"), [(2.0, "modes"), (9.0, "lines"), (float("nan"), "lines")])
def test_of_two_attempts_that_explain_nothing_the_one_that_predicts_better_is_told(held_out, expected):
    modes = Outcome("unknown", held_out, inaccuracy=OFF)
    assert choice({"lines": Outcome("unknown", 3.0), "modes": modes}) == expected
    assert choice({"lines": Outcome("named", 3.0), "modes": modes}) == "lines"


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("mass", -0.03, True), ("stiffness", 0.08, True), ("stiffness", 1e-4, False), ("damping", -0.2, True),
     ("damping", 0.02, False)],
)  # fmt: skip
def test_a_factor_throughout_is_for_no_line_to_explain(name, value, expected):
    told = {name: {"value": value, "std": 1e-6}}
    found = Outcome("clean", 1.0, 0.3, inaccuracy=MAYBE, throughout=told)
    assert suffices("modes", found, SMALL) is expected
    assert not suffices("modes", replace(found, verdict="unknown"), SMALL)
    assert not suffices("modes", replace(found, left=1e-9), SMALL)


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        (SMALL, False),  # nothing is claimed
        (replace(SMALL, modes_off=True), True),
        (replace(LARGE, modes_off=True), True),
        (replace(LARGE, modes_off=True, samples=50_000), False),  # would take too long
        (replace(LARGE, modes_off=True, elements_off=True), False),
        (replace(SMALL, modes_off=True, whole_catalogue=False), False),
        (replace(SMALL, modes_off=True, undamped=True), False),
    ],
)
def test_what_modes_say_of_a_claim_is_asked_wherever_lines_can_follow_it(task, expected):
    assert claim_compared(task) is expected
    assert by_claim(task) is (expected and task.places < 300)


def test_what_is_named_beyond_doubt_may_be_foretold_where_something_small_is_left():
    left = replace(SURE, left=0.005)
    assert surely_foretold(SURE) and surely_foretold(left)
    assert not suffices("modes", replace(left, of_elements=True), SMALL)
    for less in ({"held_out": 1.3}, {"probability": 0.9}, {"alternatives": 1}, {"verdict": "ambiguous"}):
        assert not surely_foretold(replace(SURE, **less))


def test_a_simulation_without_damping_is_compared_by_modes_first_and_by_lines_if_these_say_nothing():
    undamped = replace(SMALL, undamped=True)
    assert order(undamped) == ("modes", "lines") == order(replace(undamped, modes_off=True))
    assert not one_place_first(undamped)
    assert all(suffices("modes", Outcome(word, 1.0), undamped) for word in ("clean", "named", "ambiguous"))
    assert not suffices("modes", Outcome("unknown", 9.0), undamped)


def test_what_has_no_name_but_is_known_beyond_doubt_is_not_looked_for_again():
    assert suffices("modes", Outcome("unknown", 9.0, askew=True), SMALL)
    assert not suffices("modes", Outcome("unknown", 9.0), SMALL)


def test_a_simulation_with_massless_dofs_is_left_to_the_modal_domain():
    massless = replace(SMALL, massless=True)
    assert order(massless)[0] == "modes" and suffices("modes", Outcome("unknown", 9.0), massless)
    dofs = tuple(f"m{k}" for k in range(4))
    structure = Structure(np.diag([1.0, 1.0, 0.0, 1.0]), 0.1 * np.eye(4), 100 * np.eye(4), dofs)
    data = Measurement(np.linspace(1.0, 2.0, 5), np.ones((1, 5, 2, 1), complex), form="receptance", outputs=dofs[:2],
                       inputs=dofs[:1])  # fmt: skip
    assert task_of(data, structure, "fixed").massless


def test_the_only_answer_is_given():
    assert choice({"lines": Outcome("unknown", 9.0)}) == "lines"
    assert choice({"modes": Outcome("unknown", 9.0)}) == "modes"


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Outcome("named", 1.05, 0.3, places=1), True),
        (Outcome("ambiguous", 1.05, 0.3, places=1), True),
        (Outcome("clean", 1.05, 0.3), False),
        (Outcome("unknown", 1.05, 0.3), False),
        (Outcome("ambiguous", 1.05, 0.3, places=3), False),  # three forces may stand for none
        (Outcome("named", 1.05, 0.05, places=1), False),  # two things may be left for one
        (Outcome("named", 1.25, 0.3, places=1), False),  # does not predict
    ],
)
def test_a_search_at_one_place_settles_the_matter_where_it_leaves_nothing(found, expected):
    assert settled(found) is expected


@pytest.mark.parametrize(
    ("low", "verdict", "expected"), [(1e-4, "ambiguous", False), (1e-4, "named", True), (0.01, "ambiguous", True)]
)
def test_modes_that_cannot_tell_beside_elements_that_are_hardly_off_leave_it_to_lines(low, verdict, expected):
    """Two small causes of an exact simulation look like a general inaccuracy of a few hundredths of a per cent."""
    off = {"stiffness": {"value": 0.011, "interval": (low, 0.02)}}
    found = Outcome(verdict, 1.0, 0.5, 0.6, alternatives=3, inaccuracy=off, joint=True)
    assert suffices("modes", found, SMALL) is expected


def test_causes_that_modes_do_not_know_are_looked_for_line_by_line():
    """Of a large model the modal domain would call clean what it has not looked for."""
    dofs = tuple(f"m{k}" for k in range(30))
    structure = Structure(np.eye(30), 0.1 * np.eye(30), 100 * np.eye(30), dofs)
    data = Measurement(np.linspace(1.0, 2.0, 5), np.ones((1, 5, 2, 1), complex), form="receptance", outputs=dofs[:2],
                       inputs=dofs[:1])  # fmt: skip
    for slugs, expected in (("sensor_clipping",), ("lines",)), (("leakage", "added_mass"), ("lines",)), (
        ("added_mass", "gap"), ("modes", "lines")
    ):  # fmt: skip
        asked = [c for c in catalogue() if c.slug in slugs]
        assert {c.slug for c in asked} == set(slugs)
        assert order(task_of(data, structure, "fixed", asked)) == expected


def test_whatever_is_claimed_of_modes_a_sure_cause_beside_elements_that_are_off_is_the_answer():
    sure = replace(SURE, inaccuracy=OFF)
    assert elements_surely(sure) and not elements_surely(replace(sure, inaccuracy=MAYBE))
    for doubt in ({"probability": 0.99}, {"alternatives": 1}, {"left": 1e-3}, {"verdict": "clean"}):
        assert not elements_surely(replace(sure, **doubt))


TENTH = {"stiffness": {"value": 1e-3, "interval": [6e-4, 3e-3]}, "mass": {"value": 7e-4, "interval": [3e-4, 2e-3]}}


@pytest.mark.parametrize(
    ("inaccuracy", "verdict", "joint", "hardly"),
    [
        (TENTH, "clean", False, True),
        (TENTH, "named", False, True),
        (TENTH, "named", True, False),
        (TENTH, "unknown", False, False),
        (OFF, "clean", False, False),
        (MAYBE, "clean", False, False),
    ],
)
def test_an_inaccuracy_far_below_the_usual_may_be_a_few_things_that_lines_tell(inaccuracy, verdict, joint, hardly):
    modes = Outcome(verdict, 1.02, 0.3, 0.0, 0, inaccuracy, joint=joint)
    assert hardly_off(modes) is hardly
    if not hardly:
        return
    near = replace(modes, exact_near=True)
    assert suffices("modes", modes, SMALL) and not suffices("modes", near, SMALL)
    for lines, told in ((0.99, "lines"), (1.03, "modes")):  # whose answer foretells better, though either leaves noise
        assert choice({"modes": near, "lines": Outcome("named", lines, 0.5, 0.99)}) == told


@pytest.mark.parametrize(("passed_over", "low", "enough"), [(False, 0.0, True), (True, 0.0, False), (True, 1e-4, True)])
def test_dampings_that_one_thing_explains_better_are_looked_at_line_by_line(passed_over, low, enough):
    """Where stiffness and mass may be exact; the damping is off by an eighth at least."""
    parts = {
        "stiffness": {"value": 2e-4, "interval": [low, 3e-3]}, "mass": {"value": 1e-4, "interval": [0.0, 1e-3]},
        "damping": {"value": 0.2, "interval": [0.125, 0.5]},
    }  # fmt: skip
    found = Outcome("clean", 1.05, 0.3, inaccuracy=parts, passed_over=passed_over)
    assert damping_off(found) is enough


@pytest.mark.parametrize(("with_damping", "plain", "said"), [(0.99, 0.01, True), (0.6, 0.4, False), (0.0, 0.99, False)])
def test_what_modes_do_not_tell_from_a_cause_that_lines_have_is_left_to_these(with_damping, plain, said, monkeypatch):
    """A drift of all stiffness was named as a spring with damping, which modes did not tell from a plain spring."""
    spring = lambda along: SimpleNamespace(kind="K", pattern=None, told_as=("joint_stiffness",), along=along)
    each = [SimpleNamespace(causes=(spring("in proportion"),), probability=with_damping)]
    each += [SimpleNamespace(causes=(spring(""),), probability=plain)]
    chosen = max(each, key=lambda e: e.probability)
    found = SimpleNamespace(causes=[{}], stage=SimpleNamespace(explanations=each), chosen=chosen)
    monkeypatch.setattr(routes, "ModalDiagnosis", SimpleNamespace)
    monkeypatch.setattr(routes, "standing_out", lambda stage, chosen: chosen.causes)
    assert of_elements(found) is said
