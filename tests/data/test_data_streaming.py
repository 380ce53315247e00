"""Records that stay in their file give the FRFs of those that are read whole."""

import numpy as np
import pytest
import scipy.signal

from modalax.data import reduction, streaming
from modalax.data.reduction import frf_from_recording
from modalax.data.streaming import Streamed
from modalax.files import load_records, records_tables

FS = 256.0


@pytest.fixture
def path(tmp_path):
    """Random force and two accelerations as whole numbers, time along the first axis."""
    rng = np.random.default_rng(0)
    force = rng.normal(size=9000)
    x = [scipy.signal.lfilter([0.0, g], [1.0, -1.2, 0.8], force) + 0.05 * rng.normal(size=9000) for g in (0.3, -0.5)]
    np.save(tmp_path / "records.npy", np.round(1000 * np.column_stack([force, *x])).astype(np.int16))
    return tmp_path / "records.npy"


def both(path, monkeypatch, **choices):
    found = []
    for limit in (2**28, 0):
        monkeypatch.setattr(records_tables, "STREAMED", limit)
        recording = load_records(path, fs=FS).with_units({1: "N", 2: "g", 3: "g"}).scaled({3: 0.5})
        assert isinstance(recording, Streamed) == (limit == 0)
        with pytest.warns(UserWarning):
            found.append(frf_from_recording(recording.between(2.0, 34.0), **choices))
    return found


@pytest.mark.parametrize("choices", [{"block": 1.0}, {"block": 0.7, "overlap": 0.3, "kind": "random"}])
def test_piece_by_piece_is_the_whole(path, monkeypatch, choices):
    monkeypatch.setattr(streaming, "MEMORY_MB", 0.4)
    whole, pieces = both(path, monkeypatch, outputs=["a", "b"], **choices)
    assert pieces.outputs == ("a", "b") and pieces.form == "accelerance" and pieces.averages == whole.averages
    for name in ("freq", "H", "variance", "coherence"):
        one, other = (np.asarray(getattr(frf, name)) for frf in (whole, pieces))
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(one).max())


def test_other_excitation_is_read_whole(path, monkeypatch):
    rng = np.random.default_rng(1)
    period = rng.normal(size=512)
    np.save(path, np.column_stack([np.tile(period, 18), np.tile(np.convolve(period, [0, 1, 2], "same"), 18)]))
    monkeypatch.setattr(records_tables, "STREAMED", 0)
    recording = load_records(path, fs=FS).with_units({1: "N", 2: "m"})
    assert isinstance(recording, Streamed)
    with pytest.warns(UserWarning) as heard:
        found = frf_from_recording(recording, force=[1], response=[2], skip=1)
    assert found.form == "receptance" and any("taken as multisine" in str(w.message) for w in heard)


def test_a_broken_sample_is_told_with_its_time(path, monkeypatch):
    table = np.load(path).astype(float)
    table[5000, 1] = np.nan
    np.save(path, table)
    monkeypatch.setattr(records_tables, "STREAMED", 0)
    monkeypatch.setattr(records_tables, "HEAD", 1000)
    monkeypatch.setattr(reduction, "HEAD", 1000)
    recording = load_records(path, fs=FS).with_units({1: "N", 2: "m", 3: "m"})
    with pytest.raises(ValueError, match="channel 2 is nan at 19.5312 s"):
        frf_from_recording(recording, force=[1], response=[2, 3], kind="random", block=1.0)
