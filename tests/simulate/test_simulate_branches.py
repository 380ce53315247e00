"""Continuation through folds, stability, backbone curves: the Duffing oscillator and a Jenkins joint in closed form."""

import jax
import numpy as np
import pytest

from modalax.model import ModalModel, Structure
from modalax.model.assembly import reduce_to_modes
from modalax.model.examples import five_dof
from modalax.model.receptance import Spring, change
from modalax.simulate.backbone import backbone
from modalax.simulate.continuation import follow_branch
from modalax.simulate.control import constant_response
from modalax.simulate.joints import CubicSpring, ElastoSlip
from modalax.simulate.stability import floquet_exponents

M, C, K, K3, FORCE = 1.0, 2.0, 1e4, 5e7, 3.0
DUFFING = Structure([[M]], [[C]], [[K]], ["x"])


def closed_form_frequencies(amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    stiff = K + 0.75 * K3 * amplitude**2
    p, q = C**2 - 2 * M * stiff, stiff**2 - (FORCE / amplitude) ** 2
    root = np.sqrt(np.where(p**2 >= 4 * M**2 * q, p**2 - 4 * M**2 * q, np.nan))
    low, high = (-p - root) / (2 * M**2), (-p + root) / (2 * M**2)
    return tuple(np.sqrt(np.where(square > 0, square, np.nan)) / (2 * np.pi) for square in (low, high))


@pytest.fixture(scope="module")
def branch():
    return follow_branch(DUFFING, [CubicSpring(K3)], [["x"]], (10.0, 26.0), FORCE, input="x", points=260)


def test_the_branch_is_the_closed_form_and_crosses_the_band(branch):
    ok = np.asarray(branch.valid)
    freq, A = np.asarray(branch.freq)[ok], np.abs(np.asarray(branch.q)[ok, 0, 0])
    w = 2 * np.pi * freq
    np.testing.assert_allclose((K + 0.75 * K3 * A**2 - M * w**2) ** 2 + C**2 * w**2, (FORCE / A) ** 2, rtol=1e-6)
    assert freq[-1] > 25.0 and freq[0] < 11.0


def test_both_folds_lie_where_the_closed_form_puts_them(branch):
    A = np.linspace(1e-4, 2e-2, 400001)
    low, high = closed_form_frequencies(A)
    top = np.nanargmax(low)
    expected = np.array([low[top], np.nanmin(high[A < 0.7 * A[top]])])
    folds = branch.folds()
    assert len(folds) == 2
    # a parabola between two points of the trace: measured 2e-5 relative
    np.testing.assert_allclose(folds, expected, rtol=3e-4)


def test_only_the_middle_of_the_branch_is_unstable(branch):
    ok = np.asarray(branch.valid)
    exponents = floquet_exponents(
        DUFFING, (CubicSpring(K3),), [["x"]], branch.freq[ok], branch.q[ok], branch.harmonics, samples=32
    )
    unstable = np.asarray(exponents.real.max(axis=1)) > 0
    back = np.asarray(branch.direction)[ok] < 0
    # points next to a fold have an exponent next to 0, where one harmonic is not enough to tell
    clear = np.abs(np.asarray(branch.direction)[ok]) > 0.5
    assert back[clear].sum() > 5
    np.testing.assert_array_equal(unstable[clear], back[clear])


def test_exponents_of_a_linear_structure_are_its_poles():
    s = five_dof()
    exponents = floquet_exponents(
        s, (CubicSpring(0.0),), [["3", "5"]], np.array([7.0]), np.zeros((1, 1, 1), complex), (1,), samples=32
    )[0]
    # each exponent is a pole shifted by whole multiples of the excitation frequency, so real parts are the poles'
    expected = np.sort(np.repeat(np.asarray(s.modal().poles).real, 2))
    np.testing.assert_allclose(np.sort(np.asarray(exponents).real)[-2:], expected[-2:], rtol=1e-6)
    assert np.all(np.min(np.abs(np.asarray(exponents).real[:, None] / expected - 1), axis=1) < 1e-6)


def test_structural_damping_takes_half_its_loss_factor_times_the_frequency():
    """An oscillator at rest: (lambda + j omega)^2 m + k(1 + j eta) = 0 for what turns with the excitation."""
    eta, k = 0.04, 400.0
    s = Structure([[1.0]], [[0.0]], [[k]], ["x"], D=[[eta * k]])
    at = np.array([3.0])
    exponents = floquet_exponents(s, (CubicSpring(0.0),), [["x"]], at, np.zeros((1, 1, 1), complex), (1,), samples=32)
    exact = -np.real(np.sqrt(-k * (1 + 1j * eta) + 0j))
    np.testing.assert_allclose(np.asarray(exponents.real).max(), exact, rtol=1e-9)


@pytest.mark.slow  # by default of a slider, of two masses and of five
def test_duffing_backbone_is_the_closed_form():
    A = np.geomspace(1e-4, 2e-2, 12)
    found = backbone(DUFFING, [CubicSpring(K3)], [["x"]], 1, A)
    omega = np.sqrt(K + 0.75 * K3 * A**2)
    assert bool(found.converged.all())
    np.testing.assert_allclose(found.frequency_hz, omega / (2 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(found.damping_ratio, C / (2 * omega), rtol=1e-9)


@pytest.fixture(scope="module")
def slider():
    """Amplitudes, joint and backbone of a Jenkins oscillator."""
    A, joint = np.geomspace(1e-5, 2e-2, 15), ElastoSlip(5e3, 4.0)
    return A, joint, backbone(DUFFING, [joint], [["x"]], 1, A)


def test_backbone_of_a_jenkins_oscillator_is_its_describing_function(slider):
    A, joint, found = slider
    N = np.asarray(jax.jit(lambda: joint.describing(A, 100.0))())
    omega = np.sqrt(K + N.real)
    assert bool(found.converged.all())
    np.testing.assert_allclose(found.frequency_hz, omega / (2 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(found.damping_ratio, (C + N.imag / omega) / (2 * omega), rtol=1e-9)
    lost = np.pi * C * omega * A**2 + 4 * 4.0 * np.maximum(A - 4.0 / 5e3, 0.0)  # damper and slip, a cycle
    np.testing.assert_allclose(found.loss, lost, rtol=1e-8)
    np.testing.assert_allclose(found.force([1.0]), lost / (np.pi * A), rtol=1e-8)
    with pytest.raises(ValueError, match=r"shape is \(2,\); the backbone holds 1 modes"):
        found.force([1.0, 0.5])


def test_a_backbone_prints_how_frequency_and_damping_change(slider):
    found = slider[2]
    text, f = str(found).splitlines(), found.frequency_hz
    assert text[0] == "Backbone over 15 amplitudes: 1e-05 to 0.02 m sqrt(kg)"
    assert text[1] == f"  frequency: {f[0]:.6g} to {f[-1]:.6g} Hz"
    assert text[-1] == "  solved: 15 of 15 amplitudes"


@pytest.mark.slow  # by default of a slider, and of five masses
def test_backbone_of_the_two_dof_system_of_kerschen_peeters_golinval_and_vakakis():
    """Mech. Syst. Signal Process. 23 (2009) 170-194: x1'' + 2 x1 - x2 + x1^3/2 = 0, x2'' + 2 x2 - x1 = 0.

    Of its in-phase mode they give 1 rad/s where it is linear and sqrt(2) rad/s, the first mass at rest, at high energy.
    """
    s = Structure(np.eye(2), np.zeros((2, 2)), [[2.0, -1.0], [-1.0, 2.0]], ["1", "2"])
    found = backbone(s, [CubicSpring(0.5)], [["1"]], 1, np.geomspace(1e-3, 60.0, 25))
    omega, A1 = 2 * np.pi * np.asarray(found.frequency_hz), np.abs(np.asarray(found.q)[:, 0, 0])
    assert bool(found.converged.all())
    # one harmonic: (2 - w^2) A1 - A1/(2 - w^2) + 3/8 A1^3 = 0
    np.testing.assert_allclose(0.375 * A1**2, 1 / (2 - omega**2) - (2 - omega**2), rtol=1e-7, atol=1e-8)
    assert omega[0] == pytest.approx(1.0, abs=1e-6)
    assert np.all(np.diff(omega) > 0) and np.sqrt(2) - 0.03 < omega[-1] < np.sqrt(2)
    np.testing.assert_allclose(found.damping_ratio, 0.0, atol=1e-12)


def test_backbone_of_the_five_dof_system_starts_linear_and_softens():
    s, joint = five_dof(), ElastoSlip(9.6e3, 2.3, -9.6e3)
    found = backbone(s, [joint], [["3", "5"]], 2, np.geomspace(1e-5, 3e-3, 10), harmonics=3)
    assert bool(found.converged.all())
    assert float(found.frequency_hz[0]) == pytest.approx(36.84, rel=1e-6)
    assert float(found.damping_ratio[0]) == pytest.approx(0.02, rel=1e-6)
    assert float(found.frequency_hz[-1]) < 35.5 and float(np.max(found.damping_ratio)) > 0.03


def test_backbone_of_a_modal_model_is_that_of_its_matrices():
    s, joint, place = five_dof(), ElastoSlip(9.6e3, 2.3, -9.6e3), [["3", "5"]]
    amplitudes = np.geomspace(1e-5, 3e-3, 10)  # as many as above: compiled once
    by_matrices, by_modes = (backbone(model, [joint], place, 2, amplitudes, harmonics=3) for model in (s, s.modal()))
    np.testing.assert_allclose(by_modes.frequency_hz, by_matrices.frequency_hz, rtol=1e-9)
    np.testing.assert_allclose(by_modes.damping_ratio, by_matrices.damping_ratio, rtol=1e-7)


@pytest.mark.slow
def test_backbone_of_a_few_modes_with_static_correction_is_that_of_all():
    """Twelve masses in a row, free at both ends, of which five elastic modes and the residual terms are kept."""
    n, k = 12, 1e5
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = k
    dofs = [str(d) for d in range(n)]
    omega = np.sqrt(np.maximum(np.linalg.eigvalsh(K), 0.0))
    beta = 2 * 0.01 / omega[1]
    whole = Structure(np.eye(n), beta * K, K, dofs)
    few = reduce_to_modes(
        np.eye(n), K, dofs, modes=6, keep=["3", "8"], damping_ratio=0.5 * beta * omega[1:6], shift_hz=1.0
    )
    assert few.frequency_hz.shape == (5,) and float(np.abs(few.upper).min()) > 0 and float(np.abs(few.lower).min()) > 0
    joint, place, amplitudes = [CubicSpring(4e8)], [["3", "8"]], np.geomspace(1e-4, 1.2e-2, 6)
    # free-body modes come first of matrices, and are not counted of a modal model
    exact = np.asarray(backbone(whole, joint, place, 2, amplitudes, harmonics=3).frequency_hz)
    without = few.replace(upper=np.zeros_like(few.upper))
    found, rough = (
        np.asarray(backbone(m, joint, place, 1, amplitudes, harmonics=3).frequency_hz) for m in (few, without)
    )
    assert exact[-1] > 1.1 * exact[0]
    off, lost = (np.abs(a / exact - 1).max() for a in (found, rough))
    # static where the third harmonic comes up to three quarters of the first mode left out: measured 1.3e-3,
    # and 1.4e-2 without the correction
    assert off < 2e-3 and lost > 5 * off


def test_a_branch_of_a_model_driven_at_one_dof_only():
    whole = five_dof().modal()
    one = ModalModel(
        whole.poles, whole.shapes, whole.participation[:, :1], outputs=whole.outputs, inputs=whole.outputs[:1]
    )
    given = {"joints": [CubicSpring(1e10)], "places": [["3", "5"]], "band": (35.0, 39.0), "level": 6.0, "points": 40}
    q = [np.asarray(follow_branch(model, input="1", **given).q) for model in (whole, one)]
    np.testing.assert_allclose(q[1], q[0], rtol=1e-8)


def test_messages_say_what_was_seen():
    skew = ModalModel([-1 + 100j], [[1.0, 1j]], [[1.0, 1j]], outputs=["a", "b"], inputs=["a", "b"])
    with pytest.raises(ValueError, match="imaginary part of"):
        backbone(skew, [CubicSpring(1.0)], [["a", "b"]], 1, [1e-3])
    with pytest.raises(ValueError, match="1 joints for 2 places"):
        backbone(DUFFING, [CubicSpring(1.0)], [["x"], ["x"]], 1, [1e-3])
    with pytest.raises(ValueError, match="make local changes in the matrices"):
        backbone(change(DUFFING, ["x"], Spring(1.0)), [CubicSpring(1.0)], [["x"]], 1, [1e-3])
    with pytest.raises(ValueError, match="given a ModalModel"):
        floquet_exponents(skew, (CubicSpring(0.0),), [["a"]], np.ones(1), np.zeros((1, 1, 1), complex), (1,))
    with pytest.raises(ValueError, match="8 samples for harmonic 3"):
        constant_response(DUFFING, [CubicSpring(1.0)], [["x"]], [1.0], 1.0, held="x", input="x", harmonics=3, samples=8)
    with pytest.raises(ValueError, match="must rise"):
        follow_branch(DUFFING, [CubicSpring(1.0)], [["x"]], (3.0, 2.0), 1.0, input="x")
    with pytest.raises(ValueError, match="mode 2 asked for"):
        backbone(DUFFING, [CubicSpring(1.0)], [["x"]], 2, [1e-3])


def test_force_that_holds_a_duffing_oscillator_is_the_closed_form():
    freq, A = np.linspace(12.0, 24.0, 61), 8e-3
    held = constant_response(DUFFING, [CubicSpring(K3)], [["x"]], freq, A, held="x", input="x")
    w = 2 * np.pi * freq
    assert bool(held.converged.all())
    np.testing.assert_allclose(held.force, A * np.hypot(K + 0.75 * K3 * A**2 - M * w**2, C * w), rtol=1e-8)
    np.testing.assert_allclose(np.abs(held.X[:, 0]), A, rtol=1e-9)
    assert held.measurement("accelerance").inputs == ("x",)


def test_a_branch_and_a_held_response_print_their_range():
    duffing = DUFFING, [CubicSpring(K3)], [["x"]]  # of as many points as above: compiled once
    branch = follow_branch(*duffing, (10.0, 26.0), 0.1, input="x", points=260)
    assert str(branch).startswith("Branch of ") and str(branch).endswith("Hz: does not turn back")
    held = constant_response(*duffing, np.linspace(12.0, 24.0, 61), 1e-3, held="x", input="x")
    assert str(held).splitlines()[-1] == "  solved: 61 of 61 lines"
