"""A diagram of outputs read in turn is that of all together."""

import jax
import numpy as np
import pytest

from modalax.identify import plscf
from modalax.identify.chunked import diagram_of_chunks, outputs_in_turn
from modalax.model.examples import five_dof


def test_outputs_in_turn_give_the_poles_of_all():
    frf = five_dof().frf(np.arange(20.0, 70.0, 0.25), inputs=["1", "2"]).add_noise(jax.random.key(0), 0.01)
    H = np.asarray(frf.H)[None]
    chunks = list(outputs_in_turn(H, chunk_mb=16e-6 * 200 * 2 * 2.1))
    assert [c.shape[1] for c in chunks] == [2, 2, 1]
    table, found = diagram_of_chunks(frf.freq, chunks, range(2, 9))
    whole = plscf(frf, range(2, 9), solver="moments")
    for n, (one, other) in enumerate(zip(np.asarray(table.poles), np.asarray(whole.poles), strict=True), start=2):
        one, other = one[: 2 * n], other[: 2 * n]
        assert (np.abs(one[:, None] - other).min(axis=1) < 1e-6 * np.abs(one)).all()
    true = np.asarray(five_dof().modal().poles)
    assert (np.abs(np.asarray(found.poles)[:, None] - true).min(axis=0) < 0.1 * np.abs(true.real)).all()


def test_chunks_that_do_not_fit_are_told():
    freq = np.arange(100.0)
    good, other = np.ones((100, 3, 2), complex), np.ones((100, 3, 1), complex)
    with pytest.raises(ValueError, match=r"chunk 2 has shape \(100, 3, 1\).*100 lines and 2 inputs"):
        diagram_of_chunks(freq, [good, other], 4)
    with pytest.raises(ValueError, match="no FRFs"):
        diagram_of_chunks(freq, [], 4)
    good[3, 0, 0] = np.nan
    with pytest.raises(ValueError, match="chunk 1 holds 1 value that is not finite"):
        diagram_of_chunks(freq, [good], 4)
