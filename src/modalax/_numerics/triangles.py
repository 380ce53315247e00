"""Systems of triangular matrices, which cost a fraction of what a general solver takes for them."""

import numpy as np
from scipy.linalg.lapack import dtrtri, dtrtrs


def forward(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of ``L x = b`` for a lower triangular ``L`` and one or more right-hand sides, shape ``(n, ...)``."""
    return _solved(L, b, turned=1)


def backward(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of ``L' x = b`` for a lower triangular ``L`` and one or more right-hand sides, shape ``(n, ...)``."""
    return _solved(L, b, turned=0)


def inverse_of(L: np.ndarray) -> np.ndarray:
    """Inverse of a lower triangular ``L``, shape ``(n, n)``."""
    if not len(L):  # the library prints that a matrix without rows is wrong
        return L.copy()
    inverse, wrong = dtrtri(L.T, lower=0)
    if wrong:
        raise np.linalg.LinAlgError("a triangular matrix has a zero on its diagonal")
    return inverse.T


def _solved(L: np.ndarray, b: np.ndarray, turned: int) -> np.ndarray:
    """By the upper triangle ``L'``, which is how the library sees a matrix of NumPy."""
    x, wrong = dtrtrs(L.T, b.reshape(len(b), -1), lower=0, trans=turned)
    if wrong:
        raise np.linalg.LinAlgError("a triangular matrix has a zero on its diagonal")
    return x.reshape(b.shape)
