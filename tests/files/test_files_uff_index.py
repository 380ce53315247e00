"""The index of a universal file: types, places and headers without the numbers."""

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
