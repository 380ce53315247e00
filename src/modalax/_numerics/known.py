"""Formulas of numbers that are known run in NumPy: JAX would compile a program for every new shape."""

import inspect
from collections.abc import Callable, Sequence
from functools import partial, wraps
from types import ModuleType
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jax import lax
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
    return _by_either(formula, lambda *arrays: is_traced(*arrays))


def by_numpy_beside(formula: Callable[..., Any]) -> Callable[..., Any]:
    """:func:`by_numpy` for long work, which stays on an accelerator that holds the numbers."""
    return _by_either(formula, lambda *arrays: is_traced(*arrays) or accelerated(*arrays))


def accelerated(*arrays: Any) -> bool:
    """Whether any of ``arrays`` is held by another device than the processor."""
    return any(d.platform != "cpu" for a in arrays if isinstance(a, jax.Array) for d in a.devices())


def _by_either(formula: Callable[..., Any], by_jax: Callable[..., bool]) -> Callable[..., Any]:
    choices = [p.name for p in inspect.signature(formula).parameters.values() if p.kind is p.KEYWORD_ONLY]
    compiled = jax.jit(partial(formula, jnp), static_argnames=choices)

    @wraps(formula)
    def run(*arrays: Any, **choices: Any) -> Any:
        if by_jax(*jax.tree.leaves(arrays)):
            return compiled(*arrays, **choices)
        with np.errstate(all="ignore"):
            return jax.tree.map(as_array, formula(np, *jax.tree.map(np.asarray, arrays), **choices))

    return run


def module_of(*arrays: Any) -> ModuleType:
    """JAX where one of ``arrays`` is of it, else NumPy."""
    return jnp if any(isinstance(a, jax.Array) for a in arrays) else np


def constant(xp: ModuleType, x: Numbers) -> Numbers:
    """Numbers of which no derivative is taken."""
    return lax.stop_gradient(x) if xp is jnp else x


def scan(
    xp: ModuleType, step: Callable[[Any, Any], tuple[Any, Any]], start: Any, rows: Any = None, *,
    length: int | None = None,
) -> tuple[Any, Any]:  # fmt: skip
    """``lax.scan``, or the loop that it stands for: the last state, and what the steps gave, along a new first axis."""
    if xp is jnp:
        return lax.scan(step, start, rows, length=length)
    count = len(jax.tree.leaves(rows)[0]) if length is None else length
    state, made = start, []
    for k in range(count):
        state, out = step(state, jax.tree.map(lambda a, k=k: a[k], rows))
        made.append(out)
    if not made and rows is None:  # what a step would have given tells the shape of none
        made = [step(start, None)[1]]
    return state, jax.tree.map(lambda *rows: np.stack(rows)[:count], *made) if made else None


def over_first(xp: ModuleType, function: Callable[..., Any], *arrays: Any) -> Any:
    """``jax.vmap``, or the loop that it stands for: ``function`` of every entry along the first axis."""
    if xp is jnp:
        return jax.vmap(function)(*arrays)
    made = [function(*entries) for entries in zip(*arrays, strict=True)]
    return jax.tree.map(lambda *rows: np.stack(rows), *made)


def solved(xp: ModuleType, A: Numbers, b: Numbers) -> Numbers:
    """Solution of ``A x = b``, columns ``b``, over leading axes; NaN or infinite where a known matrix is singular."""
    if xp is jnp:
        return jnp.linalg.solve(A, b)
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        if A.ndim == 2:
            return np.full(b.shape, np.nan, np.result_type(A, b))
        return np.stack([solved(np, *one) for one in zip(A, b, strict=True)])


def cholesky(xp: ModuleType, M: Numbers) -> Numbers:
    """Lower triangular factor; NaN where a known matrix is not positive definite."""
    try:
        return xp.linalg.cholesky(M)
    except np.linalg.LinAlgError:
        return np.full(M.shape, np.nan, M.dtype)


def triangular_solved(xp: ModuleType, T: Numbers, b: Numbers, *, adjoint: bool = False) -> Numbers:
    """Solution of an upper triangular system, or of its adjoint; infinite or NaN where a known one is singular."""
    if xp is jnp:
        return jax.scipy.linalg.solve_triangular(T, b, trans="C" if adjoint else "N")
    (solve,) = scipy.linalg.get_blas_funcs(("trsm",), (T, b))
    return solve(1.0, T, b, trans_a=2 if adjoint else 0)


def ends_of(freq: Any) -> tuple[float, float]:
    """First and last of increasing frequencies that are known."""
    known = np.asarray(freq)
    return float(known[0]), float(known[-1])


@by_numpy
def circular(xp: ModuleType, freq: Any) -> Float[Numbers, " f"]:
    """Circular frequencies [rad/s] of frequencies [Hz]."""
    return 2 * np.pi * freq
