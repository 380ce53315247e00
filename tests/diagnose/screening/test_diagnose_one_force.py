"""Whether one force at one place explains the data: against least squares by hand, and what must not look like it."""

from types import SimpleNamespace

import numpy as np
import pytest
from chains import comparison_of, grid, sprung

from modalax import Structure
from modalax.diagnose import pipeline, routes
from modalax.diagnose.causes import catalogue
from modalax.diagnose.causes.base import ElementCause
from modalax.diagnose.comparison import causes_of, empty
from modalax.diagnose.deadline import NEVER
from modalax.diagnose.decision.route import Outcome, Task
from modalax.diagnose.screening import one_force
from modalax.diagnose.screening.law_free import gains_without_law
from modalax.diagnose.screening.products import at_places

STRUCTURE = grid(8, False)


class Changed:
    """FRFs of a structure with a fault of the measurement on them."""

    def __init__(self, structure, fault):
        self.structure, self.fault = structure, fault

    def frf(self, freq, **channels):
        found = self.structure.frf(freq, **channels)
        return found.replace(H=self.fault(np.array(found.H)))


def gained(H):
    H[:, 4] *= 1.2
    return H


def driven(H):
    return H * np.array([1.2, 1.0])


def test_gain_of_a_free_force_is_that_of_least_squares_at_every_line():
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    left = comparison.residual(empty(comparison))
    gains, places = one_force._gains(comparison, one_force._reduced(comparison, left), left)
    names, freq = list(STRUCTURE.dofs), comparison.scene.freq
    H = np.asarray(STRUCTURE.frf(freq, outputs=names, inputs=names).H)
    weight = np.asarray(comparison.problem.weight)
    for k in (0, 9, 20, len(places) - 1):
        a, b = places[k].index[:2]
        column = H[:, :, a] - (H[:, :, b] if b >= 0 else 0.0)
        expected = 0.0
        for run, line, i in np.ndindex(2, len(freq), 2):
            seen, wanted = weight[run, line, :8, i] * column[line], left[run, line, :8, i]
            rest = wanted - seen * np.linalg.lstsq(seen[:, None], wanted, rcond=None)[0]
            expected += (np.abs(wanted) ** 2).sum() - (np.abs(rest) ** 2).sum()
        assert gains[k] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("alike", [True, False])
def test_what_any_column_leaves_is_no_more_than_the_best_one_does(alike):
    rng = np.random.default_rng(2)
    draw = lambda *shape: rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    weight = np.exp(rng.standard_normal((2, 5, 4, 1))) * np.array([1.0, 3.0, 0.5])
    weight = weight if alike else weight * np.exp(0.3 * rng.standard_normal(weight.shape))
    weight[0, 0, 1, 2] = 0.0  # left out
    one = draw(2, 5, 4, 1) * draw(2, 5, 1, 3)
    assert one_force.left_by_any_column(weight * one, weight) < 1e-12 * (np.abs(weight * one) ** 2).sum()
    other = one + 0.5 * draw(2, 5, 4, 3)
    bound, least = one_force.left_by_any_column(weight * other, weight), 0.0
    for run, line in np.ndindex(2, 5):  # the best column, by alternating least squares
        W, D = weight[run, line], other[run, line]
        column = np.linalg.svd(W * D)[0][:, 0]
        for _ in range(400):
            factor = (W**2 * column.conj()[:, None] * D).sum(axis=0) / (W**2 * np.abs(column[:, None]) ** 2).sum(axis=0)
            column = (W**2 * D * factor.conj()).sum(axis=1) / (W**2 * np.abs(factor) ** 2).sum(axis=1)
        least += (np.abs(W * (D - column[:, None] * factor)) ** 2).sum()
    assert 0.2 * least < bound <= least * (1 + 1e-9)
    if alike:  # but for what was left out it is the very least
        assert bound > 0.9 * least


def test_no_place_is_asked_for_where_no_column_explains_the_data(monkeypatch):
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    assert one_force.places_of_one_force(comparison)
    monkeypatch.setattr(one_force, "left_by_any_column", lambda left, weight: 1e4)
    monkeypatch.setattr(one_force, "_gains", lambda *a: pytest.fail("no place can be it"))
    assert one_force.places_of_one_force(comparison) == ()


