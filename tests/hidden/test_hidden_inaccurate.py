"""The generator of simulations that are off everywhere keeps what it says."""

import ast
import json
import sys
from pathlib import Path

import inaccurate
import numpy as np
import pytest
import scipy.linalg
from generator.effect import Setup
from generator.laws import Bilinear, Cubic, Jenkins
from generator.march import Joint, march
from generator.plant import Plant
from generator.systems import System, beam
from inaccurate.balance import joint_change
from inaccurate.case import answer, linear_frf
from inaccurate.structures import SMALL as FEW_DOFS
from inaccurate.structures import Build, Element, _condensed, draw_build, modes, plate_element, spring
from inaccurate.world import Spread, draw_off, modal_inaccuracy, nominal, realised

from modalax.files import load

HERE = Path(inaccurate.__file__).parent


def assembled(elements: list[Element], n: int) -> Build:
    return Build([str(k) for k in range(n)], elements, list(range(0, n, 3)), "frame", "test", 0)


def straight(count: int, length: float, EI: float, line: float) -> Build:
    """A uniform beam in its three DoFs a node, torsion held."""
    elements = []
    for k in range(count):
        m, K = beam(np.array([length / count, 0.0]), EI, 1.0, line)
        bend = np.array([0, 2, 3, 5])
        at = 2 * k + np.arange(4)
        elements.append(Element("beam", at, K[np.ix_(bend, bend)], m[np.ix_(bend, bend)]))
    return assembled(elements, 2 * count + 2)


def plates(rows: int, columns: int, a: float, b: float) -> Build:
    """A uniform plate of ``rows`` by ``columns`` elements, D = 1, nu = 0.3, unit mass a surface."""
    elements, wide = [], columns + 1
    m, k = plate_element(a / columns, b / rows, 1.0, 0.3, 1.0)
    for r in range(rows):
        for c in range(columns):
            corners = [r * wide + c, r * wide + c + 1, (r + 1) * wide + c + 1, (r + 1) * wide + c]
            elements.append(Element("plate", np.concatenate([3 * q + np.arange(3) for q in corners]), k, m))
    return assembled(elements, 3 * wide * (rows + 1))


