"""Each kind of study once, small: its rows against a second route to them."""

import jax
import numpy as np
import pytest

from modalax.data import Measurement
from modalax.files import save
from modalax.identify import fit, lscf, select_near
from modalax.model import Structure
from modalax.model.examples import five_dof
from modalax.simulate.joints import CubicSpring
from modalax.study import study, summary
from modalax.study.bootstrap import prepare
from modalax.study.fits import matched
from modalax.study.power import judged, with_effect
from modalax.study.settings import checked
from modalax.study.system import response
from modalax.study.work import Quantity, Work, draws_of

SYSTEM = {"simulation": "five_dof", "band": [20, 70], "step": 0.5, "noise": 0.002, "inputs": ["1"]}
TRUE_HZ = np.array([26.06, 36.84, 51.47, 56.21, 62.60])


def run(tmp_path, **settings):
    return study(settings, tmp_path / "out", workers=0)


def drawn(seed: int, index: int):
    """The FRFs of one draw, by the public route."""
    clean = response(five_dof(), checked({"kind": "noise", "draws": 1, "system": SYSTEM})["system"]).frf
    return clean.add_noise(jax.random.fold_in(jax.random.key(seed), index), SYSTEM["noise"])


def noisy(seed: int, index: int):
    """The FRFs of one draw of a study without refinement."""
    clean = response(five_dof(), checked({"kind": "noise", "draws": 1, "system": SYSTEM})["system"]).frf
    sigma = np.sqrt(np.asarray(clean.add_noise(jax.random.key(0), SYSTEM["noise"]).variance) / 2)
    real, imag = draws_of(seed, index).standard_normal((2, clean.H[0].size, len(clean.freq)))
    return clean.replace(H=clean.H + sigma * (real + 1j * imag).T.reshape(clean.H.shape))


def test_many_diagrams_at_once_are_those_of_each_alone(tmp_path):
    found = run(tmp_path, kind="noise", draws=5, seed=4, chunk=3, system=SYSTEM, fit={"refine": False, "order": 16})
    assert found.columns["item"].tolist() == list(range(5))
    for k in (0, 4):
        alone = select_near(lscf(noisy(4, k), tuple(range(2, 17))), TRUE_HZ)
        f = np.array([found.columns[f"frequency_hz_{r}"][k] for r in range(1, 6)])
        zeta = np.array([found.columns[f"damping_ratio_{r}"][k] for r in range(1, 6)])
        poles = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
        # The same table; the two may take another order of it where the pole hardly changes.
        assert np.abs(poles / np.asarray(alone.poles) - 1).max() < 1e-3  # 2e-4 measured
    assert found.summary["failed"] == 0


def test_noise_study_with_standard_deviations(tmp_path):
    found = run(tmp_path, kind="noise", draws=1, seed=1, system=SYSTEM)
    alone = fit(drawn(1, 0)).to_dict()["modes"]
    assert [m["frequency_hz"] for m in alone] == [found.columns[f"frequency_hz_{r}"][0] for r in range(1, 6)]
    assert [m["damping_ratio_std"] for m in alone] == [found.columns[f"damping_ratio_std_{r}"][0] for r in range(1, 6)]
    (group,) = found.summary["groups"]
    truths = [q["truth"] for q in group["quantities"] if q["name"].startswith("frequency")]
    assert np.allclose(truths, TRUE_HZ, rtol=1e-9)
    assert all(q["coverage"] is not None for q in group["quantities"])


def test_a_draw_that_fails_is_a_row_with_its_reason(tmp_path):
    quiet = {**SYSTEM, "band": [20, 30], "step": 2.0}
    found = run(tmp_path, kind="noise", draws=2, system=quiet, fit={"order": 40})
    assert found.columns["failed"].tolist() == [True, True]
    assert "order 40 needs" in found.columns["reason"][0]
    assert found.summary["failed"] == 2


def repeats(runs: int) -> Measurement:
    return Measurement.from_frfs([drawn(9, k).replace(level=1.0) for k in range(runs)])


