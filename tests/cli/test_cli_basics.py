"""The command line: what it refuses and how it says so, conversion, simulation, quick help."""

import importlib
import json
import math
import re
import subprocess
import sys
import warnings

import jax
import numpy as np
import pytest
import typer

import modalax
from modalax.cli import main
from modalax.cli.common import check_folder, free_folder
from modalax.cli.simulate import frequencies
from modalax.data import Measurement
from modalax.files import load, save
from modalax.files.json_text import plain
from modalax.model.examples import five_dof
from modalax.simulate.joints.text import read_joints


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path_factory):
    """Compiled programs of a test run do not go to the user's cache."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A structure and two runs of its FRFs."""
    folder = tmp_path_factory.mktemp("files")
    structure = five_dof()
    frf = structure.frf(np.arange(200, 701) / 10, inputs=["1"])
    runs = [frf.add_noise(jax.random.key(k), 0.01).replace(level=float(k + 1)) for k in range(2)]
    save(structure, folder / "structure.npz")
    save(Measurement.from_frfs(runs), folder / "two.npz")
    return folder


@pytest.fixture(scope="module")
def unusable(files):
    """Beside them: five lines, names that the simulation has not, and records without a force."""
    two = load(files / "two.npz")
    save(two.band(20.0, 20.4), files / "few.npz")
    save(two.replace(outputs=tuple(f"p{k}" for k in range(5)), inputs=("p0",)), files / "other.npz")
    rows = np.column_stack([np.arange(64) / 64, np.zeros(64), np.ones(64)])
    np.savetxt(files / "still.csv", rows, delimiter=",", header="time,a,b", comments="")
    return files


