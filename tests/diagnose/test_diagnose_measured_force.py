"""Place and law of a strong element, read off the force that it must have."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.causes import catalogue
from modalax.diagnose.comparison import make_comparison, with_noise_beside
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.harmonics import HIGHEST
from modalax.diagnose.screening.modes_beside import modes_beside
from modalax.diagnose.search import measured_force
from modalax.diagnose.search.joints_by_force import joints_by_force
from modalax.diagnose.search.measured_force import FIRST, REFINED, measured_forces, starts_from_forces
from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate import joints
from modalax.simulate.harmonic import simulate

FREQ = np.arange(20.0, 70.0, 1.0)  # as of other tests, whose programs these share
LEVELS = np.array([1.0, 3.0, 6.0])
PLACE = ("2", "4")


def noisy(clean: Measurement, seed: int) -> Measurement:
    """The same with 1 % noise of each channel's root mean square, its variance known."""
    rng = np.random.default_rng(seed)
    sigma = 0.01 * np.sqrt(np.mean(np.abs(clean.H) ** 2, axis=(0, 1)))
    noise = rng.standard_normal((2, *clean.H.shape)) * sigma / np.sqrt(2)
    return clean.replace(H=np.asarray(clean.H) + noise[0] + 1j * noise[1], variance=sigma**2 + np.zeros(clean.H.shape))


def look(measurement):
    """The comparison and the simulation alone."""
    comparison = with_noise_beside(make_comparison(measurement, five_dof(), "fixed"))
    nothing = np.zeros((2, comparison.problem.modal_form.stiffness.shape[0]))
    return comparison, comparison.fit([Hypothesis(theta=nothing)], 1)[0]


def test_a_change_of_any_size_is_taken_up_at_its_place_alone():
    s = five_dof()
    a, b = (s.index(n) for n in PLACE)
    e = np.eye(5)[a] - np.eye(5)[b]
    stiffer = Structure(s.M, s.C, s.K + 40000.0 * np.outer(e, e), s.dofs)
    clean = Measurement.from_frfs([stiffer.frf(FREQ, inputs=["1"])])
    comparison, null = look(noisy(clean, 0))
    ranked = measured_forces(comparison, comparison.scene.pairs())
    assert ranked[0].place.where == PLACE
    # five outputs less one complex force a line leave four fifths of the samples; the forces are paid for
    samples = comparison.problem.samples
    assert abs(ranked[0].chi2 - samples) < 4 * np.sqrt(2 * samples)
    assert ranked[1].chi2 > 10 * samples
    impedance, weight = ranked[0].impedance, ranked[0].weight
    assert (weight**2 * impedance.real).sum() / (weight**2).sum() == pytest.approx(40000.0, rel=1e-2)
    first = starts_from_forces(comparison, null, catalogue(1))[0]
    assert (first.causes[0].slug, first.freedom) == ("joint_stiffness", 1.0)
    late = replace(comparison, late=Deadline(0.0))  # when the time is up no place is looked at
    assert starts_from_forces(late, null, catalogue(1)) == joints_by_force(late, null, catalogue(1), null) == []


@pytest.mark.parametrize(
    ("slug", "joint", "value"),
    [
        pytest.param("cubic_stiffness", joints.CubicSpring(3e10), 3e10, marks=pytest.mark.slow),
        ("elasto_slip", joints.ElastoSlip(30000.0, 3.0), 30000.0),
        pytest.param("quadratic_damping", joints.QuadraticDamping(400.0), 400.0, marks=pytest.mark.slow),
    ],
)
def test_the_law_is_read_off_the_force(slug, joint, value):
    comparison, null = look(
        noisy(simulate(five_dof(), [joint], [PLACE], FREQ, LEVELS, inputs=["1"], harmonics=HIGHEST), 1)
    )
    first = starts_from_forces(comparison, null, catalogue(3))[0]
    assert (first.causes[0].slug, first.places[0].where) == (slug, PLACE)
    assert first.params[0][0] == pytest.approx(value, rel=0.1)


def test_an_unmeasured_place_is_found_too():
    joint, place = joints.CubicSpring(3e10), PLACE
    data = simulate(five_dof(), [joint], [place], FREQ, LEVELS, inputs=["1"], harmonics=HIGHEST)
    some = data.replace(H=data.H[:, :, ::2], outputs=data.outputs[::2])
    comparison, _ = look(noisy(some, 6))
    ranked = measured_forces(comparison, comparison.scene.pairs())
    # by the structure's symmetry a force between 1 and 5 moves these outputs as one between 2 and 4 does
    assert {f.place.where for f in ranked[:2]} == {place, ("1", "5")}
    assert ranked[1].chi2 - ranked[0].chi2 < 1e-3 * ranked[0].chi2 < 1e-4 * ranked[2].chi2


def test_a_nearly_right_simulation_is_left_to_the_linear_screening():
    clean = Measurement.from_frfs([five_dof().frf(FREQ, inputs=["1"])])
    comparison, null = look(noisy(clean, 3))
    assert starts_from_forces(comparison, null, catalogue(1)) == []
    chi2 = [f.chi2 for f in measured_forces(comparison, comparison.scene.pairs())]
    spread = 4 * np.sqrt(2 * comparison.problem.samples)
    assert all(abs(x - y) < spread for x, y in itertools.pairwise(chi2))


def test_modes_follow_beside_many_places_only_where_one_of_the_first_explains_enough(monkeypatch):
    """Beside two causes no single force explains anything, and 40 places took ten seconds to show it."""
    asked = []
    monkeypatch.setattr(measured_force, "modes_beside", lambda *a: asked.append((a[2], len(a) > 4)) or modes_beside(*a))
    clean = Measurement.from_frfs([five_dof().frf(FREQ[::2], inputs=["1"])])
    claimed = replace(five_dof(), frequency_std=0.003, damping_std=0.05)
    comparison = make_comparison(noisy(clean, 3), claimed, "fixed")
    places = comparison.scene.pairs()[:2]
    alone = measured_forces(comparison, places, enough=0.0)
    assert asked == [(FIRST, False)] and len(alone) == 2
    measured_forces(comparison, places, enough=1.1 * alone[0].chi2)
    assert asked[1:] == [(FIRST, False), (REFINED, True)]
