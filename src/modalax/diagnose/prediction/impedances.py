"""Impedances of elements for many parameters, frequencies and amplitudes at once.

They are evaluated in rows of one length, so that what is compiled for a cause serves measurements of any size.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np

from modalax._numerics.compiler import lightly
from modalax.diagnose.causes.base import ElementCause, JointCause, LocalCause

ROW = 2048  # entries that are evaluated together


@partial(jax.jit, static_argnames="cause", compiler_options=lightly())
def _linear_row(cause: LocalCause, p: Any, omega: Any) -> tuple[Any, Any]:
    def one(p: Any, omega: Any) -> tuple[Any, Any]:
        Z = cause.impedance(1j * omega[None], p)
        if Z.shape != (1,):
            raise ValueError(
                f"the impedance of {cause.slug!r} has the shape {Z.shape} at one line; it must have that of its "
                "argument s, (1,) here: what it takes from a table of lines has to be interpolated at s"
            )
        return Z[0], Z[0]

    return jax.vmap(jax.jacfwd(one, has_aux=True))(p, omega)


@partial(jax.jit, static_argnames="cause", compiler_options=lightly())
def _joint_row(cause: JointCause, p: Any, omega: Any, A: Any) -> Any:
    one = lambda p, omega, A: cause.impedance(A[:, None, None], omega[None, None, None], p)[:, 0, 0]
    return jax.vmap(one)(p, omega, A)


def _by_rows(row: Callable[..., Any], *columns: np.ndarray) -> Any:
    """What a compiled function makes of entries ``(n, ...)``, in rows of one length; a tree of arrays."""
    size = len(columns[0])
    kept = np.resize(np.arange(size), -(-size // ROW) * ROW).reshape(-1, ROW)
    made = [row(*(c[k] for c in columns)) for k in kept]
    return jax.tree.map(lambda *parts: np.concatenate([np.asarray(x) for x in parts])[:size], *made)


def linear_impedances(cause: LocalCause, p: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Impedances of a linear element [N/m] and their slopes, shapes ``(..., f)`` and ``(..., f, parameter)``.

    Parameters
    ----------
    cause
        The element.
    p
        Its parameters, shape ``(..., parameter)``.
    omega
        Circular frequencies [rad/s], shape ``(f,)``.

    Raises
    ------
    ValueError
        If the impedance does not have the shape of the lines that it is asked at.
    """
    shape = *p.shape[:-1], len(omega), p.shape[-1]
    each = np.broadcast_to(p[..., None, :], shape).reshape(-1, p.shape[-1])
    slopes, Z = _by_rows(partial(_linear_row, cause), each, np.broadcast_to(omega, shape[:-1]).ravel())
    return Z.reshape(shape[:-1]), slopes.reshape(shape)


def impedances(cause: ElementCause, p: np.ndarray, omega: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Force over displacement [N/m] of an element, or of one harmonic of a joint, shape ``(..., run, f, i)``.

    Parameters
    ----------
    cause
        The element.
    p
        Its parameters, shape ``(..., parameter)``; leading axes, of trials, are broadcast against those of ``A``.
    omega
        Circular frequencies [rad/s], shape ``(f,)``.
    A
        Amplitudes across it [m], shape ``(..., run, f, i)``.
    """
    p = np.asarray(p, float)
    trials = np.broadcast_shapes(p.shape[:-1], A.shape[:-3])
    p, shape = np.broadcast_to(p, (*trials, p.shape[-1])), (*trials, *A.shape[-3:])
    if not isinstance(cause, JointCause):
        return np.broadcast_to(linear_impedances(cause, p, omega)[0][..., None, :, None], shape)
    # (trial, run, f, i) or, where a run has parameters of its own, with all runs in one entry
    A = np.broadcast_to(A, shape)
    A = np.moveaxis(A, -3, -1) if cause.each_run else A[..., None]
    each = np.broadcast_to(p.reshape(*trials, *[1] * (A.ndim - 1 - len(trials)), -1), (*A.shape[:-1], p.shape[-1]))
    lines = np.broadcast_to(omega[:, None], A.shape[:-1])
    Z = _by_rows(partial(_joint_row, cause), each.reshape(-1, p.shape[-1]), lines.ravel(), A.reshape(-1, A.shape[-1]))
    Z = Z.reshape(A.shape)
    return np.moveaxis(Z, -1, -3) if cause.each_run else Z[..., 0]
