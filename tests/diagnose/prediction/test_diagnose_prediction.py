"""What causes do to a predicted FRF, against the same change made in the matrices or in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

from modalax.diagnose.causes import LocalCause, catalogue
from modalax.diagnose.causes.channels import ForceDropout, SensorMass
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.causes.damping import ModalDamping
from modalax.diagnose.causes.drift import DriftingSpring
from modalax.diagnose.causes.forces import StrayForce
from modalax.diagnose.causes.joints import CubicStiffness, ElastoSlip
from modalax.diagnose.causes.local import AddedMass, JointStiffness, LocalDamper, TunedMass
from modalax.diagnose.causes.records import ExponentialWindow, FastSweep, Leakage, _hann, erfcx
from modalax.diagnose.prediction import element_response as pieces
from modalax.diagnose.prediction.frf import equivalent, predict
from modalax.diagnose.setup.modal_form import modal_form_of
from modalax.diagnose.setup.problem import make_problem
from modalax.model import Structure
from modalax.model.examples import five_dof

FREQ = np.linspace(18.0, 70.0, 60)
# The modal sum and the matrix inverse agree to 3e-14 of the largest receptance; a hundred times that is allowed.
ROUNDING = 3e-12
PREDICT = jax.jit(predict, static_argnums=0)
SLUGS = """modal_damping structural_damping local_damper joint_stiffness added_mass sensor_mass tuned_mass missing_mode
out_of_band channel_gain channel_sign channel_swap time_delay units exponential_window leakage fast_sweep mains_hum
force_dropout coulomb_friction elasto_slip cubic_stiffness gap quadratic_damping bilinear_stiffness gyroscopic
time_varying""".split()


def problem_of(structure, level=(1.0,), order=0):
    shape = (len(level), len(FREQ), 3, 2)
    return make_problem(
        FREQ, np.zeros(shape, complex), np.ones(shape), np.array(level), ("2", "1", "5"), ("1", "3"),
        modal_form_of(structure, FREQ[0]), order=order,
    )  # fmt: skip


def predicted(structure, cause, index, p, level=(1.0,), order=0):
    problem = problem_of(structure, level, order)
    n = problem.modal_form.stiffness.shape[0]
    H = PREDICT((cause,), np.array([index]), (None,), (np.asarray(p, float),), np.zeros((2, n)), problem)
    return np.asarray(H)[:, : len(FREQ), :3, :2]


def from_matrices(M, C, K):
    dofs = [str(k + 1) for k in range(len(M))]
    return np.asarray(Structure(M, C, K, dofs).frf(FREQ, outputs=("2", "1", "5"), inputs=("1", "3")).H)


def direction(n, *which):
    e = np.zeros(n)
    e[which[0]] = 1.0
    if len(which) > 1:
        e[which[1]] = -1.0
    return np.outer(e, e)


def test_every_slug_of_the_answer_has_a_cause():
    assert {c.slug for c in catalogue()} >= set(SLUGS)


@pytest.mark.parametrize(
    ("cause", "index", "p", "matrix", "where"),
    [
        (JointStiffness(), (2, 4, 0), 9e3, "K", (2, 4)),
        (JointStiffness(), (3, -1, 0), -4e3, "K", (3,)),
        (LocalDamper(), (0, 1, 0), 25.0, "C", (0, 1)),
        (AddedMass(), (2, -1, 0), 0.2, "M", (2,)),
    ],
)
def test_a_local_element_equals_its_term_in_the_matrices(cause, index, p, matrix, where):
    S = five_dof()
    matrices = {"M": np.asarray(S.M), "C": np.asarray(S.C), "K": np.asarray(S.K)}
    matrices[matrix] = matrices[matrix] + p * direction(5, *where)
    expected = from_matrices(**matrices)
    got = predicted(S, cause, index, [p])[0]
    assert np.abs(got - expected).max() < ROUNDING * np.abs(expected).max() * 10


def test_a_drifting_spring_equals_its_term_in_each_run():
    S, drift = five_dof(), 4e3
    got = predicted(S, DriftingSpring(), (2, 4, 0), [drift], level=(1.0, 3.0, 2.0))
    for run, share in enumerate((0.0, 0.5, 1.0)):
        expected = from_matrices(
            np.asarray(S.M), np.asarray(S.C), np.asarray(S.K) + share * drift * direction(5, 2, 4)
        )  # fmt: skip
        assert np.abs(got[run] - expected).max() < 10 * ROUNDING * np.abs(expected).max()


def test_a_tuned_mass_equals_one_more_dof():
    S, m, f, zeta = five_dof(), 0.05, 36.0, 0.02
    w = 2 * np.pi * f
    grow = lambda A, a, d: np.block([[A + a * direction(5, 1), -a * np.eye(5)[:, [1]]], [-a * np.eye(5)[[1]], d]])
    k, c = m * w**2, 2 * zeta * w * m
    expected = from_matrices(
        grow(np.asarray(S.M), 0.0, m), grow(np.asarray(S.C), c, c), grow(np.asarray(S.K), k, k)
    )  # fmt: skip
    got = predicted(S, TunedMass(), (1, -1, 0), [m, f, zeta])[0]
    assert np.abs(got - expected).max() < 10 * ROUNDING * np.abs(expected).max()


def test_gyroscopic_coupling_breaks_reciprocity_as_the_matrices_do():
    S, g = five_dof(), 12.0
    G = np.zeros((5, 5))
    G[1, 3], G[3, 1] = g, -g
    expected = from_matrices(np.asarray(S.M), np.asarray(S.C) + G, np.asarray(S.K))
    got = predicted(S, Gyroscopic(), (1, 3, 0), [g])[0]
    assert np.abs(got - expected).max() < 10 * ROUNDING * np.abs(expected).max()


def test_modal_damping_equals_the_structure_with_that_ratio():
    S = five_dof()
    model = S.modal()
    phi, zeta = np.asarray(model.shapes).real, np.full(5, 0.02)
    zeta[2] *= 1.4
    other = Structure.from_modes(model.frequency_hz, zeta, phi, np.asarray(model.modal_mass()).real, S.dofs)
    expected = np.asarray(other.frf(FREQ, outputs=("2", "1", "5"), inputs=("1", "3")).H)
    got = predicted(S, ModalDamping(), (2, -1, 0), [0.4])[0]
    # the shapes of the example are real to 1e-9 only, as its matrices come from rounded tables
    assert np.abs(got - expected).max() < 1e-7 * np.abs(expected).max()


def test_a_sensor_loads_its_own_row_only():
    S, m = five_dof(), 0.1
    bare = from_matrices(np.asarray(S.M), np.asarray(S.C), np.asarray(S.K))
    loaded = from_matrices(np.asarray(S.M) + m * direction(5, 4), np.asarray(S.C), np.asarray(S.K))
    got = predicted(S, SensorMass(), (2, -1, 0), [m])[0]
    assert np.abs(got[:, 2] - loaded[:, 2]).max() < 10 * ROUNDING * np.abs(loaded).max()
    assert np.abs(got[:, :2] - bare[:, :2]).max() < 10 * ROUNDING * np.abs(bare).max()


def test_faults_of_channels_act_on_the_structure_with_its_elements():
    """A sensor's mass, a force that is lost at resonances and a stray force, each beside a spring and a dashpot."""
    S, k, c, m, share = five_dof(), -6e3, 30.0, 0.3, 0.2
    M, C, K = np.asarray(S.M), np.asarray(S.C) + c * direction(5, 0), np.asarray(S.K) + k * direction(5, 2, 4)
    elements = (JointStiffness(), LocalDamper()), [(2, 4, 0), (0, -1, 0)], (np.array([k]), np.array([c]))
    problem = problem_of(S)
    theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))

    def got(cause, index, p):
        causes, at, params = elements
        at = np.array([*at, index])
        H = PREDICT((*causes, cause), at, (None,) * 3, (*params, np.asarray(p, float)), theta, problem)
        return np.asarray(H)[0, : len(FREQ), :3, :2]

    bare, loaded = from_matrices(M, C, K), from_matrices(M + m * direction(5, 4), C, K)
    every = np.asarray(Structure(M, C, K, [str(k + 1) for k in range(5)]).frf(FREQ).H)
    sensor = got(SensorMass(), (2, -1, 0), [m])
    assert np.abs(sensor[:, 2] - loaded[:, 2]).max() < 30 * ROUNDING * np.abs(loaded).max()
    assert np.abs(sensor[:, :2] - bare[:, :2]).max() < 30 * ROUNDING * np.abs(bare).max()
    mobility = np.stack([every[:, 0, 0], every[:, 2, 2]], axis=-1) * (2j * np.pi * FREQ)[:, None]
    lost = 0.1 * np.abs(1 + 3.0 * mobility / np.abs(mobility).max(axis=0)) ** 2
    dropped = bare / (1 + lost[:, None])
    assert np.abs(got(ForceDropout(), (0, -1, 0), [0.1, 3.0]) - dropped).max() < 30 * ROUNDING * np.abs(bare).max()
    askew = bare.copy()
    askew[:, :, 1] += share * every[:, [1, 0, 4], 3]
    assert np.abs(got(StrayForce(), (1, 3, 0), [share]) - askew).max() < 30 * ROUNDING * np.abs(bare).max()


