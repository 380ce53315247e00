"""``modalax frf``: from time records to a file of FRFs, and one clear line where that cannot be."""

import contextlib
import re
import warnings

import numpy as np
import pytest
import scipy.signal

from modalax.cli import main
from modalax.files import load

FS = 512.0
B, A = [0.0, 1e-3], [1.0, -1.2, 0.8]


def hits(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    force = np.zeros(int(FS * 1.2 * count))
    force[(FS * (0.3 + 1.2 * np.arange(count))).astype(int)] = rng.uniform(50, 80, count)
    force = np.convolve(force, np.hanning(7), "same")
    x = scipy.signal.lfilter(B, A, force)
    return np.array([np.arange(len(force)) / FS, force, x + 1e-6 * rng.normal(size=len(x))])


@pytest.fixture
def records(tmp_path):
    head = "time [s],hammer [N],a [g]"
    for k in (1, 2):
        np.savetxt(tmp_path / f"run{k}.csv", hits(4, k).T, delimiter=",", header=head, comments="")
    return tmp_path


def test_hits_of_a_table_become_frfs(records, capsys):
    target = records / "out.npz"
    asked = ["frf", str(records / "run1.csv"), "-o", str(target), "--band", "10", "120"]
    assert main([*asked, "--name", "hammer=1:+Z", "--name", "a=2:+Z"]) == 0
    said = capsys.readouterr()
    assert "accelerance, 1 run of 1 output and 1 input" in said.out and "4 averages" in said.out
    assert "note: taken as hits" in said.err and "out.npz written" in said.err
    measured = load(target)
    assert measured.outputs == ("2:+Z",) and measured.inputs == ("1:+Z",) and measured.variance is not None
    H = 9.80665 * scipy.signal.freqz(B, A, np.asarray(measured.freq), fs=FS)[1]
    assert np.abs(np.asarray(measured.H[0, :, 0, 0]) - H).max() < 1e-3 * np.abs(H).max()
    assert main(asked) == 2 and "exists already" in capsys.readouterr().err


def test_a_drive_point_has_one_name_at_both_ends(records):
    target = records / "drive.npz"
    asked = ["frf", str(records / "run1.csv"), "-o", str(target), "--band", "10", "120"]
    assert main([*asked, "--force", "2", "--name", "2=1:+Z", "--response", "a", "--name", "a=1:+Z"]) == 0
    measured = load(target)
    assert measured.outputs == measured.inputs == ("1:+Z",)


def uff_records(path, channels):
    """A universal file of time records: node, type of the ordinate, label and samples of each."""
    pyuff = pytest.importorskip("pyuff")
    sets = [
        {
            "type": 58, "binary": 1, "func_type": 1, "data": values, "x": np.arange(len(values)) / FS,
            "rsp_node": node, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "id1": "NONE", "abscissa_spacing": 1,
            "abscissa_inc": 1 / FS, "abscissa_spec_data_type": 17, "ordinate_spec_data_type": kind,
            "ordinate_axis_units_lab": label, "orddenom_spec_data_type": 0,
        }
        for node, kind, label, values in channels
    ]  # fmt: skip
    with contextlib.redirect_stdout(None), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pyuff.UFF(str(path)).write_sets(sets, mode="add")
    return path


def test_a_drive_point_of_a_universal_file_keeps_its_one_name(tmp_path, capsys):
    _, force, a = hits(4, 1)
    path = uff_records(tmp_path / "a.uff", [(17, 12, "g", a), (17, 13, "N", force), (3, 12, "g", a)])
    asked = ["frf", str(path), "--band", "10", "120", "-o"]
    assert main([*asked, str(tmp_path / "a.npz")]) == 0
    measured = load(tmp_path / "a.npz")
    assert measured.outputs == ("17:+Z", "3:+Z") and measured.inputs == ("17:+Z",)
    capsys.readouterr()
    assert main(["check", str(path)]) == 0
    assert "duplicated" in capsys.readouterr().out  # of 3 and 17, as they are
    assert main([*asked, str(tmp_path / "b.npz"), "--name", "2=18:+Z"]) == 0
    measured = load(tmp_path / "b.npz")
    assert measured.outputs == ("17:+Z", "3:+Z") and measured.inputs == ("18:+Z",)


def test_check_tells_why_records_of_a_universal_file_cannot_be_read(tmp_path, capsys):
    _, force, a = hits(1, 1)
    path = uff_records(tmp_path / "a.uff", [(1, 12, "g", a), (2, 13, "N", force), (1, 12, "g", a)])
    assert main(["check", str(path)]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert f"{path}: its channels stand unequally often (1:+Z [m/s^2] 2, 2:+Z [N] 1)" in error


def test_the_coherence_of_several_shakers_is_the_multiple_one(tmp_path, capsys):
    rng = np.random.default_rng(3)
    F = rng.normal(size=(2, int(64 * FS)))
    x = scipy.signal.lfilter(B, A, F[0] + 0.8 * F[1])
    np.savez(tmp_path / "two.npz", F1=F[0], F2=F[1], x=x + 0.01 * x.std() * rng.normal(size=x.size), fs=FS)
    asked = ["frf", str(tmp_path / "two.npz"), "-o", str(tmp_path / "o.npz"), "--unit", "g", "--band", "10", "120"]
    shakers = ["--force", "F1", "--force", "F2", "--response", "x", "--block", "1"]
    assert main([*asked, *shakers]) == 0
    said = capsys.readouterr().out
    assert float(re.search(r"median multiple coherence (\d\.\d+)", said)[1]) > 0.99
    assert np.median(load(tmp_path / "o.npz").coherence) < 0.8  # the file holds the ordinary one
    assert main([*asked, "--force", "F1", "--response", "x", "--overwrite"]) == 0
    assert re.search(r"; median coherence 0\.[4-7]", capsys.readouterr().out)


def test_files_are_runs_or_repeats(records, capsys):
    both = ["frf", str(records / "run1.csv"), str(records / "run2.csv"), "--band", "10", "120", "--block", "0.8"]
    assert main([*both, "-o", str(records / "runs.npz"), "--runs", "--level", "5", "--level", "10"]) == 0
    runs = load(records / "runs.npz")
    assert runs.H.shape[0] == 2 and np.allclose(np.asarray(runs.level), [5, 10])
    notes = capsys.readouterr().err
    assert notes.count("force by its unit") == 1
    assert main([*both, "-o", str(records / "one.npz")]) == 0
    assert load(records / "one.npz").averages == 8
    assert main([*both, "-o", str(records / "x.npz"), "--level", "5", "--level", "6"]) == 2
    assert "each run needs one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--force", "load"], "no channel 'load'; there are 2 hammer [N], 3 a [g]"),
        (["--kind", "taps"], "kind is 'taps'; it must be one of hits"),
        (["--units", "hammer"], "needs CHANNEL=VALUE"),
        (["--scale", "hammer=two"], "a number is needed"),
        (["--units", "a=V"], "unit of the responses is not known"),
        (["--estimator", "H3"], "estimator is 'H3'"),
        (["--kind", "random", "--block", "400"], "blocks of 400 s (204800 samples)"),
        (["--kind", "random", "--block", "400"], "from a record of 4.79883 s"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(records, capsys, options, words):
    assert main(["frf", str(records / "run1.csv"), "-o", str(records / "y.npz"), *options]) == 2
    error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("modalax:")]
    assert len(error) == 1 and words in error[0], error
    assert not (records / "y.npz").exists()


