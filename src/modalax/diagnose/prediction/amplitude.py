"""Amplitude across a joint at which its force by one harmonic is in balance, of every line at once."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

BRACKET, GRID, HALVINGS, POLISH = 60.0, 12, 6, 3  # range of the search, its points, bisections, and Newton's steps
DENSER = 2.0  # power by which the points of the search lie closer about a measured amplitude
KNOWN = 0.05  # distance, as a logarithm, from an amplitude that is known, within which its own root lies
TINY = 1e-300  # added to magnitudes so that their logarithm exists at zero


class Root(NamedTuple):
    """Search for the logarithm of an amplitude.

    Attributes
    ----------
    following, low, high
        Where it is looked at next, and the ends between which it lies.
    at, value, slope, change
        Where it was looked at last; what the balance missed there, and how that and the force change with it.
    """

    following: Array
    low: Array
    high: Array
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
    low, high = _bracket(lambda x: miss(x)[0], free, near)

    def closer(k: Any, at: Root) -> Root:
        """Look at ``following`` and go on: by bisection first, then by Newton's steps that stay between the ends."""
        x = at.following
        value, slope, change = _at(miss, x)
        a, b = jnp.where(value >= 0, at.low, x), jnp.where(value >= 0, x, at.high)
        new = x - value / jnp.where(jnp.abs(slope) > 0.05, slope, 0.05)
        inside = (k >= HALVINGS) & (new >= a) & (new <= b)
        return Root(jnp.where(inside, new, 0.5 * (a + b)), a, b, x, value, slope, change)

    start = Root(0.5 * (low + high), low, high, low, low, low, low + 0j)
    root = jax.lax.fori_loop(0, HALVINGS + POLISH + 1, closer, start)
    return _at_known(miss, near, root) if known else root


def _at(miss: Any, x: Array) -> tuple[Array, Array, Array]:
    """What the balance misses, and how that and the force change."""
    (value, _), (slope, change) = jax.jvp(miss, (x,), (jnp.ones_like(x),))
    return value, slope, change


def _bracket(miss: Any, free: Array, near: Array) -> tuple[Array, Array]:
    """Logarithms of amplitudes between which ``miss`` rises through 0: first of all, or nearest to one measured."""
    even = jnp.linspace(-1.0, 1.0, GRID)
    measured = near > 0
    start = jnp.where(measured, jnp.log(near + TINY), free)
    closer = jnp.sign(even) * jnp.abs(even) ** DENSER
    steps = jnp.log(BRACKET) * jnp.stack([even, closer], axis=1)[(..., *(None,) * free.ndim)]
    points = start + jnp.where(measured, steps[:, 1], steps[:, 0])
    above = jax.lax.map(miss, points) >= 0
    rises = above & ~jnp.concatenate([jnp.zeros_like(above[:1]), above[:-1]])
    far = jnp.abs(jnp.arange(GRID) - 0.5 * (GRID - 1))[(..., *(None,) * free.ndim)]
    order = jnp.where(measured, far, jnp.arange(GRID)[(..., *(None,) * free.ndim)])
    first = jnp.where(rises.any(axis=0), jnp.argmin(jnp.where(rises, order, jnp.inf), axis=0), GRID - 1)
    take = lambda k: jnp.take_along_axis(points, k[None], axis=0)[0]
    return take(jnp.maximum(first - 1, 0)), take(first)


def _at_known(miss: Any, near: Array, root: Root) -> Root:
    """The root that Newton's steps find right at a known amplitude, else the one that was searched."""
    start = jnp.log(near + TINY)

    def step(_: Any, x: Array) -> Array:
        value, slope, _ = _at(miss, x)
        return x - jnp.clip(value / jnp.where(slope == 0, 1.0, slope), -KNOWN, KNOWN)

    x = jax.lax.fori_loop(0, POLISH, step, start)
    here = (near > 0) & (jnp.abs(x - start) < KNOWN) & (jnp.abs(_at(miss, x)[0]) < 1e-6)
    x = jnp.where(here, x, root.at)
    return root._replace(at=x, **dict(zip(("value", "slope", "change"), _at(miss, x), strict=True)))
