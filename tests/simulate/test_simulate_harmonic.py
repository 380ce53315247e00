"""Harmonic balance: closed forms, a gradient at a fold, agreement of harmonics, messages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jaxtyping import Array, Float

from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.model.receptance import Spring, change
from modalax.simulate import harmonic_balance, simulate
from modalax.simulate.aft import joint_forces
from modalax.simulate.joints import (
    BilinearSpring,
    BoucWen,
    CoulombFriction,
    CubicSpring,
    ElastoSlip,
    Iwan,
    PolynomialStiffness,
)
from modalax.simulate.joints.base import Memoryless, parameter

M, C, K = 1.0, 2.0, 1e4  # 15.9 Hz, 1 %
DUFFING = Structure([[M]], [[C]], [[K]], ["x"])
SLOW = pytest.mark.slow
FORCES = jax.jit(joint_forces, static_argnums=(3, 4))
DESCRIBING = jax.jit(lambda joint, amplitude, omega: joint.describing(amplitude, omega))


def place(n: str = "x") -> list[list[str]]:
    return [[n]]


def duffing_forcing_frequencies(k3: float, force: float, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both frequencies [rad/s] at which a Duffing oscillator's fundamental has an amplitude (NaN where none)."""
    # (k + 3/4 k3 A^2 - m w^2)^2 + c^2 w^2 = (F/A)^2, a quadratic in w^2
    stiff = K + 0.75 * k3 * amplitude**2
    p, q = C**2 - 2 * M * stiff, stiff**2 - (force / amplitude) ** 2
    inner = p**2 - 4 * M**2 * q
    root = np.sqrt(np.where(inner >= 0, inner, np.nan))
    low, high = (-p - root) / (2 * M**2), (-p + root) / (2 * M**2)
    return np.sqrt(np.where(low > 0, low, np.nan)), np.sqrt(np.where(high > 0, high, np.nan))


def test_duffing_response_satisfies_the_closed_form_on_both_sweeps():
    k3, force = 5e7, 3.0
    freq = np.linspace(14, 22, 361)  # as many as below: compiled once
    for sweep in ("up", "down"):
        r = harmonic_balance(DUFFING, [CubicSpring(k3)], place(), freq, force, inputs=["x"], sweep=sweep)
        assert bool(r.converged.all())
        A = np.abs(np.asarray(r.fundamental[0, :, 0, 0]))
        w = 2 * np.pi * freq
        left = (K + 0.75 * k3 * A**2 - M * w**2) ** 2 + C**2 * w**2
        np.testing.assert_allclose(left, (force / A) ** 2, rtol=1e-8)


def test_duffing_jumps_at_the_folds_of_the_closed_form():
    k3, force = 5e7, 3.0
    freq = np.linspace(15, 24, 361)
    A = np.linspace(1e-4, 3e-2, 200001)
    low, high = duffing_forcing_frequencies(k3, force, A)
    upper_fold = np.nanmax(low) / (2 * np.pi)  # the resonance branch ends: largest frequency left of the backbone
    lower_fold = np.nanmin(high[A < 2 * A[np.nanargmax(low)]]) / (2 * np.pi)
    for sweep, fold in (("up", upper_fold), ("down", lower_fold)):
        r = harmonic_balance(DUFFING, [CubicSpring(k3)], place(), freq, force, inputs=["x"], sweep=sweep)
        size = np.abs(np.asarray(r.fundamental[0, :, 0, 0]))
        jump = int(np.argmax(np.abs(np.diff(size))))
        assert freq[jump] - 1e-9 <= fold <= freq[jump + 1] + 1e-9, (sweep, fold)


