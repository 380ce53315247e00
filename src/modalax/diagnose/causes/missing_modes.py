"""Modes that the simulation lacks, in band or out of it: any real residue in each channel."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.causes.mains_hum import hums
from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Scene


class MissingMode(PatternCause):
    r"""A whole mode in band, :math:`\phi\phi^T/(m (s^2 + 2\zeta\omega_x s + \omega_x^2))`."""

    slug = "missing_mode"
    advice = "measure a second column of the FRF matrix"
    summary = "a whole mode in band"
    parameters = (
        Parameter("participation", "-"),
        Parameter("frequency", "Hz", 1e-3, 1e7, log=True),
        Parameter("damping_ratio", "-", 1e-4, 0.5, log=True, ends=True),
    )

    def shapes(self, scene: Scene) -> np.ndarray:
        """Frequencies dense enough that no mode falls between two."""
        low, high = scene.freq[0], scene.freq[-1]
        count = int(np.clip(np.log(high / low) / 0.012, 16, 160))
        return np.array([(f, z) for f in np.geomspace(low, high, count) for z in (0.006, 0.02, 0.05)])

    def curves(self, s: Any, q: Any) -> Any:
        """Receptance of the mode for unit mass."""
        w = 2 * jnp.pi * q[0]
        return (1 / (s**2 + 2 * q[1] * w * s + w**2))[None]

    def fits(self, p: np.ndarray, scene: Scene) -> bool:
        """Only a mode within the band that is no hum, its damping within its limits and not at one of them."""
        low, high, damping = scene.freq[0], scene.freq[-1], self.parameters[2]
        inside = 0.98 * low <= p[1] <= 1.02 * high and 1.5 * damping.lower < p[2] < damping.upper / 1.5
        return bool(inside and not hums(p[1], p[2], scene.freq))


class OutOfBand(PatternCause):
    r"""Modes above and below the band, :math:`1/(\omega_u^2 + s^2)` and :math:`1/(\omega_l^2 + s^2)` without damping.

    Far away these are the residual terms :math:`R_U` and :math:`-R_L/\omega^2`: of one mode a side, or of ``several``.
    """

    slug = "out_of_band"
    advice = "measure a wider band"

    def __init__(self, side: str, several: bool = False):
        self.side = side
        if several:
            self.several, self.prior = True, 0.3
        self.sides = ("upper", "lower") if side == "both" else (side,)
        self.terms = len(self.sides)
        self.summary = f"residual terms{' of several modes' * several}: {' and '.join(self.sides)}"
        self.parameters = tuple(Parameter(name, "-") for name in self.sides) + tuple(
            Parameter(f"{name}_frequency", "Hz", 1e-6, 1e7, log=True) for name in self.sides
        )

    def shapes(self, scene: Scene) -> np.ndarray:
        """A few distances from the band."""
        low, high = scene.freq[0], scene.freq[-1]
        away = {"upper": [high * a for a in (1.3, 2.0, 4.0, 30.0)], "lower": [low * b for b in (0.7, 0.3, 0.03)]}
        return np.stack([m.ravel() for m in np.meshgrid(*[away[name] for name in self.sides])], axis=1)

    def curves(self, s: Any, q: Any) -> Any:
        """The terms, each 1 in the middle of its own range."""
        out = []
        for k, name in enumerate(self.sides):
            w = 2 * jnp.pi * q[k]
            out.append(w**2 / (w**2 + s**2) if name == "upper" else 1 / (w**2 + s**2))
        return jnp.stack(out)

    def cost(self, extra: Any) -> float:
        """The distances are hardly seen: one unknown for all."""
        return self.free_sizes(extra) + 1.0

    def fits(self, p: np.ndarray, scene: Scene) -> bool:
        """Only modes outside the band."""
        at = dict(zip(self.sides, p[self.terms :], strict=True))
        return bool(at.get("upper", np.inf) > scene.freq[-1] and at.get("lower", 0.0) < scene.freq[0])


SIDES = ("upper", "lower", "both")
MISSING_MODES: tuple[Any, ...] = (
    MissingMode(), *(OutOfBand(side) for side in SIDES), *(OutOfBand(side, several=True) for side in SIDES),
)  # fmt: skip