def test_imports_nothing_but_numpy_scipy_and_the_other_generator():
    roots = set()
    for file in HERE.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                roots |= {a.name.split(".")[0] for a in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                roots.add(str(node.module).split(".")[0])
    assert roots - set(sys.stdlib_module_names) == {"numpy", "scipy", "generator"}


def test_a_uniform_beam_has_the_textbook_frequencies():
    """Free-free Euler-Bernoulli: beta L = 4.7300, 7.8532, 10.9956; clamped: 1.8751, 4.6941."""
    build = straight(16, 2.0, 30.0, 0.7)
    omega = modes(*build.assemble())[0]
    unit = np.sqrt(30.0 / 0.7) / 2.0**2
    assert (omega[:2] == 0).all()
    assert omega[2:5] == pytest.approx(unit * np.array([4.730041, 7.853205, 10.995608]) ** 2, rel=1e-3)
    M, K = (A[2:, 2:] for A in build.assemble())
    assert modes(M, K)[0][:2] == pytest.approx(unit * np.array([1.875104, 4.694091]) ** 2, rel=1e-4)


def test_a_plate_on_simple_supports_has_the_textbook_frequencies():
    """omega = pi^2 (p^2/a^2 + q^2/b^2) sqrt(D/rho h); the element comes from below, by some per cent at this grid."""
    build, a, b = plates(6, 8, 1.2, 0.9), 1.2, 0.9
    M, K = build.assemble()
    wide = 9
    edge = [3 * (r * wide + c) for r in range(7) for c in range(9) if r in (0, 6) or c in (0, 8)]
    keep = np.setdiff1d(np.arange(build.n), edge)
    omega = modes(M[np.ix_(keep, keep)], K[np.ix_(keep, keep)])[0][:3]
    aim = np.pi**2 * np.array([p**2 / a**2 + q**2 / b**2 for p, q in ((1, 1), (2, 1), (1, 2))])
    assert (omega < aim).all() and omega == pytest.approx(aim, rel=0.03)
    assert (modes(M, K)[0] == 0).sum() == 3  # free: up and down, and two tilts


@pytest.mark.parametrize("kind", [*inaccurate.KINDS, FEW_DOFS])
def test_structures_are_whole_and_unlike(kind):
    seen = set()
    fewest, most = (6, 12) if kind == FEW_DOFS else (20, 60)
    for seed in range(10):
        build = draw_build(np.random.default_rng(seed), kind)
        M, K = build.assemble()
        omega = modes(M, K)[0]
        assert fewest <= build.n <= most and build.springs and len(set(build.dofs)) == build.n
        assert np.linalg.eigvalsh(M).min() > 0
        assert (omega == 0).sum() == (build.rigid if build.variant.endswith("free") else 0)
        assert 5 <= omega[build.rigid] / 2 / np.pi <= 60 + 1e-9
        seen.add((build.variant, build.n))
    assert len(seen) > 6


def test_condensed_plate_keeps_its_static_deflections():
    """Guyan reduction is exact for loads on what is kept: a plate held at three corners under a point load."""
    build = plates(3, 4, 0.8, 0.6)
    small = _condensed(build)
    whole, reduced = (
        np.linalg.inv(b.assemble()[1] + 1e3 * np.diag(np.isin(np.arange(b.n), held).astype(float)))
        for b, held in ((build, (0, 12, 45)), (small, (0, 4, 15)))
    )
    z = build.deflections
    assert np.allclose(whole[np.ix_(z, z)], reduced, rtol=1e-8)


def test_every_element_is_off_by_itself_and_the_modes_follow():
    rng = np.random.default_rng(3)
    build = draw_build(rng, "shaft")
    design = nominal(build, rng)
    spread = Spread(0.02, 0.02 / 3, 0.2)
    inside = np.arange(build.n) < 8
    drawn, first = [], []
    for k in range(60):
        off = draw_off(build, np.random.default_rng(k), spread)
        true = realised(build, design, off)
        change = modal_inaccuracy(build, design, true, spread, inside)
        first.append((true.frequencies / design.frequencies - 1)[inside][-1])
        drawn.append(change["stiffness"]["drawn"])
        for j, e in enumerate(build.elements):
            if e.kind == "spring" and len(e.where) == 2 and k == 0:
                a, b = e.where
                assert true.K[a, b] == pytest.approx(design.K[a, b] * np.exp(off.stiffness[j]))
    assert np.sqrt(np.mean(np.square(drawn))) == pytest.approx(change["stiffness"]["expected"], rel=0.25)
    parts = [change[w]["expected"] for w in ("stiffness", "mass")]
    assert np.std(first) == pytest.approx(np.hypot(*parts) / 2, rel=0.6)  # of all modes against the last one's
    assert np.log(true.zeta / design.zeta).std() == pytest.approx(0.2, rel=0.5)


# joints ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law", [Cubic("cubic_stiffness", 2e9), Jenkins("elasto_slip", 8e3, 1.0, 8e3), Bilinear("spring", 3e3, 3e3)]
)
def test_harmonic_balance_agrees_with_marching_in_time(law):
    n = 3
    K = 4e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    M = np.diag([1.0, 1.5, 0.8])
    chain = System(M, 2e-4 * K + 2.0 * M, K, ["1", "2", "3"], [], "masses", "chain", "local")
    freq, level, b = np.array([14.0, 17.5, 19.0, 33.0]), np.array([2.0, 8.0]), np.array([1.0, -1.0, 0.0])
    plant = Plant(chain.M, chain.C, chain.K)
    change, lost = joint_change(plant, b, law, freq, [0, 2], [1], level)
    marched, _ = march(plant, Setup(chain, freq, "receptance", [0, 2], [1], level, False), [Joint(law, b)])
    assert lost == 0
    # odd harmonics to the 23rd against all; a slider's corner is the worst
    assert np.abs(change - marched).max() < (1e-3 if isinstance(law, Jenkins) else 1e-4) * np.abs(marched).max()
    if isinstance(law, Bilinear):
        stiff = plant.add(K=3e3 * np.outer(b, b))
        s, eye = 2j * np.pi * freq, np.eye(n)
        rest = stiff.receptance(s, eye[[0, 2]], eye[[1]]) - plant.receptance(s, eye[[0, 2]], eye[[1]])
        assert np.abs(change - rest[None]).max() < 1e-6 * np.abs(rest).max()


# cases ----------------------------------------------------------------------------------------------------------------

SMALL = {"spread": 0.01, "lines": 2.0, "widen": 1.0}


