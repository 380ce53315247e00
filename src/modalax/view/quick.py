r"""Residues at given poles, quick enough to follow a click.

Every line and channel weighs the same, so that all channels share one orthogonal factorisation,

.. math:: H_{oi}(s) = \sum_r \Big(\frac{z_{roi} s^p}{s - \lambda_r} + \frac{z_{roi}^* s^p}{s - \lambda_r^*}\Big)
          + U_{oi} s^p + W_{oi} s^{p-2}.

With one reference these are the residues of :func:`modalax.identify.residues` with ``weights="unit"``; with several,
the shape of a mode is the leading singular vector of its residues.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.kernels import kernels, residual_terms


class Synthesis(NamedTuple):
    """A modal model of given poles.

    Attributes
    ----------
    shapes
        Along the longer of outputs and inputs, the largest component of each 1, shape ``(n, dof)``.
    residues
        Of the receptance, shape ``(n, o, i)`` [m/(N s)].
    unexplained
        Part of the FRFs' sum of squares that is left.
    columns, coefficients
        Basis of all FRFs, complex ``(f, k)``, and the real coefficients of each channel, ``(k, o, i)``.
    """

    shapes: np.ndarray
    residues: np.ndarray
    unexplained: float
    columns: np.ndarray
    coefficients: np.ndarray

    def channel(self, lines: np.ndarray, output: int, input: int) -> np.ndarray:
        """One FRF at some lines, shape ``(line,)``."""
        return self.columns[lines] @ self.coefficients[:, output, input]

    def sum(self, lines: np.ndarray) -> np.ndarray:
        """Sum of the magnitudes of all FRFs at some lines, shape ``(line,)``."""
        columns, flat = self.columns[lines], self.coefficients.reshape(len(self.coefficients), -1)
        return np.hypot(columns.real @ flat, columns.imag @ flat).sum(axis=1)


class Responses:
    """FRFs made ready for fits of residues."""

    def __init__(self, frf: FRF):
        self.power = DERIVATIVES[frf.form]
        self.s = float(frf.added_decay) + 1j * np.asarray(frf.omega)
        self.H = np.asarray(frf.H)
        flat = self.H.reshape(len(self.s), -1)
        # The lower residual term of receptance and mobility is infinite at 0 Hz: that line has no say.
        self.used = np.flatnonzero((self.s != 0) | (self.power == 2))
        self.data = np.concatenate([flat[self.used].real, flat[self.used].imag])
        self.energy = float(np.vdot(self.data, self.data)) or 1.0

    def fit(self, poles: np.ndarray) -> Synthesis:
        """Residues and residual terms at some poles [rad/s], shape ``(n,)``.

        Raises
        ------
        ValueError
            If there are more unknowns than samples.
        """
        poles = np.asarray(poles, complex)
        terms = residual_terms(self.s, self.power, "complex")
        columns = np.concatenate([terms, kernels(self.s, self.power, poles, squares=False)], axis=1)
        A = np.concatenate([columns[self.used].real, columns[self.used].imag])
        if A.shape[1] > len(A):
            raise ValueError(f"{len(poles)} modes have {A.shape[1]} unknowns a channel; {len(self.used)} lines hold "
                             f"{len(A)} numbers: drop modes or widen the band")  # fmt: skip
        scale = np.linalg.norm(A, axis=0)
        Q, R = np.linalg.qr(A / scale)
        found = Q.T @ self.data
        x = solve_triangular(R, found, check_finite=False) / scale[:, None]
        left = max(self.energy - float(np.vdot(found, found)), 0.0) / self.energy
        x = x.reshape(-1, *self.H.shape[1:])
        z = x[terms.shape[1] :].reshape(len(poles), 2, *self.H.shape[1:])
        residues = z[:, 0] + 1j * z[:, 1]
        return Synthesis(_shapes(residues), residues, left, columns, x)


def _shapes(residues: np.ndarray) -> np.ndarray:
    """Leading left singular vector of each mode's residues, ``(longer side, shorter side)``, largest component 1."""
    long = residues if residues.shape[1] >= residues.shape[2] else np.swapaxes(residues, 1, 2)
    if not len(long):
        return np.zeros((0, long.shape[1]), complex)
    # From the small Gram matrix: an eigenvector of the shorter side, with a clear leading value.
    right = np.linalg.eigh(np.swapaxes(long.conj(), 1, 2) @ long)[1][:, :, -1]
    shapes = np.einsum("noi,ni->no", long, right)
    top = np.take_along_axis(shapes, np.argmax(np.abs(shapes), axis=1)[:, None], axis=1)
    return shapes / np.where(top == 0, 1.0, top)
