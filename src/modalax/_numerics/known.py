"""Formulas of numbers that are known run in NumPy: JAX would compile a program for every new shape."""

import inspect
from collections.abc import Callable, Sequence
from functools import partial, wraps
from types import ModuleType
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from modalax._numerics.checks import as_array, is_traced

Numbers: TypeAlias = jax.Array | np.ndarray
"""What a formula makes: of JAX where an array is traced, else of NumPy."""


def host(value: Any) -> Any:
    """``value`` as an array of NumPy where its numbers are known; as it is where they are traced."""
    return value if is_traced(value) else np.asarray(value)


def stacked(arrays: Sequence[Any]) -> jax.Array:
    """Arrays of one shape along a new first axis."""
    return jnp.stack(arrays) if is_traced(*arrays) else as_array(np.stack([np.asarray(a) for a in arrays]))


def joined(arrays: Sequence[Any]) -> jax.Array:
    """Arrays one after the other along the first axis."""
    return jnp.concatenate(arrays) if is_traced(*arrays) else as_array(np.concatenate([np.asarray(a) for a in arrays]))


def by_numpy(formula: Callable[..., Any]) -> Callable[..., Any]:
    """``formula(xp, *arrays, *, choices)`` without its first argument: NumPy, or JAX where an array is traced.

    Known numbers so need no program of their shape; what is traced by jit, grad or vmap is one compiled function. The
    result is of JAX's arrays either way, and infinite or NaN without a warning where JAX's would be.
    """
    choices = [p.name for p in inspect.signature(formula).parameters.values() if p.kind is p.KEYWORD_ONLY]
    compiled = jax.jit(partial(formula, jnp), static_argnames=choices)

    @wraps(formula)
    def run(*arrays: Any, **choices: Any) -> Any:
        if is_traced(*jax.tree.leaves(arrays)):
            return compiled(*arrays, **choices)
        with np.errstate(all="ignore"):
            return jax.tree.map(as_array, formula(np, *jax.tree.map(np.asarray, arrays), **choices))

    return run


def ends_of(freq: Any) -> tuple[float, float]:
    """First and last of increasing frequencies that are known."""
    known = np.asarray(freq)
    return float(known[0]), float(known[-1])


@by_numpy
def circular(xp: ModuleType, freq: Any) -> Float[Numbers, " f"]:
    """Circular frequencies [rad/s] of frequencies [Hz]."""
    return 2 * np.pi * freq
