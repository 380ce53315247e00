r"""Modes that a fit lacks, or has without need: score tests on the whitened residual.

A stabilization diagram shows what is plain; a weakly excited mode drowns in it. The residual of a maximum-likelihood
fit is white noise where nothing is missing, so a missing mode shows as the matched filter's peak,
:math:`S(\lambda) = \sum_{oi} 2|\langle k_\lambda, r_{oi}\rangle|^2/\|k_\lambda\|^2`, which under noise alone is
:math:`\chi^2` with two degrees of freedom a channel.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Complex, Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.model.modal import ModalModel, poles_from

DAMPINGS = (0.001, 0.003, 0.01, 0.03)
NEW = 0.01  # part of a further mode's response that the present model should leave
NEAR = 0.01  # part of a frequency within which a further mode is the same that was tried before
CHUNK = 256  # poles whose scores are taken at once


@eqx.filter_jit
def mode_scores(
    frf: FRF,
    residual: Complex[Array, "f o i"],
    sigma: Float[Array, "f o i"],
    poles: Complex[Array, " g"],
    known: Complex[Array, " n"],
) -> Float[Array, " g"]:
    r"""Score statistic :math:`S(\lambda)` of a further mode at each of some poles.

    Parameters
    ----------
    residual
        Whitened residual of the present fit, unit variance.
    sigma
        Standard deviation of each complex sample that whitened it.
    poles
        Where to look, shape ``(g,)`` [rad/s].
    known
        Poles of the present fit, shape ``(n,)`` [rad/s]. Of a pole outside the band only what they, their changes and
        residual terms do not make counts, for otherwise any slope at an end of the band would look like it. One weight
        a line, the mean over the channels, decides on that.
    """
    s = frf.added_decay + 1j * frf.omega
    lines, power = s.shape[0], DERIVATIVES[frf.form]
    wz, w2 = (residual / sigma).reshape(lines, -1), (1 / sigma**2).reshape(lines, -1)
    shared = jnp.sqrt(jnp.mean(w2 / jnp.mean(w2, axis=0), axis=1))
    Q = _known_columns(s, power, shared, known)
    z = _stack(residual.reshape(lines, -1).T)
    z = z - (z @ Q) @ Q.T
    left_wz = (z[:, :lines] + 1j * z[:, lines:]).T * jnp.sqrt(w2)
    first, last = jnp.min(frf.omega), jnp.max(frf.omega)
    count = poles.shape[0]
    padded = jnp.concatenate([poles, jnp.full(-count % CHUNK, poles[0])]).reshape(-1, CHUNK)

    def chunk(some: Array) -> Array:
        near, far = s**power / (s - some[:, None]), s**power / (s - some[:, None].conj())
        pair = jnp.stack([near + far, 1j * (near - far)])  # responses to the real and the imaginary part of a residue
        size = jnp.sum(jnp.abs(pair) ** 2, axis=0) @ w2
        stacked = _stack(pair * shared)
        left = stacked - (stacked @ Q) @ Q.T
        whole = jnp.sum(stacked**2, axis=(0, 2))

        def statistic(data: Array, columns: Array) -> Array:
            inner = (pair.conj() @ data).real
            gram = jnp.einsum("agm,bgm->gab", columns, columns) / whole[:, None, None]
            # The ridge keeps what is all but known from counting much.
            inverse = jnp.linalg.inv(gram + NEW * jnp.eye(2))
            squares = jnp.einsum("agc,gab,bgc->gc", inner, inverse, inner)
            return jnp.sum(2 * squares / jnp.maximum(size, 1e-300), axis=1)

        inside = (some.imag >= first) & (some.imag <= last)
        return jnp.where(inside, statistic(wz, stacked), statistic(left_wz, left))

    return jax.lax.map(chunk, padded).ravel()[:count]


def _known_columns(s: Array, power: int, weight: Array, known: Array) -> Float[Array, "m k"]:
    """Orthonormal basis of what known modes, changes of their poles, and residual terms make of one channel."""
    safe = jnp.where(s == 0, 1j * jnp.max(jnp.abs(s)), s)
    near, far = 1 / (s - known[:, None]), 1 / (s - known[:, None].conj())
    pairs = [near + far, 1j * (near - far), near**2 + far**2, 1j * (near**2 - far**2)]
    terms = jnp.stack([safe**0, 1j * safe**0, safe**-2.0, 1j * safe**-2.0])
    columns = _stack(jnp.concatenate([*pairs, terms]) * s**power * weight)
    return jnp.linalg.qr((columns / jnp.maximum(jnp.linalg.norm(columns, axis=1, keepdims=True), 1e-300)).T)[0]


def _stack(a: Array) -> Array:
    return jnp.concatenate([a.real, a.imag], axis=-1)


def missing_modes(
    frf: FRF,
    model: ModalModel,
    sigma: Float[Array, "f o i"] | Sequence[Float[Array, "f o i"]],
    *,
    level: float = 1e-4,
    most: int = 4,
    inside: tuple[float, float] | None = None,
    avoid: Sequence[float] = (),
) -> Complex[Array, " n"]:
    r"""Poles at which the residual asks for a further mode, strongest first.

    Looks on a grid of frequencies, half a bandwidth apart, and the damping ratios 0.1 to 3 %; a fifth of the band
    beyond its ends too, for a mode there shows inside as a slope. A pole counts if its statistic exceeds the
    :math:`\chi^2` quantile at ``level`` shared among all poles of the grid, after scaling by the residual's own
    level, so that a model that does not fit elsewhere does not call for modes everywhere. What a pole explains is taken
    out of the residual before the next one is looked for (orthogonal matching pursuit; Pati, Rezaiifar and
    Krishnaprasad 1993), so that one mode does not call for several. A pole outside the band comes alone.

    Parameters
    ----------
    frf
        The FRF.
    model
        The modal model as it is.
    sigma
        Standard deviation of each complex sample; of several, where it is not known, a pole must count with each.
    level, most
        Chance of a mode that is not there, and most modes to return.
    inside
        Frequencies to look at [Hz], the band and a fifth of it beyond by default.
    avoid
        Frequencies [Hz] where a mode was tried and did not stay; none is returned within ``NEAR`` of them.

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
    threshold = float(_chi2_quantile(level / len(where), 2 * channels))
    made = model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay)
    deviations = list(sigma) if isinstance(sigma, (list, tuple)) else [jnp.asarray(sigma)]
    residuals = [_levelled((frf.H - made.H) / s) for s in deviations]
    rest = list(residuals)
    found: list[complex] = []
    allowed = np.ones(len(where), bool)
    for f in avoid:
        allowed &= np.abs(where[:, 0] - f) > max(NEAR * f, 2 * step)
    while len(found) < most and allowed.any():
        scores = [np.asarray(mode_scores(frf, r, s, poles, model.poles)) for r, s in zip(rest, deviations, strict=True)]
        score = np.where(allowed, np.min(scores, axis=0), -np.inf)
        best = int(np.argmax(score))
        if score[best] < threshold:
            break
        pole = complex(poles[best])
        found.append(pole)
        allowed &= np.abs(np.asarray(poles.imag) - pole.imag) > 4 * np.maximum(-np.asarray(poles.real), -pole.real)
        if not (allowed.any() and first < pole.imag / (2 * np.pi) < last):
            break
        pairs = zip(residuals, deviations, strict=True)
        rest = [_without(frf, r, s, jnp.asarray(found)) for r, s in pairs]
    within = [p for p in found if first < p.imag / (2 * np.pi) < last]
    return jnp.asarray(np.array(found[:1] if found and found[0] not in within else within, dtype=complex))


