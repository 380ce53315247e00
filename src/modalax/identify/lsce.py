"""Polyreference least-squares complex exponential estimator (LSCE)."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import is_traced
from modalax.data.frf import FRF
from modalax.identify.fraction import check_constraint
from modalax.identify.lscf import RIDGE
from modalax.identify.polynomial import limits, mean_weight, poles_of_factor, weights_of
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import Zoom, check_orders


def lsce(
    frf: FRF,
    orders: int | Sequence[int],
    *,
    weights: str = "unit",
    constraint: str = "aN",
    real: bool = False,
    part: float = 0.5,
    skip: int = 0,
    ridge: Float[Array, ""] | float = RIDGE,
) -> PoleTable:
    r"""Poles by linear prediction of the impulse responses, :math:`\sum_k h_o(t_{m-k}) A_k = 0` in least squares.

    The impulse response is the inverse Fourier transform of the band alone, zoomed: its time step belongs to the
    width of the band, not to its upper limit, and its frequencies count from the band.

    Parameters
    ----------
    frf
        The FRF, cut to the band of interest; its lines must be equispaced.
    orders
        Degrees of the prediction; order ``n`` with ``i`` references has ``n i`` poles.
    weights
        ``unit``, ``magnitude`` or ``variance``, averaged over lines and references to one weight an output,
        :math:`w_o^{-2} = \mathrm{mean}_{ki} w_{oki}^{-2}`. Weights that differ from line to line would filter the
        impulse responses, which then are no sums of exponentials: the poles would be wrong without any noise.
    constraint
        ``aN`` (the coefficient of the newest sample is one: forward prediction, the classical choice), ``a0``
        (backward prediction, whose computational poles are unstable) or ``norm``.
    real
        Real coefficients on the real impulse response of the band and its mirror image (as in the classical
        method), or complex ones on the one-sided, complex response.
    part
        Part of the impulse response that is used, from its start.
    skip
        Samples left out at the start, where the cut band leaks most.
    ridge
        Added to the normal matrix, relative to its mean diagonal.

    Returns
    -------
    PoleTable
        With participation factors if there are several inputs.

    Raises
    ------
    ValueError
        If the lines are not equispaced, or too few for an order, or an option is unknown.

    Notes
    -----
    Brown, Allemang, Zimmerman and Mergeay (1979); Vold, Kundrat, Rocklin and Russell (1982).
    """
    _check_equispaced(frf)
    if not 0 < part <= 1:
        raise ValueError(f"part is {part:g}; it is the part of the impulse response to use, above 0 and up to 1")
    samples = int(round(part * (2 * (frf.shape[0] - 1) if real else frf.shape[0])))
    found = check_orders(orders, samples - skip, limits(frf))
    weight = mean_weight(weights_of(frf, weights), over=(0, 2))
    bare = frf.without_statistics()
    R, zoomed = _factor(bare, weight, jnp.asarray(ridge), found[-1], real, skip, samples)
    return poles_of_factor(
        R, found, frf.shape[2], check_constraint(constraint), real, zoomed, "lsce", None, jnp.asarray(frf.added_decay)
    )


@eqx.filter_jit
def _factor(
    frf: FRF, weight: Float[Array, " o"], ridge: Array, order: int, real: bool, skip: int, samples: int
) -> tuple[Array, Zoom]:
    """Triangular factor of the highest order, and the map on the circle."""
    h, zoomed = impulse_response(frf, real)
    return prediction_factor(h[skip:samples] * weight[:, None], order, ridge), zoomed


def impulse_response(frf: FRF, real: bool) -> tuple[Complex[Array, "t o i"] | Float[Array, "t o i"], Zoom]:
    """Inverse Fourier transform of the band alone, and the map from its roots to poles."""
    n_lines, span = frf.shape[0], frf.omega[-1] - frf.omega[0]
    if real:
        return jnp.fft.irfft(frf.H, axis=0), Zoom(frf.omega[0], jnp.pi / span)
    step = 2 * jnp.pi / (span * n_lines / (n_lines - 1))
    turn = jnp.exp(-0.5j * span * step * jnp.arange(n_lines))
    h = jnp.fft.ifft(frf.H, axis=0) * turn[:, None, None]
    return h, Zoom((frf.omega[0] + frf.omega[-1]) / 2, step)


def prediction_factor(h: Complex[Array, "t o i"] | Float[Array, "t o i"], order: int, ridge: Float[Array, ""]) -> Array:
    """Triangular factor of the rows ``h(m), h(m-1), ...``, one output after the other."""
    t, _, size = h.shape
    m = (order + 1) * size
    index = jnp.arange(order, t)[:, None] - jnp.arange(order + 1)[None, :]

    def add(R: Array, row: Array) -> tuple[Array, None]:
        Y = row[index].reshape(t - order, m)
        return jnp.linalg.qr(jnp.concatenate([R, Y]), mode="r"), None

    energy = jnp.sum(jnp.abs(h) ** 2) / size
    R, _ = lax.scan(add, (jnp.sqrt(ridge * energy) * jnp.eye(m)).astype(h.dtype), jnp.swapaxes(h, 0, 1))
    return R


def _check_equispaced(frf: FRF) -> None:
    if is_traced(frf.freq):
        return
    step = np.diff(np.asarray(frf.freq))
    if step.size < 3 or np.ptp(step) > 1e-6 * step.mean():
        raise ValueError(
            f"LSCE needs equispaced lines; the steps here run from {step.min() if step.size else 0:g} to "
            f"{step.max() if step.size else 0:g} Hz. LSCF, pLSCF and FDPI take any lines"
        )
