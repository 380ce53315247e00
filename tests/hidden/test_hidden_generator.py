"""The generator of hidden effects keeps what it says: sizes, noise, files, and the physics behind them."""

import ast
import math
import sys
from pathlib import Path

import generator
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.signal
from generator import laws, rivals
from generator.case import EFFECTS
from generator.effect import Setup
from generator.effects_channel import hann_line
from generator.march import Joint, march
from generator.noise import Yardstick
from generator.plant import (
    Plant,
    boxcar_kernel,
    hann_kernel,
    sweep_kernel,
    through_kernel,
    truncated_kernel,
)
from generator.systems import System, draw_system, elastic_frequencies

from modalax.data import Measurement
from modalax.model import Structure

HERE = Path(generator.__file__).parent


def base_frf(case):
    """The simulation's FRF from the written matrices alone."""
    sim, data = case.simulation, case.measurement
    s = 2j * np.pi * data["freq"][:, None, None]
    dofs = list(sim["dofs"])
    rows, columns = [dofs.index(n) for n in data["outputs"]], [dofs.index(n) for n in data["inputs"]]
    H = np.linalg.inv(sim["K"] + s * sim["C"] + s**2 * sim["M"])[:, rows][:, :, columns]
    return H * s ** {"receptance": 0, "mobility": 1, "accelerance": 2}[str(data["form"])]


def test_imports_nothing_but_numpy_and_scipy():
    roots = set()
    for file in HERE.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                roots |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                roots.add(str(node.module).split(".")[0])
    assert roots - set(sys.stdlib_module_names) == {"numpy", "scipy"}


# two causes of each stage: matrices, extra mode, drift, channel, window, record, sweep, hum, joint, outside
SOME = [
    "modal_damping", "gyroscopic", "tuned_mass", "missing_mode", "time_varying", "sensor_mass", "time_delay",
    "exponential_window", "leakage", "fast_sweep", "mains_hum", "force_dropout", "elasto_slip", "outside:maxwell",
    "sensor_clipping", "outside:geometric_stiffening",
]  # fmt: skip


@pytest.mark.parametrize("cause", SOME)
def test_size_is_as_asked(cause):
    case = generator.draw_case(11, cause, d=8.0, spread=False, runs=None if cause == "time_varying" else 2)
    change = case.H_true - base_frf(case)
    d = np.sqrt((2 * np.abs(change) ** 2 / case.sigma**2).sum())
    marched = case.truth["remarks"] != {}
    assert d == pytest.approx(8.0, rel=0.03 if marched else 5e-4)  # the size is solved to 1 % marched, 1e-4 else
    assert d == pytest.approx(case.truth["causes"][0]["d"], rel=1e-6)


def test_size_allows_for_the_claimed_spread():
    """The distance is nearly the one of the full covariance, and its sensitivities are those of the written matrices.

    Of a small effect it is exactly that; errors that are not small bend the way.
    """
    case = generator.draw_case(4, "added_mass", d=8.0, family="masses", spread=True, runs=1, noise="absolute")
    claims = case.truth["frequency_std"], case.truth["damping_std"]
    yard = Yardstick.of(case.setup, case.sigma, *claims)
    base = case.setup.frf(case.setup.plant)
    delta = (np.sqrt(2) / case.sigma * (case.H_true - base)).ravel()
    J = np.concatenate([yard.J.real, yard.J.imag])
    stacked = np.concatenate([delta.real, delta.imag])
    full = stacked @ scipy.linalg.solve(np.eye(len(J)) + J @ J.T, stacked, assume_a="pos", overwrite_a=True)
    assert case.truth["d"] <= np.sqrt(full)
    assert yard.distance(1e-6 * (case.H_true - base)) == pytest.approx(1e-6 * np.sqrt(full), rel=1e-4)
    assert case.truth["d"] == pytest.approx(8.0, rel=1e-3)
    omega, zeta, shapes = case.setup.system.modes()
    left, step = case.setup.system.M @ shapes, 1e-6

    def frf(w, z):
        return case.setup.frf(Plant(case.setup.system.M, (left * 2 * z * w) @ left.T, (left * w**2) @ left.T))

    for r in (0, 2):
        grow = np.where(np.arange(len(omega)) == r, step, 0.0)
        by_frequency = frf(omega * (1 + grow), zeta) - frf(omega * (1 - grow), zeta)
        by_damping = frf(omega, zeta * (1 + grow)) - frf(omega, zeta * (1 - grow))
        for column, slope, claim in ((r, by_frequency, claims[0]), (len(omega) + r, by_damping, claims[1])):
            want = (np.sqrt(2) / case.sigma * slope[None] / (2 * step) * claim).ravel()
            assert np.linalg.norm(yard.J[:, column] - want) < 1e-6 * np.linalg.norm(want)


