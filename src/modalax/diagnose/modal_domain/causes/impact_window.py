"""The decay of an impact window, which all channels have in common."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates


@dataclass(frozen=True)
class ImpactWindow(Change):
    r"""The decay :math:`\sigma` of an impact window, :math:`H(s + \sigma)`.

    With it the dynamic stiffness is :math:`s^2M + s(C + 2\sigma M) + K + \sigma C + \sigma^2M`, so that all poles move
    by :math:`-\sigma`, and residues stay. Source: Ewins (2000), Modal Testing, 2nd ed., chapter 3.

    Attributes
    ----------
    damping
        Of the simulation in modal coordinates, shape ``(n, n)``.
    order
        Derivatives of the displacement that were measured, which the window falls on: :math:`s^k` is
        :math:`(s + \sigma)^k` with it.
    """

    damping: np.ndarray | None = field(default=None, compare=False)
    order: int = 0

    def alike(self, u: np.ndarray) -> tuple[str, float | None]:
        """Hysteretic damping may decay likewise."""
        return "structural_damping", None

    @property
    def in_channels(self) -> bool:
        """Also the measured derivative is windowed."""
        return self.order > 0

    @property
    def in_structure(self) -> bool:
        """Structures have no window."""
        return False

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Of damping and stiffness; no window grows."""
        x = self.scale * max(float(u[0]), 0.0)
        assert self.damping is not None
        unit = np.eye(len(self.damping))
        return {"C": 2 * x * unit, "K": x * self.damping + x**2 * unit}

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """By the decay."""
        assert self.damping is not None
        unit, x = self.scale * np.eye(len(self.damping)), self.scale * float(u[0])
        return [{"C": 2 * unit, "K": self.scale * self.damping + 2 * x * unit} if x >= 0 else {"C": 0 * unit}]

    def _grown(self, u: np.ndarray, poles: np.ndarray) -> np.ndarray:
        return 1 + self.scale * max(float(u[0]), 0.0) / poles

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs at ``poles`` on the imaginary axis, of the derivative that is windowed."""
        return residues * (self._grown(u, poles) ** self.order)[:, None, None]

    def transform_slope(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by the size, the poles held."""
        slope = self.order * self._grown(u, poles) ** (self.order - 1) * self.scale / poles * (u[0] >= 0)
        return residues * slope[:, None, None]

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The decay."""
        std = float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale
        return {"decay": {"value": self.size(u), "std": std, "unit": "1/s"}}


def impact_windows(c: Coordinates, inside: np.ndarray, order: int) -> list[Change]:
    """The window, usually with a decay as of the modes ``inside`` the band; none where these have no damping."""
    usual = float(np.median(np.diag(c.damping)[inside])) / 2
    if usual <= 0:
        return []
    pattern = 2 * np.eye(c.size)
    return [ImpactWindow("exponential_window", (), usual, pattern=pattern, damping=c.damping, order=order)]
