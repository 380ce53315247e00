r"""Score tests on the whitened residual, for modes that a fit lacks or has without need.

A stabilization diagram shows clear modes, but weakly excited ones are lost in it. The residual of a maximum-likelihood
fit is white noise where nothing is missing, so a missing mode shows as the matched filter's peak,
:math:`S(\lambda) = \sum_{oi} 2|\langle k_\lambda, r_{oi}\rangle|^2/\|k_\lambda\|^2`, which under noise alone is
:math:`\chi^2` with two degrees of freedom a channel.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array
from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.scan import NEW, Grid, poles_missing
from modalax.model.modal import ModalModel

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
    made = model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay)
    deviations = [np.asarray(d) for d in (sigma if isinstance(sigma, (list, tuple)) else [sigma])]
    s = float(frf.added_decay) + 1j * np.asarray(frf.omega)
    found = poles_missing(
        Grid(s, DERIVATIVES[frf.form], inside), np.asarray(frf.H - made.H), deviations, np.asarray(model.poles),
        level=level, most=most, avoid=avoid,
    )  # fmt: skip
    return as_array(found)
