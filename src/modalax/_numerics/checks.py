"""Checks that refuse unusable numbers with an error that says what was seen and what is needed."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

ALIGNED = 64  # bytes; JAX shares memory that begins at a multiple of these
ENABLE_DOUBLE = 'jax.config.update("jax_enable_x64", True)'


def is_traced(*arrays: Any) -> bool:
    """Whether any of ``arrays`` is being traced (by jit, grad or vmap), so that its values cannot be looked at."""
    return any(isinstance(a, jax.core.Tracer) for a in arrays)


def require_double(what: str) -> None:
    """Refuse to work in single precision.

    Raises
    ------
    ValueError
        If 64-bit numbers are not enabled in JAX; the message holds the line to add.
    """
    if not jax.config.jax_enable_x64:
        raise ValueError(f"{what} needs double precision; add this line before the first use of JAX: {ENABLE_DOUBLE}")


def as_double(value: Any, what: str, complex_: bool = False) -> jax.Array:
    """Return ``value`` as a float64 or complex128 array, and refuse single precision input that would look double.

    What is done later to an array of NumPy does not change it, but for one that is read only, which is not copied.

    Raises
    ------
    ValueError
        If 64-bit numbers are off, or ``value`` was stored in single precision, is sparse or holds no numbers.
    """
    require_double(what)
    dtype = getattr(value, "dtype", None)
    if dtype is not None and np.dtype(dtype) in (np.dtype("float32"), np.dtype("complex64")):
        raise ValueError(
            f"{what} is in single precision ({dtype}); poles over many lines cannot be computed in it. "
            f"Convert it knowingly with .astype('{'complex128' if complex_ else 'float64'}')"
        )
    wanted = np.dtype(np.complex128 if complex_ else np.float64)
    if hasattr(value, "toarray"):
        raise ValueError(f"{what} is a sparse matrix ({type(value).__name__}); .toarray() makes it dense")
    try:
        if is_traced(*jax.tree.leaves(value)) or (dtype is not None and not np.can_cast(dtype, wanted)):
            return jnp.asarray(value, dtype=wanted)
        if isinstance(value, jax.Array) and dtype == wanted and not value.weak_type:  # which other programs are for
            return value
        # NumPy converts without a program for each shape; JAX may share the memory of what it is given
        if isinstance(value, np.ndarray) and value.flags.writeable:
            return jax.device_put(own_copy(value, wanted))
        return jax.device_put(np.asarray(value, wanted))
    except TypeError as error:
        if isinstance(error, jax.errors.JAXTypeError):
            raise
        raise ValueError(f"{what} is a {type(value).__name__}, no numbers: {error}") from error


def own_copy(value: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """A copy, aligned so that JAX takes its memory over and does not copy it again."""
    size = value.size * dtype.itemsize
    room = np.empty(size + ALIGNED, np.uint8)
    start = -room.ctypes.data % ALIGNED
    out = room[start : start + size].view(dtype).reshape(value.shape)
    out[...] = value
    return out


def as_array(value: Any) -> jax.Array:
    """Return ``value`` as an array of JAX; one of NumPy as it is, for which ``jnp.asarray`` may compile a program."""
    return jax.device_put(value) if isinstance(value, np.ndarray | np.generic) else jnp.asarray(value)


def require_finite(value: Any, what: str) -> None:
    """Refuse NaN and infinity; the message says how many there are and where the first one is.

    Raises
    ------
    ValueError
        If ``value`` holds a number that is not finite; traced values cannot be checked.
    """
    if is_traced(value):
        return
    bad = ~np.isfinite(np.asarray(value))
    if bad.any():
        first = tuple(int(k) for k in np.argwhere(bad)[0])
        several = "1 value that is" if bad.sum() == 1 else f"{int(bad.sum())} values that are"
        raise ValueError(f"{what} holds {several} not finite, the first at index {first}")


def require_range(value: Any, what: str, low: float, high: float, needs: str, unknown: bool = False) -> None:
    """Refuse numbers that are not finite or lie outside ``low`` to ``high``; with ``unknown``, NaN is allowed.

    Raises
    ------
    ValueError
        With the first such number, and the text ``needs``; traced values cannot be checked.
    """
    if is_traced(value):
        return
    numbers = np.asarray(value, dtype=float)
    bad = ~((numbers >= low) & (numbers <= high) & np.isfinite(numbers))
    bad &= ~(np.isnan(numbers) & unknown)
    if bad.any():
        first = numbers[bad].ravel()[0]
        count = f" ({int(bad.sum())} of {bad.size})" if bad.size > 1 else ""
        raise ValueError(f"{what} is {first:g}{count}; {needs}")
