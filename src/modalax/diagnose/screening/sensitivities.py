r"""Changes of the whitened prediction by one cause at many places and parameters, and what they are compared with.

A cause that touches one sensor changes the FRFs of that sensor only: the change of its rows is all that is computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.fitting.nuisance import Nuisance
from modalax.diagnose.fitting.residual import projected
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.screening.screening_fit import Target
from modalax.diagnose.setup.problem import Problem

BATCH, WHOLE = 32, 8  # trials computed together: of single rows or elements, and of all channels
NOWHERE = np.zeros((0, 3), np.int64)


@dataclass(frozen=True)
class Residual:
    """Residual of the present hypothesis and its nuisance directions.

    Attributes
    ----------
    value
        Whitened, projected, shape ``(o, i, run f 2)``.
    nuisance
        Directions of the modal parameters times their spread, shape ``(k, o, i, run f 2)``.
    inner
        :math:`(I + G^TG)^{-1}`, shape ``(k, k)``.
    """

    value: np.ndarray
    nuisance: np.ndarray
    inner: np.ndarray

    def target(self, rows: np.ndarray | None = None) -> Target:
        """What changes are compared with: whole ones, or those of the outputs ``rows``, shape ``(trial, row)``."""
        count = len(self.inner)
        if rows is None:
            return Target(np.ones((1, 1)), self.value.reshape(1, -1), self.nuisance.reshape(1, count, -1), self.inner)
        nuisance = np.moveaxis(self.nuisance[:, rows], 0, 1).reshape(len(rows), count, -1)
        return Target(np.ones((1, 1)), self.value[rows].reshape(len(rows), -1), nuisance, self.inner)


def rows_of(cause: Cause, index: np.ndarray, problem: Problem) -> np.ndarray | None:
    """Outputs that a cause touches at each place, shape ``(place, row)``; None where it may touch any.

    Parameters
    ----------
    cause
        What is screened.
    index
        Places as numbers, shape ``(place, 3)``.
    problem
        Of how many outputs, and what the simulation has already.
    """
    whole = not cause.rows or problem.held is not None or 4 * cause.rows > problem.data.shape[2]
    return None if whole else index[:, : cause.rows]


@partial(jax.jit, static_argnames=("cause",), compiler_options={"xla_backend_optimization_level": 1})
def _changes(cause, index, params, base, theta, spread, basis, problem):
    def one(k, p):
        H = predict((cause,), k[None], (None,), (p,), theta * spread, problem)
        return projected(problem.weight * (H - base), basis).ravel()

    return jax.vmap(one)(index, params)


@partial(jax.jit, static_argnames=("cause",), compiler_options={"xla_backend_optimization_level": 1})
def _changes_of_rows(cause, index, params, base, theta, spread, basis, problem):
    def one(k, p):
        rows = k[: cause.rows]
        few = eqx.tree_at(
            lambda q: (q.data, q.weight, q.outputs), problem,
            (problem.data[:, :, rows], problem.weight[:, :, rows], problem.outputs[rows]),
        )  # fmt: skip
        at = k.at[: cause.rows].set(jnp.arange(cause.rows))
        H = predict((cause,), at[None], (None,), (p,), theta * spread, few)
        return projected(few.weight * (H - base[:, :, rows]), None if basis is None else basis[rows]).ravel()

    return jax.vmap(one)(index, params)


def changes_in_batches(
    cause: Cause, index: np.ndarray, params: np.ndarray, base: Any, theta: np.ndarray, nuisance: Nuisance,
    problem: Problem,
) -> Iterator[np.ndarray]:  # fmt: skip
    """Whitened changes of the prediction by one cause at many places and parameters, shape ``(trial, samples)``.

    The samples are those of the rows that the cause touches (:func:`rows_of`), or all. Every batch is filled up to one
    size, so that each cause is compiled once.
    """
    some = rows_of(cause, index, problem) is not None
    change, size, start = _changes_of_rows if some else _changes, BATCH if some else whole_of(problem), 0
    while start < len(params):
        take = slice(start, start + size)
        at, p = index[take], params[take]
        fill = np.minimum(np.arange(size), len(p) - 1)
        y = change(cause, at[fill], p[fill], base, theta, nuisance.spread, nuisance.basis, problem)
        yield np.asarray(y)[: len(p)]
        start += size


@jax.jit
def plain(theta, spread, problem):
    """The prediction without a further cause."""
    return predict((), NOWHERE, (), (), theta * spread, problem)


def whole_of(problem: Problem) -> int:
    """How many trials of all channels are worked on together."""
    return max(1, min(WHOLE, int(4e7 / max(problem.data.size, 1))))