def test_bootstrap_of_repeats(tmp_path, monkeypatch):
    """Seen without fits: each draw is the mean of as many repeats as there are, drawn with replacement."""
    measured = repeats(4)
    save(measured, tmp_path / "repeats.npz")
    monkeypatch.chdir(tmp_path)
    seen = []
    monkeypatch.setattr("modalax.study.bootstrap.fit_row", lambda frf, *_: seen.append(frf) or {"n": 1})
    run(tmp_path, kind="bootstrap", draws=6, seed=2, data={"file": "repeats.npz"}, fit={"refine": False})
    H = np.asarray(measured.H)
    for frf in seen:
        weights, left, *_ = np.linalg.lstsq(H.reshape(4, -1).T, np.asarray(frf.H).ravel(), rcond=None)
        assert np.allclose(4 * weights.real, np.round(4 * weights.real), atol=1e-8)
        assert np.isclose(weights.sum(), 1)
        assert np.sum(np.abs(left)) < 1e-20
    assert len({tuple(np.round(np.asarray(frf.H)[3, :, 0], 12)) for frf in seen}) > 1


def test_bootstrap_of_one_run_scatters_as_its_variance_says(tmp_path, monkeypatch):
    save(Measurement.from_frfs([drawn(9, 0)]), tmp_path / "one.npz")
    monkeypatch.chdir(tmp_path)
    seen = []
    monkeypatch.setattr("modalax.study.bootstrap.fit_row", lambda frf, *_: seen.append(frf) or {"n": 1})
    run(tmp_path, kind="bootstrap", draws=40, data={"file": "one.npz"}, fit={"refine": False})
    H = np.stack([np.asarray(frf.H) for frf in seen])
    power = np.mean(np.abs(H - H.mean(axis=0)) ** 2)
    stated = float(np.mean(np.asarray(seen[0].variance)))
    assert power * 40 / 39 == pytest.approx(stated, rel=5 / np.sqrt(40 * seen[0].H.size))
    settings = checked({"kind": "bootstrap", "draws": 1, "data": {"file": "one.npz"}, "fit": {"refine": False}})
    truths = [q.truth for q in prepare(settings, tmp_path).quantities if q.column.startswith("frequency")]
    assert np.allclose(truths, TRUE_HZ, rtol=2e-3)


def test_bootstrap_needs_something_to_draw_from(tmp_path, monkeypatch):
    frf = drawn(9, 0)
    save(Measurement.from_frfs([frf.replace(variance=None)]), tmp_path / "bare.npz")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"bare.npz holds neither 3 runs .* nor a noise variance"):
        run(tmp_path, kind="bootstrap", draws=1, data={"file": "bare.npz"}, fit={"refine": False})
    with pytest.raises(ValueError, match="resample is runs, but the file has 1 runs"):
        run(tmp_path, kind="bootstrap", draws=1, data={"file": "bare.npz", "resample": "runs"})


def test_parameter_study_goes_through_every_combination(tmp_path):
    vary = {"system.noise": [0.0, 0.002], "fit.order": [14, 16]}
    fit_of = {"refine": False, "method": "lscf"}
    # chunks as long as those of the many diagrams, whose program is that of order 16
    found = run(tmp_path, kind="parameter", draws=3, chunk=3, system=SYSTEM, fit=fit_of, vary=vary)
    assert found.columns["item"].tolist() == list(range(12))
    assert found.columns["system.noise"].tolist() == [0.0] * 6 + [0.002] * 6
    assert found.columns["fit.order"].tolist() == [14, 14, 14, 16, 16, 16] * 2
    groups = found.summary["groups"]
    assert [g["where"] for g in groups] == [{"system.noise": n, "fit.order": o} for n in vary["system.noise"]
                                            for o in vary["fit.order"]]  # fmt: skip
    first = {q["name"]: q for q in groups[0]["quantities"]}["frequency_hz_2"]
    assert first["std"] == 0.0
    assert abs(first["bias"]) < 1e-3
    noisy = {q["name"]: q for q in groups[2]["quantities"]}["frequency_hz_2"]
    assert noisy["std"] > 0


