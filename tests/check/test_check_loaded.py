"""Sensors whose mass moves the frequencies of the rows that they measured."""

import numpy as np
import pytest
from test_check_words import FREQ, NAMES, NOISE, Bench, accelerance, chain

from modalax.check import check
from modalax.data import Measurement


def driven_at(o, stretch=1.0):
    """Accelerance at one of the five places to a force at the same."""
    w, shapes = chain()
    s = 2j * np.pi * FREQ[:, None]
    return (s**2 / (s**2 + 0.02 * w * stretch * s + (w * stretch) ** 2)) @ shapes[:, o] ** 2


def loaded(rows, mass):
    """FRFs whose rows were measured one by one, some with a heavy sensor [kg] at their place."""
    H = accelerance()
    for o in rows:
        H[:, o] /= (1 + mass * driven_at(o))[:, None]
    return H


@pytest.mark.parametrize("mass", [0.02, pytest.param(0.05, marks=pytest.mark.slow)])
def test_a_heavy_sensor_at_one_place_moves_the_frequencies_of_its_row(mass):
    """By up to 0.6 and 1.5 % at this place, 0.3 and 0.7 half-power bandwidths."""
    (found,) = Bench(loaded([3], mass)).measured()
    assert (found.what, found.where) == ("frequency_shift", (NAMES[3],))
    w, shapes = chain()
    true = -50 * mass * shapes[:, 3] ** 2  # %, to first order
    assert np.min(np.abs(found.size / true - 1)) < 0.05


def test_a_heavy_sensor_that_roves_moves_those_of_each_row():
    found = Bench(loaded(range(5), 0.04)).measured()
    (shift,) = (f for f in found if f.what == "frequency_shift")
    assert shift.where == NAMES and "output" in shift.evidence


@pytest.mark.parametrize("places", [range(5), range(3)])
def test_a_structure_that_moves_in_two_planes_alike_is_sound(places):
    """One force at an angle; sensors in one direction see modes of one plane, 1 % above those of the other."""
    one, other = accelerance()[:, places, :1], accelerance(stretch=1.01)[:, places, :1]
    H = np.concatenate([one, other], axis=1)
    rng, sigma = np.random.default_rng(0), NOISE * np.sqrt(np.mean(np.abs(H) ** 2)) * np.ones((1, *H.shape))
    H = H + sigma * (rng.normal(size=sigma.shape) + 1j * rng.normal(size=sigma.shape)) / np.sqrt(2)
    names = [f"{k + 1}:+{d}" for d in "YZ" for k in places]
    m = Measurement(FREQ, H, form="accelerance", outputs=names, inputs=["9:+Z"], variance=sigma**2)
    assert [f.evidence for f in check(m)] == []
