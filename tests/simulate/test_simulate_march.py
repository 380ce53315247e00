"""Time marching against closed forms, scipy's integrators and harmonic balance, which shares only the joints' laws."""

import jax
import numpy as np
import pytest
import scipy.integrate

from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate.blocks import as_blocks, propagator
from modalax.simulate.harmonic import harmonic_balance
from modalax.simulate.joints import CoulombFriction, CubicSpring, ElastoSlip, Gap, OneSidedGap
from modalax.simulate.march import check_agreement, respond
from modalax.simulate.stepped import stepped_sine


def oscillator(mass=1.0, hz=10.0, zeta=0.02):
    omega = 2 * np.pi * hz
    return Structure([[mass]], [[2 * zeta * omega * mass]], [[omega**2 * mass]], ["m"])


def rough():
    """Three masses with a strong damper at one end: modes coupled by damping, one of them without vibration."""
    K = 1e4 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    return Structure(np.diag([1.0, 2.0, 1.5]), np.diag([700.0, 1.0, 3.0]), K, ["a", "b", "c"])


def floating():
    """Two masses and a spring, free in space, with a damper between them."""
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Structure(np.diag([1.0, 2.0]), 5.0 * pair, 4e3 * pair, ["a", "b"])


def smooth_push(t):
    """A force that begins smoothly and goes on as two sines."""
    return -20 * np.expm1(-((t / 0.1) ** 4)) * (np.sin(2 * np.pi * 9 * t) + 0.5 * np.sin(2 * np.pi * 15 * t))


def integrate(structure, force, joint_force, t, dof):
    """The same motion by scipy's order-8 Runge-Kutta at tight tolerance."""
    M, C, K = (np.asarray(A) for A in (structure.M, structure.C, structure.K))
    n, at = len(M), structure.index(dof)
    free, along = -np.linalg.solve(M, np.hstack([K, C])), np.linalg.inv(M)[:, at]

    def rate(time, y):
        return np.concatenate([y[n:], free @ y + along * (force(time) - joint_force(y[at], y[n + at]))])

    done = scipy.integrate.solve_ivp(rate, (0, t[-1]), np.zeros(2 * n), "DOP853", t, rtol=1e-11, atol=1e-14)
    return done.y[:n].T


# The force between samples is a cubic: 133 samples a cycle of 15 Hz; measured 1e-8 to 4e-8.
CUBIC = 2e-7


@pytest.mark.parametrize("make", [oscillator, rough, floating], ids=["mode", "coupled", "free"])
def test_a_linear_structure_is_propagated_exactly(make):
    structure, fs = make(), 2000.0
    t = np.arange(1000) / fs
    dof = structure.dofs[0]
    marched = respond(structure, [], [], smooth_push(t)[:, None], fs, inputs=[dof]).response
    expected = integrate(structure, smooth_push, lambda x, v: 0.0, t, dof)
    # at the last sample the force does not yet know how it goes on
    assert np.abs(marched - expected)[:-1].max() < CUBIC * np.abs(expected).max()


def test_step_of_any_length_is_the_matrix_exponential():
    blocks = as_blocks(rough(), np.eye(3), np.eye(3))
    step = propagator(blocks, np.array([1e-4, 0.02, 3.0]))
    for h, E in zip((1e-4, 0.02, 3.0), np.asarray(step.E), strict=True):
        for A, e in zip(np.asarray(blocks.A), E, strict=True):
            # squared as often as the longest step needs, 11 times, so 2^11 roundings: 4.5e-13
            assert np.abs(e - scipy.linalg.expm(A * h)).max() < 5e-13


def test_duffing_oscillator_against_scipy():
    structure, fs, k3 = oscillator(), 2000.0, 4e6
    t = np.arange(1600) / fs
    marched = respond(structure, [CubicSpring(k3)], [["m"]], smooth_push(t)[:, None], fs, inputs=["m"])
    expected = integrate(structure, smooth_push, lambda x, v: k3 * x**3, t, "m")
    assert np.abs(k3 * np.asarray(expected) ** 2).max() > 0.2 * float(structure.K[0, 0]), "the spring must matter"
    assert np.abs(marched.response - expected).max() < CUBIC * np.abs(expected).max()