def test_a_gradient_at_a_fold_is_said_not_to_exist():
    k3, force, top = 5e7, 3.0, np.longdouble(0.012)
    for width in (0.05, 1e-3, 1e-5):  # the upper fold: where the side right of the backbone turns back
        A = np.linspace(top * (1 - width), top * (1 + width), 400001, dtype=np.longdouble)
        high = duffing_forcing_frequencies(k3, force, A)[1]
        top = A[np.nanargmax(high)]
    fold = float(np.nanmax(high)) / (2 * np.pi)

    def size(k, distance):
        # ever shorter steps towards the fold, so that the sweep stays on its branch
        freq = fold * (1 - jnp.geomspace(0.3, distance, 121))
        r = harmonic_balance(DUFFING, [CubicSpring(k)], place(), freq, force, inputs=["x"])
        return jnp.abs(r.fundamental[0, -1, 0, 0]), (r.at_fold[0, :, 0], r.converged.all())

    @jax.jit
    def both(k, distance):
        value, push, said = jax.linearize(lambda k: size(k, distance), k, has_aux=True)  # traced once for both modes
        (reverse,) = jax.linear_transpose(push, k)(1.0)
        return value, said, reverse, push(1.0)

    slopes = []
    for distance in (1e-6, 1e-8):
        _, (at_fold, ok), slope, forward = both(k3, distance)
        assert bool(ok) and not bool(at_fold.any())
        assert float(forward) == pytest.approx(float(slope), rel=1e-9)
        slopes.append(float(slope))
    # next to it the slope exists, and grows as the inverse root of the distance: measured 11.2, 10.3 a decade further
    assert slopes[1] / slopes[0] == pytest.approx(10.0, rel=0.2)
    value, (at_fold, ok), slope, forward = both(k3, 1e-10)
    assert bool(ok) and float(value) == pytest.approx(float(top), rel=1e-4)
    assert bool(at_fold[-1]) and not bool(at_fold[:80].any())
    assert np.isnan(float(slope))
    assert np.isnan(float(forward))


def test_a_linear_spring_as_a_joint_is_the_changed_structure():
    s, freq = five_dof(), np.linspace(20, 70, 26)
    joint = PolynomialStiffness([3e3], (1,))
    r = harmonic_balance(s, [joint], [["3", "5"]], freq, 1.0, inputs=["1", "4"], harmonics=3)
    expected = change(s, ["3", "5"], Spring(3e3)).frf(freq, inputs=["1", "4"]).H
    np.testing.assert_allclose(r.frf_values()[0], expected, rtol=1e-9, atol=1e-16)
    modal = harmonic_balance(s.modal(), [joint], [["3", "5"]], freq, 1.0, inputs=["1", "4"], harmonics=3)
    np.testing.assert_allclose(modal.frf_values(), r.frf_values(), rtol=1e-8, atol=1e-16)


@SLOW
def test_two_joints_at_once_leave_no_residual_in_the_full_equations():
    s, freq = five_dof(), np.linspace(30, 40, 21)
    joints, places = [CubicSpring(1e10), ElastoSlip(8e3, 3.0)], [["3", "5"], ["2"]]
    r = harmonic_balance(s, joints, places, freq, [2.0, 6.0], inputs=["1"], harmonics=5)
    assert bool(r.converged.all())
    b = np.array([[0, 0, 1, 0, -1], [0, 1, 0, 0, 0]], float)
    for h, k in enumerate(r.harmonics):
        w = 2 * np.pi * freq * k
        Z = np.asarray(s.K) + 1j * w[:, None, None] * np.asarray(s.C) - w[:, None, None] ** 2 * np.asarray(s.M)
        X, f = np.asarray(r.X[:, :, :, h, 0]), np.asarray(r.force[:, :, :, h, 0])
        F = np.zeros_like(X)
        F[..., 0] = (k == 1) * np.array([2.0, 6.0])[:, None]
        missing = np.einsum("fde,lfe->lfd", Z, X) + f @ b - F
        assert np.max(np.abs(missing)) < 1e-8
        np.testing.assert_allclose(X @ b.T, np.asarray(r.q[:, :, :, h, 0]), atol=1e-14)


JENKINS = [ElastoSlip(1e4, 4.0, 2e3), Iwan(4.0, 1e4, count=10), CoulombFriction(4.0)]