def refused(capsys, *arguments):
    """Run a command that must end with status 2 and one line on stderr; give that line."""
    assert main([str(a) for a in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("modalax: "), captured.err
    return lines[0]


FEW = ["few.npz", "--run", "1"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", *FEW], "few.npz: the band 20 to 20.4 Hz holds 5 lines; a fit needs at least 6"),
        (["check", "few.npz"], "few.npz: holds 5 lines above 0 Hz; at least 8 are needed"),
        (["view", *FEW, "--no-browser"], "few.npz: order 2 needs 6 lines"),
        (["fit", *FEW, "--order", "-1"], "few.npz: order is -1"),
        (["fit", "two.npz", "--run", "1", "--band", "500", "600"], "two.npz: the band 500 to 600 Hz holds no line"),
        (["fit", "two.npz", "--run", "1", "--band", "60", "50"], "two.npz: the band 60 to 50 Hz is empty"),
        (["diagnose", "two.npz", "--simulation", "structure.npz", "--band", "500", "600"],
         "two.npz: the band 500 to 600 Hz holds no line"),
        (["diagnose", "two.npz", "--simulation", "structure.npz", "--run", "3"], "two.npz: --run 3"),
        (["diagnose", "other.npz", "--simulation", "structure.npz"], "other.npz, structure.npz: "),
        (["simulate", "structure.npz", "--band", "5", "6", "--input", "77", "-o", "x.npz"],
         "structure.npz: no DoF named '77'"),
        (["frf", "still.csv", "-o", "x.npz", "--unit", "g", "--force", "2"], "still.csv: the force does not"),
        (["frf", "still.csv", "-o", "x.npz"], "still.csv: which channel is the force is not known"),
        (["frf", "still.csv", "-o", "x.npz", "--time", "5", "6"], "still.csv: 5 to 6 s of records of 1 s"),
    ],
)  # fmt: skip
def test_an_error_of_the_data_names_its_file(unusable, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(unusable)
    assert main(arguments) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"modalax: {words}")


def test_help_names_every_command():
    done = subprocess.run([sys.executable, "-m", "modalax", "--help"], capture_output=True, text=True, check=True)
    for name in ("demo", "frf", "fit", "simulate", "diagnose", "causes", "convert", "study", "cache"):
        assert name in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["fit", "absent.npz"],
        ["diagnose", "a.npz", "--simulation", "b.npz"],
        ["study", "--help"],
        ["study", "absent.toml"],
        ["study", "--example", "noise"],
        ["cache"],
    ],  # fmt: skip
)
def test_what_needs_no_numbers_imports_none_of_their_packages(arguments):
    """So help, version and the error of a missing file come at once: imports take nearly all of their time."""
    code = (
        f"import sys; from modalax.cli import main\nmain({arguments})\n"
        "print([m for m in ('jax', 'numpy', 'scipy', 'matplotlib', 'optimistix', 'pyuff') if m in sys.modules])\n"
        "print(len(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy, count = done.stdout.splitlines()[-2:]
    assert heavy == "[]"
    assert int(count) < 500  # 360 as measured; JAX alone is 580 more


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.split() == ["modalax", modalax.__version__]


def test_no_argument_shows_the_help(capsys):
    assert main([]) == 0
    assert "simulate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "absent.uff"], ["absent.uff"]),
        (["fit"], ["DATA"]),
        (["nonsense"], ["nonsense"]),
        (["fit", "absent.npz", "--order", "many"], ["--order"]),
        (["fit", "absent.npz", "--method", "fft"], ["fft", "lscf", "fdpi"]),
        (["simulate", "absent.npz", "--band", "1", "2", "-o", "out.npz"], ["absent.npz"]),
        (["simulate", "absent.npz", "--force", "1", "--band", "1", "2"], ["-o DATA"]),
        (["simulate", "absent.npz", "--force", "1", "-o", "x.npz"], ["--band"]),
        (["simulate", "absent.npz", "--force", "-1", "--band", "1", "2", "-o", "x.npz"], ["-1", "above 0"]),
        (
            ["simulate", "a.npz", "--force", "1", "--amplitude", "1e-3", "--band", "1", "2", "-o", "x.npz"],
            ["--force", "--amplitude", "one of them"],
        ),
        (["simulate", "a.npz", "--held", "3", "--band", "1", "2", "-o", "x.npz"], ["--held 3", "--amplitude"]),
        (["simulate", "a.npz", "--amplitude", "0", "--band", "1", "2", "-o", "x.npz"], ["--amplitude 0", "above 0"]),
        (
            ["simulate", "a.npz", "--amplitude", "1e-3", "--held", "2", "--band", "1", "2", "-o", "x.npz"],
            ["--amplitude 0.001: without joints"],
        ),
        (
            ["simulate", "a.npz", "cubic_stiffness:2:k3=1", "--amplitude", "1", "--sweep", "up", "--band", "1", "2"]
            + ["-o", "x.npz"],
            ["--sweep up", "--amplitude"],
        ),
        (["simulate", "a.npz", "--noise", "-1", "--band", "1", "2", "-o", "x.npz"], ["--noise -1", "0 or above"]),
        (["simulate", "a.npz", "--noise", "nan", "--band", "1", "2", "-o", "x.npz"], ["--noise nan"]),
        (["diagnose", "absent.npz"], ["--simulation"]),
        (["convert", "absent.uff", "out.npz"], ["absent.uff"]),
    ],
)
def test_unusable_input_is_told_in_one_line(capsys, monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    line = refused(capsys, *arguments)
    assert all(word in line for word in words), line


def test_notes_are_about_the_data_not_about_cached_programs(capsys, monkeypatch):
    class Command:
        def main(self, *_, **__):
            warnings.warn("Error reading persistent compilation cache entry for 'jit_inv': cut short", stacklevel=1)
            warnings.warn("two lines only", stacklevel=1)

    monkeypatch.setattr(typer.main, "get_command", lambda _: Command())
    assert main(["causes"]) == 0
    assert capsys.readouterr().err == "note: two lines only\n"


def test_debug_shows_where_it_failed(tmp_path):
    with pytest.raises((ValueError, OSError)):
        main(["fit", str(tmp_path / "absent.npz"), "--debug"])


def test_a_model_is_no_measurement_and_the_other_way_round(capsys, files, tmp_path):
    line = refused(capsys, "fit", files / "structure.npz")
    assert "structure.npz" in line and "Structure" in line and "FRFs" in line
    line = refused(capsys, "simulate", files / "two.npz", "--band", "20", "70", "-o", tmp_path / "x.npz")
    assert "two.npz" in line and "simulation" in line


def test_existing_files_are_kept(capsys, files, tmp_path):
    target = tmp_path / "there.npz"
    target.write_text("mine")
    line = refused(capsys, "convert", files / "two.npz", target)
    assert "there.npz" in line and "--overwrite" in line
    assert target.read_text() == "mine"
    assert main(["convert", str(files / "two.npz"), str(target), "--overwrite"]) == 0
    assert load(target).runs == 2


def test_output_into_an_absent_folder_is_refused_before_working(capsys, files, tmp_path):
    line = refused(capsys, "fit", files / "two.npz", "--json", tmp_path / "no" / "f.json")
    assert "does not exist" in line


def test_convert_keeps_the_numbers(files, tmp_path, capsys):
    target = tmp_path / "two.mat"
    assert main(["convert", str(files / "two.npz"), str(target)]) == 0
    before, after = load(files / "two.npz"), load(target)
    np.testing.assert_array_equal(after.H, before.H)
    assert after.outputs == before.outputs and after.form == before.form


def test_linear_simulation(files, tmp_path, capsys):
    target = tmp_path / "sim.npz"
    arguments = ["simulate", files / "structure.npz", "--force", 2, "--force", 6, "--band", 20, 70, "--step", 0.5]
    assert main([*map(str, arguments), "--input", "3", "--form", "mobility", "-o", str(target)]) == 0
    got = load(target)
    exact = five_dof().frf(np.arange(20, 70.25, 0.5), form="mobility", inputs=["3"])
    assert got.form == "mobility" and got.inputs == ("3",) and got.runs == 2
    np.testing.assert_array_equal(got.level, [2.0, 6.0])
    np.testing.assert_allclose(got.freq, exact.freq, rtol=1e-14)
    np.testing.assert_allclose(got.H[1], exact.H, rtol=1e-9)


@pytest.mark.slow
def test_a_slipping_joint_softens_with_the_force(files, tmp_path, capsys):
    """Far above slip the joint hardly holds: the FRF comes near to that without it; far below it is linear."""
    target = tmp_path / "joint.npz"
    arguments = ["simulate", files / "structure.npz", "coulomb_friction:3,5:slip_force=1", "--harmonics", 1]
    arguments += ["--force", 1, "--force", 1000, "--band", 34, 38, "--step", 1, "-o", target]
    assert main([str(a) for a in arguments]) == 0
    got = load(target)
    free = np.asarray(five_dof().frf(got.freq, inputs=["1"]).H)
    far = [np.linalg.norm(H - free) / np.linalg.norm(free) for H in np.asarray(got.H)]
    assert far[0] > 0.1  # 1 N against a friction of 1 N
    assert far[1] < 0.01  # 1000 N against it


@pytest.mark.slow
def test_sweeps_up_and_down_and_a_held_response_of_a_hardening_spring(tmp_path, capsys):
    """Closed form of one harmonic: (k + 3/4 k3 A^2 - m w^2 + j c w) X = F."""
    m, c, k, k3 = 1.0, 2.0, 1e4, 5e7
    model, target = tmp_path / "duffing.npz", tmp_path / "out.npz"
    np.savez(model, M=[[m]], C=[[c]], K=[[k]], dofs=["x"])

    def run(*options):
        arguments = ["simulate", model, f"cubic_stiffness:x:k3={k3}", "--band", 15, 22, "--step", 0.25]
        assert main([str(a) for a in [*arguments, "--harmonics", 1, *options, "-o", target, "--overwrite"]]) == 0
        return load(target)

    size = {}
    for sweep in ("up", "down"):
        got = run("--force", 3, "--sweep", sweep)
        X, w = 3 * np.asarray(got.H)[0, :, 0, 0], 2 * np.pi * np.asarray(got.freq)
        size[sweep] = np.abs(X)
        np.testing.assert_allclose((k + 0.75 * k3 * np.abs(X) ** 2 - m * w**2 + 1j * c * w) * X, 3, rtol=1e-8)
    assert (size["up"] > 2 * size["down"]).sum() > 3
    got = run("--amplitude", 4e-3, "--amplitude", 8e-3, "--held", "x")
    for A, H in zip((4e-3, 8e-3), np.asarray(got.H)[:, :, 0, 0], strict=True):
        np.testing.assert_allclose(1 / H, k + 0.75 * k3 * A**2 - m * w**2 + 1j * c * w, rtol=1e-7)


def test_simulated_noise_has_the_size_asked_for(files, tmp_path, capsys):
    target = tmp_path / "noisy.npz"
    arguments = ["simulate", files / "structure.npz", "--band", 20, 70, "--noise", 0.2, "--seed", 3, "-o", target]
    assert main([str(a) for a in arguments]) == 0
    got = load(target)
    exact = np.asarray(five_dof().frf(got.freq, inputs=["1"]).H)
    error = np.asarray(got.H[0]) - exact
    ratio = np.sqrt(np.mean(np.abs(error) ** 2, axis=0) / np.mean(np.abs(exact) ** 2, axis=0))
    # 501 complex samples a channel: relative scatter of a standard deviation 1/sqrt(2*501) = 3 %; five of them.
    np.testing.assert_allclose(ratio, 0.2, rtol=0.16)


def test_what_has_no_effect_without_joints_is_said(files, tmp_path, capsys):
    arguments = ["simulate", files / "structure.npz", "--band", 20, 30, "-o", tmp_path / "a.npz"]
    assert main([str(a) for a in [*arguments, "--sweep", "down", "--harmonics", 5]]) == 0
    said = capsys.readouterr().err
    assert "--sweep has no effect without joints" in said and "--harmonics has no effect without joints" in said
    assert main([str(a) for a in [*arguments, "--overwrite"]]) == 0
    assert "no effect" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lower", "upper", "step", "count"), [(20, 70, 0.1, 501), (0, 1, 0.3, 4), (33.3, 33.9, 0.2, 4), (5, 6, 1, 2)]
)
def test_frequency_lines_hold_both_ends_where_the_step_meets_them(lower, upper, step, count):
    freq = frequencies(float(lower), float(upper), float(step))
    assert len(freq) == count and freq[0] == lower and freq[-1] <= upper * (1 + 1e-12)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ((50.0, 20.0, 0.1), "--band 50 20: needs 0 <= LO < HI"),
        ((50.0, math.inf, 0.1), "--band 50 inf: needs 0 <= LO < HI"),
        ((20.0, 50.0, 0.0), "--step 0: the distance"),
        ((20.0, 50.0, math.inf), "--step inf: the distance of the lines must be above 0 Hz and finite"),
        ((20.0, 50.0, math.nan), "--step nan: the distance"),
        ((20.0, 50.0, 31.0), "--step 31: wider than the band 20 to 50 Hz, which would leave one line"),
        ((20.0, 50.0, 1e-9), r"--step 1e-09: makes 3e\+10 lines .*; at most 1000000 are computed"),
        ((20.0, 50.0, 1e-310), "--step 1e-310: makes inf lines"),
    ],
)
def test_a_band_without_lines_is_explained(lines, words):
    with pytest.raises(ValueError, match=words):
        frequencies(*lines)


