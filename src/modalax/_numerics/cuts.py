"""Parts of arrays, without a program compiled for each."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import as_array, is_traced


def spread_over(array: Any, shape: tuple[int, ...]) -> jax.Array:
    """``array`` broadcast to a shape, by NumPy where the numbers are known."""
    if is_traced(array):
        return jnp.broadcast_to(array, shape)
    return array if array.shape == shape else as_array(np.broadcast_to(np.asarray(array), shape))


def cut(array: Any, index: Any) -> jax.Array:
    """``array[index]``, by NumPy where the numbers are known: JAX compiles a program for each new slice and shape."""
    return array[index] if is_traced(array) else as_array(np.asarray(array)[index])