@pytest.mark.parametrize(
    "cause",
    [
        # of joints a spring by default
        pytest.param(c, marks=pytest.mark.slow if c == "elasto_slip" else ())
        for c in inaccurate.CAUSES if c not in ("gap", "quadratic_damping")
    ],
)  # fmt: skip
def test_a_case_holds_its_one_gross_error(cause, monkeypatch):
    monkeypatch.setattr(inaccurate.case, "MOST_LINES", 150)
    case = inaccurate.draw_case(5, cause, kind="shaft", **SMALL)
    assert len(case.truth["causes"]) == (cause != "none")
    slug = "joint_stiffness" if cause == "beam_stiffness" else cause
    assert [c["name"] for c in case.truth["causes"]] == ([slug] if cause != "none" else [])
    outputs = [case.build.dofs[o] for o in case.test.outputs]
    assert list(case.measurement["outputs"]) == outputs and 6 <= len(outputs) <= 20
    straightforward = linear_frf(case.world, case.test)  # of the structure with a gross error of its own matrices
    off = np.abs(case.H_true - straightforward).max(axis=(1, 2, 3)) / np.abs(straightforward).max()
    acts_elsewhere = cause in inaccurate.gross.CHANNELS or cause in inaccurate.gross.JOINTS
    assert (off > 1e-3).any() == acts_elsewhere
    error = (case.measurement["H"] - case.H_true) / case.sigma
    assert np.mean(np.abs(error) ** 2) == pytest.approx(1.0, abs=5 / np.sqrt(error.size))


@pytest.mark.parametrize("cause", ["joint_stiffness", "added_mass"])
def test_where_damping_follows_the_modes_with_the_gross_error_keep_their_ratios(cause):
    kept, follows = (inaccurate.draw_case(5, cause, kind="shaft", damping_follows=x, **SMALL) for x in (False, True))
    assert np.array_equal(kept.world.K, follows.world.K) and np.array_equal(kept.world.M, follows.world.M)
    w2, P = scipy.linalg.eigh(follows.world.K, follows.world.M)
    elastic = np.arange(len(w2)) >= follows.build.rigid
    ratios = [np.diag(P.T @ w.C @ P)[elastic] / 2 / np.sqrt(w2[elastic]) for w in (kept.world, follows.world)]
    assert np.allclose(ratios[1], follows.world.zeta[elastic], rtol=1e-6)
    assert np.abs(ratios[0] / ratios[1] - 1).max() > 1e-3


def test_frf_is_the_direct_solution():
    case = inaccurate.draw_case(2, "none", kind="plate", **SMALL)
    w, f = case.world, 17
    s = 2j * np.pi * case.test.freq[f]
    direct = np.linalg.inv(w.K + s * w.C + s**2 * w.M)[np.ix_(case.test.outputs, case.test.inputs)]
    direct = direct * s ** {"receptance": 0, "mobility": 1, "accelerance": 2}[case.test.form]
    assert np.allclose(case.H_true[:, f], direct[None], rtol=1e-9)


def test_an_exact_simulation_without_a_gross_error_is_the_truth(tmp_path):
    case = inaccurate.draw_case(8, "none", spread=0.0, lines=2.0, widen=1.0, claim="right")
    case.save(tmp_path / "case", tmp_path / "truth.json")
    simulation, measurement = load(tmp_path / "case" / "simulation.npz"), load(tmp_path / "case" / "measurement.npz")
    assert set(measurement.outputs) <= set(simulation.dofs)
    assert np.allclose(case.simulation["K"], case.world.K) and "stiffness_std" not in case.simulation
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["causes"] == [] and truth["inaccuracy"]["stiffness"]["drawn"] < 1e-9


@pytest.mark.parametrize(("claim", "factor"), [("right", 1.0), ("half", 0.5), ("double", 2.0), ("none", None)])
def test_claims_are_right_or_off_by_two(claim, factor):
    by_matrices = inaccurate.draw_case(3, "none", kind="shaft", claim=claim, claimed="matrices", **SMALL).simulation
    by_modes = inaccurate.draw_case(3, "none", kind="shaft", claim=claim, claimed="modes", **SMALL)
    if factor is None:
        assert not {k for k in (*by_matrices, *by_modes.simulation) if k.endswith("_std")}
        return
    assert by_matrices["stiffness_std"] == pytest.approx(0.01 * factor)
    assert by_matrices["mass_std"] == pytest.approx(0.01 / 3 * factor)
    expected = by_modes.truth["inaccuracy"]
    modal = np.hypot(expected["stiffness"]["expected"], expected["mass"]["expected"]) / 2
    assert by_modes.simulation["frequency_std"] == pytest.approx(factor * modal)


