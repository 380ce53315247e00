r"""The linear problem behind LSCF and pLSCF, with what noise adds to its normal matrix.

White noise on the FRFs adds to the expected normal matrix exactly

.. math:: E[\tilde M] = M_0 + C, \qquad C = \Phi^H \mathrm{diag}\Big(\sum_o w_o^2 \sigma_o^2 (1 - \ell_o)\Big) \Phi,

with :math:`\Phi_{kj} = u_k^j` the powers of the variable on the lines and :math:`\ell_{ok}` the leverage of line
:math:`k` on the numerator of output :math:`o`: the diagonal of the projector on the numerator's space. Everything is
kept as triangular factors, so that nothing is squared.
"""

from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Inexact

from modalax._numerics.checks import as_array, as_double
from modalax._numerics.known import Numbers, by_numpy, scan
from modalax._numerics.powers import powers, powers_of
from modalax.data.frf import FRF
from modalax.identify.fraction import check_constraint
from modalax.identify.lscf import ARC, RIDGE
from modalax.identify.polynomial import limits, over_references, triangular_factor, weights_of
from modalax.identify.zoom import Zoom, check_orders, orthonormal_powers, zoom

METHODS = ("lscf", "plscf")


class LinearProblem(eqx.Module):
    r"""Rows :math:`w (H A - B)` of LSCF (one reference per row) or pLSCF (all references in a row).

    Attributes
    ----------
    H
        FRFs by row, shape ``(f, row, i)``.
    weight
        Weight of each line of each row, shape ``(f, row)``.
    variance
        Noise variance of each sample, shape ``(f, row, i)``.
    zoomed
        The map of the band on the circle.
    u
        The variable on the lines, shape ``(f,)``.
    ridge
        Ridge relative to the mean diagonal of the normal matrix.
    order, numerator
        Degrees of the denominator and of the numerators.
    real, shared
        Real coefficients; one weight for all rows.
    """

    H: Complex[Array, "f row i"]
    weight: Float[Array, "f row"]
    variance: Float[Array, "f row i"]
    zoomed: Zoom
    u: Complex[Array, " f"]
    ridge: Float[Array, ""]
    order: int = eqx.field(static=True)
    numerator: int = eqx.field(static=True)
    real: bool = eqx.field(static=True)
    shared: bool = eqx.field(static=True)
    constraint: str = eqx.field(static=True)
    method: str = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Width of one coefficient: 1 for a common denominator, the number of references otherwise."""
        return self.H.shape[2]

    def powers(self) -> Complex[Array, "f k"]:
        """The powers 0 to ``order`` of the variable on the lines."""
        return powers(self.u, self.order + 1)

    def basis_of(self, weight: Float[Numbers, " f"], xp: ModuleType = jnp) -> Numbers:
        """Orthonormal basis of the numerators of a row with this weight, by JAX or NumPy."""
        return orthonormal_powers(xp, self.u, weight, self.numerator, self.real)


def variance_of(frf: FRF, variance: Any) -> Float[Array, "f o i"]:
    """The variance given, or else that of the FRF.

    Raises
    ------
    ValueError
        If neither exists.
    """
    if variance is None:
        variance = frf.variance
    if variance is None:
        raise ValueError("the bias needs a noise variance; this FRF has none: pass variance=, one number or (f, o, i)")
    return jnp.broadcast_to(as_double(variance, "variance"), frf.H.shape)


def linear_problem(
    frf: FRF,
    order: int,
    *,
    variance: Any = None,
    method: str = "lscf",
    weights: str = "unit",
    constraint: str = "a0",
    real: bool = False,
    arc: float = ARC,
    ridge: Float[Array, ""] | float = RIDGE,
    numerator: int | None = None,
) -> LinearProblem:
    """The problem that :func:`lscf` or :func:`plscf` solves at ``order`` with these options.

    Raises
    ------
    ValueError
        If the method or an option is unknown, there is no variance, or the band holds too few lines.
    """
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; the noise bias is known for {', '.join(METHODS)}")
    (order,) = check_orders(order, frf.freq.shape[0], limits(frf))
    check_constraint(constraint)
    zoomed = zoom(frf.omega, arc, real)
    weight, sigma2 = weights_of(frf, weights), variance_of(frf, variance)
    H, f = frf.H, frf.H.shape[0]
    if method == "lscf":
        H, weight, sigma2 = H.reshape(f, -1, 1), weight.reshape(f, -1), sigma2.reshape(f, -1, 1)
    else:
        weight = over_references(weight)
    return LinearProblem(
        H, weight, sigma2, zoomed, zoomed.circle(frf.omega), as_array(ridge), order,
        order if numerator is None else numerator, real, weights == "unit", constraint, method,
    )  # fmt: skip


def leverage(xp: ModuleType, problem: LinearProblem) -> Float[Numbers, "f row"]:
    """Leverage of each line on the numerator of each row: the part of its noise that the numerator takes up."""

    def one(weight: Numbers) -> Numbers:
        Q = problem.basis_of(weight, xp)
        taken = xp.sum(xp.abs(Q) ** 2, axis=1)
        # Stacked real rows: the noise of a line is shared evenly by its real and imaginary parts.
        return taken.reshape(2, -1).mean(axis=0) if problem.real else taken

    if problem.shared:
        return xp.broadcast_to(one(problem.weight[:, 0])[:, None], problem.weight.shape)
    return scan(xp, lambda _, weight: (None, one(weight)), None, problem.weight.T)[1].T


def density_of(xp: ModuleType, problem: LinearProblem) -> Float[Numbers, "f i"]:
    r"""Noise that reaches the normal matrix from each line, :math:`\sum_o w_o^2\sigma_{oi}^2(1-\ell_o)`."""
    kept = problem.weight**2 * (1 - leverage(xp, problem))
    return xp.sum(kept[:, :, None] * problem.variance, axis=1)


noise_density = by_numpy(density_of)


def rows_of_noise(xp: ModuleType, problem: LinearProblem) -> Inexact[Numbers, "row m"]:
    """Rows whose Gram matrix is the noise matrix C."""
    density = xp.maximum(density_of(xp, problem), 0.0)
    f, m = problem.u.shape[0], (problem.order + 1) * problem.size
    eye = xp.eye(problem.size)
    columns = powers_of(xp, problem.u, problem.order + 1)
    rows = columns[None, :, :, None] * (xp.sqrt(density).T[:, :, None, None] * eye[:, None, None, :])
    rows = rows.reshape(problem.size * f, m)
    return xp.concatenate([rows.real, rows.imag]) if problem.real else rows


noise_rows = by_numpy(rows_of_noise)


def factor_of(
    xp: ModuleType, problem: LinearProblem, noise: Numbers | None = None, ridge: Any = None
) -> Inexact[Numbers, "m m"]:
    """Triangular factor of the normal matrix of the FRFs as they are, with rows ``noise`` added if there are any."""
    return triangular_factor(
        xp, problem.H, problem.weight, problem.u, problem.ridge if ridge is None else ridge, noise,
        order=problem.order, numerator=problem.numerator, real=problem.real, shared=problem.shared,
    )  # fmt: skip


factor = by_numpy(factor_of)


@by_numpy
def expected_factor(xp: ModuleType, problem: LinearProblem, scale: Numbers | float = 1.0) -> Inexact[Numbers, "m m"]:
    """Triangular factor of the expected normal matrix at ``scale`` times the noise variance, ridge included.

    The noise raises the energy, and so the ridge relative to it.
    """
    w2 = problem.weight[:, :, None] ** 2
    louder = 1 + scale * xp.sum(w2 * problem.variance) / xp.sum(w2 * xp.abs(problem.H) ** 2)
    return factor_of(xp, problem, xp.sqrt(scale) * rows_of_noise(xp, problem), problem.ridge * louder)