def test_a_parameter_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ValueError, match="'system.nois', which is not known; known are system.simulation"):
        run(tmp_path, kind="parameter", draws=1, system=SYSTEM, vary={"system.nois": [1]})
    with pytest.raises(ValueError, match=r"'fit.order' is 3; it needs a list"):
        run(tmp_path, kind="parameter", draws=1, system=SYSTEM, vary={"fit.order": 3})


def test_diagnosis_study(tmp_path):
    hidden = {"cause": "added_mass", "where": ["3"], "sizes": [0.1]}
    found = run(
        tmp_path, kind="diagnosis", draws=1, system=SYSTEM, hidden=hidden, diagnose={"causes": ["added_mass"]}
    )  # fmt: skip
    assert found.columns["size"].tolist() == [0.1]
    assert found.columns["verdict"].tolist() == ["named"]
    assert found.columns["right"].tolist() == [True]
    assert abs(found.columns["value"][0] - 0.1) < 5 * found.columns["std"][0]


MASS = {"name": "added_mass", "where": ["3"], "probability": 0.9, "parameters": {"mass": {"value": 0.1, "std": 0.01}}}
OTHER = {"name": "added_mass", "where": ["2"], "probability": 0.5, "parameters": {"mass": {"value": 0.2, "std": None}}}


@pytest.mark.parametrize(
    ("verdict", "causes", "alternatives", "size", "right", "found"),
    [
        ("clean", [], [], 0.0, True, False),
        ("named", [MASS], [], 0.0, False, True),
        ("clean", [], [], 0.1, False, False),
        ("named", [MASS], [], 0.1, True, True),
        ("named", [OTHER], [], 0.1, False, False),
        ("named", [MASS, OTHER], [], 0.1, False, True),
        ("ambiguous", [OTHER], [[MASS]], 0.1, False, True),
        ("ambiguous", [MASS], [[OTHER]], 0.1, False, True),
        ("unknown", [], [], 0.1, False, False),
    ],
)
def test_what_counts_as_a_right_diagnosis(verdict, causes, alternatives, size, right, found):
    answer = {"verdict": verdict, "causes": causes, "alternatives": alternatives}
    row = judged(answer, {"cause": "added_mass", "where": ["3"]}, size)
    assert (row["right"], row["found"]) == (right, found)
    assert np.isnan(row["value"]) == (MASS not in causes)


def by_matrices(change) -> np.ndarray:
    s = five_dof()
    M, C, K = change(np.array(s.M), np.array(s.C), np.array(s.K))
    return np.asarray(Structure(M, C, K, s.dofs).frf(20 + 0.5 * np.arange(101), inputs=["1"]).H)


e = np.eye(5)
LINEAR = by_matrices(lambda M, C, K: (M, C, K))
ROW = np.ones((1, 5, 1))
ROW[0, 2] = 1.1
TURN = np.exp(-2j * np.pi * (20 + 0.5 * np.arange(101)) * 1e-4)[:, None, None]


@pytest.mark.parametrize(
    ("cause", "where", "size", "fixed", "expected"),
    [
        ("added_mass", ["3"], 0.1, None, by_matrices(lambda M, C, K: (M + 0.1 * np.outer(e[2], e[2]), C, K))),
        ("local_damper", ["2"], 3.0, None, by_matrices(lambda M, C, K: (M, C + 3 * np.outer(e[1], e[1]), K))),
        ("joint_stiffness", ["2", "4"], 1e3, None,
         by_matrices(lambda M, C, K: (M, C, K + 1e3 * np.outer(e[1] - e[3], e[1] - e[3])))),
        ("channel_gain", ["3"], 0.1, None, LINEAR * ROW),
        ("channel_sign", ["1"], 1.0, None, LINEAR * np.array([-1, 1, 1, 1, 1])[None, :, None]),
        ("channel_swap", ["1", "5"], 1.0, None, LINEAR[:, [4, 1, 2, 3, 0]]),
        ("time_delay", [], 1e-4, None, LINEAR * TURN),
        # in the limit of a small mass an oscillator is a mass on a stiff spring
        ("tuned_mass", ["3"], 0.1, {"frequency_hz": 1e6, "damping_ratio": 0.01},
         by_matrices(lambda M, C, K: (M + 0.1 * np.outer(e[2], e[2]), C, K))),
    ],
)  # fmt: skip
def test_hidden_effects_by_a_second_route(cause, where, size, fixed, expected):
    system = checked({"kind": "noise", "draws": 1, "system": SYSTEM})["system"]
    hidden = {"cause": cause, "where": where, "fixed": fixed, "parameter": None}
    H = np.asarray(with_effect(five_dof(), system, hidden, size).H)[0]
    assert np.abs(H - expected).max() < 1e-8 * np.abs(expected).max()


