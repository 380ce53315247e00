"""Several quantities measured at a few points of one coordinate, as smooth functions with a band.

What it takes to be smooth is learnt: the power of the coordinate from all quantities together, the bend and the scatter
of each from itself. All are averaged over by their evidence, so that few points give a wide band.
"""

import itertools

import equinox as eqx
import numpy as np
from jaxtyping import Float

POWERS = (0.25, 0.5, 0.75, 1.0)  # of the coordinate: from the logarithm's side to a straight line in the force
BENDS = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)  # of the spline, relative to each quantity's own change over the points
DIGITS = 1e-12  # change of a quantity, relative to it, that is none
SCATTER = (0.003, 0.01, 0.03, 0.1)  # beyond the stated errors, relative to the same


class Smooth(eqx.Module):
    """Quantities over a coordinate: of each, a mixture of smoothing splines.

    Attributes
    ----------
    points
        Where they were measured, rising and above 0, shape ``(r,)``.
    values, std
        Shape ``(r, q)``.
    settings
        Power, bend and scatter of each spline, shape ``(s, 3)``.
    weights
        Probability of each for each quantity, shape ``(s, q)``.
    """

    points: Float[np.ndarray, " r"]
    values: Float[np.ndarray, "r q"]
    std: Float[np.ndarray, "r q"]
    settings: Float[np.ndarray, "s 3"]
    weights: Float[np.ndarray, "s q"]

    def at(self, point: float) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
        """Mean and standard deviation of each quantity at a point."""
        scale = _range(self.values, self.std)
        mean, square = np.zeros((2, self.values.shape[1]))
        for setting, weight in zip(self.settings, self.weights, strict=True):
            m, v = _predicted(self.points, self.values / scale, self.std / scale, point, setting)
            mean += weight * m
            square += weight * (v + m**2)
        return scale * mean, scale * np.sqrt(np.maximum(square - mean**2, 0.0))


def smooth(points: Float[np.ndarray, " r"], values: Float[np.ndarray, "r q"], std: Float[np.ndarray, "r q"]) -> Smooth:
    """Learn how smooth the quantities are; two points say nothing of that, and the band is as wide as can be."""
    scale = _range(values, std)
    settings = np.array(list(itertools.product(POWERS, BENDS, SCATTER)))
    evidence = np.stack([_evidence(points, values / scale, std / scale, s) for s in settings])
    by_power = evidence.reshape(len(POWERS), -1, values.shape[1])
    own = np.exp(by_power - by_power.max(axis=(0, 1)))
    shared = np.log(own.mean(axis=1)).sum(axis=1)
    shared = np.exp(shared - shared.max())
    weights = own / own.sum(axis=1, keepdims=True) * (shared / shared.sum())[:, None, None]
    return Smooth(points, values, std, settings, weights.reshape(len(settings), -1))


def _range(values: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Change of each quantity over the points; of one that is the same at all, its error or its last digits."""
    span = np.ptp(values, axis=0)
    same = np.maximum(std.max(axis=0), DIGITS * np.abs(values).max(axis=0))
    return np.where(span > 0, span, np.maximum(same, np.finfo(float).tiny))


def _coordinate(x: np.ndarray, points: np.ndarray, power: float) -> np.ndarray:
    """The coordinate, 0 at no force and with the measured points one apart from first to last."""
    y = points**power
    return x**power / (y[-1] - y[0])


def _spline(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    low = np.minimum(x[:, None], y)
    return low**3 / 3 + low**2 / 2 * np.abs(x[:, None] - y)


def _evidence(points: np.ndarray, values: np.ndarray, std: np.ndarray, setting: np.ndarray) -> np.ndarray:
    """Restricted log likelihood of each quantity: of what a straight line cannot take."""
    power, bend, scatter = setting
    x = _coordinate(points, points, power)
    free = np.linalg.qr(np.stack([np.ones_like(x), x], axis=1), mode="complete")[0][:, 2:]
    C = bend**2 * _spline(x, x) + (std.T**2 + scatter**2)[:, :, None] * np.eye(len(x))
    C = free.T @ C @ free
    r = (free.T @ values).T[:, :, None]
    fit = (r.transpose(0, 2, 1) @ np.linalg.solve(C, r))[:, 0, 0]
    return -0.5 * fit - 0.5 * np.linalg.slogdet(C)[1]


def _predicted(
    points: np.ndarray, values: np.ndarray, std: np.ndarray, point: float, setting: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Universal kriging: mean and variance of each quantity at a point, the straight line free."""
    power, bend, scatter = setting
    x = _coordinate(points, points, power)
    new = _coordinate(np.array([point]), points, power)
    line, here = np.stack([np.ones_like(x), x], axis=1), np.array([1.0, new[0]])
    k = bend**2 * _spline(x, new)[:, 0]
    own = bend**2 * float(_spline(new, new)[0, 0])
    inner = np.linalg.inv(bend**2 * _spline(x, x) + (std.T**2 + scatter**2)[:, :, None] * np.eye(len(x)))
    y = values.T[:, :, None]
    normal = np.linalg.inv(line.T @ inner @ line)
    slope = normal @ (line.T @ inner @ y)
    pull = inner @ k  # (q, r)
    mean = (here @ slope)[:, 0] + np.einsum("qr,qr->q", pull, (y - line @ slope)[:, :, 0])
    lack = here - pull @ line
    variance = own - pull @ k + np.einsum("qi,qij,qj->q", lack, normal, lack)
    return mean, np.maximum(variance, 0.0)
