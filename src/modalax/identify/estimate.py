"""Modal parameters of largest likelihood with their joint covariance, from arrays to arrays, on the host."""

from typing import NamedTuple

import numpy as np

from modalax.identify.ascent import STATISTICAL, climb
from modalax.identify.information import covariance, joint_covariance, solution
from modalax.identify.kernels import pack, unpack
from modalax.identify.projection import Projection


class Estimate(NamedTuple):
    r"""Result of :func:`estimate`.

    Attributes
    ----------
    poles
        Shape ``(n,)`` [rad/s].
    shapes, participation
        Shapes ``(n, o)`` and ``(n, i)``; the participation is 1 at one reference of each mode.
    terms
        Coefficients of the further terms, shape ``(o, i, t)``.
    covariance
        Of :math:`\ln\omega` of all modes, :math:`\ln\zeta` of all modes, then real and then imaginary parts of the
        residues in the order ``(n, o, i)``; shape ``(2 n + 2 n o i, ...)``; None where it was not asked for.
    chi2, dof
        Sum of squares of the whitened residual (real and imaginary parts), and its degrees of freedom.
    residual
        Whitened residual, complex with unit variance, shape ``(f, o, i)``.
    finished
        Whether the search came to an end of its own.
    """

    poles: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    terms: np.ndarray
    covariance: np.ndarray | None
    chi2: float
    dof: int
    residual: np.ndarray
    finished: bool

    @property
    def residues(self) -> np.ndarray:
        """Residues of the receptance, shape ``(n, o, i)``."""
        return self.shapes[:, :, None] * self.participation[:, None, :]


def estimate(
    s: np.ndarray,
    H: np.ndarray,
    sigma: np.ndarray,
    poles: np.ndarray,
    participation: np.ndarray | None = None,
    *,
    power: int = 0,
    terms: np.ndarray | None = None,
    real_modes: bool = False,
    held: np.ndarray | None = None,
    joint: bool = True,
    max_steps: int = 60,
    tol: float = STATISTICAL,
) -> Estimate:
    r"""Maximise the likelihood of FRFs over poles, participation, shapes and coefficients of further terms.

    Parameters
    ----------
    s
        Where the FRFs were measured, :math:`\sigma + j\omega`, shape ``(f,)`` [1/s].
    H, sigma
        FRFs and the standard deviation of each complex sample, shape ``(f, o, i)``; an infinite one leaves it out.
    poles, participation
        The start, shapes ``(n,)`` [rad/s] and ``(n, i)``; participation from the FRFs if None.
    power
        Number of time derivatives of the FRFs: 0, 1, 2 for receptance, mobility, accelerance.
    terms, real_modes
        As for :class:`Projection`.
    held
        Modes whose damping keeps its value, shape ``(n,)``; none if None.
    joint
        Whether to compute the joint covariance, which has ``2 n (1 + o i)`` rows.
    max_steps, tol
        As for :func:`modalax.identify.ascent.climb`.

    Raises
    ------
    ValueError
        If shapes do not belong together, a deviation is not above zero, or there are more unknowns than samples.
    """
    s, H, poles = np.asarray(s, complex), np.asarray(H, complex), np.asarray(poles, complex)
    if H.ndim != 3 or len(H) != len(s):
        raise ValueError(f"FRFs of shape {H.shape} at {len(s)} lines; they need the shape (lines, outputs, inputs)")
    sigma = np.broadcast_to(np.asarray(sigma, float), H.shape)
    if not (sigma > 0).all():
        raise ValueError(f"{np.sum(~(sigma > 0))} standard deviations are not above zero; each needs to be")
    weight = np.sqrt(2) / sigma
    projection = Projection(s, H, weight, power=power, terms=terms, real_modes=real_modes)
    dof = projection.degrees_of_freedom(len(poles))
    if dof <= 0:
        raise ValueError(f"{projection.samples} samples are too few for {projection.samples - dof} unknowns")
    if participation is None:
        participation = participation_of(projection, poles)
    part = np.asarray(participation, complex)
    pivot = np.argmax(np.abs(part), axis=1)
    free = np.zeros(len(poles)) if held is None else np.asarray(held, float)
    at = climb(projection, pack(poles, part, pivot), pivot, free, max_steps=max_steps, tol=tol)
    modes = unpack(at.theta, at.pivot, real_modes)
    x, left, _, coefficients = solution(projection, at)
    return Estimate(
        modes.poles, np.einsum("onc,nc->no", x, modes.unit), modes.participation, coefficients,
        joint_covariance(projection, at, covariance(projection, at)) if joint else None,
        2 * at.sums.cost, dof, np.moveaxis(left, 2, 0) / np.sqrt(2), at.finished,
    )  # fmt: skip


def participation_of(projection: Projection, poles: np.ndarray) -> np.ndarray:
    """Participation of each mode, ``(n, i)``: the leading factor of its residues when all are fitted freely."""
    n, inputs, real_modes = len(poles), projection.inputs, projection.real_modes
    if inputs == 1:
        return np.ones((n, 1), complex)
    pivot, one = np.zeros(n, int), np.ones((n, 1), complex)
    theta = pack(poles, one, pivot)
    unit = unpack(theta, pivot, real_modes).unit
    columns = []
    for i in range(inputs):
        blocks = projection.of_input(i).blocks(theta, pivot, np.zeros(n), squares=False)
        x = np.concatenate([block.unknowns() for block in blocks])
        columns.append(np.einsum("onc,nc->no", x.reshape(len(x), *unit.shape), unit))
    matrices = np.stack(columns, axis=2)
    # The right factor from the small Gram matrix: an eigenvector of i x i, with a clear leading value.
    leading = np.linalg.eigh(np.swapaxes(matrices.conj(), 1, 2) @ matrices)[1][:, :, -1].conj()
    if real_modes:
        top = np.take_along_axis(leading, np.argmax(np.abs(leading), axis=1)[:, None], 1)
        leading = (leading / top).real.astype(complex)
    return leading
