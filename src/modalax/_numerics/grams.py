"""Gram matrices of one set of complex columns under the weights of many channels, from one matrix product."""

import numpy as np

ALIKE = 1e-12  # relative difference of weights that rounding may make
LINES = 2048  # most lines of which products are formed at once: they stay near the processor


def weighted_grams(real: np.ndarray, imag: np.ndarray, weight: np.ndarray, numbers: int) -> np.ndarray:
    r"""Gram matrix of each channel, :math:`G_c = \mathrm{Re}(A^H\,\mathrm{diag}(w_c)\,A)` for columns ``A``.

    The products of all pairs of columns are formed once and serve every channel. Where weights change over the lines
    by the same factors in all channels, so does their sum.

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
    factor = weight.sum(axis=1)
    mean = weight.sum(axis=0) / max(factor.sum(), 1e-300)
    if len(weight) and np.allclose(weight, factor[:, None] * mean, rtol=ALIKE, atol=0.0):
        own = sum(part.T @ (mean[:, None] * part) for part in (real, imag))
        return factor[:, None, None] * (0.5 * (own + own.T))
    count = real.shape[1]
    row, column = np.tril_indices(count)
    lines = max(1, min(LINES, len(real), numbers // max(len(row), 1)))
    lower = np.zeros((len(row), len(weight)))
    pairs, part = np.empty((len(row), lines)), np.empty((count, lines))
    for start in range(0, len(real), lines):
        a, b = (np.ascontiguousarray(x[start : start + lines].T) for x in (real, imag))
        n = a.shape[1]
        for k in range(count):
            own = pairs[k * (k + 1) // 2 : (k + 1) * (k + 2) // 2, :n]  # in the order of the indices above
            np.multiply(a[: k + 1], a[k], out=own)
            own += np.multiply(b[: k + 1], b[k], out=part[: k + 1, :n])
        lower += pairs[:, :n] @ weight[:, start : start + lines].T
    gram = np.zeros((len(weight), count, count))
    gram[:, row, column] = lower.T
    gram[:, column, row] = lower.T
    return gram