@pytest.mark.parametrize("joint", JENKINS, ids=lambda j: j.slug)
def test_force_by_time_stepping_is_the_describing_function(joint):
    q = 3e-3 * np.exp(0.7j)
    closed = complex(DESCRIBING(joint, 3e-3, 100.0)) * q
    for harmonics, samples in (((1, 3), 128), ((0, 1, 2), 128)):
        padded = np.zeros((1, len(harmonics)), complex)
        padded[0, harmonics.index(1)] = q
        f = np.asarray(FORCES((joint,), padded, 100.0, harmonics, samples))[0]
        # turning points and the onset of slip are met exactly: fourth order, measured 3e-7 (Coulomb's creep: 2e-5)
        tolerance = 1e-4 if isinstance(joint, CoulombFriction) else 2e-6
        assert abs(f[harmonics.index(1)] - closed) / abs(closed) < tolerance


def test_third_harmonic_of_coulomb_friction_is_a_third_of_the_first():
    q = jnp.array([[3e-3 + 0j, 0.0]])
    expected = np.array([4j * 4 / np.pi, 4j * 4 / (3 * np.pi)])
    for samples in (128, 512):
        f = np.asarray(FORCES((CoulombFriction(4.0),), q, jnp.array(100.0), (1, 3), samples)[0])
        # a jump of the force leaves (k pi / samples)^2 / 3 of harmonic k; the creep of 1e-12 m leaves 3e-5
        left = (np.array([1, 3]) * np.pi / samples) ** 2 / 3
        assert np.all(np.abs(f - expected) / np.abs(expected) < 1.1 * left + 1e-4)


@SLOW
def test_jenkins_loss_in_steady_motion_is_the_work_of_the_force():
    # work of the excitation over a cycle = viscous loss + 4 mu (A - x_s), with A half the way to and fro
    joint, freq = ElastoSlip(6e3, 4.0), np.array([15.0, 16.0, 17.0])
    r = harmonic_balance(DUFFING, [joint], place(), freq, 10.0, inputs=["x"], harmonics=9)
    assert bool(r.converged.all())
    k, q = np.array(r.harmonics), np.asarray(r.q[0, :, 0, :, 0])
    x = np.real(q @ np.exp(1j * np.outer(k, np.linspace(0, 2 * np.pi, 20001))))
    A = 0.5 * (x.max(axis=1) - x.min(axis=1))
    work = -np.pi * 10.0 * q[:, 0].imag
    viscous = np.pi * C * 2 * np.pi * freq * np.sum(k**2 * np.abs(q) ** 2, axis=1)
    # harmonics above the ninth are left out: measured 2e-4
    np.testing.assert_allclose(work - viscous, 4 * 4.0 * (A - 4.0 / 6e3), rtol=1e-3)


def test_bilinear_spring_has_the_frequency_of_its_two_halves():
    # free oscillation: half a cycle on each stiffness, T = pi (1/w1 + 1/w2); light damping puts the peak there
    s = Structure([[1.0]], [[0.2]], [[1e4]], ["x"])
    freq = np.linspace(16.2, 17.6, 57)
    r = harmonic_balance(s, [BilinearSpring(4e3, 0.0)], place(), freq, 1.0, inputs=["x"], harmonics=5)
    peak = freq[int(np.argmax(np.abs(np.asarray(r.fundamental[0, :, 0, 0]))))]
    w = np.sqrt(1e4), np.sqrt(1.4e4)
    assert peak == pytest.approx(1 / (np.pi / w[0] + np.pi / w[1]), abs=0.026)


def test_small_levels_are_linear_and_stuck():
    s, freq = five_dof(), np.linspace(20, 70, 26)
    k = 5e3
    m = simulate(s, [ElastoSlip(k, 5.0)], [["3", "5"]], freq, [1e-3], inputs=["1"], form="accelerance")
    expected = change(s, ["3", "5"], Spring(k)).frf(freq, inputs=["1"], form="accelerance").H
    np.testing.assert_allclose(m.H[0], expected, rtol=1e-8, atol=1e-12)


