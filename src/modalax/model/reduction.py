r"""Few degrees of freedom for many, and back: transformations ``x = T x_a`` from the DoFs that are kept.

``T.T @ M @ T`` reduces a matrix; ``T @ shape`` expands a shape that was measured at the kept DoFs.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Float


def guyan(K: Any, kept: Sequence[int]) -> Float[np.ndarray, "n a"]:
    r"""Static transformation, :math:`x_c = -K_{cc}^{-1} K_{ca} x_a`: exact where no inertia acts on the other DoFs.

    Parameters
    ----------
    K
        Stiffness, shape ``(n, n)``.
    kept
        Positions of the DoFs that are kept, ``a`` of them.

    Raises
    ------
    ValueError
        If a position is not in K or stands twice, or the others are not held by the kept ones.

    References
    ----------
    R. J. Guyan, Reduction of stiffness and mass matrices, AIAA Journal 3 (1965) 380.
    """
    K = np.asarray(K, float)
    at, others = _split(kept, len(K))
    T = np.zeros((len(K), len(at)))
    T[at, np.arange(len(at))] = 1.0
    if len(others):
        try:
            factor = scipy.linalg.cho_factor(K[np.ix_(others, others)])
        except np.linalg.LinAlgError as error:
            raise ValueError(
                f"with the {len(kept)} kept DoFs held, the other {len(others)} can still move without force; keep more"
            ) from error
        T[others] = -scipy.linalg.cho_solve(factor, K[np.ix_(others, at)])
    return T


def serep(shapes: Any, kept: Sequence[int]) -> np.ndarray:
    r"""Transformation by modes, :math:`T = \Phi\,\Phi_a^+`: the modes taken are kept exactly.

    Parameters
    ----------
    shapes
        Modes of the model by row, shape ``(mode, n)``; no more than DoFs that are kept.
    kept
        Positions of the DoFs that are kept.

    Raises
    ------
    ValueError
        If there are more modes than kept DoFs, or these cannot tell the modes apart.

    References
    ----------
    J. O'Callahan, P. Avitabile, R. Riemer, System equivalent reduction expansion process, IMAC 7, 1989, 29-37.
    """
    shapes = np.atleast_2d(np.asarray(shapes))
    at, _ = _split(kept, shapes.shape[1])
    if len(shapes) > len(at):
        raise ValueError(f"{len(shapes)} modes at {len(kept)} kept DoFs; at most as many modes as DoFs are needed")
    part = shapes[:, at]
    values = np.linalg.svd(part / np.linalg.norm(part, axis=1, keepdims=True), compute_uv=False)
    if not np.isfinite(values).all() or values[-1] < 1e-6 * values[0]:
        raise ValueError(
            f"the {len(kept)} kept DoFs cannot tell the {len(shapes)} modes apart; keep others or take fewer"
        )
    return shapes.T @ np.linalg.pinv(part.T)


def _split(kept: Sequence[int], n: int) -> tuple[np.ndarray, np.ndarray]:
    index = np.asarray(kept, int)
    if not index.size or len(set(index.tolist())) < len(index) or index.min() < 0 or index.max() >= n:
        raise ValueError(f"kept DoFs {index.tolist()[:6]} must be different positions from 0 to {n - 1}")
    return index, np.setdiff1d(np.arange(n), index)
