"""Polyreference least-squares complex frequency domain estimator (pLSCF), with a right matrix fraction."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from modalax.data.frf import FRF
from modalax.identify.lscf import ARC, RIDGE
from modalax.identify.polynomial import matrix_fraction, over_references, weights_of
from modalax.identify.tables import PoleTable


def plscf(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    weights: str = "unit",
    constraint: str = "a0",
    real: bool = False,
    arc: float = ARC,
    ridge: Float[Array, ""] | float = RIDGE,
    numerator: int | None = None,
    solver: str = "auto",
) -> PoleTable:
    r"""Poles and participation by pLSCF: :math:`\sum_{ok} \|w_{ok} (H_o(\omega_k) A(u_k) - B_o(u_k))\|^2 \to \min`.

    The inputs are the references. Of a test with few outputs and many inputs (roving hammer) pass
    ``frf.transpose()``.

    Parameters
    ----------
    frf
        The FRF, cut to the band of interest.
    orders
        Degrees of the matrix polynomial; order ``n`` with ``i`` references has ``n i`` poles.
    weights, constraint, real, arc, ridge, numerator, solver
        As for :func:`lscf`, with matrix coefficients (:math:`A_0 = I` and so on). Weights are averaged over the
        references, :math:`w_{ok}^{-2} = \mathrm{mean}_i w_{oik}^{-2}`.

    Returns
    -------
    PoleTable
        With participation factors, the row vectors :math:`w^T A(u) = 0`.

    Raises
    ------
    ValueError
        If the band holds too few lines for an order, or an option is unknown.

    Notes
    -----
    Guillaume et al. (2003); Peeters et al. (2004), equations 1-14.
    """
    # One weight a line and output: the references of a row share their numerator.
    weight = over_references(weights_of(frf, weights))
    return matrix_fraction(
        frf, frf.H, weight, orders=orders, constraint=constraint, real=real, arc=arc, ridge=jnp.asarray(ridge),
        numerator=numerator, shared=weights == "unit", solver=solver, method="plscf",
    )  # fmt: skip