def _levelled(residual: Array) -> Array:
    """Scaled to the level of a neighbourhood far wider than a mode: a bad stretch of the band must not become modes."""
    power = np.asarray(jnp.mean(jnp.abs(residual) ** 2, axis=(1, 2)))
    local = _running_median(power, max(5, len(power) // 5))
    return residual / jnp.asarray(np.sqrt(np.maximum(local, 1e-300)))[:, None, None]


@eqx.filter_jit
def _without(frf: FRF, residual: Array, sigma: Array, poles: Array) -> Array:
    """The residual after the best multiples of the poles' responses were taken out of each channel."""
    s = frf.added_decay + 1j * frf.omega
    near, far = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    kernels = jnp.concatenate([near + far, 1j * (near - far)], axis=1) * s[:, None] ** DERIVATIVES[frf.form]

    def channel(r: Array, weight: Array) -> Array:
        K = _stack((kernels * weight[:, None]).T).T
        Q = jnp.linalg.qr(K / jnp.maximum(jnp.linalg.norm(K, axis=0), 1e-300))[0]
        rest = _stack(r)
        rest = rest - Q @ (Q.T @ rest)
        return rest[: len(s)] + 1j * rest[len(s) :]

    flat = residual.reshape(len(s), -1)
    return jax.vmap(channel, in_axes=1, out_axes=1)(flat, (1 / sigma).reshape(len(s), -1)).reshape(residual.shape)


def _running_median(values: np.ndarray, width: int) -> np.ndarray:
    padded = np.pad(values, width // 2, mode="reflect" if len(values) > width // 2 else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.median(windows, axis=1)[: len(values)]


def _chi2_quantile(tail: float, dof: int) -> float:
    return float(scipy.special.chdtri(dof, tail))