def test_a_sample_that_is_no_number_is_told_with_its_place(records, capsys):
    lines = (records / "run1.csv").read_text().splitlines()
    cells = lines[1001].split(",")
    lines[1001] = ",".join([*cells[:2], "nan"])
    (records / "run1.csv").write_text("% exported\n" + "\n".join(lines))
    asked = ["frf", str(records / "run1.csv"), "-o", str(records / "y.npz")]
    assert main(asked) == 2
    assert "line 1003: channel a is nan at 1.95312 s;" in capsys.readouterr().err
    lines[1001] = ",".join(["nan", *cells[1:]])
    (records / "run1.csv").write_text("\n".join(lines))
    assert main(asked) == 2
    assert f"line 1002: instant 1001 of {len(lines) - 1} is nan" in capsys.readouterr().err


@pytest.mark.measured
def test_measured_hits_have_their_peaks(measured, tmp_path, capsys):
    files = [str(p) for p in sorted((measured / "hammer_hits").glob("*.npy"))]
    assert main(["frf", *files, "-o", str(tmp_path / "h.npz")]) == 2
    assert "which channel is the force is not known" in capsys.readouterr().err
    assert main(["frf", *files, "-o", str(tmp_path / "h.npz"), "--force", "2", "--unit", "m/s^2"]) == 0
    found = load(tmp_path / "h.npz")
    size = np.abs(np.asarray(found.H[0, :, 0, 0]))[:3000]
    assert found.averages == 5 and {810, 851, 900, 2640} <= set(scipy.signal.find_peaks(size)[0] + 1)


@pytest.mark.measured
def test_a_measured_multisine_finds_its_force_rate_period_and_lines(measured, tmp_path, capsys):
    level = [str(measured / "f16" / f"F16Data_FullMSine_Level{k}.mat") for k in (1, 7)]
    assert main(["frf", *level, "--runs", "-o", str(tmp_path / "f.npz")]) == 0
    said = capsys.readouterr().err
    for words in ("400 Hz from its Fs", "force by its name: Force", "repeats every 8192 samples", "left out: Voltage"):
        assert words in said
    found = load(tmp_path / "f.npz")
    assert found.H.shape == (2, 267, 3, 1) and np.isnan(np.asarray(found.level)).all()
    freq = np.asarray(found.freq)
    assert freq[0] == pytest.approx(2.0, abs=0.05) and freq[-1] == pytest.approx(15.0, abs=0.05)
    torsion = (freq > 6.8) & (freq < 7.8)
    peaks = [freq[torsion][np.abs(np.asarray(H[torsion, 2, 0])).argmax()] for H in found.H]
    assert peaks[1] < peaks[0]  # friction at the interface softens with level
