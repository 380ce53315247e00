"""Residues, shapes and residual terms for known poles (LSFD)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array, as_double, is_traced
from modalax.data.frf import FRF
from modalax.identify.likelihood import Problem, linear_solution, make_problem, pack, shapes_and_residuals
from modalax.identify.select import Selection
from modalax.model.entry import check_frf
from modalax.model.modal import ModalModel

RESIDUALS = ("none", "real", "complex")


def residues(
    frf: FRF,
    poles: Any,
    participation: Any = None,
    *,
    residuals: str = "complex",
    real_modes: bool = False,
    weights: str | Float[Array, "f o i"] = "auto",
) -> ModalModel:
    r"""Fit shapes and residual terms to given poles by weighted linear least squares.

    .. math:: H_{oi} = (j\omega)^p\Big[\sum_r \frac{\psi_{ro}L_{ri}}{j\omega-\lambda_r} + \frac{\psi_{ro}^*L_{ri}^*}
              {j\omega-\lambda_r^*} + U_{oi} - \frac{W_{oi}}{\omega^2}\Big], \qquad p = 0, 1, 2,

    so that the residual terms are a stiffness line and a mass line whatever the form of the FRF.

    Parameters
    ----------
    frf
        The FRF in the band.
    poles
        Poles with positive imaginary part, shape ``(n,)`` [rad/s]; or a :class:`Selection`, participation included.
    participation
        Shape ``(n, i)``. If None it is found from the FRF itself: for several inputs by a fit of all residues, of
        which the best rank-one factor is taken.
    residuals
        ``complex``, ``real`` or ``none``.
    real_modes
        Real normal modes: residues of the receptance purely imaginary.
    weights
        ``unit``; ``variance`` (:math:`1/\sigma`); ``auto``: variance where there is one above zero; or the standard
        deviations themselves.

    Returns
    -------
    ModalModel
        Shapes with their largest component 1.

    Raises
    ------
    ValueError
        If there are more unknowns than samples, a pole has no positive imaginary part, or an option is unknown.

    Notes
    -----
    Guillaume et al. (2003), equation 13; the columns are scaled and solved by QR, never by normal equations.
    """
    check_frf(frf, "residues")
    if isinstance(poles, Selection):
        poles, participation = poles.poles, poles.participation if participation is None else participation
    poles = as_double(poles, "poles", complex_=True)
    if not is_traced(poles) and (np.asarray(poles).imag <= 0).any():
        raise ValueError(
            "a pole has no positive imaginary part; modalax.model.poles_from(frequency_hz, damping_ratio) makes poles"
        )
    check_size(frf, poles.shape[0], residuals)
    sigma = sigma_of(frf, weights)
    if participation is None:
        if frf.shape[2] > frf.shape[1]:  # the shorter axis carries the participation, the longer one is linear
            turned = residues(
                frf.transpose(), poles, residuals=residuals, real_modes=real_modes, weights=jnp.swapaxes(sigma, 1, 2)
            )
            return turned.transpose().normalised("max")
        n = poles.shape[0]  # of one input there is nothing to find, and no program to compile
        one = frf.shape[2] == 1
        participation = np.ones((n, 1)) if one else participation_of(frf, poles, sigma, residuals, real_modes)
    participation = as_double(participation, "participation", complex_=True)
    return _fit(frf.without_statistics(), poles, participation, sigma, residuals, real_modes)


@eqx.filter_jit
def _fit(frf: FRF, poles: Array, participation: Array, sigma: Array, residuals: str, real_modes: bool) -> ModalModel:
    pivot = jnp.argmax(jnp.abs(participation), axis=1)
    problem = make_problem(frf, sigma, pivot, residuals, real_modes)
    x, _ = linear_solution(pack(poles, participation, pivot), problem)
    return model_of(x, problem, poles, participation / jnp.take_along_axis(participation, pivot[:, None], 1), frf)


def model_of(
    x: Float[Array, "o k"],
    problem: Problem,
    poles: Complex[Array, " n"],
    participation: Complex[Array, "n i"],
    frf: FRF,
) -> ModalModel:
    """The modal model of linear unknowns, its shapes scaled to a largest component of 1."""
    shapes, upper, lower = shapes_and_residuals(x, problem, poles)
    model = ModalModel(
        poles, shapes, participation, outputs=frf.outputs, inputs=frf.inputs, upper=upper, lower=lower
    )  # fmt: skip
    return model.normalised("max")


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


@jax.jit
def _root_above_zero(variance: Float[Array, "f o i"]) -> Float[Array, "f o i"]:
    """Standard deviations; a sample said to be exact would outweigh all others: it gets the smallest above zero."""
    return jnp.sqrt(jnp.maximum(variance, jnp.min(jnp.where(variance > 0, variance, jnp.inf))))


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


@eqx.filter_jit
def participation_of(
    frf: FRF, poles: Complex[Array, " n"], sigma: Float[Array, "f o i"], residuals: str, real_modes: bool
) -> Complex[Array, "n i"]:
    """Participation of each mode at several inputs: the leading factor of its residues, all of them fitted freely."""
    _, n_out, n_in = frf.shape
    n = poles.shape[0]
    flat = FRF(frf.freq, frf.H.reshape(frf.H.shape[0], -1, 1), form=frf.form)
    pivot = jnp.zeros(n, int)
    problem = make_problem(flat, sigma.reshape(*flat.H.shape), pivot, residuals, real_modes)
    x, _ = linear_solution(pack(poles, jnp.ones((n, 1), jnp.complex128), pivot), problem)
    full, _, _ = shapes_and_residuals(x, problem, poles)
    matrices = full.reshape(n, n_out, n_in)
    # The right factor from the small Gram matrix: an eigenvector of i x i, with a clear leading value.
    gram = jnp.einsum("noi,noj->nij", matrices.conj(), matrices)
    leading = jnp.linalg.eigh(gram)[1][:, :, -1].conj()
    if real_modes:
        top = jnp.take_along_axis(leading, jnp.argmax(jnp.abs(leading), axis=1)[:, None], 1)
        leading = (leading / top).real.astype(jnp.complex128)
    return leading
