r"""Test whether a mode is the same in a wide and a narrow band, as a linear one is and an amplitude-dependent is not.

Both bands give maximum-likelihood estimates of :math:`\theta = (\ln\omega, \ln\zeta)` of the mode. If the structure is
linear both are consistent and the wide one is efficient, so that the covariance of their difference is the difference
of their covariances and

.. math:: h = (\theta_n - \theta_w)^T (V_n - V_w)^{-1} (\theta_n - \theta_w) \sim \chi^2_2.

Source: Hausman (1978), Specification tests in econometrics, Econometrica 46, theorem 2.1.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaincc
from jaxtyping import Array, Bool, Float

from modalax.data.frf import FRF
from modalax.identify.overview import of_bandwidth
from modalax.identify.refine import refine
from modalax.identify.residues import residues


class BandwidthTest(eqx.Module):
    """One mode in two bands.

    Attributes
    ----------
    frequency_hz, damping_ratio
        In the wide and in the narrow band, shape ``(2,)`` [Hz], [-].
    difference_std
        Standard deviation of the differences of ln frequency and of ln damping if the structure is linear, ``(2,)``.
    statistic
        Hausman's h.
    p_value
        Probability of as large a one if the structure is linear and the variance of the noise is right.
    valid
        Whether the wide search ended at a maximum and the narrow band knows less than the wide one.
    """

    frequency_hz: Float[Array, " 2"]
    damping_ratio: Float[Array, " 2"]
    difference_std: Float[Array, " 2"]
    statistic: Float[Array, ""]
    p_value: Float[Array, ""]
    valid: Bool[Array, ""]

    def __str__(self) -> str:
        """The mode in both bands, and how likely such a difference is."""
        return of_bandwidth(self)


def bandwidth_test(
    frf: FRF, poles: Any, near: float, band: tuple[float, float], *, reach: float = 0.5, residuals: str = "complex"
) -> BandwidthTest:
    r"""Test whether a mode depends on the band from which it is taken.

    Parameters
    ----------
    frf
        The FRF in the wide band, with its variance.
    poles
        Poles of all modes in it, to start from, shape ``(n,)`` [rad/s].
    near
        Frequency of the mode in question [Hz]: the one next to it is tested.
    band
        The narrow band [Hz], around the mode.
    reach
        Modes up to this part of the narrow band's width outside it stay in its model; the others are residual terms.
        With none of them the residual terms are not good enough and linear modes are rejected too. The narrow band
        says little of these modes, and its search may end before theirs does; that does not move the one in question.
    residuals
        As for :func:`modalax.identify.refine`.

    Returns
    -------
    BandwidthTest
        Both covariances are those at the wide band's estimate, so that their difference cannot be negative by chance.

    Raises
    ------
    ValueError
        If there is no variance, the mode lies outside the narrow band, or that has as many lines as the wide one.
    """
    if frf.variance is None:
        raise ValueError("the test needs the variance of the noise; this FRF has none")
    low, high = band
    part = frf.band(low, high)
    if part.shape[0] >= frf.shape[0]:
        raise ValueError(
            f"the band {low:g}-{high:g} Hz holds all {frf.shape[0]} lines; a narrow one within them is needed"
        )
    wide = refine(frf, residues(frf, poles, residuals=residuals), residuals=residuals, scale_errors="never")
    hertz = np.asarray(wide.model.frequency_hz)
    mode = int(np.argmin(np.abs(hertz - near)))
    if not low < hertz[mode] < high:
        raise ValueError(f"the mode at {hertz[mode]:g} Hz lies outside the narrow band {low:g}-{high:g} Hz")
    margin = reach * (high - low)
    kept = np.flatnonzero((hertz > low - margin) & (hertz < high + margin))
    start = residues(part, wide.model.poles[kept], residuals=residuals)
    there = refine(part, start, residuals=residuals, scale_errors="never", max_steps=1)
    narrow = refine(part, start, residuals=residuals, scale_errors="never")
    own = int(np.flatnonzero(kept == mode)[0])
    one, two = (
        jnp.stack([jnp.log(m.frequency_hz[k]), jnp.log(m.damping_ratio[k])])
        for m, k in ((wide.model, mode), (narrow.model, own))
    )
    block = lambda r, k: r.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
    spread = block(there, own) - block(wide, mode)
    difference = two - one
    statistic = difference @ jnp.linalg.solve(spread, difference)
    valid = (jnp.linalg.eigvalsh(spread)[0] > 0) & wide.success & jnp.isfinite(statistic)
    return BandwidthTest(
        jnp.exp(jnp.stack([one[0], two[0]])), jnp.exp(jnp.stack([one[1], two[1]])),
        jnp.sqrt(jnp.maximum(jnp.diag(spread), 0.0)), statistic,
        gammaincc(1.0, jnp.maximum(statistic, 0.0) / 2), valid,
    )  # fmt: skip
