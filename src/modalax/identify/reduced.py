r"""Least squares of shapes in reduced coordinates, with its derivatives by the unknowns of the poles.

The lines of the FRFs no longer appear: with the triangular factor :math:`U` of a channel's basis, of which the further
terms are eliminated, its data are :math:`\beta`, its columns :math:`A = U_g a + U_h b` with few real pairs, and
everything has as many rows as the basis has columns. Arrays have one axis for references and one for these rows.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

TINY = 1e-14  # diagonal of a triangular factor whose column depends on those before it
OWN = 1e-6  # part of a derivative's squares outside the columns, from which on a difference of squares tells it


class Sums(NamedTuple):
    """Half the squared residual, its gradient in the unknowns, and the Gauss-Newton matrix."""

    cost: float
    gradient: np.ndarray
    matrix: np.ndarray


class Row(NamedTuple):
    """Contribution of one output to the cost and its derivatives.

    Attributes
    ----------
    x
        Unknowns of the shape components, shape ``(n c,)``.
    inverse
        Inverse of the triangular factor of their columns: ``inverse @ inverse.T`` is their covariance.
    coupling
        Change of ``x`` with the non-linear unknowns, shape ``(n c, p)``.
    projected
        Makes the derivatives less what the linear unknowns make of them, shape ``(i, k, p)``.
    residual
        Shape ``(i, k)``.
    lines
        Makes the orthonormal columns of the reduced rows over the samples, ``(i, 2 f, k)``: real parts, then imaginary.
    """

    x: np.ndarray
    inverse: np.ndarray
    coupling: np.ndarray
    projected: Callable[[], np.ndarray]
    residual: np.ndarray
    lines: Callable[[], np.ndarray]


class Slopes(NamedTuple):
    """Real pairs of the columns ``(n, i, c, 2)``, of derivatives on kernels and on squares ``(n, i, c, q, 2)``."""

    columns: np.ndarray
    plain: np.ndarray
    squared: np.ndarray


def combined(pair: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Columns from pairs ``(..., n, 2)`` and real pairs of coefficients ``(..., n, q, 2)``: shape ``(..., n, q)``."""
    return pair[..., None, 0] * coefficients[..., 0] + pair[..., None, 1] * coefficients[..., 1]