def test_an_exponential_window_shifts_every_pole():
    S, decay = five_dof(), 1.7
    model = S.modal()
    expected = np.asarray(
        model.replace(poles=model.poles - decay).frf(FREQ, outputs=("2", "1", "5"), inputs=("1", "3")).H
    )
    got = predicted(S, ExponentialWindow(), (0, -1, 0), [decay])[0]
    assert np.abs(got - expected).max() < 10 * ROUNDING * np.abs(expected).max()


@pytest.mark.parametrize("order", [0, 1, 2])
def test_windows_act_on_the_response_that_was_measured(order):
    """Velocities and accelerations through a decaying window and a record that ends, integrated in time.

    A blow on the masses at rest: x'' = M^-1 (f delta - C x' - K x), so an accelerance holds an instant part.
    """
    S, decay, T = five_dof(), 1.3, 0.4
    M, C, K = (np.asarray(getattr(S, name)) for name in "MCK")
    A = np.block([[np.zeros((5, 5)), np.eye(5)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    poles, V = np.linalg.eig(A)
    start = np.linalg.solve(V, np.vstack([np.zeros((5, 2)), np.linalg.inv(M)[:, [0, 2]]]))
    s = 2j * np.pi * FREQ
    instant = np.linalg.inv(M)[[1, 0, 4]][:, [0, 2]] if order == 2 else 0.0
    right = V[[1, 0, 4]][:, :, None] * start * (poles**order)[:, None]  # of each pole's decay in time
    for cause, p, ends in ((ExponentialWindow(), [decay], None), (Leakage(), [1 / T], T)):
        x = (s[:, None] + (0.0 if ends else decay)) - poles
        through = (1 - np.exp(-x * ends)) / x if ends else 1 / x
        expected = (np.einsum("fn,oni->foi", through, right) + instant) / s[:, None, None] ** order
        got = predicted(S, cause, (0, -1, 2), p, order=order)[0]
        assert np.abs(got - expected).max() < 10 * ROUNDING * np.abs(expected).max()


def test_a_slow_sweep_bends_the_frf_as_its_second_derivative():
    """H - (j/2) S H'' for a small rate; the next term is of the order of its square."""
    S, rate = five_dof(), 1e-3
    model = S.modal()
    s = 2j * np.pi * FREQ[:, None]
    poles = np.asarray(model.poles)
    R = np.asarray(model.residues)[:, [1, 0, 4]][:, :, [0, 2]]
    second = -2 / (s - poles) ** 3, -2 / (s - poles.conj()) ** 3  # d2/domega2 of 1/(j omega - pole)
    curve = np.einsum("fn,noi->foi", second[0], R) + np.einsum("fn,noi->foi", second[1], R.conj())
    plain = from_matrices(np.asarray(S.M), np.asarray(S.C), np.asarray(S.K))
    change = predicted(S, FastSweep(), (0, -1, 0), [rate])[0] - plain
    expected = -0.5j * 2 * np.pi * rate * curve
    assert np.abs(change - expected).max() < 2e-3 * np.abs(expected).max()  # next order: measured 5e-4


def test_a_cubic_joint_solves_its_own_describing_function_equation():
    S, k3, level = five_dof(), 2e9, (2.0, 5.0)
    got = predicted(S, CubicStiffness(), (2, 4, 0), [k3], level)
    b = np.eye(5)[2] - np.eye(5)[4]
    H = np.asarray(S.frf(FREQ).H)
    for run, force in enumerate(level):
        free = H[:, :, 0] @ b * force
        flat = np.einsum("d,fde,e->f", b, H, b)
        change = got[run, :, :, 0] - H[:, [1, 0, 4], 0]
        joint = -(H[:, [1, 0, 4]] @ b)
        f1 = (change / joint)[:, 0] * force  # the joint's fundamental force, from what it does to an output
        q = free - flat * f1
        law = 0.75 * k3 * np.abs(q) ** 2 * q
        assert np.abs(f1 - law).max() < 1e-5 * np.abs(law).max()  # two polishing steps leave 1e-8


def test_the_scaled_error_function_against_scipy():
    rng = np.random.default_rng(1)
    z = np.concatenate([rng.normal(size=50) * 4 + 1j * rng.normal(size=50) * 4, [120 + 3j, 1e-3j]])
    z = z[(z**2).real < 300]
    expected = scipy.special.wofz(1j * z)
    assert np.abs(np.asarray(erfcx(jnp.asarray(z))) / expected - 1).max() < 1e-11  # measured 7e-15


def test_the_hann_lag_window_against_its_autocorrelation():
    T, x = 3.0, 0.7 + 5j
    t = np.linspace(0, T, 4001)
    w = 0.5 - 0.5 * np.cos(2 * np.pi * t / T)
    lag = np.correlate(w, w, "full")[len(w) - 1 :]
    numeric = np.trapezoid(lag / lag[0] * np.exp(-x * t), t)
    assert (
        abs(complex(_hann(jnp.asarray(x), jnp.asarray(T))) / numeric - 1) < 1e-5
    )  # the trapezoidal rule is off by 2e-6


def test_the_prediction_differentiates_and_maps():
    S = five_dof()
    problem = problem_of(S, (3.0,))
    n = problem.modal_form.stiffness.shape[0]

    @jax.jit
    def energy(k3):
        where = jnp.array([[2, 4, 0]])
        H = predict((CubicStiffness(),), where, (None,), (k3[None],), jnp.zeros((2, n)), problem)
        return jnp.sum(jnp.abs(H) ** 2) * 1e6

    at, step = jnp.array(1e8), 1e6
    slope = float(jax.jit(jax.grad(energy))(at))
    numeric = float((energy(at + step) - energy(at - step)) / (2 * step))
    assert abs(slope / numeric - 1) < 3e-4  # measured 3.5e-5
    many = jax.vmap(energy)(jnp.array([0.0, 1e8]))
    assert abs(float(many[1]) / float(energy(at)) - 1) < 1e-12


@pytest.mark.parametrize("cause", [TunedMass(), ElastoSlip(False), DriftingSpring()])
def test_elements_in_pieces_are_the_elements_of_whole_trials(cause, monkeypatch):
    """Samples cut anywhere, filled up or not, against each trial over all its runs, lines and inputs at once."""
    monkeypatch.setattr(pieces, "LENGTH", 64)
    rng, places, lines, inputs = np.random.default_rng(4), 3, 17, 2
    motion = 1e-5 * rng.normal(size=(places, lines, inputs, 2)).view(complex)[..., 0]
    drive = 1e-5 * rng.normal(size=(places, lines, 2)).view(complex)[..., 0]
    omega, level = np.linspace(60.0, 90.0, lines), np.array([[1.0], [2.0], [5.0]]) * rng.uniform(0.9, 1.1, (1, lines))
    typical = {"tuned_mass": [2.0, 12.0, 0.1], "elasto_slip": [4e4, 2e-5], "time_varying": [4e4]}[cause.slug]
    params, owner = typical * rng.uniform(0.5, 2.0, (7, len(typical))), np.array([2, 0, 1, 1, 0, 2, 2])
    y = pieces.coefficients(cause, True, params, owner, motion, drive, omega, level)
    solved = jax.jit(equivalent, static_argnums=0)
    for k, place in enumerate(owner):
        p, w, H, F = map(jnp.asarray, (params[k], omega, drive[place][None], motion[place][None]))
        if isinstance(cause, LocalCause):
            Z = cause.impedance(1j * w, p)[None, :, None]
        else:
            Z = solved(cause, p, w, H, F, jnp.asarray(level))
        assert y[k] == pytest.approx(np.asarray(-Z / (1 + Z * H[..., None]) * F), rel=1e-9)


def test_derivatives_of_a_balance_are_those_of_its_equation():
    """A root that a step of the search meets exactly is not left again; it was, which left 2e-5 in derivatives."""
    rng, lines = np.random.default_rng(0), 30
    motion = jnp.asarray(1e-6 * rng.normal(size=(1, lines, 2)).view(complex))
    omega, level, cause = jnp.linspace(100.0, 200.0, lines), jnp.ones((3, lines)), ElastoSlip(False)
    p = jnp.array([1e4, 5e-7])
    balanced = jax.jit(lambda q: equivalent(cause, q, omega, motion[..., 0], motion, level))
    slopes = np.asarray(jax.jit(jax.jacfwd(balanced))(p))
    Z, motion = np.asarray(balanced(p)), np.asarray(motion)
    A = np.abs(motion / (1 + Z * motion))
    law = jax.jit(lambda A, q: cause.impedance(A, omega[:, None], q))
    along = jax.jit(lambda changes: jax.jvp(law, (A, p), changes)[1])
    assert np.asarray(law(A, p)) == pytest.approx(Z, rel=1e-12)  # measured 1e-15
    # ln A + ln|1 + Z h| stays as it is while the parameters and with them the amplitude change
    by_A = np.asarray(along((A, jnp.zeros(2))))
    weight = motion / (1 + Z * motion)
    for k, direction in enumerate(np.eye(2)):
        own = np.asarray(along((np.zeros_like(A), direction)))
        grown = -(weight * own).real / (1 + (weight * by_A).real)
        assert slopes[..., k] == pytest.approx(own + by_A * grown, rel=1e-9)  # measured 1e-13


def test_an_impedance_that_does_not_follow_its_lines_says_so():
    """Its first entry would else be taken at every line."""

    class Tabled(JointStiffness):
        slug = "tabled"

        def impedance(self, s, p):
            return p[0] * jnp.linspace(1.0, 2.0, 17) + 0j

    one = np.ones((1, 17, 1), complex)
    with pytest.raises(ValueError, match=r"impedance of 'tabled' has the shape \(17,\) at one line"):
        pieces.coefficients(
            Tabled(), True, np.ones((1, 1)), np.zeros(1, int), one, one[..., 0], np.ones(17), np.ones((1, 17))
        )
