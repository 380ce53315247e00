"""Least-squares complex frequency domain estimator (LSCF), with a common denominator."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from modalax.data.frf import FRF
from modalax.identify.polynomial import matrix_fraction, weights_of
from modalax.identify.tables import PoleTable

ARC = 0.8  # part of the unit circle that the band covers by default
RIDGE = 1e-29  # ridge relative to the mean diagonal of the normal matrix, which only keeps it regular


def lscf(
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
    r"""Poles by LSCF: minimise :math:`\sum_{oik} w_{oik}^2 |A(u_k) H_{oi}(\omega_k) - B_{oi}(u_k)|^2`.

    Parameters
    ----------
    frf
        The FRF, cut to the band of interest; its form does not matter.
    orders
        Degrees of the common denominator :math:`A`, which in complex coefficients is the number of poles.
    weights
        ``unit``, ``magnitude`` (:math:`|H|^{-1}`) or ``variance`` (:math:`\sigma^{-1}`).
    constraint
        What excludes :math:`A = 0`: ``a0`` (computational poles turn unstable, so the diagram is clear), ``aN``,
        or ``norm`` (:math:`\|a\| = 1`, total least squares).
    real
        Real instead of complex coefficients; poles then come in pairs mirrored about the lower band limit.
    arc
        Part of the unit circle that the band covers. Full (1) makes white noise act as a pure ridge; less lets the
        numerator follow the modes outside the band, to rounding from order 15 or so.
    ridge
        Added to the normal matrix, relative to its mean diagonal. The default only decides between solutions that
        fit equally well to rounding: the one of least norm.
    numerator
        Degree of the numerators for all orders; if None the largest order, so that one factorisation serves all, and
        by ``moments`` a tenth more. A
        numerator far above the order takes up much of what is no pole: orders that are to be read off FRFs of a
        non-linear structure are better computed each for itself.
    solver
        ``qr``: orthogonal factorisation, exact to rounding; ``moments``: the normal matrix, far faster for many
        outputs, but blind below :math:`10^{-8}` of the largest FRF; ``auto``: moments for large sets (over 60 FRFs of
        3000 lines at order 80).

    Returns
    -------
    PoleTable
        All roots; ``table.physical()`` tells which could be modes.

    Raises
    ------
    ValueError
        If the band holds too few lines for an order, or an option is unknown.

    Notes
    -----
    Guillaume, Verboven and Vanlanduit (1998); Guillaume et al. (2003), equations 1-12. By ``qr`` the normal matrix is
    never formed: its triangular factor comes from an orthogonal factorisation of the projected columns.
    """
    weight = weights_of(frf, weights)
    f = frf.H.shape[0]
    return matrix_fraction(
        frf, frf.H.reshape(f, -1, 1), weight.reshape(f, -1), orders=orders, constraint=constraint, real=real,
        arc=arc, ridge=jnp.asarray(ridge), numerator=numerator, shared=weights == "unit", solver=solver, method="lscf",
    )  # fmt: skip