def factor(A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """QR of columns scaled to unit norm; also usable on dependent columns, also of stacks of matrices."""
    rows, columns = A.shape[-2:]
    if rows < columns:
        raise np.linalg.LinAlgError(f"{rows} rows do not tell {columns} columns apart")
    norm = np.linalg.norm(A, axis=-2)
    norm = np.where(norm > 0, norm, 1.0)
    Q, R = np.linalg.qr(A / norm[..., None, :])
    index = np.arange(R.shape[-1])
    diagonal = R[..., index, index]
    R[..., index, index] = np.where(np.abs(diagonal) < TINY, TINY, diagonal)
    return Q, R, norm


class SharedOutputs:
    r"""Outputs of one common weight: of one factorisation, and derivatives that are products of column and shape.

    Parameters
    ----------
    U, beta
        Shapes ``(i, k, 4 n)`` and ``(i, k, o)``.
    rest
        Squares of the data outside the basis.
    slopes
        Of the columns.
    lines
        Makes the columns of the reduced rows over the samples, of an output by its number.
    size
        Weight of each output, relative to that of the factorisation, shape ``(o,)``.
    """

    def __init__(
        self, U: np.ndarray, beta: np.ndarray, rest: float, slopes: Slopes, lines: Callable[[int], np.ndarray],
        size: np.ndarray,
    ):  # fmt: skip
        i, k, _ = U.shape
        n, _, c, q, _ = slopes.plain.shape
        self.inputs, self.n, self.c, self.q, self.size = i, n, c, q, size
        g, h = U[..., : 2 * n].reshape(i, k, n, 2), U[..., 2 * n :].reshape(i, k, -1, 2)
        A = combined(g, np.moveaxis(slopes.columns, 1, 0)[:, None]).reshape(i * k, n * c)
        self.Q, self.R, self.norm = factor(A)
        data = beta.reshape(i * k, -1)
        projected = self.Q.T @ data
        self.x = solve_triangular(self.R, projected, check_finite=False) / self.norm[:, None]
        self.residual = data - self.Q @ projected
        self.cost = 0.5 * (float(np.sum(self.residual**2)) + rest)
        self._parts, self._lines = (g, h, slopes), lines

    def _derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all columns, and their parts along these: ``(i k, n q c)``, ``(n c, n q c)``."""
        g, h, slopes = self._parts
        order = lambda part: np.transpose(part, (1, 0, 3, 2, 4)).reshape(self.inputs, 1, self.n, -1, 2)
        B = combined(g, order(slopes.plain)) + combined(h, order(slopes.squared))
        B = B.reshape(len(self.residual), -1)
        return B, self.Q.T @ B

    def sums(self) -> Sums:
        """Cost, gradient and matrix over all outputs."""
        n, c, q = self.n, self.c, self.q
        weight = (self.x @ self.x.T).reshape(n, 1, c, n, 1, c)
        matrix = np.sum(self._products().reshape(n, q, c, n, q, c) * weight, axis=(2, 5))
        return Sums(self.cost, -np.sum(self.scores(), axis=0), matrix.reshape(n * q, n * q))

    def _basis(self) -> tuple[np.ndarray, np.ndarray]:
        """Basis mode after mode ``(i, k, n, 4)``, and the coefficients of the derivatives in it ``(i, n, 4, q, c)``."""
        g, h, slopes = self._parts
        made = np.concatenate([slopes.plain, slopes.squared], axis=4)
        return np.concatenate([g, h], axis=3), np.transpose(made, (1, 0, 4, 3, 2))

    def _products(self) -> np.ndarray:
        """Inner products of the derivatives less their parts along the columns, shape ``(n q c, n q c)``.

        A derivative holds one mode's few columns of the basis, so that the products of these are all it takes.
        """
        n, size = self.n, self.q * self.c
        basis, made = self._basis()
        whole = np.zeros((n, size, n * size))
        for U, C in zip(basis, made.reshape(self.inputs, n, 4, size), strict=True):
            flat = U.reshape(len(U), -1)
            gram = np.moveaxis((flat.T @ flat).reshape(4 * n, n, 4), 1, 0)
            right = np.moveaxis(gram @ C, 0, 1).reshape(n, 4, -1)
            whole += np.swapaxes(C, 1, 2) @ right
        whole = whole.reshape(n * size, -1)
        B, along = self._derivatives()
        own = whole - along.T @ along
        if (np.diag(own) < OWN * np.diag(whole)).any():
            B = B - self.Q @ along
            own = B.T @ B
        return own

    def scores(self) -> np.ndarray:
        """What each output adds to the slope of half the sum of squares, its sign turned: shape ``(o, p)``."""
        basis, made = self._basis()
        x = self.x.reshape(self.n, self.c, -1)
        total = np.zeros((self.n, self.q, x.shape[2]))
        for U, C, left in zip(basis, made, self.residual.reshape(self.inputs, -1, x.shape[2]), strict=True):
            along = (U.reshape(len(U), -1).T @ left).reshape(self.n, 4, -1)
            for k in range(self.c):
                total += np.swapaxes(C[..., k], 1, 2) @ along * x[:, k, None]
        return total.reshape(self.n * self.q, -1).T

    def unknowns(self) -> np.ndarray:
        """Unknowns of the shapes of all outputs, shape ``(o, n c)``."""
        return self.x.T / self.size[:, None]

    def solution(self) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of the shapes of all outputs ``(o, n c)`` and the inverse of their triangular factors."""
        inverse = solve_triangular(self.R, np.eye(len(self.R)), check_finite=False) / self.norm[:, None]
        return self.unknowns(), inverse / self.size[:, None, None]

    def rows(self) -> Iterator[Row]:
        """Output after output."""
        n, c, q = self.n, self.c, self.q
        B, along = self._derivatives()
        B = (B - self.Q @ along).reshape(self.inputs, -1, n * q, c)
        inverse = solve_triangular(self.R, np.eye(len(self.R)), check_finite=False) / self.norm[:, None]
        coupling = (inverse @ along).reshape(n * c, n * q, c)
        for k, (x, size, residual) in enumerate(zip(self.x.T, self.size, self.residual.T, strict=True)):
            own = np.repeat(x.reshape(n, c), q, axis=0)
            yield Row(
                x / size, inverse / size, np.einsum("apc,pc->ap", coupling, own) / size,
                partial(np.einsum, "ikpc,pc->ikp", B, own), residual.reshape(self.inputs, -1), partial(self._lines, k),
            )  # fmt: skip


class OwnOutputs:
    """Outputs with different weights; arrays as in :class:`SharedOutputs` with a first axis for outputs.

    Parameters
    ----------
    U, beta
        Shapes ``(o, i, k, 4 n)`` and ``(o, i, k)``.
    rest
        Squares of the data outside the basis.
    slopes
        Of the columns.
    lines
        Makes the columns of the reduced rows over the samples, of an output by its number.
    """

    def __init__(
        self, U: np.ndarray, beta: np.ndarray, rest: float, slopes: Slopes, lines: Callable[[int], np.ndarray]
    ):
        o, i, k, _ = U.shape
        n, _, c, q, _ = slopes.plain.shape
        self.inputs, self.n, self.c, self.q = i, n, c, q
        g, h = U[..., : 2 * n].reshape(o, i, k, n, 2), U[..., 2 * n :].reshape(o, i, k, -1, 2)
        A = combined(g, np.moveaxis(slopes.columns, 1, 0)[None, :, None]).reshape(o, i * k, n * c)
        self.Q, self.R, self.norm = factor(A)
        data = beta.reshape(o, i * k, 1)
        projected = np.swapaxes(self.Q, 1, 2) @ data
        self.x = np.linalg.solve(self.R, projected)[..., 0] / self.norm
        self.residual = (data - self.Q @ projected)[..., 0]
        self.cost = 0.5 * (float(np.sum(self.residual**2)) + rest)
        self._parts, self._lines = (g, h, slopes), lines

    def _derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        """Projected derivatives, and their parts along the columns: ``(o, i k, n q)``, ``(o, n c, n q)``."""
        g, h, slopes = self._parts
        x = self.x.reshape(-1, self.n, self.c)
        plain, squared = (np.einsum("onc,nicqe->oinqe", x, part) for part in (slopes.plain, slopes.squared))
        D = combined(g, plain[:, :, None]) + combined(h, squared[:, :, None])
        D = D.reshape(*self.residual.shape, -1)
        along = np.swapaxes(self.Q, 1, 2) @ D
        return D - self.Q @ along, along

    def sums(self) -> Sums:
        """Cost, gradient and matrix over these outputs."""
        P, _ = self._derivatives()
        P = P.reshape(-1, P.shape[2])
        return Sums(self.cost, -self.residual.ravel() @ P, P.T @ P)

    def scores(self) -> np.ndarray:
        """What each output adds to the slope of half the sum of squares, its sign turned: shape ``(o, p)``."""
        return np.einsum("ok,okp->op", self.residual, self._derivatives()[0])

    def unknowns(self) -> np.ndarray:
        """Unknowns of the shapes of all outputs, shape ``(o, n c)``."""
        return self.x

    def solution(self) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of the shapes of all outputs ``(o, n c)`` and the inverse of their triangular factors."""
        return self.x, np.linalg.inv(self.R) / self.norm[:, :, None]

    def rows(self) -> Iterator[Row]:
        """Output after output."""
        P, along = self._derivatives()
        x, inverses = self.solution()
        coupling = inverses @ along
        for k, projected in enumerate(P):
            yield Row(
                x[k], inverses[k], coupling[k], partial(projected.reshape, self.inputs, -1, projected.shape[1]),
                self.residual[k].reshape(self.inputs, -1), partial(self._lines, k),
            )  # fmt: skip
