r"""Covariances of everything that a projection estimates, on the host.

Given the unknowns :math:`\theta` of poles and participation the outputs are independent, so that a function :math:`g`
of everything has the variance

.. math:: v^T\mathrm{cov}(\theta)v + \sum_o g_{x_o}^T R_o^{-1}R_o^{-T} g_{x_o}, \qquad
          v = g_\theta - \sum_o G_o^T g_{x_o},

with :math:`R_o` the triangular factor of the shape's columns and :math:`G_o` the change of the shape with
:math:`\theta`.
"""

from collections.abc import Iterator

import numpy as np

from modalax.identify.ascent import Ascent, frozen
from modalax.identify.kernels import coefficient_slopes, coefficients, pairs, unpack
from modalax.identify.projection import Projection
from modalax.identify.reduced import Row

LAGS = 8  # lines over which a residual that is not white is taken to be correlated
WORK = 1e12  # operations from which on samples that are independent count by rows too, where there are many
MANY = 20  # rows from which on their scores tell how much rows differ


def rows(projection: Projection, at: Ascent) -> Iterator[Row]:
    """Contributions of the outputs at the end of a search."""
    for block in projection.blocks(at.theta, at.pivot, at.held):
        yield from block.rows()


def covariance(
    projection: Projection, at: Ascent, *, kind: str = "gauss-newton", inflate: float = 1.0, white: bool = True
) -> np.ndarray:
    r"""Covariance of the non-linear unknowns, :math:`\ln\omega, \ln\zeta` and participation of each mode.

    Parameters
    ----------
    projection, at
        The data, and where the search ended.
    kind
        ``gauss-newton``: the inverse of Fisher's information; ``sandwich``; or ``robust``, as for
        :func:`modalax.identify.refine`.
    inflate
        Factor on the variances of the weights.
    white
        Whether samples of neighbouring lines are taken to be independent.

    Returns
    -------
    array
        Shape ``(p, p)``, zero for unknowns that the data does not see.
    """
    free = frozen(at.theta, at.held, projection.real_modes).ravel() == 0
    S = np.where(np.outer(free, free), at.sums.matrix, 0.0) + np.diag(1.0 * ~free)
    inverse = inverse_information(S) * np.outer(free, free)
    plain = inverse * inflate
    if kind == "gauss-newton":
        return plain
    sandwich = inverse @ _scores(projection, at, kind == "sandwich" or white) @ inverse
    if kind == "sandwich":
        return sandwich
    own = np.diag(sandwich)
    grow = np.sqrt(np.maximum(np.diag(plain) / np.where(own > 0, own, 1.0), 1.0))
    return sandwich * grow[:, None] * grow


def inverse_information(S: np.ndarray) -> np.ndarray:
    """Inverse of an information matrix; zero for unknowns of which it tells no more than rounding.

    With a unit diagonal, the inverse's diagonal is by how much each variance grows because the other unknowns are
    unknown too: at least one, and a number without meaning from the inverse of rounding on. Where there is such a one,
    directions that are not seen count by rounding, and unknowns that these take half of the digits from are not told.
    """
    root = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
    scaled, rounding = S / np.outer(root, root), len(S) * np.finfo(float).eps
    inverse, sound = scaled, False
    try:
        inverse = np.linalg.inv(scaled)
        sound = bool((np.diag(inverse) > 0.5).all() and (np.diag(inverse) < 1 / rounding).all())
    except np.linalg.LinAlgError:
        pass
    if not np.isfinite(scaled).all():
        return np.zeros(S.shape)
    if not sound:
        size, directions = np.linalg.eigh(scaled)
        inverse = (directions / np.maximum(size, rounding * size[-1])) @ directions.T
        seen = np.diag(inverse) < 1 / np.sqrt(np.finfo(float).eps)
        inverse = inverse * np.outer(seen, seen)
    return inverse / np.outer(root, root)


def _scores(projection: Projection, at: Ascent, white: bool) -> np.ndarray:
    """Outer products of the gradient's parts: of samples, or of lines close to each other, or of whole rows."""
    total, f = np.zeros((at.theta.size, at.theta.size)), len(projection.s)
    work = 2 * at.theta.size * projection.y.size * 4 * len(at.theta)  # of the scores of all samples
    if projection.outputs >= MANY and (not white or work > WORK):
        slopes = np.concatenate([block.scores() for block in projection.blocks(at.theta, at.pivot, at.held)])
        return slopes.T @ slopes
    _, left, _, _ = solution(projection, at)
    for row, residual in zip(rows(projection, at), left, strict=True):
        columns = row.lines() @ row.projected()
        scores = columns[:, :f] * residual.real[..., None] + columns[:, f:] * residual.imag[..., None]
        if white:
            scores = scores.reshape(-1, total.shape[0])
            total += scores.T @ scores
        else:
            total += lagged(scores.sum(axis=0))
    return total


