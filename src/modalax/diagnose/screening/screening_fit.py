r"""Fits of single causes that need no compilation beyond that of the screening.

The screening already holds a compiled function from places and parameters to changes of the prediction. Its
differences give the Jacobian, and the modal nuisances are marginalised in linear order around the simulation:
:math:`\chi^2 = |e|^2 - 2\langle e, r\rangle - c^T(I + G^TG)^{-1}c`, :math:`c = G^Te`, for a change e.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.gauss_newton import covariance_of, damped
from modalax.diagnose.fitting.hypothesis import Hypothesis, bounds_of, from_search, to_search

STEP = 1e-4  # relative step of an unknown for differences
AT_ONCE = 8  # hypotheses fitted side by side
NEAREST, BESIDE = 200, 1e8  # fewest points near a fit that are tried, and most samples of all of them together
DEEPER = 0.5  # chi-square by which another minimum has to be the deeper one


@dataclass(frozen=True)
class Target:
    """What changes are compared with, one row a hypothesis or one for all.

    Attributes
    ----------
    weight
        Weights of the squared changes, shape ``(row, sample)``.
    toward
        Products with the residual, shape ``(row, sample)``.
    nuisance
        Products with the nuisance directions, shape ``(row, k, sample)``.
    inner
        Inverse information of the nuisances, shape ``(k, k)``.
    """

    weight: np.ndarray
    toward: np.ndarray
    nuisance: np.ndarray
    inner: np.ndarray

    def of(self, rows: np.ndarray) -> "Target":
        """The target for some of the hypotheses."""
        weight, toward, nuisance = (a if len(a) == 1 else a[rows] for a in (self.weight, self.toward, self.nuisance))
        return Target(weight, toward, nuisance, self.inner)

    def normal(self, e: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Chi-square less that of the simulation, normal matrix and gradient, for changes ``(row, sample)``."""
        c = np.einsum("bks,bs->bk", np.broadcast_to(self.nuisance, (len(e), *self.nuisance.shape[1:])), e)
        cJ = np.einsum("bks,bsp->bkp", np.broadcast_to(self.nuisance, (len(e), *self.nuisance.shape[1:])), J)
        value = (self.weight * e * e - 2 * self.toward * e).sum(axis=1) - np.einsum("bk,kl,bl->b", c, self.inner, c)
        weighted = np.broadcast_to(self.weight, e.shape)[..., None] * J
        A = np.swapaxes(J, 1, 2) @ weighted - np.einsum("bkp,kl,blq->bpq", cJ, self.inner, cJ)
        g = np.einsum("bsp,bs->bp", J, self.weight * e - self.toward) - np.einsum("bkp,kl,bl->bp", cJ, self.inner, c)
        return value, A, g


def fit_from_screening(
    comparison: Comparison, base: Hypothesis, starts: list[Hypothesis], target: Callable[[list[Hypothesis]], Target],
    changes: Callable[[list[Hypothesis], np.ndarray, np.ndarray], np.ndarray], rounds: int,
) -> list[Hypothesis]:  # fmt: skip
    """Fit hypotheses of one cause each, all of one kind.

    Parameters
    ----------
    target
        What the changes of some hypotheses are compared with.
    changes
        Changes for owners (numbers of hypotheses) and parameters, shape ``(trial, sample)``.
    """
    cause = starts[0].causes[0]
    low, high = bounds_of((cause,))
    logarithmic = [q.logarithmic for q in cause.parameters]
    out: list[Hypothesis] = []
    for k in range(0, len(starts), AT_ONCE):
        part = starts[k : k + AT_ONCE]
        aim = target(part)
        u0 = np.stack([to_search(cause, h.params[0]) for h in part])
        size = np.where(logarithmic, 1.0, np.maximum(np.abs(u0), 1e-12)) if u0.size else u0

        def normal(
            u: np.ndarray, moving: np.ndarray, part: Any = part, aim: Target = aim, size: np.ndarray = size
        ) -> Any:
            rows, every, count = np.flatnonzero(moving), len(u), u.shape[1]
            u = u[rows]
            step = STEP * np.maximum(np.where(logarithmic, 1.0, np.abs(u)), 1e-3 * size[rows])
            step = np.where(u + step > high, -step, step)
            points = np.concatenate([u[:, None], u[:, None] + step[:, None, :] * np.eye(count)[None]], axis=1)
            owner = np.repeat(rows, count + 1)
            E = changes(part, owner, from_search(cause, points.reshape(len(u) * (count + 1), count)))
            E = E.reshape(len(u), count + 1, -1)
            J = (
                np.swapaxes((E[:, 1:] - E[:, :1]) / step[..., None], 1, 2)
                if count
                else np.zeros((len(u), E.shape[2], 0))
            )
            full = np.full(every, np.inf), np.zeros((every, count, count)), np.zeros((every, count))
            for whole, some in zip(full, aim.of(rows).normal(E[:, 0], J), strict=True):
                whole[rows] = some
            return full

        u, value, A, still = damped(normal, u0, low, high, rounds)
        beside = _beside(comparison, part, aim, changes, u, value)
        if beside is not None:
            u, value, A, still = damped(normal, beside, low, high, rounds)
        last = changes(part, np.arange(len(part)), from_search(cause, u))
        c = np.einsum("bks,bs->bk", np.broadcast_to(aim.nuisance, (len(part), *aim.nuisance.shape[1:])), last)
        for j, h in enumerate(part):
            out.append(
                replace(
                    h, params=(from_search(cause, u[j]),), chi2=base.chi2 + float(value[j]),
                    theta=_moved(comparison, base, aim.inner @ c[j]), covariance=covariance_of(A[j]),
                    reason="still moving" if still[j] else "settled",
                )
            )  # fmt: skip
    return out


def _beside(
    comparison: Comparison, part: list[Hypothesis], aim: Target, changes: Any, u: np.ndarray, value: np.ndarray
) -> np.ndarray | None:
    """Unknowns with those of the best hypothesis where its cause has a deeper minimum beside; None if it has none."""
    best = int(np.argmin(value))
    cause, place = part[best].causes[0], part[best].places[0]
    points = cause.nearby(from_search(cause, u[best]), place, comparison.scene)
    points = points[: max(NEAREST, int(BESIDE / max(aim.toward.shape[1], 1)))]
    found = []
    for k in range(0, len(points), AT_ONCE):
        some = points[k : k + AT_ONCE]
        owner = np.full(len(some), best)
        E = changes(part, owner, some)
        found += aim.of(owner).normal(E, np.zeros((*E.shape, 0)))[0].tolist()
    if not found or min(found) > value[best] - DEEPER:
        return None
    out = u.copy()
    out[best] = to_search(cause, points[int(np.argmin(found))])
    return out


def _moved(comparison: Comparison, base: Hypothesis, shift: np.ndarray) -> np.ndarray:
    """Modal parameters that follow the change: those that the simulation had adapted give way to it."""
    assert base.theta is not None
    theta = np.array(base.theta)
    if comparison.nuisance.active:
        live = comparison.nuisance.live
        theta.ravel()[live] -= shift[: len(live)]
    return theta
