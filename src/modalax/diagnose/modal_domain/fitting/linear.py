r"""The linearised problem: unknowns that are normal before the data, whitened features that they move in proportion.

With derivatives J, standard deviations S before the data and a covariance of the features :math:`\tau I`, the mean is
:math:`(S^{-2} + J^TJ/\tau)^{-1} J^Td/\tau = S^2J^T(\tau I + JS^2J^T)^{-1}d`. Whichever is smaller is solved: the left
form has as many equations as there are unknowns, the right one as there are features. In the right one causes are kept
apart, :math:`B = \tau I + \sum_g\epsilon_g^2 J_gJ_g^T` being what noise and the groups of the inaccuracy make of the
features (generalised least squares, Aitken 1936): what is known of a cause is no difference of large numbers then, and
new sizes :math:`\epsilon_g` cost nothing but a sum.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from modalax.diagnose.modal_domain.fitting.inaccuracy import Inaccuracy

STEEP = 1e7  # derivatives from which on an inaccuracy may move features so far that rounding hides their noise
SMALLEST = 1e-5  # least relative size of an inaccuracy; no structure is known better
# greatest relative sizes that are tried
LARGEST = {"stiffness": 0.3, "mass": 0.3, "damping": 1.5, "damping between modes": 1.5, "rest": 0.3,
           "stiffness throughout": 1.0, "mass throughout": 1.0, "damping throughout": 3.0, "stiffness within": 0.3,
           "mass within": 0.3}  # fmt: skip


@dataclass(frozen=True)
class Posterior:
    """What a linearised problem tells.

    Attributes
    ----------
    mean
        Of all unknowns, those of the inaccuracy first.
    determined
        Number of well-determined unknowns of each group of the inaccuracy.
    covariance
        Of the sizes of causes, in units of their standard deviations before the data.
    volume
        Half the logarithm of the determinant of the covariance of all, in the same units.
    """

    mean: np.ndarray
    determined: np.ndarray
    covariance: np.ndarray
    volume: float


def widths(u: np.ndarray) -> np.ndarray:
    """Standard deviations before the data of causes' sizes over their usual ones: one, or the size itself beyond it."""
    return np.maximum(1.0, np.abs(u))


class Linear(ABC):
    """A linearised problem.

    Parameters
    ----------
    inaccuracy
        Of which the first unknowns are.
    u
        Sizes of the causes, about which it is linearised.
    """

    def __init__(self, inaccuracy: Inaccuracy, u: np.ndarray):
        self.inaccuracy, self.group, self.widths = inaccuracy, inaccuracy.group_of, widths(u)

    def prior(self, epsilon: np.ndarray) -> np.ndarray:
        """Standard deviation of each unknown."""
        return np.concatenate([epsilon[self.group], self.widths])

    @abstractmethod
    def solve(self, epsilon: np.ndarray, temperature: float = 1.0) -> Posterior:
        """The posterior at sizes of the inaccuracy."""

    @abstractmethod
    def mean(self, epsilon: np.ndarray, temperature: float) -> np.ndarray:
        """The mean alone."""

    @abstractmethod
    def known(self, epsilon: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray]:
        """The mean, and the number of well-determined unknowns of each group."""

    @abstractmethod
    def rise(self, old: np.ndarray, new: np.ndarray) -> float:
        """By how much the chi-square of the features rises from unknowns ``old`` to ``new``."""

    def learnt(self, epsilon: np.ndarray, temperature: float, rounds: int, at: np.ndarray | None = None) -> np.ndarray:
        """Sizes of greatest evidence, with their prior; with the unknowns ``at`` given values, if not at their mean."""
        a, count = self.inaccuracy, len(self.group)
        largest = np.array([LARGEST[g] for g in a.groups])
        for _ in range(rounds):
            x, known = self.known(epsilon, temperature)
            x = x if at is None else at
            total = np.bincount(self.group, (x[:count] / epsilon[self.group]) ** 2, len(epsilon)) - known
            slope = total - np.log(epsilon / a.usual) / a.spread**2
            step = slope / (2 * np.maximum(known, total + known) + 1 / a.spread**2)
            epsilon = np.clip(epsilon * np.exp(np.clip(step, -1.0, 1.0)), SMALLEST, largest)
            if np.abs(step).max() < 0.01:
                break
        return epsilon