def test_a_hidden_joint_is_handed_to_the_simulation(monkeypatch):
    system = checked({"kind": "noise", "draws": 1, "system": {**SYSTEM, "force": [1.0]}})["system"]
    seen = []
    monkeypatch.setattr("modalax.study.power.response", lambda structure, system, joints=(): seen.extend(joints))
    hidden = {"cause": "cubic_stiffness", "where": ["3", "5"], "fixed": None, "parameter": None}
    with_effect(five_dof(), system, hidden, 1e9)
    [(law, where)] = seen
    assert isinstance(law, CubicSpring)
    assert float(law.k3) == 1e9
    assert where == ("3", "5")
    with pytest.raises(ValueError, match="cause is 'gremlin'; effects that can be hidden are added_mass"):
        with_effect(five_dof(), system, {**hidden, "cause": "gremlin"}, 1.0)
    with pytest.raises(ValueError, match="joints, whose response depends on the force, but no force"):
        response(five_dof(), {**system, "force": None}, [(law, where)])


def test_a_function_under_vmap_is_the_function_itself(tmp_path):
    found = run(tmp_path, kind="function", draws=5, chunk=2, seed=7, function=two_numbers, vmap=True)
    for k in range(5):
        expected = two_numbers(jax.random.fold_in(jax.random.key(7), k))
        assert found.columns["sum"][k] == pytest.approx(float(expected["sum"]), rel=1e-12)
        assert found.columns["pair_2"][k] == pytest.approx(float(expected["pair"][1]), rel=1e-12)


@pytest.mark.parametrize("vmap", [False, True])
def test_a_function_that_asks_for_the_number_of_the_draw_gets_it(tmp_path, vmap):
    """Such as which of some files is its own."""
    found = run(tmp_path, kind="function", draws=5, chunk=2, function=tenfold, vmap=vmap)
    assert found.columns["value"].tolist() == [0, 10, 20, 30, 40]
    given = {"kind": "function", "draws": 2, "function": tenfold, "parameters": {"number": 7}}
    assert run(tmp_path / "given", **given).columns["value"].tolist() == [70, 70]


def tenfold(seed, number):
    return 10 * number


def two_numbers(key):
    x = jax.random.normal(key, (2,))
    return {"sum": x.sum(), "pair": x}


def test_statistics_by_hand():
    columns = {
        "item": np.arange(5), "x": np.array([1.0, 2.0, 3.0, np.nan, 100.0]), "s": np.array([2.0, 0.2, 0.4, 1.0, 1.0]),
        "failed": np.array([False, False, False, False, True]), "reason": np.array(["", "", "", "", "no mode"]),
    }  # fmt: skip
    told = summary(columns, Work(5, 1, 0, quantities=[Quantity("x", "s", 2.5)]))
    (group,) = told["groups"]
    (q,) = group["quantities"]
    assert (q["draws"], q["missing"], q["mean"], q["std"], q["bias"]) == (3, 1, 2.0, 1.0, -0.5)
    assert q["bias_std"] == pytest.approx(1 / np.sqrt(3))
    assert q["coverage"] == pytest.approx(2 / 3)  # 1 +- 3.9 and 3 +- 0.78 hold 2.5, 2 +- 0.39 does not
    assert told["reasons"] == {"no mode": 1}


def test_modes_belong_to_the_nearest_once_each():
    true = np.array([-1 + 100j, -1 + 101j, -1 + 300j])
    found = np.array([-1 + 100.9j, -1 + 100.2j, -1 + 200j])
    assert matched(true, found).tolist() == [1, 0, -1]
    assert matched(true, np.zeros(0, complex)).tolist() == [-1, -1, -1]
