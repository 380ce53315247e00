"""What further causes beside an inexact joint must explain before they count."""

from dataclasses import replace

import numpy as np
import pytest

from modalax.diagnose.causes.joints import CoulombFriction
from modalax.diagnose.causes.local import AddedMass
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.search.tolerance import tolerated, uncounted, widened

NULL = 1_010_000.0
JOINT = Hypothesis(
    (CoulombFriction(),), (Place(("1", "2"), (0, 1, 0)),), (np.ones((4, 1, 1, 1)),), (np.array([2.0]),), chi2=10_000.0,
    freedom=1.0, fidelity=0.05,
)  # fmt: skip


def with_mass(chi2: float) -> Hypothesis:
    return replace(JOINT.with_cause(AddedMass(), Place(("3",), (2, -1, 0)), None, np.array([1.0])), chi2=chi2)


def test_a_joint_may_leave_what_its_harmonics_left_out_do():
    assert tolerated(JOINT, NULL) == pytest.approx(0.05**2 * 1e6)
    one_harmonic = replace(JOINT, fidelity=None)
    assert tolerated(one_harmonic, NULL) == pytest.approx(CoulombFriction.fidelity**2 * 1e6)


def test_intervals_hold_the_inexactness_of_a_single_harmonic():
    one_harmonic = replace(JOINT, fidelity=None, covariance=np.array([[4.0]]))
    bend = CoulombFriction.fidelity * np.sqrt(NULL - JOINT.chi2)
    covariance = widened(one_harmonic, NULL).covariance
    assert covariance is not None
    assert covariance[0, 0] == pytest.approx(4.0 * (1 + bend**2))
    in_full = replace(one_harmonic, fidelity=0.05)
    assert widened(in_full, NULL) is in_full


def test_a_further_cause_counts_for_what_it_explains_beyond_that():
    fitted = [JOINT, with_mass(9000.0)]
    assert uncounted(JOINT, fitted, NULL) == 0
    assert uncounted(with_mass(9000.0), fitted, NULL) == pytest.approx(1000.0)  # all of it
    assert uncounted(with_mass(6000.0), fitted, NULL) == pytest.approx(2500.0)  # no more than the joint may leave
    assert uncounted(with_mass(10_500.0), fitted, NULL) == 0


def test_a_further_cause_beside_what_is_exact_counts_in_full():
    mass = Hypothesis((AddedMass(),), (Place(("3",), (2, -1, 0)),), (None,), (np.array([1.0]),), chi2=10_000.0)
    both = replace(mass.with_cause(AddedMass(), Place(("4",), (3, -1, 0)), None, np.array([1.0])), chi2=9000.0)
    assert uncounted(both, [mass, both], NULL) == 0


def test_what_is_known_of_harmonics_stays_known_when_something_is_added():
    assert tolerated(with_mass(9000.0), NULL) == pytest.approx(0.05**2 * 1e6 + CoulombFriction.fidelity**2 * 1000.0)
    again = with_mass(9000.0).with_cause(AddedMass(), Place(("4",), (3, -1, 0)), None, np.array([1.0]))
    assert tolerated(replace(again, chi2=8000.0), NULL) == pytest.approx(
        0.05**2 * 1e6 + CoulombFriction.fidelity**2 * 2000.0  # since the harmonics were found, not since the last cause
    )
