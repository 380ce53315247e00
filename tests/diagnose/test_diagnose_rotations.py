"""What is told at a rotation has the units of one, end to end."""

import numpy as np
import pytest

from modalax import diagnose
from modalax.data import FRF, Measurement
from modalax.diagnose.rotations import in_own_units, rotations_in, turns
from modalax.model import Structure

INERTIA, STIFF = np.array([2.0, 1.5, 1.0]), 4e4  # kg m^2, N m/rad
DOFS = ("1:+RZ", "2:+RZ", "3:+RZ")


def shaft(factor=1.0):
    """Three discs in a row, clamped at one end."""
    K = np.zeros((3, 3))
    K[0, 0] = STIFF
    for k, size in ((0, factor), (1, 1.0)):
        K[k : k + 2, k : k + 2] += size * STIFF * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Structure(np.diag(INERTIA), 2e-4 * K, K, DOFS)


def test_a_torsional_spring_is_told_in_newton_metres_a_radian():
    freq = np.linspace(5.0, 60.0, 300)
    H = np.asarray(shaft(0.8).frf(freq, outputs=DOFS, inputs=DOFS[:1]).H)
    rng = np.random.default_rng(0)
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean())
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    data = FRF(freq, H, variance=np.full(H.shape, sigma**2), outputs=DOFS, inputs=DOFS[:1])
    (cause,) = diagnose(Measurement.from_frfs([data]), shaft()).causes
    assert (cause["name"], set(cause["where"])) == ("joint_stiffness", set(DOFS[:2]))
    (told,) = cause["parameters"].values()
    assert told["unit"] == "N m/rad" and abs(told["value"] + 0.2 * STIFF) < 4 * told["std"]


@pytest.mark.parametrize(
    ("where", "given", "unit"),
    [
        (["3:+RX"], "kg", "kg m^2"), (["3:-rx", "4:RX"], "N/m", "N m/rad"), (["3:+RX"], "-", "-"),
        (["3:+Z", "3:+RX"], "N/m", "N/m"), (["3:+X"], "kg", "kg"), ([], "N", "N"), ([2], "-", "-"),
    ],
)  # fmt: skip
def test_units_are_those_of_the_place(where, given, unit):
    cause = {"name": "a", "where": where, "parameters": {"b": {"value": 1.0, "std": 0.1, "unit": given}}}
    (told,) = in_own_units([cause])
    assert told["parameters"] == {"b": {"value": 1.0, "std": 0.1, "unit": unit}}
    assert cause["parameters"]["b"]["unit"] == given  # which is left as it was


def test_names_without_a_direction_do_not_turn():
    assert [turns(name) for name in ("R", "12", "RX", "wing:3:+RY", "3:+Y")] == [False, False, False, True, False]


def test_a_body_that_pitches_turns_whatever_it_is_called():
    """Two springs to the ground at levers of 1 and -1.5 m, and one between the body and a mass at 0.4 m."""
    K = sum(k * np.outer(g, g) for k, g in ((2e4, [0, 1, 1]), (3e4, [0, 1, -1.5]), (1e4, [1, -1, -0.4])))
    K = np.block([[K, np.zeros((3, 1))], [np.zeros((1, 3)), np.zeros((1, 1))]])  # and a further mass on the body
    g = np.array([0, -1, 0.7, 1])
    car = Structure(np.eye(4), 0 * K, K + 5e3 * np.outer(g, g), ("seat", "body", "pitch", "engine"))
    assert rotations_in(car) == {"pitch"} and rotations_in(shaft()) == {"1:+RZ", "2:+RZ", "3:+RZ"}
    assert rotations_in(object()) == frozenset()
    cause = {"name": "a", "where": ["pitch"], "parameters": {"b": {"value": 1.0, "std": 0.1, "unit": "kg"}}}
    (told,) = in_own_units([cause], rotations_in(car))
    assert told["parameters"]["b"]["unit"] == "kg m^2"
    assert in_own_units([cause])[0]["parameters"]["b"]["unit"] == "kg"