def test_errors_that_the_author_admits_are_no_distance():
    """Modes off by large but claimed errors are as far as these errors are unlikely, however much they show."""
    case = generator.draw_case(4, "clean", family="masses", spread=True, runs=1, noise="absolute")
    yard = Yardstick.of(case.setup, case.sigma, 0.01, 0.2)
    system = case.setup.system
    omega, zeta, shapes = system.modes()
    left, grown = system.M @ shapes, np.where(np.arange(len(omega)) == 1, 1.4, 1.0)
    off = Plant(system.M, (left * 2 * zeta * grown * omega) @ left.T, (left * omega**2) @ left.T)
    straight = Plant(system.M, (left * 2 * zeta * omega) @ left.T, (left * omega**2) @ left.T)
    change = case.setup.frf(off) - case.setup.frf(straight)
    admitted = np.log(1.4) / 0.2
    assert yard.plain(change) > 10
    assert yard.distance(np.broadcast_to(change, case.H_true.shape)) <= admitted * (1 + 1e-6)


@pytest.mark.parametrize("kind", ["absolute", "relative", "coloured"])
def test_noise_is_as_stated(kind):
    case = generator.draw_case(5, "clean", noise=kind, variance="8", runs=3)
    error = (case.measurement["H"] - case.H_true) / case.sigma
    n = error.size
    assert np.mean(np.abs(error) ** 2) == pytest.approx(1.0, abs=5 / np.sqrt(n))
    assert abs(np.mean(error**2)) < 5 / np.sqrt(n)  # circular
    ratio = case.measurement["variance"] / case.sigma**2
    assert ratio.mean() == pytest.approx(1.0, abs=5 / np.sqrt(7 * n))
    assert ratio.var() == pytest.approx(1 / 7, rel=0.2)  # chi-square of 14 degrees of freedom
    assert case.measurement["averages"] == 8
    exact = generator.draw_case(5, "clean", noise=kind, variance="exact", runs=3)
    assert np.array_equal(exact.measurement["variance"], exact.sigma**2)
    assert "averages" not in exact.measurement
    assert "variance" not in generator.draw_case(5, "clean", variance="missing").measurement


def test_clean_simulation_is_the_truth_and_spread_is_claimed():
    case = generator.draw_case(6, "clean", spread=False)
    assert np.allclose(case.H_true, base_frf(case), rtol=1e-8, atol=0)
    off = generator.draw_case(6, "clean", spread=True)
    true, said = off.setup.system.modes()[0], off.simulation
    moved = Structure(said["M"], said["C"], said["K"], dofs=list(said["dofs"])).modal().poles
    relative = np.abs(np.asarray(moved)) / true - 1
    assert 0.2 < np.std(relative) / said["frequency_std"] < 2.5


@pytest.mark.parametrize("family", generator.FAMILIES)
def test_files_have_the_agreed_form(family, tmp_path):
    case = generator.draw_case(21, "channel_gain", d=12.0, family=family, variance="6")
    case.save(tmp_path / "open", tmp_path / "hidden" / "truth.json")
    assert sorted(p.name for p in (tmp_path / "open").iterdir()) == ["measurement.npz", "simulation.npz"]
    with np.load(tmp_path / "open" / "measurement.npz") as z:
        data = dict(z)
    measured = Measurement(
        data["freq"], data["H"], variance=data["variance"], level=data["level"], form=str(data["form"]),
        outputs=[str(n) for n in data["outputs"]], inputs=[str(n) for n in data["inputs"]],
        averages=int(data["averages"]),
    )  # fmt: skip
    assert data["H"].dtype == complex and measured.H.shape == tuple(case.truth["shape"])
    with np.load(tmp_path / "open" / "simulation.npz") as z:
        sim = dict(z)
    structure = Structure(sim["M"], sim["C"], sim["K"], dofs=[str(n) for n in sim["dofs"]])
    assert set(measured.outputs) | set(measured.inputs) <= set(structure.dofs)
    assert np.linalg.eigvalsh(sim["K"]).min() > 0 and np.linalg.eigvalsh(sim["M"]).min() > 0
    poles = np.asarray(structure.modal().poles)
    inside = (poles.imag / 2 / np.pi > data["freq"][0]) & (poles.imag / 2 / np.pi < data["freq"][-1])
    assert inside.sum() >= 2