def test_velocity_and_acceleration_are_derivatives():
    structure, fs = five_dof(), 4000.0
    t = np.arange(1200) / fs
    joints, places = [CubicSpring(1e9)], [["3", "5"]]
    x, v, a = (
        np.asarray(respond(structure, joints, places, smooth_push(t)[:, None], fs, inputs=["1"], form=form).response)
        for form in ("receptance", "mobility", "accelerance")
    )
    for low, high in ((x, v), (v, a)):
        slope = (low[2:] - low[:-2]) * fs / 2
        # second order difference of motion below 100 Hz: (2 pi 60 / 4000)^2 / 6 = 1.5e-3 at most
        assert np.abs(slope - high[1:-1]).max() < 3e-3 * np.abs(high).max()


def test_jenkins_element_loses_its_closed_form_energy_each_cycle():
    joint = ElastoSlip(2e4, 4.0)
    structure, steps, hz = oscillator(hz=12.0, zeta=0.2), 512, 9.0  # damped, so that it is steady after some cycles
    t = np.arange(18 * steps) / (hz * steps)
    force = (30.0 * np.clip(t * hz / 3, 0, 1) * np.sin(2 * np.pi * hz * t))[:, None]
    record = respond(structure, [joint], [["m"]], force, hz * steps, inputs=["m"])
    x, f = np.asarray(record.across)[-steps - 1 :, 0], np.asarray(record.joint_force)[-steps - 1 :, 0]
    energy, A, slip = np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(x)), 0.5 * np.ptp(x), 4.0 / 2e4
    assert A > 2 * slip
    # samples of the loop, not the marching, limit this: 512 a cycle; measured 3e-5
    assert energy == pytest.approx(4 * 4.0 * (A - slip), rel=2e-4)


def test_coulomb_friction_takes_the_same_amplitude_each_half_cycle_until_it_sticks():
    structure, fs, F = oscillator(zeta=0.0), 20_000.0, 7.0
    k, samples = float(structure.K[0, 0]), 18_000
    force = np.zeros((samples, 1))
    force[1:201, 0] = 500 * np.sin(np.pi * np.arange(1, 201) / 201)
    record = respond(structure, [CoulombFriction(F)], [["m"]], force, fs, inputs=["m"])
    x = np.asarray(record.response)[:, 0]
    turns = np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0) + 1
    peaks = np.abs(x[turns[turns > 201]])[:12]
    # peaks are read off samples, (2 pi / 2000)^2 / 8 = 1.2e-6 of them
    assert np.allclose(-np.diff(peaks), 2 * F / k, rtol=0, atol=4e-6 * peaks[0])
    assert np.ptp(x[-2000:]) < 1e-12 and abs(x[-1]) < F / k, "at rest where the spring no longer overcomes friction"


def test_stuck_friction_holds_a_sine_below_its_limit():
    held = stepped_sine(oscillator(), [CoulombFriction(5.0)], [["m"]], [8.0], 4.9, inputs=["m"], steps=64)
    freed = stepped_sine(oscillator(), [CoulombFriction(5.0)], [["m"]], [8.0], 8.0, inputs=["m"], steps=64)
    assert np.abs(held.X).max() < 1e-9 * np.abs(freed.X).max()


@pytest.mark.slow
def test_dry_friction_in_the_limit_of_all_harmonics():
    """A jump leaves an error of first order in one over the harmonics, which two responses tell apart."""
    friction, at = [CoulombFriction(5.0)], dict(inputs=["m"])
    marched = np.asarray(stepped_sine(oscillator(), friction, [["m"]], [8.0], 8.0, steps=64, **at).X)
    coarse, fine = (
        harmonic_balance(oscillator(), friction, [["m"]], [8.0], 8.0, harmonics=h, samples=512, **at) for h in (7, 15)
    )
    error = [np.abs(np.asarray(X) - marched).max() for X in (coarse.fundamental, fine.fundamental, fine.limit(coarse))]
    assert error[1] < 0.6 * error[0] and error[2] < 0.1 * error[1] and error[2] < 1e-3 * np.abs(marched).max()
    with pytest.raises(ValueError, match="highest 15 and 7"):
        coarse.limit(fine)