def test_of_very_many_places_the_loudest_lines_tell_that_none_explains(monkeypatch):
    comparison, state = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    left, reduced = comparison.residual(empty(comparison)), state.reduced[True]
    monkeypatch.setattr(one_force, "ENOUGH", 10**6)  # of all lines it is what the best place leaves
    gains, _ = one_force._gains(comparison, reduced, left)
    chi2 = float((np.abs(left) ** 2).sum()) - 2 * int(comparison.live().sum())
    assert one_force._left_where_loudest(reduced, left) == pytest.approx(chi2 - gains.max(), rel=1e-5)
    monkeypatch.setattr(one_force, "MANY", 3)
    assert one_force.places_of_one_force(comparison)
    both = sprung(STRUCTURE, 2, 5, 5e3)
    two, _ = comparison_of(STRUCTURE, sprung(both, 0, 3, 5e3), lines=20)
    monkeypatch.setattr(one_force, "ENOUGH", 20)
    monkeypatch.setattr(one_force, "left_by_any_column", lambda left, weight: 0.0)
    monkeypatch.setattr(one_force, "_gains", lambda *a: pytest.fail("no place can be it"))
    assert one_force.places_of_one_force(two) == ()


def test_all_pairs_at_once_are_the_same(monkeypatch):
    monkeypatch.setattr(one_force, "LOUDEST", 10**6)
    comparison, state = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    left = comparison.residual(empty(comparison))
    gains, places = one_force._gains(comparison, one_force._reduced(comparison, left), left)
    every, _ = one_force._at_loudest_lines(state.reduced[True], left)
    at = [p.index[:2] if p.index[1] >= 0 else (p.index[0],) * 2 for p in places]
    np.testing.assert_allclose([every[a, b] for a, b in at], gains, rtol=1e-5)


def test_a_force_like_the_motion_gains_what_least_squares_by_hand_does(monkeypatch):
    monkeypatch.setattr(one_force, "LOUDEST", 10**6)
    comparison, state = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    left = comparison.residual(empty(comparison))
    _, along = one_force._at_loudest_lines(state.reduced[True], left)
    names, freq = list(STRUCTURE.dofs), comparison.scene.freq
    H = np.asarray(STRUCTURE.frf(freq, outputs=names, inputs=names).H)
    driven = [names.index(name) for name in comparison.scene.inputs]
    weight = np.asarray(comparison.problem.weight)
    for a, b in ((2, 5), (0, 7), (3, 3)):
        column = H[:, :, a] - (H[:, :, b] if b != a else 0.0)
        motion = H[:, a][:, driven] - (H[:, b][:, driven] if b != a else 0.0)
        expected = 0.0
        for run in range(2):
            rows = np.s_[run, : len(freq), :8, : len(driven)]
            seen = (weight[rows] * column[:, :8, None] * motion[:, None]).ravel()
            expected += abs(seen.conj() @ left[rows].ravel()) ** 2 / (np.abs(seen) ** 2).sum()
        assert along[a, b] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("a", "b"), [(2, 5), (1, 6)])
def test_a_joint_without_a_law_is_best_at_the_place_of_a_spring(a, b):
    """And takes away nearly all that a free force does there beyond what noise gives to that."""
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, a, b, 2e3))
    left = comparison.residual(empty(comparison))
    reduced, places = one_force._reduced(comparison, left), comparison.scene.pairs()
    gains, unknowns = gains_without_law(at_places(reduced, places), reduced)
    best = int(np.argmax(gains))
    assert places[best].index[:2] == (a, b)
    free, _ = one_force._gains(comparison, one_force._reduced(comparison, left), left)
    count = 2 * comparison.live().any(axis=2).sum()
    assert gains[best] == pytest.approx(free[best] - count, abs=5 * np.sqrt(4 * count) + unknowns)
    few = one_force._likeliest(comparison, left, places)
    assert few[0].index[:2] == (a, b) and len(few) < len(places)


