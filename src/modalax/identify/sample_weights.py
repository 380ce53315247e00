"""How samples are weighed against each other, and whether there are enough of them for the unknowns of a model."""

from types import ModuleType

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array, as_double, is_traced
from modalax._numerics.known import Numbers, by_numpy
from modalax.data.frf import FRF

RESIDUALS = ("none", "real", "complex")


def sigma_of(frf: FRF, weights: str | Float[Array, "f o i"]) -> Float[Array, "f o i"]:
    r"""Standard deviation :math:`\sigma` that weighs each complex sample; 1 where all count the same.

    Raises
    ------
    ValueError
        If variance weights are asked for without a variance, or the word is unknown.
    """
    if not isinstance(weights, str):
        return jnp.broadcast_to(as_double(weights, "weights"), frf.H.shape)
    if weights not in ("auto", "unit", "variance"):
        raise ValueError(f"weights is {weights!r}; it must be auto, unit, variance, or standard deviations (f, o, i)")
    if weights == "variance" and frf.variance is None:
        raise ValueError("weights 'variance' needs an FRF with a variance; this one has none")
    if weights == "unit" or frf.variance is None:
        return as_array(np.ones(frf.H.shape))
    if not is_traced(frf.variance) and not (np.asarray(frf.variance) > 0).any():
        return as_array(np.ones(frf.H.shape))
    return _root_above_zero(frf.variance)


@by_numpy
def _root_above_zero(xp: ModuleType, variance: Float[Numbers, "f o i"]) -> Float[Numbers, "f o i"]:
    """Standard deviations; a sample said to be exact would outweigh all others: it gets the smallest above zero."""
    return xp.sqrt(xp.maximum(variance, xp.min(xp.where(variance > 0, variance, np.inf))))


def check_size(frf: FRF, n_modes: int, residuals: str) -> None:
    """Refuse a fit with more unknowns than samples, or an unknown kind of residual term.

    Raises
    ------
    ValueError
        With the numbers.
    """
    if residuals not in RESIDUALS:
        raise ValueError(f"residuals is {residuals!r}; it must be one of {', '.join(RESIDUALS)}")
    lines, _, n_in = frf.shape
    unknowns = 2 * n_modes + (0 if residuals == "none" else (2 if residuals == "real" else 4) * n_in)
    if 2 * lines * n_in < unknowns:
        raise ValueError(
            f"{n_modes} modes have {unknowns} unknowns an output, but {lines} lines x {n_in} inputs give "
            f"{2 * lines * n_in} equations; widen the band or fit fewer modes"
        )
