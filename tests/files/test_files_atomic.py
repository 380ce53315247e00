"""What is written replaces nothing but what it may, and leaves the old file or the new one, whole."""

import errno
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import modalax
from modalax import Measurement
from modalax.files import write
from modalax.files.write import replacing, write_bytes, write_text

FAULTS = Path(__file__).parents[2] / "experiments" / "files" / "faults.py"


def measurement(level: float = 1.0) -> Measurement:
    freq = np.linspace(1.0, 20.0, 30)
    return Measurement(freq, 1 / (100 - freq[None, :, None, None] ** 2 + 2j), level=[level])


def level(path: Path) -> float:
    return float(modalax.load(path, conjugate=False).level[0])


@pytest.mark.parametrize("name", ["x.uff", "x.npz", "x.mat", "x.nc", "x.zarr"])
def test_a_folder_that_is_no_store_is_never_replaced(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "a").write_text("precious")
    with pytest.raises(ValueError, match=r"x\.\w+ is a folder"):
        modalax.save(measurement(), folder, overwrite=True)
    assert (folder / "a").read_text() == "precious"
    assert os.listdir(tmp_path) == [name]


def test_a_store_that_holds_something_else_as_well_is_not_replaced(tmp_path):
    store = tmp_path / "x.zarr"
    modalax.save(measurement(), store)
    (store / "thesis.txt").write_text("precious")
    with pytest.raises(ValueError, match="never replaced"):
        modalax.save(measurement(), store, overwrite=True)
    assert (store / "thesis.txt").read_text() == "precious"


def test_a_store_is_replaced_by_a_store_and_a_file_by_a_file(tmp_path):
    store, file = tmp_path / "x.zarr", tmp_path / "y.zarr"
    modalax.save(measurement(1.0), store)
    with pytest.raises(ValueError, match=r"x\.zarr exists already.*overwrite=True"):
        modalax.save(measurement(2.0), store)
    modalax.save(measurement(2.0), store, overwrite=True)
    assert level(store) == 2.0
    file.write_text("precious")
    with pytest.raises(ValueError, match="is a file, and a Zarr store is a folder"):
        modalax.save(measurement(), file, overwrite=True)
    with pytest.raises(ValueError, match="is a folder; a file cannot take its place"):
        write_text(store, "text")
    assert sorted(os.listdir(tmp_path)) == ["x.zarr", "y.zarr"]


def test_of_a_link_the_file_it_points_to_is_replaced(tmp_path):
    (tmp_path / "else").mkdir()
    real, link = tmp_path / "else" / "real.npz", tmp_path / "link.npz"
    modalax.save(measurement(1.0), real)
    link.symlink_to(real)
    modalax.save(measurement(2.0), link, overwrite=True)
    assert link.is_symlink() and level(real) == 2.0
    assert os.listdir(real.parent) == ["real.npz"]


def test_nothing_else_is_replaced_through_a_link(tmp_path):
    store, folder = tmp_path / "s.zarr", tmp_path / "folder"
    modalax.save(measurement(1.0), store)
    folder.mkdir()
    for target in (store, folder, tmp_path / "absent"):
        link = tmp_path / "link.zarr"
        link.symlink_to(target)
        with pytest.raises(ValueError, match="symbolic link to .* which is no file"):
            modalax.save(measurement(2.0), link, overwrite=True)
        link.unlink()
    assert level(store) == 1.0 and not (tmp_path / "absent").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")
def test_a_pipe_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "x.npz")
    with pytest.raises(ValueError, match="neither a file nor a folder"):
        modalax.save(measurement(), tmp_path / "x.npz", overwrite=True)


@pytest.mark.parametrize(("ending", "which"), [("npz", 1), ("zarr", 1), ("zarr", 2), ("zarr", 3)])
def test_old_and_new_survive_a_rename_that_fails(tmp_path, monkeypatch, ending, which):
    """Any of the renames fails; without the one step of Linux, in which nothing can come between."""
    path = tmp_path / f"x.{ending}"
    modalax.save(measurement(1.0), path)
    calls, real = [], os.replace

    def fails(a, b):
        calls.extend([a] if Path(a).name in (f"part.{ending}", path.name) else [])
        if len(calls) == which:
            calls.append("failed")
            raise OSError(errno.EIO, "input/output error", str(a))
        return real(a, b)

    monkeypatch.setattr(os, "replace", fails)
    monkeypatch.setattr(write, "_exchange", lambda a, b: False)
    with pytest.raises(OSError, match="input/output error .*the new file is whole and stands in") as caught:
        modalax.save(measurement(2.0), path, overwrite=True)
    assert str(path) in str(caught.value)
    assert level(path) == 1.0
    kept = next(p for p in tmp_path.iterdir() if p != path)
    new = next(p for p in kept.iterdir() if p.name.endswith(ending))
    assert level(new) == 2.0
    monkeypatch.setattr(os, "replace", real)
    modalax.save(measurement(3.0), path, overwrite=True)
    assert level(new) == 2.0 and level(path) == 3.0


