"""Refinement on the host, with the arguments and results of that in JAX.

It gives the numbers of :func:`modalax.identify.refine` without compiling anything, and cannot be differentiated: for
searches, whose sizes change from step to step.
"""

from typing import Any

import numpy as np

from modalax._numerics.checks import as_array
from modalax.data.frf import FRF
from modalax.identify.ascent import frozen
from modalax.identify.deviations import shape_deviations
from modalax.identify.information import covariance
from modalax.identify.maximum import Maximum, maximise
from modalax.identify.plain import modal_of, model_of, samples_of, shorter_side
from modalax.identify.refine import CORRELATED, Refined
from modalax.identify.sample_weights import check_size, sigma_of
from modalax.model.modal import ModalModel

PRECISE = 1e-13  # part of a degree of freedom's sum of squares that a last step gains


def refine_on_host(
    frf: FRF, model: ModalModel, *, residuals: str = "complex", real_modes: bool = False, weights: Any = "auto",
    covariance: str = "gauss-newton", scale_errors: str = "auto", max_steps: int = 60, tol: float = PRECISE,
) -> Refined:  # fmt: skip
    """Refine a model as :func:`modalax.identify.refine` does for the same arguments.

    Parameters
    ----------
    tol
        As for :func:`modalax.identify.ascent.climb`.
    """
    check_size(frf, model.poles.shape[0], residuals)
    samples = samples_of(frf, residuals, real_modes)
    known = frf.variance is not None and isinstance(weights, str) and weights != "unit"
    modal = modal_of(model)
    found = maximise(
        samples, modal.poles, shorter_side(modal, samples), np.asarray(sigma_of(frf, weights)), known=known,
        max_steps=max_steps, tol=tol,
    )  # fmt: skip
    return refined_of(frf, found, covariance, scale_errors)


def refined_of(frf: FRF, found: Maximum, kind: str, scale_errors: str = "auto") -> Refined:
    """The end of a search with standard deviations; kinds and scaling as for :func:`modalax.identify.refine`."""
    variance = found.chi2 / found.dof
    inflate = {"never": 1.0, "always": variance}.get(scale_errors, found.inflate)
    n, q = found.at.theta.shape
    white = not found.whiteness < CORRELATED
    with np.errstate(over="ignore", invalid="ignore"):  # of modes that the data do not see deviations are infinite
        cov = covariance(found.projection, found.at, kind=kind, inflate=inflate, white=white)
        std = np.sqrt(np.maximum(np.diag(cov), 0.0)).reshape(n, q)
        blind = (std == 0) & (frozen(found.at.theta, found.at.held, found.projection.real_modes) == 0)
        std[blind.any(axis=1)] = np.nan  # the data do not tell such a mode
        own = inflate if scale_errors != "auto" else inflate / found.shared  # of one output by itself
        shape_std, mass_std = shape_deviations(found, cov, own, frf.outputs, frf.inputs)
    pick = (np.arange(n)[:, None] * q + np.arange(2)).ravel()
    weight = found.projection.weight
    noise = 1.0 if found.known else np.sqrt(np.mean(found.sigma**2))
    numbers = dict(
        frequency_std_hz=np.exp(found.at.theta[:, 0]) / (2 * np.pi) * std[:, 0],
        damping_std=np.exp(found.at.theta[:, 1]) * std[:, 1], shape_std=shape_std, modal_mass_std=mass_std,
        covariance=cov[pick][:, pick], evidence=found.evidence * found.inflate / inflate,
        noise_scale=np.sqrt(variance) * noise, chi2=found.chi2, dof=float(found.dof), whiteness=found.whiteness,
        log_likelihood=-0.5 * found.chi2 + 2 * np.sum(np.log(weight[weight > 0])), residual=found.residual,
        success=found.reason == 0, reason_code=found.reason, steps=found.at.steps,
    )  # fmt: skip
    arrays = {name: None if value is None else as_array(value) for name, value in numbers.items()}
    return Refined(model=model_of(found.model, frf), **arrays)