def test_simulation_without_joints_is_the_linear_frf():
    s, freq = five_dof(), np.linspace(20, 70, 26)
    m = simulate(s, [], [], freq, [1.0, 2.0], inputs=["1"], outputs=["1", "3"], form="mobility")
    assert m.runs == 2 and m.form == "mobility"
    np.testing.assert_allclose(m.H[1], s.frf(freq, form="mobility", outputs=["1", "3"], inputs=["1"]).H, rtol=1e-12)


def test_messages_say_what_was_seen():
    freq, joint = np.array([10.0, 11.0]), CubicSpring(1e6)
    with pytest.raises(ValueError, match="1 joints for 2 places"):
        harmonic_balance(DUFFING, [joint], [["x"], ["x"]], freq, 1.0, inputs=["x"])
    with pytest.raises(ValueError, match="level holds 0 N"):
        harmonic_balance(DUFFING, [joint], place(), freq, [0.0, 1.0], inputs=["x"])
    with pytest.raises(ValueError, match="fundamental"):
        harmonic_balance(DUFFING, [joint], place(), freq, 1.0, inputs=["x"], harmonics=(3, 5))
    with pytest.raises(ValueError, match="8 samples for harmonic 3"):
        harmonic_balance(DUFFING, [joint], place(), freq, 1.0, inputs=["x"], harmonics=3, samples=8)
    free = Structure(np.eye(2), 0.1 * np.eye(2), [[1e4, -1e4], [-1e4, 1e4]], ["a", "b"])
    with pytest.raises(ValueError, match="floats freely"):
        harmonic_balance(free, [BilinearSpring(1.0, 2.0)], [["a"]], freq, 1.0, inputs=["a"])


@pytest.mark.parametrize(
    "harmonics", [pytest.param((1, 3), id="half a cycle", marks=pytest.mark.slow), pytest.param((0, 1, 2), id="whole")]
)
def test_bouc_wen_loop_is_closed_where_little_is_lost_a_cycle(harmonics):
    class Patient(BoucWen):
        settle = 80

        def close(self, lap, state):
            return jax.lax.fori_loop(0, self.settle, lambda _, s: lap(s), state)

    def force(law, amplitude):
        q = np.zeros((1, len(harmonics)), complex)
        q[0, harmonics.index(1)] = amplitude * (1 + 0.4j)
        return np.asarray(FORCES((law(2e4, 2e-4, 0.1),), q, 220.0, harmonics, 128))[0]

    for amplitude in (1e-4, 2e-4):
        found, expected = force(BoucWen, amplitude), force(Patient, amplitude)
        # measured 4e-11 where 200 cycles were run
        assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))


class Softening(Memoryless):
    """A law of a user's own: nothing but its parameters and its force."""

    limit: Float[Array, ""] = parameter()
    reach: Float[Array, ""] = parameter()

    def force(self, x, v):
        return self.limit * jnp.tanh(x / self.reach)


def test_a_law_of_ones_own_against_integration_in_time():
    m, c, k, f, F, joint = 1.0, 3.0, 2500.0, 9.0, 20.0, Softening(15.0, 4e-3)
    structure = Structure([[m]], [[c]], [[k]], ["x"])
    found = harmonic_balance(structure, [joint], [["x"]], [f], F, inputs=["x"], harmonics=21, samples=512)
    w, cycles = 2 * np.pi * f, 120

    def rate(t, y):
        return [y[1], (F * np.cos(w * t) - c * y[1] - k * y[0] - 15.0 * np.tanh(y[0] / 4e-3)) / m]

    t = (cycles + np.arange(256) / 256) / f
    y = scipy.integrate.solve_ivp(rate, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-13, method="DOP853").y[0]
    exact = 2 * np.mean(y * np.exp(-1j * w * t))
    assert abs(complex(found.fundamental[0, 0, 0, 0]) / exact - 1) < 1e-6
