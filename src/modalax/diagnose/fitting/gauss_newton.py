"""Damped Gauss-Newton search for the parameters of hypotheses, the modal parameters adapting with them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax._numerics.compiler import lightly
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.fitting.hypothesis import Hypothesis, bounds_of, from_search, searched, split
from modalax.diagnose.fitting.nuisance import Nuisance
from modalax.diagnose.fitting.residual import whitened
from modalax.diagnose.setup.problem import Problem

ROUNDS, SETTLED = 14, 5e-3  # steps of the search; change of chi-square at which it ends
LONG = 8_000  # samples from which on ten steps of a program cost more than to compile it better
UNSEEN = 1e-12  # share of the information below which a combination of unknowns is not seen


def _normal(causes, index, extras, x, chooser, spread, basis, problem):
    count = x.shape[0] - chooser.shape[0]

    def residual(x):
        theta = (x[count:] @ chooser).reshape(spread.shape)
        r = whitened(causes, index, extras, x[:count], theta, spread, basis, problem).ravel()
        return r, r

    if not x.shape[0]:
        r = residual(x)[0]
        return r @ r, jnp.zeros((0, 0)), jnp.zeros(0)
    J, r = jax.jacfwd(residual, has_aux=True)(x)
    chi2, A, g = r @ r, J.T @ J, J.T @ r
    prior = jnp.concatenate([jnp.zeros(count), jnp.ones(chooser.shape[0])])
    return chi2 + jnp.sum(prior * x**2), A + jnp.diag(prior), g + prior * x


_quickly = jax.jit(_normal, static_argnames="causes", compiler_options=lightly(0))
_at_length = jax.jit(_normal, static_argnames="causes", compiler_options=lightly(2))


def fit_many(
    starts: Sequence[Hypothesis], problem: Problem, nuisance: Nuisance, rounds: int = ROUNDS, late: Deadline = NEVER
) -> list[Hypothesis]:
    """Fit hypotheses of the same causes at different places or from different starts, one after the other.

    Parameters
    ----------
    starts
        Hypotheses with the parameters to start from.
    nuisance
        Modal parameters that adapt with them.
    rounds
        Most steps of the search.
    late
        When no further step begins.
    """
    return [_fitted(h, problem, nuisance, rounds, late) for h in starts]


def _fitted(h: Hypothesis, problem: Problem, nuisance: Nuisance, rounds: int, late: Deadline) -> Hypothesis:
    shape = 2, problem.modal_form.stiffness.shape[0]
    u, chooser = searched(h), nuisance.chooser
    low, high = bounds_of(h.causes)
    count = len(u)
    run = _at_length if problem.data.size > LONG else _quickly

    def normal(x: np.ndarray, _: np.ndarray) -> Any:
        found = run(h.causes, h.index, h.extras, x[0], chooser, nuisance.spread, nuisance.basis, problem)
        return [np.asarray(part)[None] for part in found]

    free = np.full(len(chooser), np.inf)
    theta = np.zeros(shape) if h.theta is None else h.theta
    start = np.concatenate([u, chooser @ theta.ravel()])[None]
    x, chi2, A, open_ = damped(normal, start, np.concatenate([low, -free]), np.concatenate([high, free]), rounds, late)
    params = [np.asarray(from_search(c, v)) for c, v in zip(h.causes, split(h.causes, x[0, :count]), strict=True)]
    return replace(
        h, params=tuple(params), theta=(x[0, count:] @ chooser).reshape(shape), chi2=float(chi2[0]),
        covariance=covariance_of(A[0])[:count, :count], reason="still moving" if open_[0] else "settled",
    )  # fmt: skip


def damped(
    normal: Any, x: np.ndarray, low: np.ndarray, high: np.ndarray, rounds: int, late: Deadline = NEVER
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg's and Marquardt's search for many starts side by side.

    Parameters
    ----------
    normal
        Gives chi-square, normal matrix and gradient of half the chi-square at each row of ``x``, from ``x`` and which
        rows are still moving; what it gives for the others is not looked at.

    Returns
    -------
    tuple
        Unknowns, chi-squares, normal matrices, and which were still moving.
    """

    def checked(x: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        chi2, A, g = (np.asarray(a) for a in normal(x, moving))
        bad = ~(np.isfinite(chi2) & np.isfinite(A).all(axis=(1, 2)) & np.isfinite(g).all(axis=1))
        return np.where(bad, np.inf, chi2), np.nan_to_num(A), np.nan_to_num(g)

    chi2, A, g = checked(x, np.ones(len(x), bool))
    damping = np.full(len(x), 1e-3)
    moving = np.isfinite(chi2) & (x.shape[1] > 0)
    for _ in range(rounds):
        if not moving.any() or late():
            break
        # what stands at a bound and is pushed against it stays there; the others do not step as if it moved
        held = ((x <= low) & (g > 0)) | ((x >= high) & (g < 0))
        step = np.stack([damped_step(A[b], g[b], damping[b], held[b]) for b in range(len(x))])
        trial = np.where(moving[:, None], np.clip(x + step, low, high), x)
        new_chi2, new_A, new_g = checked(trial, moving)
        better = moving & (new_chi2 <= chi2)
        drop = np.subtract(chi2, new_chi2, out=np.full(len(x), np.inf), where=better)
        x = np.where(better[:, None], trial, x)
        A = np.where(better[:, None, None], new_A, A)
        g = np.where(better[:, None], new_g, g)
        chi2 = np.where(better, new_chi2, chi2)
        damping = np.where(better, damping / 8, damping * 6)
        moving &= (drop > SETTLED) & (damping < 1e6)
    return x, chi2, A, moving


def damped_step(A: np.ndarray, g: np.ndarray, damping: float, held: np.ndarray) -> np.ndarray:
    """Step of the unknowns that are not held, by normal matrix ``(n, n)`` and gradient ``(n,)`` (Marquardt 1963)."""
    free, out = ~held, np.zeros(len(g))
    scale = np.sqrt(np.maximum(np.diag(A)[free], 1e-300))
    scaled = A[np.ix_(free, free)] / scale[:, None] / scale[None]
    scaled[np.diag_indices_from(scaled)] += damping + 1e-12
    out[free] = -np.linalg.lstsq(scaled, g[free] / scale, rcond=None)[0] / scale
    return out


def covariance_of(A: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; along directions without information the variance is huge instead of zero."""
    diagonal = np.diag(A)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    value, V = np.linalg.eigh(A / scale[:, None] / scale[None])
    return (V / np.maximum(value, UNSEEN)) @ V.T / scale[:, None] / scale[None]
