"""Whitened residuals of a hypothesis and their derivatives."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from modalax._numerics.checks import is_traced
from modalax._numerics.compiler import lightly
from modalax.diagnose.causes.base import Cause
from modalax.diagnose.fitting.hypothesis import from_search, split
from modalax.diagnose.prediction.frf import NOWHERE, predict
from modalax.diagnose.setup.problem import Problem


@partial(jax.jit, compiler_options=lightly(0))
def modal_directions(theta, spread, basis, problem):
    """Change of the whitened prediction by one standard deviation of each modal parameter.

    The shape of the result is ``(2 n, o, i, run f 2)``.

    Parameters
    ----------
    theta
        Modal parameters in units of their spread, shape ``(2, n)``.
    spread
        Their standard deviations, shape ``(2, n)``.
    basis
        Directions that are taken out, or None.
    """

    def one(t):
        H = predict((), NOWHERE, (), (), t * spread, problem)
        return projected(problem.weight * H, basis)

    J = jax.jacfwd(one)(theta)
    return jnp.moveaxis(J.reshape(*J.shape[:3], -1), -1, 0)


def complex_of(value: np.ndarray, runs: int) -> np.ndarray:
    """Whitened arrays ``(..., o, i, run f 2)`` as complex ``(..., run, f, o, i)``."""
    z = value.reshape(*value.shape[:-1], runs, -1, 2)
    z = z[..., 0] + 1j * z[..., 1]
    return np.moveaxis(z, (-4, -3), (-2, -1))


def laid_out(z: Any) -> Any:
    """Complex ``(..., run, f, o, i)`` as whitened residuals are, ``(..., o, i, run f 2)``."""
    xp: Any = jnp if is_traced(z) else np
    z = xp.moveaxis(xp.stack([z.real, z.imag], axis=-1), (-3, -2), (-5, -4))
    return z.reshape(*z.shape[:-3], -1)


def projected(r: Any, basis: Any) -> Any:
    """Real and imaginary parts of whitened residuals, shape ``(o, i, run f 2)``, free directions taken out."""
    xp: Any = jnp if is_traced(r) else np
    real = laid_out(r)
    if basis is None:
        return real
    return real - xp.einsum("oink,oik->oin", basis, xp.einsum("oink,oin->oik", basis, real))


def whitened(
    causes: Sequence[Cause], index: Array, extras: Any, u: Array, theta: Array, spread: Array, basis: Any,
    problem: Problem,
) -> Array:  # fmt: skip
    """Whitened residuals of a hypothesis, free directions taken out, shape ``(o, i, run f 2)``.

    Parameters
    ----------
    index, extras
        Places as numbers and further data of each cause.
    u
        Unknowns of the causes as searched.
    theta, spread
        Modal parameters in units of their spread, and that spread, shape ``(2, n)``.
    basis
        Directions that are taken out, or None.
    """
    params = [from_search(c, v) for c, v in zip(causes, split(causes, u), strict=True)]
    H = predict(causes, index, extras, params, theta * spread, problem)
    return projected(problem.weight * (problem.data - H), basis)


def residual_of(H: np.ndarray, basis: Any, problem: Problem) -> np.ndarray:
    """Whitened residuals of receptances that have been predicted, shape ``(o, i, run f 2)``."""
    with np.errstate(all="ignore"):  # what a hypothesis predicts may be beyond all numbers
        return projected(np.asarray(problem.weight) * (np.asarray(problem.data) - H), basis)


@partial(jax.jit, static_argnames=("causes",), compiler_options=lightly(0))
def jacobian_of(causes, index, extras, u, theta, spread, basis, problem):
    """Derivatives of the whitened residual by the searched unknowns, shape ``(unknown, o, i, run f 2)``."""
    J = jax.jacfwd(lambda v: whitened(causes, index, extras, v, theta, spread, basis, problem))(u)
    return jnp.moveaxis(J, -1, 0)


def free_basis(problem: Problem) -> np.ndarray:
    """Whitened directions that any linear modal model with the same poles can take, orthonormal in each channel."""
    s = 1j * np.asarray(problem.omega)[:, None]
    poles = np.asarray(problem.modal_form.poles)
    live = np.abs(np.asarray(problem.modal_form.shapes)).max(axis=1) > 0
    near, far = 1 / (s - poles[live]), 1 / (s - poles[live].conj())
    columns = np.concatenate(
        [near + far, 1j * (near - far), np.ones_like(s), 1j * np.ones_like(s), 1 / s**2, 1j / s**2], axis=1
    )
    weight = np.asarray(problem.weight)
    A = weight.transpose(2, 3, 0, 1)[..., None] * columns
    real = np.stack([A.real, A.imag], axis=-2).reshape(*A.shape[:2], -1, A.shape[-1])
    norm = np.linalg.norm(real, axis=-2, keepdims=True)
    Q, R = np.linalg.qr(real / np.where(norm > 0, norm, 1.0))
    strong = np.abs(np.diagonal(R, axis1=-2, axis2=-1)) > 1e-9
    return Q * strong[..., None, :]