def test_seed_decides_everything(tmp_path):
    one, two, other = (generator.draw_case(s, "gap", d=5.0) for s in (7, 7, 8))
    assert np.array_equal(one.measurement["H"], two.measurement["H"]) and one.truth == two.truth
    assert one.measurement["H"].shape != other.measurement["H"].shape or not np.allclose(
        one.measurement["H"], other.measurement["H"]
    )


@pytest.mark.parametrize("cause", ["joint_stiffness", "local_damper", "channel_gain", "time_delay", "cubic_stiffness"])
def test_a_small_effect_is_what_its_own_name_explains(cause):
    """The linearised look-alikes are right: an effect lies along its own direction, and its rivals short of it."""
    case = generator.draw_case(100, cause, 3.0, "masses", spread=False, inputs=1, runs=3, structure=35)
    yard = Yardstick.of(case.setup, case.sigma, 0.0, 0.0)
    found = rivals.shares(case.setup, yard, case.H_true - base_frf(case))
    assert found[cause] > 0.999  # measured at least 0.9998: the size is small, not zero
    assert all(0 <= v <= 1 for v in found.values())
    assert rivals.confusion(20.0, 1.0) == 0.5 and rivals.confusion(20.0, 0.5) < 1e-10


@pytest.mark.parametrize("seed", range(4))
def test_hum_stands_on_its_own_lines_within_the_band(seed):
    case = generator.draw_case(seed, "mains_hum", 30.0, spread=False, noise="absolute")
    change = np.abs(case.H_true - base_frf(case)).max(axis=(0, 2, 3))
    freq, mains = case.measurement["freq"], case.truth["causes"][0]["parameters"]["frequency"]["value"]
    off = np.abs(freq[change > 0.3 * change.max()][:, None] - mains * np.arange(1, 20)).min(axis=1)
    assert off.max() < 2 * (freq[1] - freq[0])


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="rust"):
        generator.draw_case(1, "rust")
    with pytest.raises(ValueError, match="boat"):
        generator.draw_case(1, "clean", family="boat")


def test_compound_holds_both_effects():
    case = generator.draw_case(3, "added_mass+channel_gain", d=20.0, spread=False)
    assert [c["name"] for c in case.truth["causes"]] == ["added_mass", "channel_gain"]
    for c in case.truth["causes"]:
        assert c["d"] == pytest.approx(20.0, rel=1e-3)
    assert case.truth["cause"] == "added_mass+channel_gain"


def test_every_effect_has_its_own_name():
    setup = generator.draw_case(1, "clean", inputs=2, runs=3).setup
    setup = Setup(**{**vars(setup), "level": np.array([1.0, 2.0, 4.0])})
    for slug, draw in EFFECTS.items():
        assert draw(setup, np.random.default_rng(0)).slug == slug


# joints against an independent integration -----------------------------------------------------------------------

LEVEL = 2.0


@pytest.fixture(scope="module")
def chain() -> System:
    n = 3
    K = 4e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    M = np.diag([1.0, 1.5, 0.8])
    C = 0.06 / 120 * K + 2.0 * M
    return System(M, C, K, ["1", "2", "3"], [(0, 1, 4e4), (1, 2, 4e4)], "masses", "chain", "local")


def lines(chain) -> np.ndarray:
    f = chain.modes()[0][:2] / 2 / np.pi
    return np.array([0.7 * f[0], 0.99 * f[0], 1.03 * f[0], 1.01 * f[1]])


