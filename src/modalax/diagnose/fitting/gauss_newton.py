"""Damped Gauss-Newton search for many hypotheses side by side, the modal parameters adapting with them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.fitting.hypothesis import Hypothesis, bounds_of, from_search, searched, split
from modalax.diagnose.fitting.nuisance import Nuisance
from modalax.diagnose.fitting.residual import whitened
from modalax.diagnose.setup.problem import Problem

ROUNDS, SETTLED = 14, 5e-3  # steps of the search; change of chi-square at which it ends
UNSEEN = 1e-12  # share of the information below which a combination of unknowns is not seen
BATCH_SAMPLES = 400_000  # complex numbers times unknowns that one batch of candidates may hold


@partial(jax.jit, static_argnames=("causes",))
def _normal_one(causes, index, extras, x, chooser, spread, basis, problem):
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


@partial(jax.jit, static_argnames=("causes",))
def _normal_many(causes, index, extras, x, chooser, spread, basis, problem):
    return jax.vmap(lambda k, e, v: _normal_one(causes, k, e, v, chooser, spread, basis, problem))(index, extras, x)


def fit_many(
    starts: Sequence[Hypothesis], problem: Problem, nuisance: Nuisance, rounds: int = ROUNDS, late: Deadline = NEVER
) -> list[Hypothesis]:
    """Fit hypotheses of the same causes at different places or from different starts, in batches of a fixed size.

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
    if not starts:
        return []
    unknowns = max(1, len(searched(starts[0])) + len(nuisance.chooser))
    size = 4 if problem.data.size * unknowns * 4 <= 40 * BATCH_SAMPLES and len(starts) > 1 else 1
    out: list[Hypothesis] = []
    for k in range(0, len(starts), size):
        part = list(starts[k : k + size])
        out += _fit_batch(part + [part[-1]] * (size - len(part)), problem, nuisance, rounds, late)[: len(part)]
    return out


def _fit_batch(
    starts: list[Hypothesis], problem: Problem, nuisance: Nuisance, rounds: int, late: Deadline
) -> list[Hypothesis]:
    causes = starts[0].causes
    n = problem.modal_form.stiffness.shape[0]
    u = np.stack([searched(h) for h in starts])
    theta = np.stack([np.zeros((2, n)) if h.theta is None else h.theta for h in starts])
    index = np.stack([h.index for h in starts])
    extras = tuple(
        None if starts[0].extras[k] is None else np.stack([h.extras[k] for h in starts]) for k in range(len(causes))
    )
    low, high = bounds_of(causes)
    count = u.shape[1]

    chooser = nuisance.chooser

    def normal(x: np.ndarray, _: np.ndarray) -> Any:
        return _normal_many(causes, index, extras, x, chooser, nuisance.spread, nuisance.basis, problem)

    free = np.full(len(chooser), np.inf)
    start = np.concatenate([u, theta.reshape(len(u), -1) @ chooser.T], axis=1)
    x, chi2, A, open_ = damped(normal, start, np.concatenate([low, -free]), np.concatenate([high, free]), rounds, late)
    u, theta = x[:, :count], (x[:, count:] @ chooser).reshape(theta.shape)
    out = []
    for b, h in enumerate(starts):
        params = [np.asarray(from_search(c, v)) for c, v in zip(causes, split(causes, u[b]), strict=True)]
        out.append(
            replace(
                h, params=tuple(params), theta=theta[b], chi2=float(chi2[b]),
                covariance=covariance_of(A[b])[:count, :count],
                reason="still moving" if open_[b] else "settled",
            )
        )  # fmt: skip
    return out


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
        step = np.stack([_step(A[b], g[b], damping[b], held[b]) for b in range(len(x))])
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


def _step(A: np.ndarray, g: np.ndarray, damping: float, held: np.ndarray) -> np.ndarray:
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
