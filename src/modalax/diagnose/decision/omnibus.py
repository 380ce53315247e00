r"""Omnibus tests for anything but noise in a residual, without reference to a cause.

Residuals are summed over short stretches of neighbouring lines: an effect spread over a resonance adds up there as
its amplitude, noise only as its square root, so that it is seen at a third of the size that a plain chi-square needs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from modalax.diagnose.setup.noise import TRUSTED

STRETCHES = (1, 4, 12, 40)  # numbers of neighbouring lines that are summed


@dataclass(frozen=True)
class Omnibus:
    """Result of the tests on one residual.

    Attributes
    ----------
    p_value
        Chance of so large a deviation under noise alone, corrected for the number of tests.
    z
        Largest standardised deviation.
    where
        Which test it was.
    whiteness
        Correlation of neighbouring residuals and its standard score.
    """

    p_value: float
    z: float
    where: str
    whiteness: tuple[float, float]


def omnibus(residual: np.ndarray, live: np.ndarray, freedom: float, tolerated: float = 0.0) -> Omnibus:
    """Test whitened residuals.

    Parameters
    ----------
    residual
        Complex, both parts of unit variance, shape ``(run, f, o, i)``.
    live
        Which samples count.
    freedom
        Degrees of freedom of each line's variance before smoothing: an estimated scale adds its own spread.
    tolerated
        Chi-square that the known inexactness of a law may leave.
    """
    r = np.where(live, residual, 0.0)
    spread = 1.0 + (4.0 / freedom if np.isfinite(freedom) else 0.0)
    tests = []
    kinds: dict[str, tuple[np.ndarray, Any]] = {"each run": (r, live)}
    if r.shape[0] > 1:
        count = np.maximum(live.sum(axis=0, keepdims=True), 1)
        kinds["all runs"] = (r.sum(axis=0, keepdims=True) / np.sqrt(count), live.any(axis=0, keepdims=True))
    for name, (value, on) in kinds.items():
        for stretch in STRETCHES if freedom >= TRUSTED else STRETCHES[2:]:
            if stretch > 1 and value.shape[1] < 2 * stretch:
                continue
            sums, n = _stretches(value, on, stretch)
            square = np.abs(sums) ** 2 / np.maximum(n, 1)
            dof = 2 * int((n > 0).sum())
            if dof == 0:
                continue
            total = float(square[n > 0].sum()) - tolerated
            # the cube root brings a chi-square to a normal even for few degrees of freedom
            z = (np.cbrt(max(total, 0.0) / dof) - (1 - 2 / (9 * dof))) / np.sqrt(2 / (9 * dof) * spread)
            tests.append((float(z), f"{name}, {'single lines' if stretch == 1 else f'stretches of {stretch} lines'}"))
            if tolerated == 0 and stretch > 1:  # one sample far off is an outlier, no effect that a model lacks
                top = float(square[n > 0].max())
                p = -np.expm1(dof / 2 * np.log1p(-min(np.exp(-top / 2), 1 - 1e-16)))
                tests.append(
                    (
                        float(-scipy.special.ndtri(min(max(p * 1.0, 1e-300), 1 - 1e-9))) / np.sqrt(spread),
                        f"largest of {name}, {stretch} lines",
                    )
                )
    z, where = max(tests, default=(0.0, ""))
    return Omnibus(min(1.0, float(scipy.special.ndtr(-z)) * max(len(tests), 1)), z, where, whiteness(r, live))


def _stretches(value: np.ndarray, live: np.ndarray, stretch: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums over stretches of neighbouring lines, and how many samples each holds."""
    pad = -value.shape[1] % stretch
    shape = (value.shape[0], -1, stretch, *value.shape[2:])
    fill = ((0, 0), (0, pad), (0, 0), (0, 0))
    return np.pad(value, fill).reshape(shape).sum(axis=2), np.pad(live, fill).reshape(shape).sum(axis=2)


def whiteness(residual: np.ndarray, live: np.ndarray) -> tuple[float, float]:
    """Correlation of residuals of neighbouring lines, and how many standard deviations it is from 0."""
    both = live[:, 1:] & live[:, :-1]
    n = int(both.sum())
    power = float((np.abs(residual[live]) ** 2).mean()) if live.any() else 0.0
    if n < 2 or power == 0:
        return 0.0, 0.0
    rho = float(np.real((residual[:, 1:] * residual[:, :-1].conj())[both]).mean() / power)
    return rho, rho * np.sqrt(2 * n)
