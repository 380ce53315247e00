"""Parts of arrays, without a program compiled for each."""

from typing import Any

import jax
import numpy as np

from modalax._numerics.checks import as_array, is_traced


def cut(array: Any, index: Any) -> jax.Array:
    """``array[index]``, by NumPy where the numbers are known: JAX compiles a program for each new slice and shape."""
    return array[index] if is_traced(array) else as_array(np.asarray(array)[index])