def integrate(chain, law, b, freq, cycles=32):
    """Fundamental of the first DoF over the last cycle, by DOP853 on the equations of motion as they stand."""
    n, w, push = chain.n, 2 * np.pi * freq, np.array([LEVEL, 0, 0])
    slider = isinstance(law, laws.Jenkins)
    driven, along = np.linalg.solve(chain.M, push), np.linalg.solve(chain.M, b)
    free = -np.linalg.solve(chain.M, np.hstack([chain.K, chain.C]))
    if slider:
        free[:, :n] += np.outer(along, law.given * b)

    def rate(t, y):
        q, u = b @ y[:n], b @ y[n : 2 * n]
        f = min(max(y[-1], -law.limit), law.limit) if slider else float(law.start(np.array(q), np.array(u)))
        out = np.zeros(2 * n + 1)
        out[:n], out[n:-1] = y[n:-1], math.cos(w * t) * driven - f * along + free @ y[:-1]
        if slider and not (abs(y[-1]) >= law.limit and y[-1] * u > 0):
            out[-1] = law.k * u
        return out

    linear = np.linalg.solve(chain.K + 1j * w * chain.C - w**2 * chain.M, push)
    from_linear = np.concatenate([linear.real, (1j * w * linear).real, [0.0]])
    T = 2 * np.pi / w
    t = np.linspace((cycles - 1) * T, cycles * T, 2001)
    smooth = isinstance(law, laws.Cubic | laws.QuadraticDamper | laws.CubicDamper)
    got = scipy.integrate.solve_ivp(
        rate, (0, cycles * T), from_linear, "DOP853", t, rtol=1e-7, atol=1e-12,
        max_step=np.inf if smooth else T / 50,
    )  # fmt: skip
    return 2 / T * scipy.integrate.trapezoid(got.y[0] * np.exp(-1j * w * t), t) / LEVEL


PAIR, GROUND = np.array([1.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
# the linear peak is about 3e-4 m at 2 N; thresholds are set to bite there
LAWS = {
    "cubic": (laws.Cubic("c", 3e11), PAIR),
    "quadratic": (laws.QuadraticDamper("q", 1500.0), GROUND),
    "cubic damper": (laws.CubicDamper("q", 3e4), GROUND),
    "gap": (laws.Gap("g", 8e3, 5e-5), PAIR),
    "bilinear": (laws.Bilinear("b", 5e3, 0.0), GROUND),
    "jenkins": (laws.Jenkins("j", 6e3, 0.5), PAIR),
    "jenkins for a spring": (laws.Jenkins("j", 8e3, 0.3, 8e3), PAIR),
    "jenkins to ground": (laws.Jenkins("j", 3e3, 0.4), GROUND),
}


ALIKE = ("jenkins for a spring", "jenkins to ground")  # to the law that stands for them


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in ALIKE else ()) for n in LAWS])
def test_marched_joint_is_that_of_a_fine_integration(chain, name):
    law, b = LAWS[name]
    freq = lines(chain)
    setup = Setup(chain, freq, "receptance", [0], [0], np.array([LEVEL]), False)
    change, remarks = march(setup.plant, setup, [Joint(law, b)])
    assert remarks["unsettled_rows"] == 0
    change = change[0, :, 0, 0]
    linear = setup.frf(setup.plant)[:, 0, 0]
    assert (np.abs(change) / np.abs(linear)).max() > 0.03  # the joint matters
    fine = np.array([integrate(chain, law, b, f) for f in freq[1:3]])
    # measured: at most 6.3e-5 of the joint's own effect
    assert np.abs(linear[1:3] + change[1:3] - fine).max() < 5e-4 * np.abs(change).max()