def test_a_mass_thrown_against_a_stop_comes_back_with_its_speed():
    mass, k, gap, fs = 2.0, 8e5, 1e-3, 20_000.0
    free = Structure([[mass]], [[0.0]], [[0.0]], ["m"])
    force = np.zeros((2000, 1))
    force[1:101, 0] = 50 * np.sin(np.pi * np.arange(1, 101) / 101)
    record = respond(free, [OneSidedGap(k, gap)], [["m"]], force, fs, inputs=["m"], form="mobility")
    v = np.asarray(record.response)[:, 0]
    thrown = v[150]
    assert thrown == pytest.approx(np.sum(force) / fs / mass, rel=1e-4)
    # contact lasts 100 steps and begins and ends inside one: measured 2.3e-6
    assert v[-1] == pytest.approx(-thrown, rel=5e-6)
    contact = np.count_nonzero(np.asarray(record.joint_force)[:, 0]) / fs
    assert contact == pytest.approx(np.pi * np.sqrt(mass / k), abs=1.5 / fs)


# 128 steps a period, harmonics up to 9: measured 1e-8 (cubic), 1.3e-5 (slip), 3.4e-5 (gap).
ROUTES = 1e-4


@pytest.mark.parametrize(  # the cubic spring beyond its fold, below, by default
    "joint",
    [
        pytest.param(CubicSpring(2e9), marks=pytest.mark.slow),
        pytest.param(ElastoSlip(2e4, 4.0), marks=pytest.mark.slow),  # the loss of a slider is known in closed form
        pytest.param(Gap(2e4, 3e-4), marks=pytest.mark.slow),  # as cubic in what it asks of both
    ],
    ids=lambda j: j.slug,
)
@pytest.mark.parametrize(("damping", "freq"), [(10.0, [35.0]), pytest.param(1.0, [35.0, 36.5], marks=pytest.mark.slow)])
def test_both_routes_agree(joint, damping, freq):
    """At a tenth of the damping the marching takes ten times as long to become steady."""
    places = [["3", "5"]]
    structure, force = five_dof().replace(C=damping * np.asarray(five_dof().C)), 6.0 * damping
    marched = stepped_sine(structure, [joint], places, np.array(freq), force, inputs=["1"], sweep="each", steps=128)
    balanced = harmonic_balance(
        structure, [joint], places, np.array(freq), force, inputs=["1"], harmonics=9, samples=256
    )
    assert bool(marched.settled.all()) and bool(balanced.converged.all())
    assert np.abs(marched.X - balanced.fundamental).max() < ROUTES * np.abs(marched.X).max()


@pytest.mark.parametrize(
    ("start", "lines", "steps", "harmonics"),
    [(22.5, 8, 64, 7), pytest.param(20.0, 17, 128, 15, marks=pytest.mark.slow)],
)
def test_both_routes_agree_past_the_fold_on_both_branches(start, lines, steps, harmonics):
    structure, joint = oscillator(hz=20.0), CubicSpring(4e8)
    freq = np.linspace(start, 24.0, lines)
    found = {}
    for sweep in ("up", "down"):
        marched = stepped_sine(structure, [joint], [["m"]], freq, 10.0, inputs=["m"], sweep=sweep, steps=steps)
        balanced = harmonic_balance(
            structure, [joint], [["m"]], freq, 10.0, inputs=["m"], harmonics=harmonics, samples=256, sweep=sweep
        )
        found[sweep] = np.abs(np.asarray(marched.X))[0, :, 0, 0]
        assert np.abs(marched.X - balanced.fundamental).max() < ROUTES * np.abs(marched.X).max()
    assert np.sum(np.abs(found["up"] - found["down"]) > 0.1 * found["up"].max()) >= 2, "two branches must be there"


