r"""Modes that a fit lacks, or has without need: score tests on the whitened residual.

A stabilization diagram shows what is plain; a weakly excited mode drowns in it. The residual of a maximum-likelihood
fit is white noise where nothing is missing, so a missing mode shows as the matched filter's peak,
:math:`S(\lambda) = \sum_{oi} 2|\langle k_\lambda, r_{oi}\rangle|^2/\|k_\lambda\|^2`, which under noise alone is
:math:`\chi^2` with two degrees of freedom a channel.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.refine import Refined
from modalax.model.modal import poles_from

DAMPINGS = (0.001, 0.003, 0.01, 0.03)


@eqx.filter_jit
def mode_scores(
    frf: FRF, residual: Complex[Array, "f o i"], sigma: Float[Array, "f o i"], poles: Complex[Array, " g"]
) -> Float[Array, " g"]:
    r"""Matched-filter statistic :math:`S(\lambda)` of a further mode at each of some poles.

    Parameters
    ----------
    residual
        Whitened residual of the present fit, unit variance.
    sigma
        Standard deviation of each complex sample that whitened it.
    poles
        Where to look, shape ``(g,)`` [rad/s].
    """
    s = frf.added_decay + 1j * frf.omega
    power = DERIVATIVES[frf.form]
    f = s.shape[0]
    z = residual.reshape(f, -1)
    w = (1 / sigma).reshape(f, -1)

    def score(pole: Array) -> Array:
        kernel = s**power / (s - pole)
        inner = jnp.abs((kernel.conj()[:, None] * w * z).sum(axis=0)) ** 2
        norm = (jnp.abs(kernel[:, None] * w) ** 2).sum(axis=0)
        return jnp.sum(2 * inner / jnp.maximum(norm, 1e-300))

    return jax.lax.map(score, poles, batch_size=16)


def missing_modes(
    frf: FRF,
    refined: Refined,
    sigma: Float[Array, "f o i"],
    *,
    level: float = 1e-4,
    most: int = 4,
    inside: tuple[float, float] | None = None,
) -> Complex[Array, " n"]:
    r"""Poles at which the residual asks for a further mode, strongest first.

    Looks on a grid of frequencies, half a bandwidth apart, and the damping ratios 0.1 to 3 %; a fifth of the band
    beyond its ends too, for a mode there shows inside as a slope. A pole counts if its statistic exceeds the
    :math:`\chi^2` quantile at ``level`` shared among all poles of the grid, after scaling by the residual's own
    level, so that a model that does not fit elsewhere does not call for modes everywhere. What a pole explains is taken
    out of the residual before the next one is looked for (orthogonal matching pursuit; Pati, Rezaiifar and
    Krishnaprasad 1993), so that one mode does not call for several. A pole outside the band is given alone.

    Returns
    -------
    Array
        At most ``most`` poles, no two within two bandwidths of each other, possibly none.
    """
    first, last = float(frf.freq[0]), float(frf.freq[-1])
    beyond = 0.2 * (last - first)
    lower, upper = (max(first - beyond, 0.0), last + beyond) if inside is None else inside
    grid = []
    step = float((frf.freq[-1] - frf.freq[0]) / max(len(frf.freq) - 1, 1))
    for zeta in DAMPINGS:
        f = max(lower, step)
        while f < upper:
            grid.append((f, zeta))
            f += max(zeta * f, 0.5 * step)
    where = np.array(grid)
    poles = poles_from(where[:, 0], where[:, 1])
    channels = frf.shape[1] * frf.shape[2]
    variance = jnp.mean(jnp.abs(refined.residual) ** 2, axis=(1, 2), keepdims=True)
    # The level of a neighbourhood far wider than a mode: a bad stretch of the band must not become modes.
    wide = max(5, len(frf.freq) // 5)
    local = _running_median(np.asarray(variance[:, 0, 0]), wide)
    scale = jnp.asarray(np.sqrt(np.maximum(local, 1e-300)))[:, None, None]
    threshold = float(_chi2_quantile(level / len(where), 2 * channels))
    found: list[complex] = []
    allowed = np.ones(len(where), bool)
    residual = refined.residual / scale
    while len(found) < most:
        score = np.where(allowed, np.asarray(mode_scores(frf, residual, sigma, poles)), -np.inf)
        best = int(np.argmax(score))
        if score[best] < threshold:
            break
        pole = complex(poles[best])
        found.append(pole)
        allowed &= np.abs(np.asarray(poles.imag) - pole.imag) > 4 * np.maximum(-np.asarray(poles.real), -pole.real)
        residual = jnp.asarray(_without(frf, np.asarray(refined.residual / scale), np.asarray(sigma), found))
        if not (allowed.any() and first < pole.imag / (2 * np.pi) < last):
            break
    within = [p for p in found if first < p.imag / (2 * np.pi) < last]
    found = found[:1] if found and found[0] not in within else within
    return jnp.asarray(np.array(found, dtype=complex))


def _without(frf: FRF, residual: np.ndarray, sigma: np.ndarray, poles: list[complex]) -> np.ndarray:
    """The residual after the best multiples of the poles' responses were taken out of each channel."""
    s = float(frf.added_decay) + 1j * np.asarray(frf.omega)
    kernels = s[:, None] ** DERIVATIVES[frf.form] / (s[:, None] - np.array(poles))
    shape = residual.shape
    out, weight = residual.reshape(len(s), -1).copy(), (1 / sigma).reshape(len(s), -1)
    for c in range(out.shape[1]):
        K = kernels * weight[:, c : c + 1]
        K = K / np.maximum(np.linalg.norm(K, axis=0), 1e-300)
        out[:, c] -= K @ np.linalg.lstsq(K, out[:, c], rcond=None)[0]
    return out.reshape(shape)


def _running_median(values: np.ndarray, width: int) -> np.ndarray:
    padded = np.pad(values, width // 2, mode="reflect" if len(values) > width // 2 else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.median(windows, axis=1)[: len(values)]


def _chi2_quantile(tail: float, dof: int) -> float:
    import scipy.stats

    return float(scipy.stats.chi2.isf(tail, dof))