@pytest.mark.parametrize(("kind", "size"), [("M", 0.05), ("M", 0.5), ("C", 20.0), ("C", 200.0), ("K", 2e5)])
def test_a_joint_without_a_law_takes_away_all_that_a_linear_element_of_any_size_does(kind, size):
    """In a band of a decade; the largest move modes by ten times their width and more."""
    matrices = {name: np.array(getattr(STRUCTURE, name)) for name in "MCK"}
    matrices[kind][3, 3] += size
    comparison, _ = comparison_of(STRUCTURE, Structure(**matrices, dofs=STRUCTURE.dofs))
    left = comparison.residual(empty(comparison))
    reduced, places = one_force._reduced(comparison, left), comparison.scene.pairs()
    at = at_places(reduced, [p for p in places if p.index[:2] == (3, -1)])
    gains, unknowns = gains_without_law(at, reduced)
    omega = reduced.omega[None, :, None]
    Z = size * {"M": -(omega**2), "C": 1j * omega, "K": 1.0}[kind]
    y = -Z / (1 + Z * at.drive[0][None, :, None]) * at.motion[0][None]
    exact = float((2 * y.conj() * at.S[0]).real.sum() - (at.N[0] * np.abs(y) ** 2).sum())
    assert exact < gains[0] + 1 < exact + 2 * unknowns


class Stiffening:
    """The grid with a cubic spring between two DoFs, driven at one, solved at the first harmonic by Newton's method."""

    def __init__(self, cubic, a, b, level):
        self.cubic, self.a, self.b, self.level = cubic, a, b, level

    def frf(self, freq, outputs, inputs):
        found = STRUCTURE.frf(freq, outputs=outputs, inputs=outputs)
        H = np.asarray(found.H)
        column = H[:, :, self.a] - H[:, :, self.b]
        free = self.level * column[:, [outputs.index(name) for name in inputs]]
        drive = (column[:, self.a] - column[:, self.b])[:, None]
        x, k = np.zeros_like(free), 0.75 * self.cubic
        for share in np.linspace(0.02, 1.0, 50):  # from small forces to the whole
            for _ in range(20):
                r = x + drive * k * np.abs(x) ** 2 * x - share * free
                there, back = 1 + 2 * drive * k * np.abs(x) ** 2, drive * k * x**2
                x = x - (there.conj() * r - back * r.conj()) / (np.abs(there) ** 2 - np.abs(back) ** 2)
        assert np.abs(r).max() < 1e-9 * np.abs(free).max()
        H = H[:, :, [outputs.index(name) for name in inputs]]
        return found.replace(H=H - column[:, :, None] * (k * np.abs(x) ** 2 * x / self.level)[:, None], inputs=inputs)


def test_a_joint_without_a_law_takes_away_what_a_cubic_spring_does_over_decades_of_amplitude():
    """Hats over the logarithm alone leave four times what noise does, of some structures more than at other places."""
    level, cubic = 2.0, 1e13
    comparison, _ = comparison_of(STRUCTURE, Stiffening(cubic, 2, 5, level), level=(level, level))
    left = comparison.residual(empty(comparison))
    reduced, places = one_force._reduced(comparison, left), comparison.scene.pairs()
    gains, unknowns = gains_without_law(at_places(reduced, places), reduced)
    free, _ = one_force._gains(comparison, reduced, left)
    count = 2 * comparison.live().any(axis=2).sum()
    best = int(np.argmax(gains))
    assert places[best].index[:2] == (2, 5)
    assert gains[best] == pytest.approx(free[best] - count, abs=5 * np.sqrt(4 * count) + unknowns)


@pytest.mark.parametrize(("a", "b"), [(2, 5), (1, 6)])
def test_the_place_of_a_spring_is_among_a_few(a, b):
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, a, b, 5e3))
    found = one_force.places_of_one_force(comparison)
    assert (a, b) in [p.index[:2] for p in found]
    assert len(found) < len(comparison.scene.pairs()) / 2