def lagged(scores: np.ndarray) -> np.ndarray:
    r"""Scores of neighbouring lines together, :math:`\sum_l (1-|l|/L)\sum_k s_ks_{k+l}^T` (Newey, West 1987)."""
    padded = np.pad(scores, ((LAGS, LAGS), (0, 0)))
    triangle = 1 - np.abs(np.arange(-LAGS, LAGS + 1)) / (LAGS + 1)
    near = sum(triangle[k] * padded[k : k + len(scores)] for k in range(2 * LAGS + 1))
    return scores.T @ near


def solution(projection: Projection, at: Ascent) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Shapes, residual, evidence, and coefficients of the further terms at the end of a search.

    Returns
    -------
    tuple
        Unknowns of the shapes ``(o, n, c)``; whitened residual ``(o, i, f)``; by how much the sum of squares would
        rise without each mode, shape ``(n,)``; and coefficients of the further terms ``(o, i, t)``.
    """
    modes = unpack(at.theta, at.pivot, projection.real_modes)
    n, c = modes.unit.shape
    found, evidence = [], np.zeros(n)
    for block in projection.blocks(at.theta, at.pivot, at.held, squares=False):
        x, inverse = block.solution()
        parts = inverse.reshape(len(x), n, c, -1)
        shape = x.reshape(len(x), n, c, 1)
        evidence += np.sum(shape * _solved(parts @ np.swapaxes(parts, 2, 3), shape), axis=(0, 2, 3))
        found.append(x)
    x = np.concatenate(found)
    terms, left = projection.remainder(x, modes)
    return x.reshape(len(x), n, c), left, evidence, terms


def _solved(covariance: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Covariances' inverses times shapes; nothing where the data do not see a component at all."""
    try:
        return np.linalg.solve(covariance, shape)
    except np.linalg.LinAlgError:
        seen = np.isfinite(covariance).all(axis=(2, 3), keepdims=True)
        return np.linalg.pinv(np.where(seen, covariance, 0.0), hermitian=True) @ shape


def joint_covariance(projection: Projection, at: Ascent, cov: np.ndarray, inflate: float = 1.0) -> np.ndarray:
    r"""Covariance of poles and residues together.

    Parameters
    ----------
    projection, at
        The data, and where the search ended.
    cov
        Covariance of the non-linear unknowns, from :func:`covariance`.
    inflate
        Factor on the variances of the weights.

    Returns
    -------
    array
        Of :math:`\ln\omega` of all modes, :math:`\ln\zeta` of all modes, then real and then imaginary parts of the
        residues :math:`\psi_{ro}L_{ri}`, both in the order ``(n, o, i)``.
    """
    modes = unpack(at.theta, at.pivot, projection.real_modes)
    plain, _ = coefficient_slopes(modes, at.pivot)
    columns = pairs(coefficients(modes))
    n, i, c, _ = columns.shape
    o, p = projection.outputs, at.theta.size
    slope = np.zeros((2, n, o, i, p))  # of the residues in theta, the shapes following
    own = np.zeros((2, n, o, i, 2, n, i))
    mode = np.arange(n)
    for k, row in enumerate(rows(projection, at)):
        x = row.x.reshape(n, c)
        direct = np.zeros((2, n, i, n, p // n))
        direct[:, mode, :, mode] = np.moveaxis(pairs(np.einsum("nc,nicq->niq", x, plain)), 3, 1)
        follow = np.einsum("nice,ncp->enip", columns, row.coupling.reshape(n, c, p))
        slope[:, :, k] = direct.reshape(2, n, i, p) - follow
        made = np.einsum("nice,ncm->enim", columns, row.inverse.reshape(n, c, -1)).reshape(2 * n * i, -1)
        own[:, :, k] = (inflate * made @ made.T).reshape(2, n, i, 2, n, i)
    poles = np.zeros((2, n, p))
    for q in (0, 1):
        poles[q, mode, mode * (p // n) + q] = 1
    J = np.concatenate([poles.reshape(2 * n, p), slope.reshape(-1, p)])
    total = J @ cov @ J.T
    part = total[2 * n :, 2 * n :].reshape(2, n, o, i, 2, n, o, i)
    for k in range(o):
        part[:, :, k, :, :, :, k] += own[:, :, k]
    return total