def test_the_same_test_measured_more_finely_and_widely():
    coarse, fine = (
        inaccurate.draw_case(11, "added_mass", kind="frame", spread=0.01, lines=x, widen=w)
        for x, w in ((2.0, 1.0), (8.0, 1.5))
    )
    assert coarse.truth["causes"] == fine.truth["causes"] and np.array_equal(coarse.world.K, fine.world.K)
    assert coarse.test.outputs == fine.test.outputs and coarse.test.inputs == fine.test.inputs
    assert fine.test.freq[-1] > 1.3 * coarse.test.freq[-1]
    assert np.diff(fine.test.freq).min() < 0.5 * np.diff(coarse.test.freq).min()
    assert len(fine.test.freq) > len(coarse.test.freq)


# the perfect namer ----------------------------------------------------------------------------------------------------


def test_the_distance_of_a_small_error_is_that_of_the_full_covariance():
    """Against dense algebra on finite differences: one spring a little off, all elements uncertain."""
    case = inaccurate.draw_case(4, "joint_stiffness", kind="shaft", lines=2.0, widen=1.0, spread=0.01)
    weight = (np.sqrt(2) / case.sigma).reshape(len(case.test.level), *case.H_true.shape[1:])
    spread = case.truth["inaccuracy"]["damping"]["element"]
    base = linear_frf(case.world, case.test)
    build, world, step, columns = case.build, case.world, 1e-6, []

    def slope(M=0.0, C=0.0, K=0.0):
        change = (linear_frf(world.changed(M, C, K), case.test) - linear_frf(world.changed(-M, -C, -K), case.test)) / 2
        whole = (weight * change[None] / step).ravel()
        return np.concatenate([whole.real, whole.imag])

    def on(e, part):
        A = np.zeros((build.n, build.n))
        A[np.ix_(e.at, e.at)] = step * part
        return A

    for e in build.elements:
        columns += [0.01 * slope(K=on(e, e.k))] if e.k.any() else []
        columns += [0.01 / 3 * slope(M=on(e, e.m))] if e.m.any() else []
    hidden = case.truth["causes"][0]
    at = tuple(build.dofs.index(name) for name in hidden["where"])
    k = hidden["parameters"]["stiffness"]["value"]
    effect = slope(K=on(spring(at, 1.0), k * np.outer(b := build.direction(at)[list(at)], b)))
    J = np.stack(columns, axis=1)
    inner = J.T @ effect
    without_damping = np.sqrt(effect @ effect - inner @ np.linalg.solve(np.eye(J.shape[1]) + J.T @ J, inner))
    assert base.shape == case.H_true.shape[1:] and spread > 0
    # uncertain damping can only hide a little more
    assert 0.8 * without_damping < case.truth["d"] < without_damping * (1 + 1e-4)


def test_a_perfect_namer_is_blind_below_the_general_spread_and_sure_beyond():
    small, large = (
        inaccurate.draw_case(seed, "joint_stiffness", kind="shaft", spread=s, lines=2.0, widen=1.0).truth
        for seed, s in ((4, 0.03), (4, 0.0))
    )
    assert small["d"] < large["d"] and small["perfect_right"] <= large["perfect_right"]
    none = inaccurate.draw_case(4, "none", kind="shaft", spread=0.03, lines=2.0, widen=1.0).truth
    assert none["perfect_right"] > 0.98 and none["d"] == 0.0
    hopeless = inaccurate.draw_case(4, "joint_stiffness", kind="shaft", spread=0.5, lines=2.0, widen=1.0).truth
    assert hopeless["d"] < 2 and hopeless["perfect_right"] < 0.5


def test_what_is_asked_is_checked():
    with pytest.raises(ValueError, match="rust"):
        inaccurate.draw_case(1, "rust")
    with pytest.raises(ValueError, match="boat"):
        inaccurate.draw_case(1, "none", kind="boat")
    one, two = (inaccurate.draw_case(7, "added_mass", **SMALL) for _ in range(2))
    assert np.array_equal(one.measurement["H"], two.measurement["H"]) and one.truth == two.truth
    assert np.array_equal(answer(one.world, one.test, None)[0], one.H_true)