class ByUnknowns(Linear):
    """Solved in the space of the unknowns, by the information J'J on them and by J'd."""

    def __init__(self, inaccuracy: Inaccuracy, gram: np.ndarray, right: np.ndarray, u: np.ndarray):
        super().__init__(inaccuracy, u)
        self.gram, self.right = gram, right

    def _factor(self, epsilon: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations of the prior, and the Cholesky factor of the information in units of them."""
        s = self.prior(epsilon)
        inner = self.gram * (s[:, None] * (s / temperature))
        inner.ravel()[:: len(s) + 1] += 1.0
        return s, _cholesky(inner)

    def _grouped(self, each: np.ndarray) -> np.ndarray:
        return np.bincount(self.group, each[: len(self.group)], len(self.inaccuracy.groups))

    def mean(self, epsilon: np.ndarray, temperature: float) -> np.ndarray:
        """The mean alone, which costs a third of :meth:`solve`."""
        s, L = self._factor(epsilon, temperature)
        return s * scipy.linalg.lapack.dpotrs(L, s * self.right / temperature, lower=1)[0]

    def known(self, epsilon: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray]:
        """The mean, and the number of well-determined unknowns of each group."""
        s, L = self._factor(epsilon, temperature)
        x = s * scipy.linalg.lapack.dpotrs(L, s * self.right / temperature, lower=1)[0]
        inverse = scipy.linalg.lapack.dtrtri(L, lower=1, overwrite_c=1)[0] if len(L) else L  # it prints of no rows
        return x, self._grouped(1 - np.einsum("ij,ij->j", inverse, inverse))

    def rise(self, old: np.ndarray, new: np.ndarray) -> float:
        """By how much the chi-square of the features rises from unknowns ``old`` to ``new``."""
        step = new - old
        return float(step @ (self.gram @ step) - 2 * step @ (self.right - self.gram @ old))

    def covariance(self, epsilon: np.ndarray, temperature: float = 1.0) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean, covariance of all unknowns over the prior's, and half the logarithm of the determinant of that."""
        s, L = self._factor(epsilon, temperature)
        V = _inverse(L)
        return s * (V @ (s * self.right / temperature)), V, -float(np.log(L.diagonal()).sum())

    def solve(self, epsilon: np.ndarray, temperature: float = 1.0) -> Posterior:
        """The posterior at sizes of the inaccuracy."""
        x, V, volume = self.covariance(epsilon, temperature)
        count = len(self.group)
        return Posterior(x, self._grouped(1 - np.diag(V)), V[count:, count:], volume)


class ByFeatures(Linear):
    """Solved in the space of the features, by derivatives J and features ``d`` less those of no change at all."""

    def __init__(self, inaccuracy: Inaccuracy, J: np.ndarray, d: np.ndarray, u: np.ndarray):
        super().__init__(inaccuracy, u)
        self.J, self.U, self.d = J[:, : len(self.group)], J[:, len(self.group) :] * self.widths, d

    @cached_property
    def grams(self) -> np.ndarray:
        """What each group makes of the features by a size of one, shape ``(groups, m, m)``."""
        starts = np.searchsorted(self.group, np.arange(len(self.inaccuracy.groups) + 1))
        parts = [self.J[:, a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)]
        return np.stack([part @ part.T for part in parts])

    def _apart(self, epsilon: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Cholesky factor of B, and by it ``L^-1 U``, ``L^-1 d`` and the covariance of the causes' sizes."""
        B = np.tensordot(epsilon**2, self.grams, 1)
        B.ravel()[:: len(B) + 1] += temperature
        L = _cholesky(B)
        both = scipy.linalg.lapack.dtrtrs(L, np.column_stack([self.U, self.d]), lower=1)[0]
        U, d = both[:, :-1], both[:, -1]
        return L, U, d, np.linalg.inv(np.eye(U.shape[1]) + U.T @ U)

    def _mean(self, epsilon: np.ndarray, L: np.ndarray, U: np.ndarray, d: np.ndarray, V: np.ndarray) -> np.ndarray:
        u = V @ (U.T @ d)
        left = scipy.linalg.lapack.dtrtrs(L, d - U @ u, lower=1, trans=1)[0]
        return np.concatenate([epsilon[self.group] ** 2 * (self.J.T @ left), self.widths * u])

    def _determined(self, epsilon: np.ndarray, L: np.ndarray, U: np.ndarray, V: np.ndarray) -> np.ndarray:
        A = _inverse(L)
        if U.shape[1]:
            Y = scipy.linalg.lapack.dtrtrs(L, U, lower=1, trans=1)[0]
            A -= Y @ V @ Y.T
        return epsilon**2 * (self.grams.reshape(len(epsilon), -1) @ A.ravel())

    def _made(self, x: np.ndarray) -> np.ndarray:
        count = len(self.group)
        return self.J @ x[:count] + self.U @ (x[count:] / self.widths)

    def rise(self, old: np.ndarray, new: np.ndarray) -> float:
        """By how much the chi-square of the features rises from unknowns ``old`` to ``new``."""
        step = self._made(new - old)
        return float(step @ step - 2 * step @ (self.d - self._made(old)))

    def mean(self, epsilon: np.ndarray, temperature: float) -> np.ndarray:
        """The mean alone."""
        return self._mean(epsilon, *self._apart(epsilon, temperature))

    def known(self, epsilon: np.ndarray, temperature: float) -> tuple[np.ndarray, np.ndarray]:
        """The mean, and the number of well-determined unknowns of each group."""
        L, U, d, V = self._apart(epsilon, temperature)
        return self._mean(epsilon, L, U, d, V), self._determined(epsilon, L, U, V)

    def solve(self, epsilon: np.ndarray, temperature: float = 1.0) -> Posterior:
        """The posterior at sizes of the inaccuracy."""
        L, U, d, V = self._apart(epsilon, temperature)
        volume = -float(np.log(L.diagonal() / np.sqrt(temperature)).sum()) + 0.5 * float(np.linalg.slogdet(V)[1])
        return Posterior(self._mean(epsilon, L, U, d, V), self._determined(epsilon, L, U, V), V, volume)


def linear_of(inaccuracy: Inaccuracy, J: np.ndarray, d: np.ndarray, u: np.ndarray) -> Linear:
    """The problem of derivatives ``(m, unknowns)`` and features ``(m,)``, in the space that is smaller."""
    if len(J) < J.shape[1] and np.abs(J).max() < STEEP:
        return ByFeatures(inaccuracy, J, d, u)
    return ByUnknowns(inaccuracy, J.T @ J, J.T @ d, u)


def root_of_information(J: np.ndarray, gram: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Lower triangular root of the information of a posterior in units of the prior's deviations ``s``, I + sJ'Js."""
    inner = gram * (s[:, None] * s)
    inner.ravel()[:: len(s) + 1] += 1.0
    try:
        return np.linalg.cholesky(inner)
    except np.linalg.LinAlgError:  # of large derivatives rounding hides the one; their own triangle keeps it
        R = np.linalg.qr(np.concatenate([np.eye(len(s)), J * s]), mode="r")
        return (np.copysign(1.0, np.diag(R))[:, None] * R).T


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular root of a symmetric matrix, which is overwritten."""
    L, wrong = scipy.linalg.lapack.dpotrf(matrix.T, lower=1, overwrite_a=1)  # symmetric: turned, it needs no copy
    if wrong:
        raise np.linalg.LinAlgError("the information of a linearised problem is not positive")
    return L


def _inverse(L: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix by its root."""
    V = scipy.linalg.lapack.dpotri(L, lower=1)[0]  # of a lower triangle, nothing above it
    V = V + V.T
    V.ravel(order="K")[:: len(V) + 1] *= 0.5
    return V
