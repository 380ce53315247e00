"""Derivatives of predicted responses against finite differences: every joint, on both branches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from modalax.model import Structure
from modalax.simulate import constant_response, harmonic_balance
from modalax.simulate.aft import choose_harmonics, joint_forces
from modalax.simulate.joints import (
    CATALOGUE,
    BilinearSpring,
    BoucWen,
    CoulombFriction,
    CubicSpring,
    ElastoSlip,
    Gap,
    Iwan,
    OneSidedGap,
    ParallelJenkins,
    PolynomialDamping,
    PolynomialStiffness,
    PreloadedGap,
    QuadraticDamping,
)

M, C, K, FORCE = 1.0, 2.0, 1e4, 3.0  # 15.9 Hz, 1 %
OSCILLATOR, PLACE = Structure([[M]], [[C]], [[K]], ["x"]), [["x"]]
# Each with a frequency at which it has two branches, or, without folds, with one on either side of its resonance.
JOINTS = [
    (CubicSpring(5e7), (18.5,)),
    (PolynomialStiffness([1e3, 1e5, 5e7], (1, 2, 3)), (18.5,)),
    (Gap(5e3, 2e-3), (18.0,)),
    (OneSidedGap(1.5e4, 2e-3), (17.8,)),
    (PreloadedGap(5e3, 2e-4, 5.0), (17.0, 20.0)),
    (BilinearSpring(4e3, 1e3), (17.0, 18.5)),
    (QuadraticDamping(20.0), (15.5, 16.5)),
    (PolynomialDamping([1.0, 2.0, 5.0], (1, 2, 3)), (15.5, 16.5)),
    (ElastoSlip(6e3, 2.0, 1e3), (16.0, 18.0)),
    (CoulombFriction(1.0), (15.5, 16.5)),
    (ParallelJenkins([3e3, 2e3], [2.0, 6.0]), (16.0, 18.0)),
    (Iwan(8.0, 4e3, -0.4, 0.3, count=8), (16.0, 18.0)),
    (BoucWen(6e3, 5e-4, 0.1), (16.0, 18.0)),
]
# Seven lines up to the one looked at, so that the sweep stays on the upper branch; and seven all but at that line,
# where raising the force leads to the lower one.
RAMPS = (np.linspace(0.85, 1.0, 7), 1.0 - 1e-9 * np.arange(6, -1, -1))
# A law that closes its loop by laps within laps is the only one whose program in reverse takes long to compile: by
# default its derivatives are compared forwards, and in reverse they are traced.
EVERY = pytest.mark.parametrize(
    ("joint", "at", "mode"),
    [
        *(pytest.param(*case, jax.grad, id=case[0].slug) for case in JOINTS[:-1]),
        pytest.param(*JOINTS[-1], jax.jacfwd, id="bouc_wen"),
        pytest.param(*JOINTS[-1], jax.grad, id="bouc_wen in reverse", marks=pytest.mark.slow),
    ],
)
# that the way from a joint to the answer is differentiated is shown in every run, the other laws in the slow one
FIRST = pytest.mark.parametrize(
    ("joint", "at"),
    [pytest.param(*case, id=case[0].slug, marks=[pytest.mark.slow] if k else []) for k, case in enumerate(JOINTS)],
)


def test_every_joint_of_the_catalogue_is_here():
    assert {type(joint) for joint, _ in JOINTS} == set(CATALOGUE.values())


def check(answer, start, *given, h=1e-6):
    """Compare the slopes of an answer's weighted sum by relative changes of all entries of ``start`` with differences.

    One sum shows an error in any part of the answer.
    """
    flat, build = ravel_pytree(start)

    def summed(scales, *rest):
        value, ok = answer(*build(flat * scales), *rest)
        return value.ravel() @ np.linspace(1.0, 0.6, value.size), (value, ok)

    slope = jax.jit(jax.value_and_grad(summed, has_aux=True))
    one, seen, matters = np.ones(flat.shape), [], np.zeros(flat.shape, bool)
    for rest in given:
        (_, (value, ok)), found = slope(one, *rest)
        assert bool(ok)
        sides = [[slope(one + s, *rest)[0] for s in (step, -step)] for step in h * np.eye(len(flat))]
        expected = np.array([(up[0] - down[0]) / (2 * h) for up, down in sides])
        # central differences of answers good to 1e-12: measured 1.2e-9 of the largest entry
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.max(np.abs(expected)))
        matters |= [bool(np.any(up[1][0] != down[1][0])) for up, down in sides]
        seen.append(value)
    assert matters.all(), "an entry that has no influence is not tested"
    return seen


@FIRST
def test_gradients_by_joint_structure_force_and_frequency_on_both_branches(joint, at):
    def answer(law, matrices, force, stretch, lines):
        r = harmonic_balance(
            OSCILLATOR.replace(**matrices), [law], PLACE, stretch * lines, force, inputs=["x"], harmonics=3, samples=64
        )
        value = jnp.log(r.fundamental[0, -1, 0, 0])
        return jnp.stack([value.real, value.imag]), r.converged.all()

    sweeps = [f * RAMPS[0] for f in at] if len(at) > 1 else [at[0] * ramp for ramp in RAMPS]
    matrices = {"M": OSCILLATOR.M, "C": OSCILLATOR.C, "K": OSCILLATOR.K}
    seen = check(answer, (joint, matrices, FORCE, 1.0), *((lines,) for lines in sweeps))
    if len(at) == 1:
        assert seen[0][0] > seen[1][0] + np.log(2), "two branches must be there"


@EVERY
def test_gradients_of_the_force_harmonics_by_motion_frequency_and_parameters(joint, at, mode):
    """What each law alone puts into the derivatives of every answer."""
    harmonics = choose_harmonics((joint,), 3)
    q = jnp.array([[{0: 4e-4, 1: 6e-3 + 1e-3j, 2: 5e-4j, 3: 8e-4 - 3e-4j}[k] for k in harmonics]])

    weights = np.random.default_rng(5).standard_normal((2, len(harmonics)))  # one sum shows an error of any harmonic

    def answer(law, real, imag, omega):
        f = joint_forces((law,), real + 1j * imag, omega, harmonics, 32)[0]
        return weights[0] @ f.real + weights[1] @ f.imag

    flat, build = ravel_pytree((joint, q.real, q.imag, 2 * np.pi * at[0]))
    scaled = lambda scales: answer(*build(flat * scales))
    slope = jax.jit(lambda scales: (scaled(scales), mode(scaled)(scales)))
    one, h = np.ones(flat.shape), 1e-6
    assert jax.eval_shape(jax.grad(scaled), one).shape == one.shape
    found = slope(one)[1]
    sides = [[slope(one + s)[0] for s in (step, -step)] for step in h * np.eye(len(flat))]
    expected = np.array([(up - down) / (2 * h) for up, down in sides])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.max(np.abs(expected)))
    own = len(ravel_pytree(joint)[0])
    assert np.all(np.asarray(found)[:own] != 0), "a parameter that has no influence is not tested"


@FIRST
def test_gradients_of_the_force_that_holds_a_response(joint, at):
    def answer(law, matrices, amplitude):
        r = constant_response(
            OSCILLATOR.replace(**matrices), [law], PLACE, np.array([0.98, 1.02]) * at[0], amplitude, held="x",
            input="x", harmonics=3, samples=64,
        )  # fmt: skip
        return jnp.log(r.force), r.converged.all()

    check(answer, (joint, {"M": OSCILLATOR.M, "C": OSCILLATOR.C, "K": OSCILLATOR.K}, 6e-3), ())
