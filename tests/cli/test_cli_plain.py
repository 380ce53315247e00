"""The command on plain files: what it is told of them, modes by frequency, modes into files."""

import csv

import numpy as np
import pytest

from modalax.cli import main
from modalax.files import load, load_geometry
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 70.0, 251)


@pytest.fixture
def plain(tmp_path, monkeypatch):
    """Frequencies and FRFs of five outputs and one input, nothing else."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    H = np.asarray(five_dof().frf(FREQ, inputs=["1"]).H)[:, :, 0]
    H = H * (1 + 0.005 * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)))
    np.savez("plain.npz", f=FREQ, FRF=H)
    return tmp_path / "plain.npz"


NAMES = ["--outputs", "1:+X,2:+X,3:+X,4:+X,5:+X", "--inputs", "1:+X"]


def test_what_is_not_said_is_asked_for(plain, capsys):
    assert main(["convert", "plain.npz", "out.npz"]) == 2
    assert "--form accelerance" in capsys.readouterr().err.splitlines()[-1]
    assert main(["convert", "plain.npz", "out.npz", "--form", "receptance"]) == 2
    assert "--axes 'f o i'" in capsys.readouterr().err.splitlines()[-1]
    assert main(["convert", "plain.npz", "out.npz", "--unit", "mm/N", *NAMES]) == 0
    assert "note:" in capsys.readouterr().err
    found = load("out.npz")
    assert found.form == "receptance" and found.outputs[4] == "5:+X"
    np.testing.assert_allclose(found.H[0, :, :, 0], 1e-3 * np.load("plain.npz")["FRF"], rtol=1e-14)


def test_a_universal_file_that_lacks_an_frf_is_read_without_that_channel(tmp_path, monkeypatch, capsys):
    pyuff = pytest.importorskip("pyuff")
    monkeypatch.chdir(tmp_path)
    H = np.asarray(five_dof().frf(FREQ, inputs=["1", "4"]).H)
    for o, i in [(1, 1), (1, 4), (2, 1), (2, 4), (4, 1)]:
        one = {
            "type": 58, "func_type": 4, "data": H[:, o - 1, int(i == 4)], "x": FREQ, "abscissa_spacing": 1,
            "rsp_node": o, "rsp_dir": 1, "ref_node": i, "ref_dir": 1, "ordinate_spec_data_type": 8,
            "orddenom_spec_data_type": 13,
        }  # fmt: skip
        pyuff.UFF("lacks.uff").write_sets(one, "add")
    for command in (["convert", "lacks.uff", "out.npz"], ["fit", "lacks.uff"], ["check", "lacks.uff"],
                    ["view", "lacks.uff"], ["diagnose", "lacks.uff", "--simulation", "lacks.uff"]):  # fmt: skip
        assert main(command) == 2
        error = capsys.readouterr().err.splitlines()[-1]
        assert "lacks.uff: 1 of 6 FRFs (output/input) are missing: 4:+X/4:+X; " in error and "--complete" in error
    assert main(["convert", "lacks.uff", "out.npz", "--complete"]) == 0
    assert "left out, because some of their FRFs are missing: output 4:+X" in capsys.readouterr().err
    found = load("out.npz")
    assert found.outputs == ("1:+X", "2:+X") and found.inputs == ("1:+X", "4:+X")
    assert main(["convert", "out.npz", "again.npz", "--complete"]) == 2
    assert "out.npz: option complete is for UFF files, this one is npz" in capsys.readouterr().err
    assert main(["check", "lacks.uff", "--complete"]) == 0
    assert "output 4:+X" in capsys.readouterr().err


def test_modes_by_frequency_go_to_files_with_their_nodes(plain, capsys):
    (plain.parent / "nodes.csv").write_text("node,x,y,z\n" + "".join(f"{n},{n},0,0\n" for n in range(1, 6)))
    true = np.asarray(five_dof().modal().frequency_hz)
    picks = [word for f in true[:2] for word in ("--pick", f"{f:.1f}")]
    command = ["fit", "plain.npz", "--form", "receptance", *NAMES, "--no-refine", *picks, "--geometry", "nodes.csv"]
    assert main([*command, "--modes", "modes.csv", "--real-modes", "--without", "5:+X"]) == 0
    with (plain.parent / "modes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose([float(r["frequency_hz"]) for r in rows], true[:2], rtol=2e-3)
    assert "re 5:+X" not in rows[0] and all(abs(float(r["im 1:+X"])) < 1e-9 for r in rows)
    pytest.importorskip("pyuff")
    assert main([*command, "--modes", "modes.uff"]) == 0
    assert load_geometry("modes.uff").nodes == ("1", "2", "3", "4", "5")
    assert "modes: modes.uff" in capsys.readouterr().err
    assert main([*command, "--modes", "plain.npz", "--overwrite"]) == 2
    assert main([*command, "--modes", "modes.xlsx"]) == 2
    assert main([*command, "--drop", "30"]) == 2
    assert "drop has nothing to do" in capsys.readouterr().err


def test_check_is_told_what_a_plain_file_does_not_say(plain, capsys):
    assert main(["check", "plain.npz"]) == 2
    assert "--form accelerance" in capsys.readouterr().err.splitlines()[-1]
    assert main(["check", "plain.npz", "--form", "receptance", *NAMES]) == 0
    assert "nothing wrong was found" in capsys.readouterr().out