@pytest.mark.parametrize("limit", [0.15, pytest.param(0.4, marks=pytest.mark.slow)])
def test_marched_slider_is_the_limit_of_steep_friction(chain, limit):
    """Rigid friction against F tanh(v/e) with e a thousandth of the speed, integrated as it stands."""
    n, b, freq = chain.n, GROUND, lines(chain)[1]
    w, inverse, push = 2 * np.pi * freq, np.linalg.inv(chain.M), np.array([LEVEL, 0, 0])
    linear = np.linalg.solve(chain.K + 1j * w * chain.C - w**2 * chain.M, push)
    steep = 1e-3 * abs(w * b @ linear)

    def rate(t, y):
        friction = b * limit * np.tanh(b @ y[n:] / steep)
        return np.concatenate([y[n:], inverse @ (push * np.cos(w * t) - friction - chain.C @ y[n:] - chain.K @ y[:n])])

    T = 2 * np.pi / w
    t = np.linspace(39 * T, 40 * T, 4001)
    got = scipy.integrate.solve_ivp(rate, (0, 40 * T), np.zeros(2 * n), "LSODA", t, rtol=1e-8, atol=1e-12)
    want = (2 / T * scipy.integrate.trapezoid(got.y[0] * np.exp(-1j * w * t), t) - linear[0]) / LEVEL
    setup = Setup(chain, np.array([freq]), "receptance", [0], [0], np.array([LEVEL]), False)
    change, _ = march(setup.plant, setup, [Joint(laws.Coulomb("c", limit), b)])
    assert abs(change[0, 0, 0, 0] - want) < 5e-4 * abs(want)  # measured: 1.1e-4


def test_slider_that_never_slips_is_a_rigid_link(chain):
    setup = Setup(chain, lines(chain), "receptance", [0, 2], [0], np.array([LEVEL]), False)
    change, remarks = march(setup.plant, setup, [Joint(laws.Coulomb("c", 1e6), GROUND)])
    held = setup.plant.add(K=1e12 * np.outer(GROUND, GROUND))
    want = setup.frf(held) - setup.frf(setup.plant)
    # measured: 2.2e-5
    assert np.abs(change[0] - want).max() < 2e-4 * np.abs(want).max()
    assert remarks["unsettled_rows"] == 0


def test_linear_spring_marched_is_the_spring_in_the_matrix(chain):
    setup = Setup(chain, np.linspace(10, 70, 40), "receptance", [0, 1, 2], [0, 2], np.array([1.0, 3.0]), False)
    b = PAIR
    change, _ = march(setup.plant, setup, [Joint(laws.Bilinear("b", 5e3, 5e3), b)])
    want = setup.frf(setup.plant.add(K=5e3 * np.outer(b, b))) - setup.frf(setup.plant)
    # measured: 1.1e-5 at 256 steps a period
    assert np.abs(change - want[None]).max() < 1e-4 * np.abs(want).max()


def test_two_joints_marched_together_are_both_in_the_matrix(chain):
    setup = Setup(chain, np.linspace(10, 70, 20), "receptance", [0], [0], np.array([1.0]), False)
    two = [Joint(laws.Bilinear("b", 5e3, 5e3), PAIR), Joint(laws.Bilinear("b", 2e3, 2e3), GROUND)]
    change, _ = march(setup.plant, setup, two)
    K = 5e3 * np.outer(PAIR, PAIR) + 2e3 * np.outer(GROUND, GROUND)
    want = setup.frf(setup.plant.add(K=K)) - setup.frf(setup.plant)
    assert np.abs(change - want[None]).max() < 2e-4 * np.abs(want).max()  # measured: 3.4e-5


# records, windows and sweeps against time histories ---------------------------------------------------------------


@pytest.fixture(scope="module")
def impulse(chain):
    """Poles, residues, time axis and impulse response of one receptance."""
    setup = Setup(chain, lines(chain), "receptance", [0], [0], np.array([np.nan]), False)
    poles, R = setup.plant.residues(setup.rows, setup.columns)
    dt = 1 / 4096
    t = np.arange(32768) * dt
    h = (R[:, 0, 0, None] * np.exp(poles[:, None] * t)).sum(axis=0).real
    return poles, R, t, h


def transform(h, t, omega):
    return scipy.integrate.trapezoid(h * np.exp(-1j * omega[:, None] * t), t, axis=1)


def test_residues_rebuild_the_matrices(chain, impulse):
    poles, R, _, _ = impulse
    setup = Setup(chain, lines(chain), "accelerance", [0], [0], np.array([np.nan]), False)
    whole = through_kernel(poles, R, setup.omega, 2, lambda s: -1 / s)
    assert np.allclose(whole, setup.frf(setup.plant), rtol=1e-9)


