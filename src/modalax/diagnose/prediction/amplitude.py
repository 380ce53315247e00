"""Amplitude across a joint at which its force by one harmonic is in balance, of every line at once."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

BRACKET, GRID, STEPS, POLISH = 60.0, 12, 10, 3  # range of the search, its points, steps between two, and Newton's
DENSER = 2.0  # power by which the points of the search lie closer about a measured amplitude
KNOWN = 0.05  # distance, as a logarithm, from an amplitude that is known, within which its own root lies
TINY = 1e-300  # added to magnitudes so that their logarithm exists at zero


class Root(NamedTuple):
    """The logarithm of an amplitude, what the balance misses there, and how that and the force change with it."""

    at: Array
    value: Array
    slope: Array
    change: Array


def amplitude(miss: Callable[[Array], tuple[Array, Array]], free: Array, near: Array, known: bool) -> Root:
    r"""Find the amplitude A at which :math:`\ln A + \ln|1 + Z(A)\,h| - \ln|u|`, what a balance misses, is zero.

    Z is the force a unit displacement [N/m], h the receptance across the joint [m/N] and u the motion without it [m];
    all arrays have one shape, an entry for each run, line and input, and amplitudes are logarithms of meters.

    Parameters
    ----------
    miss
        Tells of amplitudes what the balance misses, which rises at that of a steady motion, and Z.
    free
        Amplitude without the joint.
    near
        Amplitude that was measured [m], no logarithm, 0 where none was.
    known
        Whether a root right at those is theirs, also where the balance falls.
    """
    value = lambda x: miss(x)[0]
    (low, f_low), (high, f_high) = _bracket(value, free, near)
    ends = _Ends(low, high, high, f_low, f_high, f_high, jnp.full_like(low, 0.5))
    ends = jax.lax.fori_loop(0, STEPS, lambda _, ends: _closer(value, ends), ends)
    x = jnp.where(jnp.abs(ends.f_new) < jnp.abs(ends.f_far), ends.new, ends.far)
    return _at_known(miss, near, x) if known else Root(x, *_at(miss, x))


class _Ends(NamedTuple):
    """Where a root was looked for last, the other end between which it lies, and the point before, with their values.

    ``share`` is that of the way from the first to the second at which it is looked for next.
    """

    new: Array
    far: Array
    old: Array
    f_new: Array
    f_far: Array
    f_old: Array
    share: Array


def _closer(value: Callable[[Array], Array], ends: _Ends) -> _Ends:
    """One step: inverse quadratic interpolation where that is safe, else half of the way.

    Source: Chandrupatla (1997), Adv. Eng. Softw. 28:145.
    """
    a, b, _, fa, fb, _, share = ends
    x = a + share * (b - a)
    f = value(x)
    same = (f >= 0) == (fa >= 0)
    (c, b), (fc, fb) = (jnp.where(same, jnp.stack(ends), jnp.stack(ends[::-1])) for ends in ((a, b), (fa, fb)))
    part, rise = (x - b) / (c - b), (f - fb) / (fc - fb)
    share = f / (fb - f) * fc / (fb - fc) + (c - x) / (b - x) * f / (fc - f) * fb / (fc - fb)
    safe = (rise**2 < part) & ((1 - rise) ** 2 < 1 - part) & (share >= 0) & (share <= 1)
    return _Ends(x, b, c, f, fb, fc, jnp.where(f == 0, 0.0, jnp.where(safe, share, 0.5)))


def _at(miss: Any, x: Array) -> tuple[Array, Array, Array]:
    """What the balance misses, and how that and the force change."""
    (value, _), (slope, change) = jax.jvp(miss, (x,), (jnp.ones_like(x),))
    return value, slope, change


def _bracket(miss: Any, free: Array, near: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Amplitudes between which ``miss`` rises through 0, first or nearest to the measured one, each with its value."""
    even = jnp.linspace(-1.0, 1.0, GRID)
    measured = near > 0
    start = jnp.where(measured, jnp.log(near + TINY), free)
    closer = jnp.sign(even) * jnp.abs(even) ** DENSER
    steps = jnp.log(BRACKET) * jnp.stack([even, closer], axis=1)[(..., *(None,) * free.ndim)]
    points = start + jnp.where(measured, steps[:, 1], steps[:, 0])
    values = jax.lax.map(miss, points)
    above = values >= 0
    rises = above & ~jnp.concatenate([jnp.zeros_like(above[:1]), above[:-1]])
    far = jnp.abs(jnp.arange(GRID) - 0.5 * (GRID - 1))[(..., *(None,) * free.ndim)]
    order = jnp.where(measured, far, jnp.arange(GRID)[(..., *(None,) * free.ndim)])
    first = jnp.where(rises.any(axis=0), jnp.argmin(jnp.where(rises, order, jnp.inf), axis=0), GRID - 1)
    take = lambda a, k: jnp.take_along_axis(a, k[None], axis=0)[0]
    before = jnp.maximum(first - 1, 0)
    return (take(points, before), take(values, before)), (take(points, first), take(values, first))


def _at_known(miss: Any, near: Array, root: Array) -> Root:
    """The root that Newton's steps find right at a known amplitude, else the one that was searched."""
    start = jnp.log(near + TINY)

    def step(_: Any, x: Array) -> Array:
        value, slope, _ = _at(miss, x)
        return x - jnp.clip(value / jnp.where(slope == 0, 1.0, slope), -KNOWN, KNOWN)

    x = jax.lax.fori_loop(0, POLISH, step, start)
    here = (near > 0) & (jnp.abs(x - start) < KNOWN) & (jnp.abs(miss(x)[0]) < 1e-6)
    x = jnp.where(here, x, root)
    return Root(x, *_at(miss, x))
