r"""Changes of the whitened prediction by one cause at many places and parameters, and what they are compared with.

A cause that touches one sensor changes the FRFs of that sensor only: the change of its rows is all that is computed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax._numerics.compiler import lightly
from modalax.diagnose.causes.base import Cause, ChannelCause
from modalax.diagnose.fitting.nuisance import Nuisance
from modalax.diagnose.fitting.residual import projected
from modalax.diagnose.prediction.frf import NOWHERE, predict, predict_with_channels
from modalax.diagnose.screening.screening_fit import Target
from modalax.diagnose.setup.problem import Problem

BATCH, WHOLE = 32, 8  # trials computed together: of single rows or elements, and of all channels


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
    count = cause.rows if isinstance(cause, ChannelCause) else 0
    whole = not count or problem.held is not None or 4 * count > problem.data.shape[2]
    return None if whole else index[:, :count]


@partial(jax.jit, static_argnames=("cause", "some"), compiler_options=lightly())
def _changes_of_channels(cause, some, index, params, before, weight, basis):
    """A fault of a channel acts on what is predicted without it, so that only the fault itself is compiled."""
    H, channels = before

    def one(k, p):
        if not some:
            return projected(weight * (cause.channels(H, channels, k, None, p) - H), basis).ravel()
        rows, at = k[: cause.rows], k.at[: cause.rows].set(jnp.arange(cause.rows))
        change = cause.channels(H[:, :, rows], channels.at(rows), at, None, p) - H[:, :, rows]
        return projected(weight[:, :, rows] * change, None if basis is None else basis[rows]).ravel()

    return jax.vmap(one)(index, params)


@partial(jax.jit, static_argnames=("cause",), compiler_options=lightly())
def _changes(cause, index, params, before, theta, spread, basis, problem):
    def one(k, p):
        H = predict((cause,), k[None], (None,), (p,), theta * spread, problem)
        return projected(problem.weight * (H - before[0]), basis).ravel()

    return jax.vmap(one)(index, params)


def changes_in_batches(
    cause: Cause, index: np.ndarray, params: np.ndarray, before: Any, theta: np.ndarray, nuisance: Nuisance,
    problem: Problem,
) -> Iterator[np.ndarray]:  # fmt: skip
    """Whitened changes of the prediction by one cause at many places and parameters, shape ``(trial, samples)``.

    The samples are those of the rows that the cause touches (:func:`rows_of`), or all; ``before`` is what
    :func:`plain` gives. Every batch is filled up to one size, so that each cause is compiled once.
    """
    some = rows_of(cause, index, problem) is not None
    size, start = BATCH if some else whole_of(problem), 0
    while start < len(params):
        take = slice(start, start + size)
        at, p = index[take], params[take]
        fill = np.minimum(np.arange(size), len(p) - 1)
        if isinstance(cause, ChannelCause):
            y = _changes_of_channels(cause, some, at[fill], p[fill], before, problem.weight, nuisance.basis)
        else:
            y = _changes(cause, at[fill], p[fill], before, theta, nuisance.spread, nuisance.basis, problem)
        yield np.asarray(y)[: len(p)]
        start += size


@jax.jit
def plain(theta, spread, problem):
    """The prediction without a further cause, and what a fault of a channel may look at."""
    return predict_with_channels((), NOWHERE, (), (), theta * spread, problem)


def whole_of(problem: Problem) -> int:
    """How many trials of all channels are worked on together."""
    return max(1, min(WHOLE, int(4e7 / max(problem.data.size, 1))))