def test_a_folder_for_pictures_is_not_filled_twice(tmp_path):
    check_folder(tmp_path / "new", overwrite=False)
    taken = tmp_path / "file"
    taken.write_text("x")
    with pytest.raises(ValueError, match="is a file; --out needs a folder"):
        check_folder(taken, overwrite=True)
    with pytest.raises(ValueError, match="is not empty; choose another folder or add --overwrite"):
        check_folder(tmp_path, overwrite=False)
    check_folder(tmp_path, overwrite=True)


def test_joints_are_read_from_words_and_from_a_file(tmp_path):
    [(joint, where)] = read_joints("elasto_slip:3,5:k=2e4,slip_force=4")
    assert joint.slug == "elasto_slip" and where == ("3", "5")
    assert float(joint.k) == 2e4 and float(joint.slip_force) == 4
    # DoF names hold colons of their own.
    [(joint, where)] = read_joints("cubic_stiffness:12:+Z,13:-Z:k3=1e9")
    assert where == ("12:+Z", "13:-Z") and float(joint.k3) == 1e9
    path = tmp_path / "joints.toml"
    path.write_text('[[joint]]\nlaw = "coulomb_friction"\nwhere = "3"\nslip_force = 2\n')
    joints = read_joints(str(path))
    assert [(j.slug, w) for j, w in joints] == [("coulomb_friction", ("3",))]
    [(joint, _)] = read_joints("polynomial_stiffness:3,5:coefficients=1e3;2e9,powers=1;3")
    assert joint.powers == (1, 3) and [float(c) for c in joint.coefficients] == [1e3, 2e9]
    path.write_text('[[joint]]\nlaw = "polynomial_damping"\nwhere = ["3", "5"]\ncoefficients = 4\npowers = 2\n')
    [(joint, _)] = read_joints(str(path))
    assert joint.powers == (2,) and float(joint.coefficients[0]) == 4


