"""A joint without a law: stiffness and loss as smooth functions of the amplitude."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex
from scipy.interpolate import CubicSpline

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place, Scene

START = 1e-3  # of the stiffness that matters, where a fit starts


class FreeLaw(JointCause):
    r"""Stiffness and loss of a joint over the amplitude, :math:`N(A) = k(A) + j\,h(A)`, as natural cubic splines.

    Both are 0 at no amplitude, where the joint belongs to the linear structure, and have a value at each of ``count``
    knots up to ``reach``; beyond it they go on along straight lines. Source of the spline: Green and Silverman (1994),
    Nonparametric Regression and Generalized Linear Models, section 2.

    Parameters
    ----------
    count
        Knots with a value, evenly spaced; two or more.
    reach
        Amplitude of the last one [m], to four digits.
    """

    slug = "free_law"
    summary = "a joint whose stiffness and loss follow the amplitude by no law that is listed"
    named = False
    fidelity = 0.01

    def __init__(self, count: int, reach: float):
        self.count, self.reach = count, f"{reach:.3e}"
        each = range(1, count + 1)
        self.parameters = (
            *(Parameter(f"stiffness_{k}", "N/m") for k in each), *(Parameter(f"loss_{k}", "N/m") for k in each),
        )  # fmt: skip

    @property
    def knots(self) -> np.ndarray:
        """Amplitudes of the values [m], shape ``(count,)``."""
        return float(self.reach) * np.arange(1, self.count + 1) / self.count

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Hardly any force, at each knot of either sign of the stiffness."""
        size = START * scene.stiffness_scale(place) * np.ones(self.count)
        return np.stack([np.concatenate([sign * size, size]) for sign in (1.0, -1.0)])

    def impedance(self, A: Array, omega: Array, p: Array) -> Complex[Array, "..."]:
        """Stiffness and loss at amplitude ``A``."""
        unit = jnp.asarray(self.spline())
        x = A / float(self.reach) * self.count
        k = jnp.clip(jnp.floor(x), 0, self.count - 1).astype(int)
        inside = jnp.clip(x, 0.0, float(self.count)) - k
        weights = jnp.einsum("d...,d...j->...j", inside ** np.arange(3, -1, -1).reshape(-1, *[1] * k.ndim), unit[:, k])
        weights = weights + jnp.maximum(x - self.count, 0.0)[..., None] * self.slope()
        return weights @ p[: self.count] + 1j * (weights @ p[self.count :]) + 0 * omega

    def spline(self) -> np.ndarray:
        """Coefficients of the third to zeroth power in each interval, of each knot's value; ``(4, interval, knot)``."""
        return _splines(self.count).c[:, :, 1:]

    def slope(self) -> np.ndarray:
        """Slope at the last knot, of each knot's value, shape ``(knot,)``."""
        return _splines(self.count)(self.count, 1)[1:]

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """Stiffness and loss at half and all of the range."""
        half = (self.count + 1) // 2 - 1
        return {
            f"{name}_at_{1e6 * self.knots[k]:.3g}_um": (p[first + k], "N/m")
            for k in (half, self.count - 1) for name, first in (("stiffness", 0), ("loss", self.count))
        }  # fmt: skip


def _splines(count: int) -> CubicSpline:
    """Natural cubic splines that are 1 at one of the knots 0, 1, ... and 0 at all others."""
    return CubicSpline(np.arange(count + 1), np.eye(count + 1), bc_type="natural")


def free_law_of(key: str) -> FreeLaw | None:
    """The joint of a saved key; None if it is that of another cause."""
    found = re.fullmatch(r"FreeLaw\(count=(\d+),reach=([\d.e+-]+)\)", key)
    return None if found is None else FreeLaw(int(found[1]), float(found[2]))
