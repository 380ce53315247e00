"""Sensors that roll off, as a fault of a channel in the modal domain."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from modalax.diagnose.causes import Cause
from modalax.diagnose.causes.sensors import AcCoupling, SensorLowpass
from modalax.diagnose.modal_domain.causes.change import Change

Form = Literal["low", "butterworth", "high"]
USUAL = 0.5  # phase [rad] by which a filter usually turns the end of the band that is next to its corner
RARE = 0.05  # chance relative to other kinds: corners are chosen far from the band, where a filter is but a delay


@dataclass(frozen=True)
class SensorFilter(Change):
    r"""One sensor behind a filter that turns the edge :math:`\omega_e` of the band by the phase :math:`x`.

    With :math:`z = x s/\omega_e` it is :math:`1/(1 + z)` (``low``) or :math:`1/(1 + z + z^2/2)` (``butterworth``, of
    second order), and :math:`1/(1 + x\omega_e/s)` for an edge at the start of the band (``high``).

    Attributes
    ----------
    form
        The kind of filter.
    edge
        Edge of the band next to the corner [rad/s].
    """

    form: Form = "low"
    edge: float = 1.0

    @property
    def rarity(self) -> float:
        """Chance of its kind relative to others."""
        return RARE

    @property
    def limits(self) -> tuple[tuple[str, ...], float]:
        """Far above the band a filter is a delay of its sensor."""
        return ("time_delay",), 1.0

    def _turn(self, u: np.ndarray, poles: np.ndarray) -> np.ndarray:
        """:math:`z` at the poles; no filter has a negative one."""
        x = self.scale * max(float(u[0]), 0.0)
        return x * (self.edge / poles if self.form == "high" else poles / self.edge)

    def _gain(self, z: np.ndarray) -> np.ndarray:
        return 1 / (1 + z + (0.5 * z**2 if self.form == "butterworth" else 0.0))

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs at ``poles`` on the imaginary axis, as the sensor shows them."""
        out = residues.copy()
        out[:, self.channel[1]] *= self._gain(self._turn(u, poles))[:, None]
        return out

    def transform_slope(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by the size."""
        out = np.zeros_like(residues)
        if u[0] >= 0:
            z, by = self._turn(u, poles), self._turn(np.ones(1), poles)
            slope = -by * (1 + (z if self.form == "butterworth" else 0.0)) * self._gain(z) ** 2
            out[:, self.channel[1]] = slope[:, None] * residues[:, self.channel[1]]
        return out

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The frequency at which the gain is down by 3 dB."""
        x, std = self.size(u), float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale
        edge = self.edge / (2 * math.pi)
        down = {"low": edge / x, "butterworth": math.sqrt(2) * edge / x, "high": edge * x}[self.form] if x > 0 else 0.0
        error = down * std / x if x > 0 else 0.0
        if self.form == "high":
            return {"high_pass_corner": {"value": down, "std": error, "unit": "Hz"}}
        order = {"value": 2.0 if self.form == "butterworth" else 1.0, "std": None, "unit": "-"}
        return {"low_pass_corner": {"value": down, "std": error, "unit": "Hz"}, "order": order}

    @property
    def in_catalogue(self) -> Cause:
        """The filter line by line."""
        return AcCoupling() if self.form == "high" else SensorLowpass(2 if self.form == "butterworth" else 1)

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Corner [Hz] of a high pass, time constant [s] of a low pass."""
        x, std = max(self.size(u), 0.0), float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale
        unit = self.edge / (2 * math.pi) if self.form == "high" else 1 / self.edge
        return [x * unit], [std * unit], None


def sensor_filters(outputs: Sequence[str], lowest: float, highest: float) -> list[Change]:
    """Each filter at each output; the band is from ``lowest`` to ``highest`` [rad/s]."""
    edges: dict[Form, float] = {"low": highest, "butterworth": highest, "high": lowest}
    found: list[Change] = [
        SensorFilter("sensor_filter", (name,), USUAL, channel=(0, k), form=form, edge=edge)
        for form, edge in edges.items() if edge > 0
        for k, name in enumerate(outputs)
    ]  # fmt: skip
    return found