def test_a_wrong_file_of_joints_is_explained(tmp_path):
    path = tmp_path / "joints.toml"
    for text, words in (
        ("", "holds no table"),
        ('[[joint]]\nlaw = "gap"\n', "joint 1: lacks where"),
        ("[[joint", "joints.toml: "),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=re.escape(words)):
            read_joints(str(path))


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("elasto_slip", ["law:dofs:parameters"]),
        ("glue:3,5:k=1", ["glue", "elasto_slip"]),
        ("elasto_slip:3,5:k=1", ["k=1: elasto_slip needs slip_force [N]; optional: k0 [N/m]"]),
        ("gap:3,5:k=1", ["gap needs gap [m]"]),
        ("elasto_slip:3,5:k=1,q=2", ["no parameter q; it has k [N/m], slip_force [N]; optional: k0 [N/m]"]),
        ("elasto_slip:3,5:k=-1,slip_force=2", ["-1"]),
        ("elasto_slip:3,5:k=much,slip_force=2", ["much"]),
        ("elasto_slip:3,4,5:k=1,slip_force=2", ["3 DoFs"]),
        ("polynomial_stiffness:3,5:coefficients=1e3,powers=1.5", ["powers is 1.5", "whole numbers"]),
        ("polynomial_stiffness:3,5:coefficients=1e3", ["polynomial_stiffness needs powers"]),
    ],
)
def test_a_wrong_joint_is_explained(spec, words):
    with pytest.raises(ValueError) as error:
        read_joints(spec)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_free_folder_is_found(tmp_path):
    first = tmp_path / "demo"
    assert free_folder(first) == first
    first.mkdir()
    (tmp_path / "demo-2").mkdir()
    assert free_folder(first) == tmp_path / "demo-3"


