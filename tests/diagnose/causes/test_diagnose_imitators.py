"""What the catalogue has no name for: its laws against matrices and closed forms, and the doubt that it casts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from modalax.diagnose.causes import catalogue, imitators
from modalax.diagnose.causes.couplings import FollowerStiffness, OneWayDamper
from modalax.diagnose.causes.drift import AllStiffness
from modalax.diagnose.causes.forces import Crosstalk, ForceGain, StrayForce
from modalax.diagnose.causes.power_laws import (
    IwanJoint,
    MicroSlip,
    PowerDamper,
    PowerSpring,
    macro_slip,
    power_and_root,
)
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.sensors import AcCoupling, ClippedSensor, SensorLowpass, SensorResonance
from modalax.diagnose.causes.viscoelastic import FractionalJoint, HystereticJoint, MaxwellJoint, ZenerJoint
from modalax.diagnose.decision.posterior import posterior
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.search.imitator_check import apart, likeness
from modalax.diagnose.setup.modal_form import modal_form_of
from modalax.diagnose.setup.problem import make_problem
from modalax.model.examples import five_dof
from modalax.simulate import joints

FREQ = np.linspace(18.0, 70.0, 40)
S = 2j * np.pi * FREQ
OUTPUTS, INPUTS = ("2", "1", "5"), ("1", "3")
PREDICT = jax.jit(predict, static_argnums=0)
ROUNDING = 3e-11  # of the largest receptance: the modal sum against the inverse of the matrices


def predicted(cause, index, p, level=(1.0,)):
    structure = five_dof()
    shape = (len(level), len(FREQ), len(OUTPUTS), len(INPUTS))
    problem = make_problem(
        FREQ,
        np.zeros(shape, complex),
        np.ones(shape),
        np.array(level),
        OUTPUTS,
        INPUTS,
        modal_form_of(structure, FREQ[0]),
    )
    theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))
    H = PREDICT((cause,), np.array([index]), (None,), (np.asarray(p, float),), theta, problem)
    return np.asarray(H)[:, : len(FREQ), : len(OUTPUTS), : len(INPUTS)]


def solved(change=None):
    """Receptances from the dynamic stiffness with a change at every line, shape ``(f, o, i)``."""
    M, C, K = (np.asarray(getattr(five_dof(), name)) for name in "MCK")
    D = S[:, None, None] ** 2 * M + S[:, None, None] * C + K
    if change is not None:
        D = D + change
    return np.linalg.inv(D)[:, [1, 0, 4]][:, :, [0, 2]]


def test_stray_force_and_resonant_mount_against_closed_forms():
    H = solved()
    M, C, K = (np.asarray(getattr(five_dof(), name)) for name in "MCK")
    whole = np.linalg.inv(S[:, None, None] ** 2 * M + S[:, None, None] * C + K)
    stray = H.copy()
    stray[:, :, 1] += 0.2 * whole[:, [1, 0, 4], 3]
    found = predicted(StrayForce(), (1, 3, 0), [0.2])[0]
    assert np.abs(found - stray).max() < ROUNDING * np.abs(H).max()
    w = 2 * np.pi * 40.0
    mount = H.copy()
    mount[:, 2] *= (1 - 0.3 * S**2 / (S**2 + 0.04 * w * S + w**2))[:, None]
    found = predicted(SensorResonance(), (2, -1, 0), [0.3, 40.0, 0.02])[0]
    assert np.abs(found - mount).max() < ROUNDING * np.abs(H).max()


def across(a, b):
    e = np.zeros(5)
    e[a], e[b] = 1.0, -1.0
    return np.outer(e, e)[None]


ONE = np.zeros((1, 5, 5))
ONE[0, 1, 3] = 1.0


@pytest.mark.parametrize(
    ("cause", "index", "p", "change"),
    [
        (FractionalJoint(), (1, 3, 0), [900.0, 0.4], 900.0 * S[:, None, None] ** 0.4 * across(1, 3)),
        (MaxwellJoint(), (1, 3, 0), [5e3, 4e-3], (20 * S / (1 + S * 4e-3))[:, None, None] * across(1, 3)),
        (ZenerJoint(), (1, 3, 0), [5e3, 4e-3, 0.6], (3e3 + 20 * S / (1 + S * 4e-3))[:, None, None] * across(1, 3)),
        (HystereticJoint(), (1, 3, 0), [2e3], 2e3j * across(1, 3)),
        (OneWayDamper(False), (1, 3, 0), [30.0], 30.0 * S[:, None, None] * ONE),
        (OneWayDamper(True), (1, 3, 0), [30.0], 30.0 * S[:, None, None] * ONE.transpose(0, 2, 1)),
        (FollowerStiffness(), (1, 3, 0), [4e3], 4e3 * (ONE - ONE.transpose(0, 2, 1))),
        (AllStiffness(), (0, -1, 0), [0.03], 0.03 * np.asarray(five_dof().K)[None]),
    ],
)
def test_an_element_equals_its_dynamic_stiffness(cause, index, p, change):
    expected = solved(change)
    assert np.abs(predicted(cause, index, p)[0] - expected).max() < ROUNDING * np.abs(expected).max()
    assert np.abs(expected - solved()).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("cause", "index", "p", "factor"),
    [
        (AcCoupling(), (2, -1, 0), [6.0], S / (S + 2 * np.pi * 6.0)),
        (SensorLowpass(1), (2, -1, 0), [1e-3], 1 / (1 + S * 1e-3)),
        (SensorLowpass(2), (2, -1, 0), [1e-3], 1 / (1 + S * 1e-3 + S**2 * 5e-7)),
    ],
)
def test_a_filter_acts_on_its_own_row(cause, index, p, factor):
    expected = solved()
    expected[:, 2] *= factor[:, None]
    assert np.abs(predicted(cause, index, p)[0] - expected).max() < ROUNDING * np.abs(expected).max()


def test_gains_of_the_force_and_crosstalk():
    H = solved()
    size = ROUNDING * np.abs(H).max()
    assert np.abs(predicted(ForceGain(), (-1, -1, 0), [0.1])[0] - 1.1 * H).max() < size
    assert np.abs(predicted(ForceGain(), (1, -1, 0), [0.1])[0] - H * np.array([1.0, 1.1])).max() < size
    leaked = H.copy()
    leaked[:, 0] += 0.2 * H[:, 2]
    assert np.abs(predicted(Crosstalk(), (0, 2, 0), [0.2])[0] - leaked).max() < size


def test_a_clipped_sensor_gives_the_fundamental_of_a_clipped_sine():
    H, level = solved(), np.array([1.0, 20.0])
    acceleration = np.abs(S[:, None] ** 2 * H[:, 1]) * level[:, None, None]
    ceiling = 0.4 * acceleration.max()
    turn = 2 * np.pi * (np.arange(4096) + 0.5) / 4096
    cut = np.clip(acceleration[..., None] * np.sin(turn), -ceiling, ceiling)
    fundamental = 2 * (cut * np.sin(turn)).mean(axis=-1) / acceleration
    expected = np.stack([H, H])
    expected[:, :, 1] *= fundamental
    got = predicted(ClippedSensor(), (1, 2, 0), [1 / ceiling], level)
    assert np.abs(got - expected).max() < 1e-6 * np.abs(H).max()
    assert fundamental.min() < 0.6


def test_power_laws_hold_the_known_ones():
    A, omega = jnp.array([1e-4, 3e-4]), jnp.array([100.0, 100.0])
    k3, c2 = 4e10, 5e3
    cubic = joints.CubicSpring(jnp.array(k3)).describing(A, omega)
    assert np.allclose(PowerSpring().impedance(A, omega, jnp.array([0.75 * k3 * 1e-8, 2.0])), cubic, rtol=1e-12)
    drag = joints.QuadraticDamping(jnp.array(c2)).describing(A, omega)
    c0 = 8 / (3 * np.pi) * c2 * 100.0 * 1e-4
    assert np.allclose(PowerDamper().impedance(A, omega, jnp.array([c0, 1.0])), drag, rtol=1e-12)


def test_no_imitator_bears_a_name_of_the_catalogue_and_each_is_rare():
    assert not {c.slug for c in imitators()} & {c.slug for c in catalogue()}
    assert max(c.prior for c in imitators()) < 0.1


def test_doubt_is_told_apart_and_in_words():
    gap = Hypothesis((catalogue()[0],), (Place(("1",), (0, -1, 0)),), chi2=10.0)
    other = Hypothesis((SensorResonance(),), (Place(("7",), (6, -1, 0)),), chi2=9.0)
    named, nameless = apart(posterior([(gap, 0.0), (other, 1.0)]))
    assert [r.best for r in named] == [gap] and [r.best for r in nameless] == [other]
    assert "a resonance of the mount of one sensor at 7" in likeness(nameless)[0] and "0.73" in likeness(nameless)[0]
    assert likeness([]) == ()


@pytest.mark.parametrize(
    ("cause", "p", "kind"),
    [(SensorLowpass(1), 2e-3, "low"), (SensorLowpass(2), 2e-3, "low"), (AcCoupling(), 6.0, "high")],
)
def test_a_filter_is_a_butterworth_filter_of_the_corner_that_is_told(cause, p, kind):
    told = {k: v for k, (v, _) in cause.report(np.array([p]), Place(("2",), (0, -1, 0))).items()}
    filter_ = scipy.signal.butter(int(told.get("order", 1)), 2 * np.pi * told[f"{kind}_pass_corner"], kind, analog=True)
    expected = solved()
    expected[:, 0] *= scipy.signal.freqs(*filter_, worN=S.imag)[1][:, None]
    assert np.abs(predicted(cause, (0, -1, 0), [p])[0] - expected).max() < ROUNDING * np.abs(expected).max()


def test_an_iwan_joint_is_as_stiff_as_its_sliders_together():
    """The closed form, before and after all slips, against a great many sliders side by side; and its micro-slip."""
    A = np.array([0.05, 0.3, 0.99, 1.01, 2.0, 30.0]) * 1e-4
    impedance, lost_of = jax.jit(IwanJoint().impedance), jax.jit(MicroSlip().impedance)
    sliders = jax.jit(lambda p: joints.Iwan(macro_slip(p), p[0], p[2] - 1, count=3000).describing(A, 1.0))
    for n in (0.4, 1.0):
        p = jnp.array([2e4, 1e-4, n])
        got = np.asarray(impedance(A, np.ones(6), p))
        assert np.abs(got / np.asarray(sliders(p)) - 1).max() < 1e-4
        lost = np.asarray(lost_of(A, np.ones(6), np.array([1.0, n])))[:3]
        assert np.ptp((got[:3] - 2e4) / lost) < 1e-6 * abs((got[0] - 2e4) / lost[0])
        assert abs(got[-1]) < 0.05 * abs(got[0])


def test_the_integral_of_spread_sliders_and_its_slopes_are_those_of_an_incomplete_beta_function():
    x, step = np.array([1e-9, 1e-3, 0.3, 0.49999, 0.5, 0.7, 0.999, 1.0]), 1e-5
    integral = lambda x, a: scipy.special.betainc(a + 1, 1.5, x) * scipy.special.beta(a + 1, 1.5) / x ** (a + 1)
    slopes = jax.jit(jax.vmap(jax.value_and_grad(power_and_root, (0, 1)), (0, None)))
    for a in (0.6, 1.5):
        value, (by_x, by_a) = slopes(x, a)
        assert np.allclose(value, integral(x, a), rtol=1e-13, atol=0)
        assert np.allclose(by_a, (integral(x, a + step) - integral(x, a - step)) / (2 * step), rtol=1e-8)
        inner = (x > 1e-6) & (x < 1)
        assert np.allclose(by_x[inner], (np.sqrt(1 - x) / x - (a + 1) / x * value)[inner], rtol=1e-9)
        assert np.isfinite(by_x).all()