def test_what_killed_writers_left_is_cleaned_and_an_old_store_put_back(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    host = write._host()
    modalax.save(measurement(7.0), tmp_path / "store.zarr")
    left = tmp_path / f".modalax-{host}-{dead.pid}-0123abcd"
    left.mkdir()
    (left / "part.npz").write_text("half")
    moved = tmp_path / f".modalax-{host}-{dead.pid}-4567abcd"
    moved.mkdir()
    (tmp_path / "store.zarr").rename(moved / "old")
    (moved / "name").write_text("store.zarr")
    alive = tmp_path / f".modalax-{host}-{os.getppid()}-0123abcd"
    elsewhere = tmp_path / ".modalax-another_machine-1-0123abcd"
    forgotten = tmp_path / ".modalax-another_machine-2-0123abcd"
    users = tmp_path / ".modalax-notes"
    for folder in (alive, elsewhere, forgotten, users):
        folder.mkdir()
    os.utime(forgotten, (time.time() - 2 * write.FORGOTTEN,) * 2)
    modalax.save(measurement(), tmp_path / "new.npz")
    assert sorted(p for p in tmp_path.iterdir()) == sorted(
        [alive, elsewhere, users, tmp_path / "new.npz", tmp_path / "store.zarr"]
    )
    assert level(tmp_path / "store.zarr") == 7.0


def test_an_error_while_writing_leaves_nothing(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(KeyError), replacing(path) as part:
        part.write_text("half")
        raise KeyError
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]


def test_the_rights_of_a_file_stay(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    path.chmod(0o640)
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new" and path.stat().st_mode & 0o777 == 0o640


def test_nothing_in_the_package_writes_but_through_the_one_writer():
    """What writes to a place that the writer gave it is listed here."""
    source = Path(modalax.__file__).parent
    given = {"files/write.py", "files/labelled.py", "files/mat.py", "files/npz.py", "files/uff.py", "show/fit.py"}
    given |= {"files/matrices.py", "files/uff_binary.py"}  # their readers write into a temporary folder
    given |= {"study/store.py"}  # and its lock, in the study's own folder
    given |= {"show/style.py"}  # a picture in memory, for notebooks
    wrong = []
    for path in source.rglob("*.py"):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            writes = re.search(
                r"\.write_(text|bytes)\(|open\([^)]*[\"'][wax]b?[\"']|savefig\(|savez?\(|savemat\(", line
            )
            own = "def " in line or "files import" in line or re.search(r"(?<![.\w])save\(", line)
            if writes and not own and str(path.relative_to(source)) not in given:
                wrong.append(f"{path.relative_to(source)}:{number}: {line.strip()}")
    assert not wrong, wrong


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the script of the faults forks")
@pytest.mark.parametrize(
    "kinds",
    [["npz", "json"], *(pytest.param([k], marks=pytest.mark.slow) for k in ("uff", "mat", "nc", "zarr", "png"))],
)
def test_no_fault_costs_a_file(kinds):
    """A full disk, a read-only folder (where they can be made), limits on sizes and kills, by the script for them."""
    command = [sys.executable, str(FAULTS), "--kills", "2", *kinds]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("2 of 2 whole") == len(kinds) and done.stdout.endswith("0 failures\n"), done.stdout


@pytest.mark.parametrize("ending", ["npz", "uff", "mat", "nc", "zarr"])
def test_a_full_disk_is_said_and_the_old_file_stays(tmp_path, ending):
    """By a limit on the size of files, which is to the writer what a full disk is."""
    resource = pytest.importorskip("resource")
    path = tmp_path / f"x.{ending}"
    modalax.save(measurement(1.0), path)
    new, before = measurement(2.0), resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, before[1]))
        with pytest.raises(OSError, match="File too large .nothing was replaced") as caught:
            modalax.save(new, path, overwrite=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert str(path) in str(caught.value)
    assert level(path) == 1.0 and os.listdir(tmp_path) == [path.name]
