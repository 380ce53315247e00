"""Where the commands write: never on what they read, never twice in one place, never half."""

import os

import numpy as np
import pytest

from modalax.cli import main
from modalax.cli.common import check_folder, check_free, write_json
from modalax.data import Measurement
from modalax.files import save
from modalax.model.examples import five_dof


@pytest.fixture
def data(tmp_path):
    freq = np.linspace(1.0, 20.0, 30)
    path = tmp_path / "d.npz"
    save(Measurement(freq, 1 / (100 - freq[None, :, None, None] ** 2 + 2j)), path)
    return path


def refused(capsys, *arguments) -> str:
    assert main([str(a) for a in arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_a_folder_is_not_replaced_by_convert(tmp_path, data, capsys):
    folder = tmp_path / "x.uff"
    folder.mkdir()
    (folder / "a").write_text("precious")
    assert "x.uff is a folder" in refused(capsys, "convert", data, folder, "--overwrite")
    assert (folder / "a").read_text() == "precious"


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "d.npz", "--json", "d.npz"],
        ["fit", "d.npz", "--report", "link.npz"],
        ["fit", "d.npz", "--json", "sub/../d.npz"],
        ["fit", "d.npz", "--modes", "d.npz"],
        ["check", "d.npz", "--json", "d.npz"],
        ["import-fe", "s.npz", "-o", "s.npz"],
        ["convert", "d.npz", "./d.npz"],
        ["diagnose", "d.npz", "--simulation", "s.npz", "--json", "s.npz"],
        ["simulate", "s.npz", "--band", "1", "2", "-o", "s.npz"],
    ],
)
def test_an_output_that_is_an_input_is_refused(tmp_path, data, capsys, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "s.npz").write_bytes(b"simulation")
    (tmp_path / "link.npz").symlink_to("d.npz")
    before = data.read_bytes()
    assert "is read as input" in refused(capsys, *arguments, "--overwrite")
    assert data.read_bytes() == before and (tmp_path / "s.npz").read_bytes() == b"simulation"


def test_two_outputs_of_one_name_are_refused(tmp_path, data, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = refused(capsys, "fit", data, "--json", "a.out", "--report", "./a.out")
    assert "asked for twice" in line and not (tmp_path / "a.out").exists()


def test_nothing_is_written_into_a_store_that_is_read(tmp_path):
    store = tmp_path / "d.zarr"
    store.mkdir()
    with pytest.raises(ValueError, match="is read as input"):
        check_free(store / "a.json", overwrite=True, inputs=[store])
    for folder in (store, store / "pictures"):
        folder.mkdir(exist_ok=True)
        with pytest.raises(ValueError, match="is read as input"):
            check_folder(folder, overwrite=True, inputs=[store])


def test_a_result_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": 1})
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert path.read_text() == '{\n "a": 1\n}\n' and os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["convert", "d.npz", "a.txt"], "a.txt: ending '.txt' is not one that can be written; use .npz, "),
        (["simulate", "s.npz", "--band", "1", "2", "-o", "a"], "a: ending '' is not one that can be written; use .npz"),
        (["frf", "r.csv", "-o", "a.json"], "a.json: ending '.json' is not one that can be written"),
        (["import-fe", "s.npz", "-o", "a.uff"], "a.uff: the ending must be .npz or .mat for a simulation"),
        (
            ["diagnose", "d.npz", "--simulation", "s.npz", "--save", "a.mat"],
            "a.mat: the ending must be .npz for an ext",
        ),
        (["fit", "d.npz", "--modes", "a.txt"], "a.txt"),
    ],
)
def test_a_wrong_ending_of_an_output_is_refused_before_anything_is_read(
    tmp_path, capsys, monkeypatch, arguments, words
):
    monkeypatch.chdir(tmp_path)
    for name in ("d.npz", "s.npz", "r.csv"):  # of the right kind at first sight, but nothing can be read from them
        (tmp_path / name).write_bytes(b"PK\x03\x04")
    assert words in refused(capsys, *arguments)


@pytest.mark.parametrize(
    "options",
    [["--input", "77"], ["cubic_stiffness:2,77:k3=1", "--force", "1"]]
    + [["cubic_stiffness:2:k3=1", "--amplitude", "1", "--held", "77"]],
)
def test_a_dof_that_is_not_there_is_refused_before_simulating(tmp_path, capsys, options):
    path = tmp_path / "s.npz"
    save(five_dof(), path)
    line = refused(capsys, "simulate", path, *options, "--band", "1", "2", "-o", tmp_path / "a.npz")
    assert "s.npz: no DoF named '77'" in line
