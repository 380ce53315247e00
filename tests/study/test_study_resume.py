"""A study that is killed and started again: nothing is lost, nothing is done twice, and the rows are the same bits."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from modalax.cli import main
from modalax.study import study
from modalax.study.engine import has_dask
from modalax.study.store import read_rows

CODE = """
import os, signal
from pathlib import Path

def draw(seed, log, deadly):
    place = Path(log)
    with place.open("a") as stream:
        stream.write(f"{seed}\\n")
    if len(place.read_text().split()) == deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    if seed % 7 == 0:
        raise ValueError("a seed that can be divided by seven")
    return {"value": (seed % 1000) / 7, "word": "odd" if seed % 2 else "even"}
"""
DRAWS, CHUNK, DEADLY = 20, 3, 11


@pytest.fixture
def described(tmp_path):
    """Write the description of a study whose process is killed at its eleventh draw."""

    def write(name: str, deadly: int) -> Path:
        (tmp_path / "draws_of_test.py").write_text(CODE)
        path = tmp_path / f"{name}.toml"
        path.write_text(
            f'kind = "function"\ndraws = {DRAWS}\nseed = 3\nchunk = {CHUNK}\nfunction = "draws_of_test:draw"\n'
            f'[parameters]\nlog = "{tmp_path / f"{name}.log"}"\ndeadly = {deadly}\n'
        )
        return path

    return write


def rows_by_hand(folder: Path) -> dict[str, list]:
    """What the function gives for each seed of the study, without any of its machinery."""
    rows: dict[str, list] = {"value": [], "word": [], "failed": []}
    for k in range(DRAWS):
        seed = int(np.random.SeedSequence(3, spawn_key=(k,)).generate_state(1, np.uint64)[0]) >> 1
        failed = seed % 7 == 0
        rows["failed"].append(failed)
        rows["value"].append(np.nan if failed else (seed % 1000) / 7)
        rows["word"].append("" if failed else "odd" if seed % 2 else "even")
    return rows


@pytest.mark.skipif(os.name == "nt", reason="processes are killed by POSIX signals")
def test_a_killed_study_goes_on_where_it_was(described, tmp_path, capsys):
    path = described("killed", DEADLY)
    command = ["study", str(path), "--workers", "0"]
    first = subprocess.run([sys.executable, "-m", "modalax", *command], capture_output=True, text=True, check=False)
    assert first.returncode == -signal.SIGKILL
    done = sorted(p.name for p in (tmp_path / "killed-results" / "rows").iterdir())
    assert len(done) == (DEADLY - 1) // CHUNK

    assert main(command) == 0
    assert "9 of 20 draws were done before" in capsys.readouterr().err
    logged = (tmp_path / "killed.log").read_text().split()
    # Chunks that were stored are not computed again; the one under way is, whose second draw was the last.
    assert len(logged) == DRAWS + DEADLY - (DEADLY - 1) // CHUNK * CHUNK
    assert len(set(logged)) == DRAWS

    whole = study(described("whole", 0), workers=0)
    for place in ("results", *(f"rows/{k:06d}" for k in range(7))):
        (one,) = (tmp_path / "killed-results").glob(f"{place}.*")
        (other,) = (tmp_path / "whole-results").glob(f"{place}.*")
        assert one.read_bytes() == other.read_bytes()
    expected = rows_by_hand(tmp_path)
    assert np.array_equal(whole.columns["value"], expected["value"], equal_nan=True)
    assert whole.columns["word"].tolist() == expected["word"]
    assert whole.columns["failed"].tolist() == expected["failed"]
    assert whole.summary["failed"] == sum(expected["failed"]) > 0
    assert list(whole.summary["reasons"]) == ["a seed that can be divided by seven"]


@pytest.mark.skipif(not has_dask() or os.name == "nt", reason="needs Dask distributed and POSIX signals")
def test_a_killed_worker_is_replaced(described, tmp_path):
    """Two processes, one of which is killed at work, store the same bits as one process does."""
    assert main(["study", str(described("workers", DEADLY)), "--workers", "2"]) == 0
    study(described("alone", 0), workers=0)
    (one,) = (tmp_path / "workers-results").glob("results.*")
    (other,) = (tmp_path / "alone-results").glob("results.*")
    assert one.read_bytes() == other.read_bytes()
    assert len((tmp_path / "workers.log").read_text().split()) > DRAWS  # a worker was killed, and its chunk redone


def test_a_changed_study_is_refused(described, tmp_path):
    path = described("changed", 0)
    study(path, workers=0)
    text = path.read_text()
    path.write_text(text.replace("seed = 3", "seed = 4"))
    with pytest.raises(ValueError, match="results of another study: seed was 3 and is now 4.*choose another folder"):
        study(path, workers=0)
    path.write_text("# a remark changes nothing\n" + text)
    assert len(study(path, workers=0).columns["item"]) == DRAWS
    (tmp_path / "draws_of_test.py").write_text(CODE + "# another function\n")
    with pytest.raises(ValueError, match="another study: inputs draws_of_test.py was"):
        study(path, workers=0)


def test_folders_that_are_no_study_are_left_alone(described, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(ValueError, match="holds other files, and no study"):
        study(described("other", 0), tmp_path / "mine", workers=0)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"
    assert os.listdir(tmp_path / "mine") == ["thesis.txt"]


def test_a_damaged_chunk_is_told(described, tmp_path):
    path = described("damaged", 0)
    study(path, workers=0)
    (file,) = (tmp_path / "damaged-results" / "rows").glob("000002.*")
    file.write_bytes(b"")
    with pytest.raises(ValueError, match="000002.* is damaged.*remove it"):
        study(path, workers=0)
    file.unlink()
    assert np.array_equal(study(path, workers=0).columns["item"], np.arange(DRAWS))


def test_rows_are_kept_in_numpy_files_without_parquet(described, tmp_path, monkeypatch):
    plain = study(described("parquet", 0), workers=0)
    monkeypatch.setattr("modalax.study.store.find_spec", lambda name: None)
    other = study(described("numpy", 0), workers=0)
    assert other.file.suffix == ".npz"
    stored = read_rows(other.file)
    assert list(stored) == list(plain.columns)
    for name, values in plain.columns.items():
        assert np.array_equal(stored[name], values, equal_nan=values.dtype.kind == "f"), name