@pytest.mark.parametrize(
    "changed",
    [
        STRUCTURE,
        Changed(STRUCTURE, gained),
        Changed(STRUCTURE, driven),
        sprung(sprung(STRUCTURE, 2, 5, 2e4), 0, 7, 2e4),
        STRUCTURE.replace(C=1.3 * np.asarray(STRUCTURE.C)),
    ],
    ids=["nothing", "gain of an output", "gain of an input", "two springs", "damping of all modes"],
)
def test_nothing_else_is_taken_for_a_force_at_one_place(changed):
    assert one_force.places_of_one_force(comparison_of(STRUCTURE, changed)[0]) == ()


def test_nothing_is_said_where_too_many_places_would_do(monkeypatch):
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3))
    monkeypatch.setattr(one_force, "KEPT", len(one_force.places_of_one_force(comparison)) - 1)
    assert one_force.places_of_one_force(comparison) == ()


def test_a_claimed_spread_or_few_outputs_leave_the_question_open():
    claimed, _ = comparison_of(grid(8, True), sprung(STRUCTURE, 2, 5, 5e3), lines=20)
    few, _ = comparison_of(grid(3, False), sprung(grid(3, False), 0, 2, 5e4), lines=20)
    assert one_force.places_of_one_force(claimed) == () == one_force.places_of_one_force(few)


def test_only_elements_at_these_places_are_searched(monkeypatch):
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3))
    asked = []
    monkeypatch.setattr(pipeline, "searched", lambda comparison, causes, tell: asked.append(comparison))
    monkeypatch.setattr(pipeline, "FITTED_EACH", 0)
    pipeline.at_one_place(comparison.measurement, STRUCTURE, "auto", Task(True), lambda _: None, NEVER, lambda: None)
    (used,) = asked
    assert used.joint_places() == list(used.only) and 0 < len(used.only) < len(comparison.scene.pairs())
    assert all(isinstance(c, ElementCause) for c in causes_of(None, used, catalogue(2)))
    assert not all(isinstance(c, ElementCause) for c in causes_of(None, comparison, catalogue(2)))


@pytest.mark.parametrize(
    ("verdict", "left", "whole", "off", "expected"),
    [("named", 0.3, True, None, "modes"), ("named", 1e-4, True, None, "open"), ("clean", 0.3, True, None, "open"),
     ("named", 0.3, False, None, "open"), ("clean", 0.3, False, [4e-3, 2e-2], "modes"),
     ("clean", 1e-4, False, [4e-3, 2e-2], "open"), ("clean", 0.3, False, [0.0, 2e-2], "open")],
)  # fmt: skip
def test_modes_are_asked_before_the_whole_catalogue_and_answer_where_they_leave_nothing(
    monkeypatch, verdict, left, whole, off, expected
):
    """No element or joint between two points is a beam that is softer as a whole, which modes name in seconds.

    Nor are elements that are all off: at 8 sensors of a plate one force had stood for them, for two minutes.

    What else it may be is open: an oscillator and hum together had been an oscillator at another place, and a delay of
    all sensors hid a damper, as which lines tell dampings that are off.
    """
    comparison, _ = comparison_of(STRUCTURE, sprung(STRUCTURE, 2, 5, 5e3))
    monkeypatch.setattr(pipeline, "searched", lambda *_: "all")
    monkeypatch.setattr(pipeline, "explain_force", lambda look, causes: None)
    inaccuracy = {} if off is None else {"stiffness": {"value": 8e-3, "interval": off}}
    said = Outcome(verdict, 1.0, left, 1.0, inaccuracy=inaccuracy, of_elements=whole)
    for module in (pipeline, routes):
        monkeypatch.setattr(module, "outcome_of", lambda found: said)
    modes = SimpleNamespace(verdict=verdict)
    monkeypatch.setattr(pipeline, "of_elements", lambda found: False)
    tell = lambda _: None
    found = pipeline.at_one_place(comparison.measurement, STRUCTURE, "auto", Task(True), tell, NEVER, lambda: modes)
    assert found == {"modes": modes, "open": None}[expected]
