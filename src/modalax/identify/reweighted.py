r"""LSCF repeated with its own denominator as weight: Sanathanan and Koerner's iteration, or iterative quadratic ML.

The equation error :math:`A H - B` of LSCF is the output error times :math:`A`; dividing by the last :math:`|A|` turns
one into the other. Whether the noise bias goes with it depends on the constraint: at the fixed point noise pulls with
:math:`\oint dA/A`, which vanishes for stable poles when the coefficient of the newest sample is fixed (``aN``), and
does not for ``a0``.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.checks import as_array
from modalax._numerics.known import Numbers
from modalax._numerics.powers import powers
from modalax.data.frf import FRF
from modalax.identify.fraction import coefficients, roots
from modalax.identify.lscf import RIDGE
from modalax.identify.polynomial import LAST, limits, triangular_factor, weights_of, without_window
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders, zoom


def reweighted(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    weights: str = "variance",
    constraint: str = "aN",
    arc: float = 0.9,
    ridge: Float[Array, ""] | float = RIDGE,
    numerator: int | None = None,
    iterations: int = 8,
) -> PoleTable:
    r"""Poles by minimising :math:`\sum w^2 |A H - B|^2 / |A_{\text{last}}|^2` again and again.

    Parameters
    ----------
    frf, orders, weights, constraint, arc, ridge, numerator
        As for :func:`lscf`. ``variance`` weights make it approach the maximum-likelihood estimate.
    iterations
        Number of repetitions after the first, unweighted solve.

    Returns
    -------
    PoleTable
        As :func:`lscf`. Orders well above the number of poles waste it: each spare root near the lines becomes a
        weight that magnifies the noise there.

    Raises
    ------
    ValueError
        As :func:`lscf`.

    Notes
    -----
    Sanathanan and Koerner (1963); Bresler and Macovski (1986).
    """
    found = check_orders(orders, frf.freq.shape[0], limits(frf))
    zoomed = zoom(frf.omega, arc, False)
    u, f, top = zoomed.circle(frf.omega), frf.H.shape[0], found[-1]
    H, weight = frf.H.reshape(f, -1, 1), weights_of(frf, weights).reshape(f, -1)
    degree = top if numerator is None else numerator
    columns = powers(u, top + 1)
    chosen = dict(order=top, numerator=degree, real=False, shared=weights == "unit")

    def one(order: Int[Array, ""]) -> tuple[Numbers, Numbers]:
        def solve(size: Float[Array, " f"]) -> Complex[Numbers, "k i i"]:
            R = triangular_factor(jnp, H, weight / size[:, None], u, as_array(ridge), **chosen)
            return coefficients(jnp, R, order, 1, LAST[constraint])

        def again(_: Array, A: Numbers) -> Numbers:
            size = jnp.abs(columns @ A[:, 0, 0])
            # A floor keeps a root on the circle from taking all the weight.
            return solve(jnp.maximum(size / jnp.max(size), 1e-4))

        A = lax.fori_loop(0, iterations, again, solve(jnp.ones(f)))
        u_r, _, valid = roots(jnp, A, order)
        return u_r, valid

    u_r, valid = lax.map(one, as_array(found))
    poles = zoomed.poles(jnp.where(valid, u_r, 1.0))
    return without_window(PoleTable(jnp.where(valid, poles, 0.0), valid, None, found, "reweighted"), frf)