def test_a_joint_far_stiffer_than_the_step_resolves_still_agrees_with_its_motion():
    force = 20 * np.sin(2 * np.pi * 35 * np.arange(500) / 2000)[:, None]
    record = respond(five_dof(), [Gap(5e6, 3e-4)], [["3", "5"]], force, 2000.0, inputs=["1"])
    assert float(record.disagreement) < 1e-10 and np.abs(np.asarray(record.joint_force)).max() > 1


def test_a_modal_model_marches_as_its_structure():
    structure, fs = rough().replace(C=np.diag([3.0, 1.0, 2.0])), 2000.0
    t = np.arange(600) / fs
    force = smooth_push(t)[:, None]
    joint, place = [CubicSpring(1e7)], [["c", "a"]]
    both = [
        np.asarray(respond(s, joint, place, force, fs, inputs=["b"], outputs=["a", "c"]).response)
        for s in (structure, structure.modal())
    ]
    assert np.abs(both[0] - both[1]).max() < 1e-9 * np.abs(both[0]).max()


def test_derivative_of_a_marched_response_by_the_joint():
    structure, fs = oscillator(), 500.0
    force = smooth_push(np.arange(200) / fs)[:, None]

    def last(k3):
        return respond(structure, [CubicSpring(k3)], [["m"]], force, fs, inputs=["m"]).response[-1, 0]

    both = lambda k3: jax.jvp(last, (k3,), (1.0,))  # value and slope by one program
    slope = both(4e6)[1]
    numeric = (both(4e6 + 400.0)[0] - both(4e6 - 400.0)[0]) / 800.0
    assert slope == pytest.approx(float(numeric), rel=1e-6)


def test_unusable_input_is_refused():
    structure = oscillator()
    with pytest.raises(ValueError, match="hysteretic damping"):
        respond(structure.replace(D=[[5.0]]), [], [], np.zeros((4, 1)), 100.0, inputs=["m"])
    with pytest.raises(ValueError, match="M is singular: rank 0 of 1"):
        respond(structure.replace(M=[[0.0]]), [], [], np.zeros((4, 1)), 100.0, inputs=["m"])
    with pytest.raises(ValueError, match="1 joints for 0 places"):
        respond(structure, [CubicSpring(1.0)], [], np.zeros((4, 1)), 100.0, inputs=["m"])
    with pytest.raises(ValueError, match="needs \\(t, i\\)"):
        respond(structure, [], [], np.zeros(4), 100.0, inputs=["m"])
    with pytest.raises(ValueError, match="too stiff"):
        check_agreement(np.array([0.0, 1e-3]), "64 steps per period")
    with pytest.raises(ValueError, match="sweep is 'sideways'"):
        stepped_sine(structure, [], [], [5.0], 1.0, inputs=["m"], sweep="sideways")
    with pytest.raises(ValueError, match="8 steps per period"):
        stepped_sine(structure, [], [], [5.0], 1.0, inputs=["m"], steps=8)


def test_creep_that_the_steps_resolve_is_an_elasto_slip_law():
    structure, fs, creep = oscillator(), 2000.0, 2e-4
    push = smooth_push(np.arange(1000) / fs)[:, None]
    given = {"inputs": ["m"], "places": [["m"]], "fs": fs, "force": push}
    creeping, rigid, slip = (
        np.asarray(respond(structure, [joint], **given).response)[:, 0]
        for joint in (CoulombFriction(5.0, creep), CoulombFriction(5.0), ElastoSlip(5.0 / creep, 5.0))
    )
    np.testing.assert_allclose(creeping, slip, atol=1e-12 * np.abs(slip).max())
    # creep of a twentieth of the motion: it differs, but not by more than that
    assert 1e-3 < np.abs(creeping - rigid).max() / np.abs(rigid).max() < 0.2
