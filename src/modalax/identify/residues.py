"""Residues, shapes and residual terms for known poles (LSFD)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double, is_traced
from modalax.data.frf import FRF
from modalax.identify.likelihood import Problem, linear_solution, make_problem, pack, shapes_and_residuals
from modalax.identify.plain import residue_fits
from modalax.identify.sample_weights import check_size, sigma_of
from modalax.identify.select import Selection
from modalax.model.entry import check_frf
from modalax.model.modal import ModalModel


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
        One whose motion grows or lasts counts as one with a damping ratio of 0.1 %.
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
    Guillaume et al. (2003), equation 13, by an orthogonal factorisation of the columns. Known numbers are fitted
    without compiling anything (:mod:`modalax.identify.projection`), traced ones in JAX.
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
    if participation is not None:
        participation = as_double(participation, "participation", complex_=True)
    turned = frf.shape[2] > frf.shape[1]  # the shorter axis carries the participation, the longer one is linear
    known = not is_traced(*jax.tree.leaves((frf, poles, sigma, participation)))
    if known and (participation is None or not turned):
        fits = residue_fits(frf, residuals=residuals, real_modes=real_modes, weights=sigma)
        return fits(poles, None if participation is None else np.asarray(participation))
    if participation is None and turned:
        swapped = jnp.swapaxes(sigma, 1, 2)
        found = residues(frf.transpose(), poles, residuals=residuals, real_modes=real_modes, weights=swapped)
        return found.transpose().normalised("max")
    if participation is None:
        participation = participation_of(frf, poles, sigma, residuals, real_modes)
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
