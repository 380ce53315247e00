"""A place is found by its force although the modes of the simulation are off by far more than the noise."""

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.screening import one_force
from modalax.diagnose.screening.modes_beside import Beside, modes_beside
from modalax.diagnose.screening.one_force import places_of_one_force
from modalax.model import Structure
from modalax.model.examples import five_dof

FREQ = np.arange(20.0, 70.0, 0.5)
PLACE, STD, SHIFT = ("2", "4"), 0.004, 0.006
NOISE = 0.002


@pytest.fixture(scope="module")
def comparison():
    """A spring at a place of a structure whose frequencies are 1.5 claimed deviations above the simulation's."""
    s = five_dof()
    e = np.eye(5)[s.index(PLACE[0])] - np.eye(5)[s.index(PLACE[1])]
    K = np.asarray(s.K) * (1 + SHIFT) ** 2
    truth = Structure(s.M, np.asarray(s.C) * (1 + SHIFT), K + 40000.0 * np.outer(e, e), s.dofs)
    clean = Measurement.from_frfs([truth.frf(FREQ, inputs=["1"])])
    sigma = NOISE * np.sqrt(np.mean(np.abs(clean.H) ** 2))
    noise = np.random.default_rng(0).standard_normal((2, *clean.H.shape)) * sigma / np.sqrt(2)
    H = np.asarray(clean.H) + noise[0] + 1j * noise[1]
    data = clean.replace(H=H, variance=sigma**2 + np.zeros(H.shape))
    return make_comparison(data, Structure(s.M, s.C, s.K, s.dofs, frequency_std=STD), "fixed")


def test_the_place_leads_once_the_modes_follow(comparison):
    places = comparison.scene.pairs()
    nominal = Beside.nominal(comparison)
    at = {p.where: nominal.step(nominal.direction(p))[0] for p in places}
    samples = comparison.problem.samples
    assert at[PLACE] > 30 * samples  # about the nominal modes even the true place leaves far more than noise
    ranked = sorted(modes_beside(comparison, places, len(places)), key=lambda one: one[1])
    place, chi2, beside = ranked[0]
    assert place.where == PLACE and ranked[1][1] > 10 * chi2
    # one complex force a line is taken up, of five outputs
    assert abs(chi2 - 0.8 * samples) < 5 * np.sqrt(2 * samples)
    assert np.allclose(beside.theta[0, :5] * STD, SHIFT, atol=2e-3)


def test_one_force_explains_the_data_beside_claimed_modes(comparison):
    assert [p.where for p in places_of_one_force(comparison)] == [PLACE]


def test_nothing_is_said_of_one_force_once_the_time_is_up(comparison):
    late = Deadline(0.0)
    assert (
        places_of_one_force(comparison, late) == ()
        and modes_beside(comparison, comparison.scene.pairs(), 9, late) == []
    )


@pytest.mark.parametrize(("gain", "settled"), [(1.0, 15), (1.2, 2)])
def test_modes_follow_at_a_few_places_where_none_of_the_likeliest_explains_all(comparison, monkeypatch, gain, settled):
    data, seen = comparison.measurement, []
    factor = np.where(np.arange(len(data.outputs)) == 2, gain, 1.0)[:, None]
    given = make_comparison(data.replace(H=np.asarray(data.H) * factor), comparison.simulation, "fixed")
    inner = Beside.settled
    monkeypatch.setattr(Beside, "settled", lambda self, of, steps: (seen.append(1), inner(self, of, steps))[1])
    monkeypatch.setattr(one_force, "FIRST", 2)
    assert [p.where for p in places_of_one_force(given)] == ([PLACE] if gain == 1 else [])
    by_place = len(seen) - (len(data.outputs) + 5 if gain == 1 else 0)  # with faults and modes
    assert by_place == settled


@pytest.mark.parametrize("coupled", [False, True])
def test_changes_by_the_modal_parameters_are_those_of_small_steps(comparison, coupled):
    """Of modes on their own, and of modes that a damper at one place couples, whose shapes turn with them."""
    s = comparison.simulation
    C = np.array(s.C)
    C[0, 0] += 20 * C.max() * coupled
    claimed = Structure(s.M, C, s.K, s.dofs, frequency_std=STD, damping_std=0.05)
    given = make_comparison(comparison.measurement, claimed, "fixed")
    assert (given.problem.modal_form.mixing is not None) == coupled
    place = next(p for p in given.scene.pairs() if p.where == PLACE)
    theta = 0.3 * np.random.default_rng(1).standard_normal((2, given.problem.modal_form.stiffness.shape[0]))
    here = Beside.at(given, theta)
    slopes = here.turned(place), *here.across_by_parameters(place)
    kept = [len(theta[0]) + 1, 2, 0]
    for k in kept:
        step = np.zeros(theta.size)
        step[k] = 1e-3
        low, high = (Beside.at(given, theta + sign * step.reshape(theta.shape)) for sign in (-1, 1))
        for J, name in zip(slopes, ("direction", "motion", "drive"), strict=True):
            difference = (getattr(high, name)(place) - getattr(low, name)(place)) / 2e-3
            assert np.abs(J[k] - difference).max() < 1e-5 * np.abs(J[k]).max()