def test_cut_record_and_exponential_window(chain, impulse):
    poles, R, t, h = impulse
    omega, T = 2 * np.pi * lines(chain), 0.25
    cut = t <= T + 1e-9
    got = through_kernel(poles, R, omega, 0, lambda s: truncated_kernel(s, T))[:, 0, 0]
    assert np.allclose(got, transform(h[cut], t[cut], omega), rtol=1e-3)  # measured 1.8e-4: the quadrature
    setup = Setup(chain, lines(chain), "receptance", [0], [0], np.array([np.nan]), False)
    shifted = setup.plant.receptance(1j * omega + 8.0, setup.rows, setup.columns)[:, 0, 0]
    assert np.allclose(shifted, transform(h * np.exp(-8.0 * t), t, omega), rtol=1e-3)


@pytest.mark.parametrize("rate", [600.0, -600.0])
def test_sweep_is_the_demodulated_answer_of_a_chirp(chain, impulse, rate):
    poles, R, t, h = impulse
    omega = 2 * np.pi * lines(chain)
    want = transform(h * np.exp(0.5j * rate * t**2), t, omega)
    got = through_kernel(poles, R, omega, 0, lambda s: sweep_kernel(s, rate))[:, 0, 0]
    assert np.allclose(got, want, rtol=1e-3)  # measured 2.2e-4
    assert np.abs(got - transform(h, t, omega)).max() > 0.05 * np.abs(got).max()


@pytest.mark.parametrize("window", ["hann", "boxcar"])
def test_mean_h1_of_finite_records(impulse, window):
    """Welch on 4,000 records of white force agrees with the exact mean within its own scatter."""
    poles, R, t, h = impulse
    dt, N = t[1] * 8, 128
    h = h[::8] * dt
    rng = np.random.default_rng(0)
    force = rng.normal(size=N * 4000)
    response = scipy.signal.fftconvolve(force, h)[: force.size]
    kind = scipy.signal.get_window("hann" if window == "hann" else "boxcar", N)
    options = dict(window=kind, nperseg=N, noverlap=0, detrend=False, fs=1 / dt)
    f, cross = scipy.signal.csd(force, response, **options)
    _, auto = scipy.signal.welch(force, **options)
    kernel = {"hann": hann_kernel, "boxcar": boxcar_kernel}[window]
    inside = slice(4, 20)
    omega = 2 * np.pi * f[inside]
    got = through_kernel(poles, R, omega, 0, lambda s: kernel(s, N * dt))[:, 0, 0]
    linear = through_kernel(poles, R, omega, 0, lambda s: -1 / s)[:, 0, 0]
    H1 = (cross / auto)[inside]
    effect = np.linalg.norm(got - linear)
    assert effect > 0.2 * np.linalg.norm(linear)
    # scatter of H1: about 1/sqrt(4000) of the response that leaks; measured 0.04 and 0.06 of the effect
    assert np.linalg.norm(H1 - got) < 0.1 * effect


def test_hum_line_is_that_of_the_transform():
    n = np.arange(512)
    window = 1 - np.cos(2 * np.pi * n / 512)
    for x in (0.0, 0.3, -0.7, 1.2):
        tone = np.exp(2j * np.pi * (100 - x) * n / 512)
        assert np.mean(window * tone * np.exp(-2j * np.pi * 100 * n / 512)) == pytest.approx(
            complex(hann_line(x)), abs=1e-10
        )


@pytest.mark.parametrize("family", generator.FAMILIES)
def test_structures_are_sound(family):
    kinds = set()
    for seed in range(25):
        system = draw_system(np.random.default_rng(seed), family)
        kinds.add(system.kind)
        assert 4 <= system.n <= 40
        assert np.linalg.eigvalsh(system.M).min() > 0 and np.linalg.eigvalsh(system.K).min() > 0
        omega, zeta, _ = system.modes()
        first = 2 * np.pi * elastic_frequencies(system)[0]
        low = zeta[(omega > 0.99 * first) & (omega < 5 * first)]
        assert 0.001 < low.min() and low.max() < 0.15
        assert all(0 <= a < system.n and -1 <= b < system.n and a != b and k >= 0 for a, b, k in system.places)
    assert len(kinds) >= (1 if family == "review" else 2)
