"""Gram matrices of one set of complex columns under the weights of many channels, from one matrix product."""

import numpy as np


def weighted_grams(real: np.ndarray, imag: np.ndarray, weight: np.ndarray, numbers: int) -> np.ndarray:
    r"""Gram matrix of each channel, :math:`G_c = \mathrm{Re}(A^H\,\mathrm{diag}(w_c)\,A)` for columns ``A``.

    The products of all pairs of columns are formed once and serve every channel.

    Parameters
    ----------
    real, imag
        Parts of the columns, shape ``(f, k)``.
    weight
        Weight of each line, shape ``(channel, f)``.
    numbers
        How many numbers the products of pairs of columns may take at once; more are formed in blocks of lines.

    Returns
    -------
    np.ndarray
        Symmetric matrices, shape ``(channel, k, k)``.
    """
    count = real.shape[1]
    row, column = np.tril_indices(count)
    lines = max(1, numbers // max(len(row), 1))
    lower = np.zeros((len(weight), len(row)))
    for start in range(0, len(real), lines):
        part = slice(start, start + lines)
        pair = real[part][:, row] * real[part][:, column]
        pair += imag[part][:, row] * imag[part][:, column]
        lower += weight[:, part] @ pair
    gram = np.zeros((len(weight), count, count))
    gram[:, row, column] = lower
    gram[:, column, row] = lower
    return gram
