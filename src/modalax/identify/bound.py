"""The Cramer-Rao bound: the least standard deviations that any unbiased estimate of a modal model can have."""

import equinox as eqx
from jaxtyping import Array, Complex, Float

from modalax.data.frf import FRF
from modalax.identify.overview import of_bound
from modalax.identify.refine import refine
from modalax.model.modal import ModalModel


class Bound(eqx.Module):
    """Least standard deviations that an unbiased estimator can have.

    Attributes
    ----------
    frequency_std_hz, damping_std
        Of each natural frequency [Hz] and damping ratio [-], shape ``(n,)``.
    shape_std
        Of real and imaginary part of each shape component, its largest 1, as one complex number, shape ``(n, o)``.
    """

    frequency_std_hz: Float[Array, " n"]
    damping_std: Float[Array, " n"]
    shape_std: Complex[Array, "n o"]

    def __str__(self) -> str:
        """A table of the bounds."""
        return of_bound(self)


def cramer_rao(model: ModalModel, frf: FRF, *, residuals: str = "complex", real_modes: bool = False) -> Bound:
    r"""Cramer-Rao bound of poles and shapes, :math:`(J^T \Sigma^{-1} J)^{-1}` at the true model, all unknown together.

    Parameters
    ----------
    model
        The truth.
    frf
        Lines, channels, form and noise variance of the test; its values are not used.
    residuals, real_modes
        What is unknown beside the poles, as for :func:`modalax.identify.refine`: the more, the larger the bound.

    Returns
    -------
    Bound
        For circular Gaussian noise, independent from sample to sample.

    Raises
    ------
    ValueError
        If the FRF has no variance, or there are more unknowns than samples.

    Notes
    -----
    Cramer (1946), Rao (1945); for frequency-domain identification Pintelon and Schoukens (2012).
    """
    if frf.variance is None:
        raise ValueError("the Cramer-Rao bound needs a noise variance; this FRF has none: frf.replace(variance=...)")
    exact = model.frf(frf.freq, outputs=frf.outputs, inputs=frf.inputs, form=frf.form)
    told = refine(frf.replace(H=exact.H), model, residuals=residuals, real_modes=real_modes, scale_errors="never")
    return Bound(told.frequency_std_hz, told.damping_std, told.shape_std)
