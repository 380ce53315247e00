"""The command line from data to pictures: fit and demo, as a user runs them."""

import json
import re
from functools import partial

import jax
import numpy as np
import pytest

import modalax
from modalax.cli import main, virtual
from modalax.cli.virtual import FREQ, LEVELS, hidden_joint, random_effect, virtual_test
from modalax.data import Geometry, Measurement
from modalax.diagnose.causes import catalogue
from modalax.files import save
from modalax.model import Structure
from modalax.model.examples import five_dof


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path_factory):
    """Compiled programs of a test run do not go to the user's cache."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.mark.slow
def test_fit_writes_what_it_says(tmp_path, capsys):
    """Two runs; the second is fitted: five modes, each true value within four standard deviations."""
    structure = five_dof()
    frf = structure.frf(np.arange(200, 701) / 10, inputs=["1"])
    runs = [frf.add_noise(jax.random.key(k), 0.05) for k in range(2)]
    save(Measurement.from_frfs(runs), tmp_path / "two.npz")
    names = {name: tmp_path / name for name in ("f.json", "f.html", "pictures")}
    arguments = ["fit", str(tmp_path / "two.npz"), "--run", "2", "--band", "21", "69", "--json", str(names["f.json"])]
    assert main([*arguments, "--report", str(names["f.html"]), "--out", str(names["pictures"])]) == 0
    printed = capsys.readouterr()
    assert "Frequency" in printed.out and "unexplained" in printed.out
    answer = json.loads(names["f.json"].read_text())
    assert answer["band_hz"] == [21.0, 69.0]
    truth = structure.modal()
    for mode, f, zeta in zip(answer["modes"], truth.frequency_hz, truth.damping_ratio, strict=True):
        assert abs(mode["frequency_hz"] - f) < 4 * mode["frequency_std_hz"]
        assert abs(mode["damping_ratio"] - zeta) < 4 * mode["damping_ratio_std"]
        assert 0.5 < mode["grade"] <= 1 and f"{mode['grade']:.2f}" in printed.out
        assert len(mode["shape"]) == 5 and set(map(len, mode["shape"])) == {2}
    assert "21 to 69 Hz" in names["f.html"].read_text()
    written = {p.name for p in names["pictures"].iterdir()}
    assert written == {"stabilization.png", "modes.png", "frf.png", "frfs.png", "auto_mac.png"}
    # A second time, nothing is replaced.
    assert main([*arguments, "--report", str(names["f.html"])]) == 2
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["with", pytest.param("without", marks=pytest.mark.slow)])
def test_fit_draws_the_shapes_on_the_nodes_of_a_universal_file(name, tmp_path, capsys):
    structure = five_dof()
    frf = structure.frf(np.arange(200, 701) / 10, inputs=["1"]).add_noise(jax.random.key(0), 0.02)
    frf = frf.replace(outputs=[f"{k}:+Z" for k in range(1, 6)], inputs=["1:+Z"])
    nodes = [str(k) for k in range(1, 6)]
    geometry = Geometry(nodes, np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1), [nodes])
    where = geometry if name == "with" else None
    save(frf, tmp_path / f"{name}.uff", geometry=where)
    target = tmp_path / name
    report, answer = target.with_suffix(".html"), target.with_suffix(".json")
    arguments = ["fit", str(tmp_path / f"{name}.uff"), "--out", str(target), "--report", str(report)]
    assert main([*arguments, "--json", str(answer)]) == 0
    assert (target / "shapes.png").exists() == (where is not None)
    assert ("Mode shapes on the geometry" in report.read_text()) == (where is not None)
    truth, printed = structure.modal(), capsys.readouterr().out
    found = json.loads(answer.read_text())["modes"]
    for mode, f, zeta in zip(found, truth.frequency_hz, truth.damping_ratio, strict=True):
        assert abs(mode["frequency_hz"] - f) < 4 * mode["frequency_std_hz"] < 2e-3 * f
        assert abs(mode["damping_ratio"] - zeta) < 4 * mode["damping_ratio_std"] < 0.2 * zeta
        assert len(mode["shape"]) == 5 and f"{mode['grade']:.2f}" in printed
    assert "Frequency" in printed and "unexplained" in printed
    assert main([*arguments, "--json", str(answer)]) == 2  # a second time, nothing is replaced
    assert "--overwrite" in capsys.readouterr().err


def test_demo_tells_its_story_from_start_to_end(tmp_path, monkeypatch, capsys):
    """As a user runs it, but for most of the lines, harmonics and of the catalogue, which the slow test has."""
    seed = 0  # draws a sensor's sign
    hidden = random_effect(seed, five_dof().dofs)
    quick = [c for c in catalogue() if c.slug in ("elasto_slip", hidden.name)]
    monkeypatch.setattr(virtual, "FREQ", np.arange(20.0, 70.0, 1.0))  # as in other tests, whose programs it shares
    made = virtual.simulate
    monkeypatch.setattr(virtual, "simulate", lambda *given, harmonics=1, **more: made(*given, **more))
    monkeypatch.setattr(modalax.diagnose, "diagnose", partial(modalax.diagnose.diagnose, causes=quick))
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seed", str(seed)]) == 0
    out = tmp_path / "modalax-demo"
    assert str(out / "report.html") in capsys.readouterr().out.replace("\n", "")
    assert len(json.loads((out / "modes.json").read_text())["modes"]) >= 4
    first, second = (json.loads((out / f"diagnosis{k}.json").read_text())["causes"] for k in (2, 3))
    assert [(c["name"], c["where"]) for c in first] == [("elasto_slip", ["3", "5"])]
    assert first[0]["parameters"]["slip_force"]["value"] == pytest.approx(4.0, rel=0.03)
    assert [(c["name"], tuple(c["where"])) for c in second] == [(hidden.name, hidden.where)]
    assert set(re.findall(r"<h2[^>]*>(\d)\.", (out / "report.html").read_text())) == {"1", "2", "3"}
    assert len(list(out.glob("*.png"))) >= 8


@pytest.mark.slow
def test_demo_tells_the_whole_story(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "modalax-demo").mkdir()  # taken: the demo finds another name
    assert main(["demo", "--seed", "1"]) == 0
    out = tmp_path / "modalax-demo-2"
    printed = capsys.readouterr()
    assert "modalax-demo-2" in printed.err and str(out / "report.html") in printed.out.replace("\n", "")
    first = json.loads((out / "diagnosis2.json").read_text())
    assert first["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in first["causes"]] == [("elasto_slip", ["3", "5"])]
    slip = first["causes"][0]["parameters"]["slip_force"]
    # One harmonic of a friction joint is about 1 % off.
    assert slip["value"] == pytest.approx(4.0, rel=0.03)
    assert first["gain"]["chi2_after"] < 0.01 * first["gain"]["chi2_before"]
    second = json.loads((out / "diagnosis3.json").read_text())
    hidden = random_effect(1, five_dof().dofs)
    assert [(c["name"], tuple(c["where"])) for c in second["causes"]] == [(hidden.name, hidden.where)]
    report = (out / "report.html").read_text()
    titles = re.findall(r"<h2[^>]*>(\d)\.", report)
    assert set(titles) == {"1", "2", "3"} and len(report.encode()) < 10e6


@pytest.mark.parametrize("seed", range(12))
def test_every_hidden_effect_changes_the_measurement(seed):
    """Each drawn effect is seen: it moves some FRF by more than the noise of 2 %."""
    dofs = five_dof().dofs
    effect = random_effect(seed, dofs)
    assert str(effect).startswith(effect.name)
    clean = five_dof().frf(FREQ, inputs=["1"]).H
    M, C, K = effect.matrices(*(np.asarray(A) for A in (five_dof().M, five_dof().C, five_dof().K)))
    changed = effect.channels(Structure(M, C, K, dofs).frf(FREQ, inputs=["1"]).H)
    relative = np.sqrt(np.mean(np.abs(changed - clean) ** 2, axis=0) / np.mean(np.abs(clean) ** 2, axis=0))
    # 501 lines: an effect as large as the noise of one line is 501 times its variance in all.
    assert relative.max() > 0.01


def test_below_slip_the_hidden_joint_is_the_spring_of_the_simulation():
    effect, joint = hidden_joint()
    structure = five_dof()
    M, C, K = effect.matrices(*(np.asarray(A) for A in (structure.M, structure.C, structure.K)))
    a, b = (structure.index(name) for name in effect.where)
    direction = np.eye(5)[a] - np.eye(5)[b]
    np.testing.assert_allclose(K + float(joint.k) * np.outer(direction, direction), structure.K, rtol=1e-12, atol=1e-9)


@pytest.mark.slow
def test_virtual_test_is_linear_without_a_joint():
    """Every run is the structure's FRF with the noise it states: chi-square a sample is 1 within its scatter."""
    effect = random_effect(2, five_dof().dofs)
    got = virtual_test(effect, seed=5)
    assert got.runs == len(LEVELS)
    M, C, K = effect.matrices(*(np.asarray(A) for A in (five_dof().M, five_dof().C, five_dof().K)))
    exact = effect.channels(Structure(M, C, K, five_dof().dofs).frf(FREQ, inputs=["1"]).H)
    chi2 = np.mean(np.abs(np.asarray(got.H) - exact) ** 2 / np.asarray(got.variance))
    # 3 x 501 x 5 complex samples: scatter 1/sqrt(7515) = 1.2 %; four of them.
    assert abs(chi2 - 1) < 0.05
