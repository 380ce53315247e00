"""Screening beside elements that were found, against the same structure with these built in."""

from dataclasses import replace
from functools import cache

import numpy as np
from chains import comparison_of, grid, sprung

from modalax import Structure
from modalax.diagnose.causes.channels import ChannelGain, ChannelSign, SensorMass
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.causes.forces import StrayForce
from modalax.diagnose.causes.local import AddedMass, JointStiffness, LocalDamper
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.in_place import in_place
from modalax.diagnose.screening.score_state import score_state_of

ACROSS, DASHPOT = (2, 5), 40.0


def softened(structure, k):
    """The structure with a spring of ``k`` and a dashpot to ground more."""
    C = np.array(structure.C)
    C[7, 7] += DASHPOT
    changed = sprung(structure, *ACROSS, k)
    return Structure(structure.M, C, changed.K, structure.dofs)


@cache
def both_states():
    """A grid whose spring is 60 % softer, with a further mass: beside both elements, and with both built in."""
    structure = grid(9, False)
    built_in = softened(structure, -1.2e5)
    M = np.array(structure.M)
    M[3, 3] += 0.05
    truth = Structure(M, built_in.C, built_in.K, structure.dofs)
    comparison, state = comparison_of(structure, truth)
    count = comparison.problem.modal_form.stiffness.shape[0]
    h = Hypothesis(
        causes=(JointStiffness(), LocalDamper()),
        places=(Place(("3", "6"), (*ACROSS, 0)), Place(("8",), (7, -1, 0))), extras=(None, None),
        params=(np.array([-1.2e5]), np.array([DASHPOT])), theta=np.zeros((2, count)),
    )  # fmt: skip
    return score_state_of(comparison, h), comparison_of(built_in, truth)[1]


def test_products_beside_elements_are_those_of_the_structure_that_has_them():
    beside, built_in = both_states()
    one, other = beside.reduced[True], built_in.reduced[True]
    assert one.there is not None and other.there is None
    dofs = np.arange(9)
    a, b = np.array([0, 2, 3, 7]), np.array([-1, 5, 4, -1])
    pairs = [
        (one.motion(a, b), other.motion(a, b)), (one.column(a, b), other.column(a, b)),
        (one.drive(a, b), other.drive(a, b)), (one.S[:, :, dofs], other.S[:, :, dofs]),
        (one.summed(30, np.eye(len(one.outputs)))[:, dofs], other.summed(30, np.eye(len(one.outputs)))[:, dofs]),
    ]  # fmt: skip
    for k, (found, exact) in enumerate(pairs):
        assert np.abs(found - exact).max() < 1e-7 * np.abs(exact).max(), k
    without = replace(one, there=None).motion(a, b)
    assert np.abs(without - pairs[0][1]).max() > 0.2 * np.abs(pairs[0][1]).max()


def test_a_further_cause_beside_elements_is_judged_as_if_they_were_built_in():
    """The mass is found at its place, at its size, and its gain is that beside the true structure; channels too."""
    beside, built_in = both_states()
    causes = [AddedMass(), JointStiffness(), ChannelGain(), ChannelSign(), SensorMass(), StrayForce()]
    found, exact = (
        sorted(screen_all(state, causes, finite=False).trials, key=lambda t: -t.gain) for state in (beside, built_in)
    )
    assert found[0].cause == AddedMass() and found[0].place.where == ("4",)
    assert abs(found[0].start[0] - 0.05) < 0.002
    by_place = {(t.cause, t.place.where): t.gain for t in exact}
    top = exact[0].gain
    for t in found:  # the sizes that are tried follow from the structure without the elements, and differ a little
        assert abs(t.gain - by_place[t.cause, t.place.where]) < 2e-3 * max(top, abs(t.gain)), (t.cause, t.place)


def test_elements_in_place_against_the_inverse_of_the_dynamic_stiffness():
    """With residual terms, a coupling of two DoFs that is not symmetric, and a spring: (Z0 + B Z B^T)^-1."""
    rng = np.random.default_rng(3)
    n, omega = 5, np.array([30.0, 70.0, 110.0])
    gains = rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))
    psi, part = rng.normal(size=(4, n)), rng.normal(size=(4, n)) + 1j * rng.normal(size=(4, n))
    upper, lower = np.diag(rng.uniform(1, 2, n)), np.diag(rng.uniform(100, 200, n))
    H = np.einsum("fm,ma,mb->fab", gains, psi, part) + upper - lower / omega[:, None, None] ** 2
    h = Hypothesis(
        causes=(JointStiffness(), Gyroscopic()), places=(Place(("1",), (0, 3, 0)), Place(("2",), (1, 4, 0))),
        extras=(None, None), params=(np.array([0.7]), np.array([0.02])),
    )  # fmt: skip
    there = in_place(h, gains, psi, part, (upper, lower), omega)
    assert there is not None
    found = H - there.between(np.arange(n), np.arange(n))
    spring = np.zeros((n, n))
    spring[[0, 3, 0, 3], [0, 3, 3, 0]] = [0.7, 0.7, -0.7, -0.7]
    block = np.asarray(Gyroscopic().block(1j * omega, np.array([0.02])))
    for f in range(3):
        change = spring + 0j
        change[np.ix_([1, 4], [1, 4])] += block[f]
        exact = np.linalg.inv(np.linalg.inv(H[f]) + change)
        assert np.abs(found[f] - exact).max() < 1e-10 * np.abs(exact).max()
    assert in_place(replace(h, causes=(), places=(), params=()), gains, psi, part, None, omega) is None