def test_json_has_no_numbers_that_are_none():
    value = {"a": np.array([1.0, np.nan]), "b": (np.float64("inf"), 2 + 1j), "c": [np.int64(3), None, "x", True]}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "a": [1.0, None],
        "b": [None, [2.0, 1.0]],
        "c": [3, None, "x", True],
    }


def test_a_warning_becomes_a_note(files, tmp_path, capsys):
    """FRFs of the other time convention are turned back, and that is told without a file name and line of code."""
    measured = load(files / "two.npz")
    save(measured.replace(H=np.conj(measured.H)), tmp_path / "turned.npz")
    assert main(["convert", str(tmp_path / "turned.npz"), str(tmp_path / "right.npz")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("note: ") and "turned.npz" in lines[0] and "conjugat" in lines[0]
    np.testing.assert_allclose(load(tmp_path / "right.npz").H, measured.H)


def test_without_plotly_a_demo_says_so_first_and_goes_on(monkeypatch, tmp_path, capsys):
    """No report is promised, none is written, and no other work is left out."""
    demo, done = importlib.import_module("modalax.cli.demo"), []
    monkeypatch.setattr(demo, "can_report", lambda: False)
    for name in ("identify_story", "diagnosis_story"):
        monkeypatch.setattr(demo, name, lambda console, out, *told: done.append(told) or [])
    assert main(["demo", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert printed.err.startswith("no report is written") and "modalax[report]" in printed.err
    assert len(done) == 3 and "Report" not in printed.out and not (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize("command", ["fit", "check", "diagnose"])
def test_without_plotly_a_report_is_refused_before_any_work(monkeypatch, tmp_path, capsys, command):
    monkeypatch.setattr("modalax.cli.common.can_report", lambda: False)
    save(five_dof(), tmp_path / "sim.npz")
    arguments = [command, str(tmp_path / "sim.npz"), "--report", str(tmp_path / "r.html")]
    arguments += ["--simulation", str(tmp_path / "sim.npz")] if command == "diagnose" else []
    assert main(arguments) == 2
    assert "r.html cannot be written: a report needs plotly and jinja2" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "none.npz")]) == 2
    assert "modalax[view]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [("units", "--prior units: it needs SLUG=FACTOR"), ("units=much", "--prior units=much: it needs SLUG=FACTOR"),
     ("gremlin=2", "prior names 'gremlin'"), ("units=-1", "the prior of units is -1; it must be above 0")],
)  # fmt: skip
def test_a_prior_that_cannot_be_held_is_an_error_that_says_so(tmp_path, capsys, given, said):
    data, simulation = tmp_path / "data.npz", tmp_path / "simulation.npz"
    save(five_dof().frf(np.linspace(20.0, 70.0, 60), inputs=["1"]), data)
    save(five_dof(), simulation)
    assert main(["diagnose", str(data), "--simulation", str(simulation), "--prior", given]) == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
