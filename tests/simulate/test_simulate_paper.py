"""The joint of the review of aircraft modal-analysis methods: its three published numbers, met at once."""

import importlib
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[2] / "experiments" / "paper"


@pytest.fixture(scope="module")
def section4():
    sys.path.insert(0, str(SCRIPTS))
    yield importlib.import_module("section4")
    sys.path.remove(str(SCRIPTS))


def test_the_three_published_numbers_go_with_one_stiffness_and_one_slip_force(section4):
    """What the search finds, put in: largest response at 35 Hz, there 35.23 Hz and 3.51 %."""
    choice = section4.CHOICES["linear ratio 2 %, added at actual frequency"]
    got = section4.VALUE(np.log([9828.67, 2.424937]), choice=choice)
    np.testing.assert_array_less(np.abs(got - np.array([35.0, 35.23, 3.51])), [0.5, 0.005, 0.005])
    # with a tenth more slip force or stiffness they do not
    for other in ([9828.67, 2.667], [10811.5, 2.424937]):
        off = np.abs(section4.VALUE(np.log(other), choice=choice) - np.array([35.0, 35.23, 3.51]))
        assert (off > [0.5, 0.005, 0.005]).sum() >= 1


@pytest.mark.slow
def test_the_joint_meets_all_three_published_numbers_at_once(section4):
    """Largest response near mode 2 at 35 Hz, there 35.23 Hz and 3.51 %, at 6 N on DoF 1: two unknowns."""
    choice = section4.CHOICES["linear ratio 2 %, added at actual frequency"]
    unknowns, got, slope = section4.solve(choice)
    np.testing.assert_array_less(np.abs(got - [35.0, 35.23, 3.51]), [0.5, 0.005, 0.005])
    # sensitivities that go with them, by the implicit function, against differences of new solutions
    h = 1e-5
    differences = [
        (section4.VALUE(unknowns + s, choice=choice) - section4.VALUE(unknowns - s, choice=choice)) / (2 * h)
        for s in h * np.eye(2)
    ]
    np.testing.assert_allclose(slope, np.stack(differences, axis=1), rtol=1e-4)
    # what the numbers are read from: at its peak, the motion balances the equations of all five DoFs
    law, s = section4.joint(jnp.asarray(unknowns)), section4.STRUCTURE
    w = 2 * np.pi * got[0]
    r = section4.harmonic_balance(s, [law], [["3", "5"]], [got[0]], 6.0, inputs=["1"])
    X, b = np.asarray(r.X[0, 0, :, 0, 0]), np.array([0, 0, 1.0, 0, -1.0])
    N = complex(law.describing(np.abs(b @ X), w))
    F = (np.asarray(s.K) + N * np.outer(b, b) + 1j * w * np.asarray(s.C) - w**2 * np.asarray(s.M)) @ X
    np.testing.assert_allclose(F, [6.0, 0, 0, 0, 0], atol=1e-8)
