r"""A mode answers with one shape whatever drives it: residues :math:`A_{oi} = \psi_o l_i` are of rank one.

Turned signs, exchanged channels, wrong constants and delays of whole channels leave them so; a single FRF that differs
from what its row and its column say does not, and no exchange of channels explains it.
"""

from collections.abc import Iterable

import numpy as np

from modalax.check.finding import deviations
from modalax.check.study import Study

# Relative error of a residue that is not in its standard deviation (of the ratio of two: 0.02); deviations from which
# on a shape is another.
MODE_ERROR, SURE = 0.014, 6.0


def other_shape(study: Study, frfs: Iterable[tuple[int, int]]) -> float:
    """How far single FRFs (output, input) are from the shapes that the others give: of another shape from 1 on.

    Standard deviations as unlikely as the squares of one mode or of all together, over ``SURE``. Modes that share their
    bandwidths have no single shape and are left out; 0 with one row or one column.
    """
    _, residues, spread = study.summed
    single = np.array([len(g) == 1 for g in study.groups], bool)
    A, std = residues[single], np.hypot(spread, study.unsure)[single]
    if not len(A) or min(A.shape[1:]) < 2:
        return 0.0
    std = np.hypot(std, MODE_ERROR * np.abs(A)) + np.finfo(float).tiny
    squares = [2 * _deviations(A, std, o, i) ** 2 for o, i in frfs]
    each = [max(deviations(float(s.max()), 2), deviations(float(s.sum()), 2 * len(A))) for s in squares]
    return max(each, default=0.0) / SURE


def _deviations(A: np.ndarray, std: np.ndarray, o: int, i: int) -> np.ndarray:
    r"""Standard deviations by which each mode's :math:`A_{oi} A_{pj} - A_{oj} A_{pi}` is not zero, ``(n,)``.

    Of all other rows p and columns j those are taken whose product is known best.
    """
    rows, columns = (np.delete(np.arange(n), k) for n, k in zip(A.shape[1:], (o, i), strict=True))
    own, across = A[:, o, i, None, None], A[:, rows][:, :, columns]
    row, column = A[:, o, columns][:, None, :], A[:, rows, i][:, :, None]
    error = np.sqrt(
        np.abs(across) ** 2 * std[:, o, i, None, None] ** 2 + np.abs(own) ** 2 * std[:, rows][:, :, columns] ** 2
        + np.abs(column) ** 2 * std[:, o, columns][:, None] ** 2 + np.abs(row) ** 2 * std[:, rows, i][:, :, None] ** 2
    )  # fmt: skip
    size = np.abs(row * column)
    best = np.argmax((size / error).reshape(len(A), -1), axis=1)
    at = np.arange(len(A)), best
    return np.abs(own * across - row * column).reshape(len(A), -1)[at] / error.reshape(len(A), -1)[at]
