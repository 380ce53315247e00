"""The index of a universal file: types, places and headers without the numbers."""

import contextlib

import jax
import numpy as np
import pytest

from modalax.files import save
from modalax.files.uff import set_types
from modalax.files.uff_index import index_of
from modalax.model.examples import five_dof


@pytest.fixture(params=[True, False], ids=["binary", "text"])
def path(request, tmp_path):
    frf = five_dof().frf(np.arange(20.0, 60.0), inputs=["1", "2"]).add_noise(jax.random.key(0), 0.01)
    save(frf, tmp_path / "frfs.uff", binary=request.param)
    return tmp_path / "frfs.uff"


def test_index_is_what_pyuff_finds(path):
    import pyuff

    found = index_of(path)
    assert [e.kind for e in found] == [int(t) for t in pyuff.UFF(str(path)).get_set_types()] == set_types(path)
    content = path.read_bytes()
    for entry in found:
        assert content[entry.start :].lstrip().startswith(b"-1")
        assert (len(entry.header) == 11) == (entry.kind == 58)
    functions = [e for e in found if e.kind == 58 and e.header[0].startswith("Receptance")]
    assert len(functions) == 10 and functions[0].header[0].startswith("Receptance 1 / 1")


def test_a_wrong_count_of_bytes_is_told_and_pyuff_asked(tmp_path):
    frf = five_dof().frf(np.arange(20.0, 60.0), inputs=["1"])
    path = tmp_path / "wrong.uff"
    save(frf, path)
    kinds = set_types(path)
    content = path.read_bytes()
    at = content.index(b"    58b") + 31
    path.write_bytes(content[:at] + b"%12d" % (int(content[at : at + 12]) + 300) + content[at + 12 :])
    with pytest.raises(ValueError, match="of type 58, is not closed where its header says"):
        index_of(path)
    assert set_types(path) == kinds


def test_numbers_of_binary_sets_are_read_from_their_places(tmp_path, monkeypatch):
    """The same FRFs as by pyuff alone, which is handed no numbers at all; text beside them is left to it."""
    import modalax.files.uff as uff
    from modalax.data import Measurement
    from modalax.files import load

    frf = five_dof().frf(np.geomspace(20.0, 60.0, 41), inputs=["1", "2"]).add_noise(jax.random.key(0), 0.01)
    save(Measurement.from_frfs([frf, frf]), tmp_path / "frfs.uff")
    content = (tmp_path / "frfs.uff").read_bytes()
    sizes = []
    real = uff.without_numbers

    @contextlib.contextmanager
    def watched(path, entries):
        with real(path, entries) as copy:
            sizes.append(copy.stat().st_size)
            yield copy

    monkeypatch.setattr(uff, "without_numbers", watched)
    one = load(tmp_path / "frfs.uff", conjugate=False)
    numbers = sum(e.numbers.stop - e.numbers.start for e in index_of(tmp_path / "frfs.uff") if e.numbers)
    assert sizes == [len(content) - numbers] and numbers > 0
    monkeypatch.setattr(uff, "with_numbers_apart", lambda path: [])
    other = load(tmp_path / "frfs.uff", conjugate=False)
    for name in ("freq", "H", "variance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.H[0], frf.H)
