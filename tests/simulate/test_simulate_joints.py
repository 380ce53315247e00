"""Joints: each closed describing function against quadrature of its own time law, energy, limits, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.simulate.joints import (
    CATALOGUE,
    BilinearSpring,
    BoucWen,
    CoulombFriction,
    CubicSpring,
    ElastoSlip,
    Gap,
    Hysteretic,
    Iwan,
    OneSidedGap,
    ParallelJenkins,
    PolynomialDamping,
    PolynomialStiffness,
    PreloadedGap,
    QuadraticDamping,
    quadrature,
)
from modalax.simulate.joints.contact import contact_share
from modalax.simulate.joints.friction import slide_average

JOINTS = [
    CubicSpring(2e9),
    QuadraticDamping(30.0),
    PolynomialStiffness([1e3, 4e5, 2e9, 1e12], (1, 2, 3, 5)),
    PolynomialDamping([3.0, 2.0, 40.0], (1, 2, 3)),
    Gap(1e5, 4e-4),
    OneSidedGap(1e5, 4e-4),
    PreloadedGap(1e5, 2e-4, 30.0),
    BilinearSpring(1e5, 3e4),
    ElastoSlip(1e5, 40.0, 2e4),
    CoulombFriction(12.0),
    Iwan(60.0, 1e5, -0.4, 0.3),
    ParallelJenkins([5e4, 3e4, 1e4], [5.0, 30.0, 90.0]),
]
AMPLITUDES = np.array([1e-4, 3.9e-4, 4.1e-4, 1e-3, 5e-3])
OMEGA = 200.0
# Kinks inside a step of the quadrature make it second order: 2,048 points measured 3e-6 relative at worst,
# except for a jump in force (Coulomb), which is of first order: 1/1024 of the force.
QUADRATURE = 2e-5
QUADRATURE_JUMP = 2e-3


@pytest.mark.parametrize("joint", JOINTS, ids=lambda j: j.slug)
def test_describing_function_is_the_quadrature_of_the_time_law(joint):
    closed, numbers = map(
        np.asarray, jax.jit(lambda j, A: (j.describing(A, OMEGA), quadrature(j, A, OMEGA)))(joint, AMPLITUDES)
    )
    tolerance = QUADRATURE_JUMP if isinstance(joint, CoulombFriction) else QUADRATURE
    scale = np.maximum(np.abs(closed), np.abs(closed).max() * 1e-3)
    assert np.max(np.abs(closed - numbers) / scale) < tolerance


def test_every_joint_of_the_catalogue_is_tested_here():
    assert {type(j) for j in JOINTS} | {BoucWen} == set(CATALOGUE.values())


@pytest.mark.parametrize("slug", sorted(CATALOGUE))
def test_units_and_bounds_name_the_same_parameters(slug):
    joint = CATALOGUE[slug]
    assert set(joint.units) == set(joint.bounds)
    assert set(joint.units) <= set(joint.__dataclass_fields__)


def test_jenkins_energy_loss_per_cycle_is_four_mu_times_slip():
    k, mu = 1e5, 40.0
    for A in (5e-4, 2e-3):
        expected = 4 * mu * (A - mu / k)
        assert float(ElastoSlip(k, mu, 3e4).energy(A, OMEGA)) == pytest.approx(expected, rel=1e-12)
    assert float(ElastoSlip(k, mu).energy(3e-4, OMEGA)) == 0.0


def test_coulomb_is_four_j_force_over_pi_amplitude():
    # the creep of 1e-12 m adds a real part of order sqrt(creep / A) = 3e-5
    assert complex(CoulombFriction(12.0).describing(1e-3, OMEGA)) == pytest.approx(4j * 12.0 / (np.pi * 1e-3), rel=1e-4)


def test_iwan_dissipation_follows_segalmans_power_law():
    # D = 4 R A^(chi+3)/((chi+2)(chi+3)) below macro-slip, Segalman (2005) eq. 17; 40 sliders measured 2e-3.
    chi, beta, slip, k = -0.4, 0.3, 60.0, 1e5
    joint = Iwan(slip, k, chi, beta, count=200)
    top = float(joint.largest())
    R = k / (1 + beta) * (chi + 1) / top ** (chi + 1)
    A = np.array([0.05, 0.2, 0.7]) * top
    expected = 4 * R * A ** (chi + 3) / ((chi + 2) * (chi + 3))
    np.testing.assert_allclose(jax.jit(lambda a: joint.energy(a, OMEGA))(A), expected, rtol=2e-3)


def test_iwan_keeps_its_stiffness_and_its_slip_force():
    joint = Iwan(60.0, 1e5, -0.4, 0.3)
    k, slip = joint.sliders()
    assert float(k.sum()) == pytest.approx(1e5, rel=1e-12)
    assert float((k * slip).sum()) == pytest.approx(60.0, rel=1e-12)


def test_bouc_wen_yields_and_is_elastic_when_small():
    joint = BoucWen(1e5, 1e-3, 0.1)
    describing = jax.jit(lambda a: joint.describing(a, OMEGA))
    small = complex(describing(1e-6))
    assert small == pytest.approx(1e5, rel=1e-5)
    large = complex(describing(1.0))
    # plastic: spring alpha k and a friction force (1 - alpha) k x_y
    assert large.real == pytest.approx(1e4, rel=2e-2)
    assert large.imag == pytest.approx(4 * 0.9 * 1e5 * 1e-3 / (np.pi * 1.0), rel=2e-2)


def test_bouc_wen_with_one_parameter_set_has_a_closed_form():
    # n = 1, beta = 1/2: loading z' = 1 - z/x_y, unloading z' = 1: an exponential, then a straight line.
    joint = BoucWen(1.0, 2.0, 0.0, 1.0, 0.5)
    state, step = joint.initial_state(), jax.jit(lambda *way: joint.step(*way))
    for low, high in zip(np.linspace(0, 3, 31)[:-1], np.linspace(0, 3, 31)[1:], strict=True):
        state, force = step(state, low, high)
    assert float(force) == pytest.approx(2 * (1 - np.exp(-1.5)), rel=1e-8)  # Runge-Kutta with 60 steps: measured 2e-9
    _, back = step(state, 3.0, 2.5)
    assert float(back) == pytest.approx(float(force) - 0.5, rel=1e-12)


def test_preloaded_gap_opens_at_its_preload_and_meets_the_other_stop():
    joint = PreloadedGap(1e5, 2e-4, 30.0)
    x = np.array([1e-3, 0.0, -3e-4, -4e-4, -7e-4, -8e-4])
    np.testing.assert_allclose(joint.force(x, 0 * x), [100.0, 0.0, -30.0, -30.0, -30.0, -40.0], atol=1e-10)


@pytest.mark.parametrize("joint", JOINTS, ids=lambda j: j.slug)
def test_gradient_of_describing_function_is_that_of_finite_differences(joint):
    @jax.jit
    def size(scale, amplitude):
        bent = jax.tree.map(lambda leaf: leaf * scale, joint)
        return jnp.abs(bent.describing(amplitude, OMEGA) + 1e4)

    h = 1e-6
    slope = jax.jit(jax.grad(size, argnums=(0, 1)))(1.0, 1.1e-3)
    by_scale = (size(1 + h, 1.1e-3) - size(1 - h, 1.1e-3)) / (2 * h)
    by_amplitude = (size(1.0, 1.1e-3 * (1 + h)) - size(1.0, 1.1e-3 * (1 - h))) / (2.2e-3 * h)
    np.testing.assert_allclose(slope[0], by_scale, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(slope[1], by_amplitude, rtol=1e-6, atol=1.0)


@pytest.mark.parametrize("joint", JOINTS, ids=lambda j: j.slug)
def test_no_gradient_is_nan_at_rest_or_where_a_law_bends(joint):
    both = jax.jit(jax.value_and_grad(lambda a: jnp.real(joint.describing(a, OMEGA))))
    for amplitude in (0.0, 4e-4, 1e-3):
        value, slope = both(amplitude)
        assert np.isfinite(value) and np.isfinite(slope)


def test_contact_share_of_negative_gap_is_the_rest():
    np.testing.assert_allclose(contact_share(-0.3, 1.0) + contact_share(0.3, 1.0), 1.0, rtol=1e-14)


@pytest.mark.parametrize("joint", [j for j in JOINTS if isinstance(j, Hysteretic)], ids=lambda j: j.slug)
def test_average_force_along_a_step_is_the_mean_of_many_small_steps(joint):
    state, _ = jax.jit(lambda s: joint.step(s, 0.0, 2e-4))(joint.initial_state())
    parts = np.linspace(2e-4, -7e-4, 20001)
    average = float(jax.jit(lambda s: joint.average(s, parts[0], parts[-1]))(state))

    def advance(state, pair):
        mean = joint.average(state, pair[0], pair[1])
        return joint.step(state, pair[0], pair[1])[0], mean

    _, means = jax.lax.scan(advance, state, np.stack([parts[:-1], parts[1:]], axis=1))
    assert average == pytest.approx(float(means.mean()), rel=1e-9)


def test_messages_say_what_was_seen():
    with pytest.raises(ValueError, match=r"2 coefficients for powers \(1,\)"):
        PolynomialStiffness([1.0, 2.0], (1,))
    with pytest.raises(ValueError, match="one number per slider"):
        ParallelJenkins([1.0, 2.0], [1.0])
    with pytest.raises(ValueError, match="needs one number"):
        CubicSpring([1.0, 2.0])


@pytest.mark.slow
def test_mean_force_of_a_slider_has_the_derivatives_of_finite_differences():
    """First and second ones: stuck, slip that begins on the way, slip all the way; forwards and backwards."""
    h, atol = 1e-4, 1e-7  # central differences of numbers near one: measured 2e-9 and 3e-9
    for push, way, bow in ((0.1, 0.5, 0.1), (0.4, 1.2, 0.5), (0.4, 1.2, -0.7), (1.6, 1.2, 0.3), (0.2, -1.9, 0.4)):
        at = jnp.array([push, 1.5, 2.0, way, bow])

        def mean(v):
            return slide_average(*v)

        first, second = jax.jacfwd(mean)(at), jax.jacfwd(jax.jacrev(mean))(at)
        for k in range(5):
            move = h * jnp.eye(5)[k]
            np.testing.assert_allclose(first[k], (mean(at + move) - mean(at - move)) / (2 * h), atol=atol)
            slope = (jax.jacfwd(mean)(at + move) - jax.jacfwd(mean)(at - move)) / (2 * h)
            np.testing.assert_allclose(second[k], slope, atol=atol)
