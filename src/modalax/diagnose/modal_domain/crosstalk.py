"""A channel that leaks into another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.causes import Change

LEAK = 0.1  # usual share of another channel
RARE = 0.2  # chance of crosstalk relative to other kinds: only damaged or long shared cables show it
MOST = 24  # outputs beyond which there are too many pairs


@dataclass(frozen=True)
class Crosstalk(Change):
    """A share of one output's signal in another's: the first of ``channel[1:]`` hears the second."""

    @property
    def rarity(self) -> float:
        """Chance of its kind relative to others."""
        return RARE

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs at ``poles`` on the imaginary axis, as the channel shows them."""
        out = residues.copy()
        out[:, self.channel[1]] += self.scale * u[0] * residues[:, self.channel[2]]
        return out

    def transform_slope(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by the size."""
        out = np.zeros_like(residues)
        out[:, self.channel[1]] = self.scale * residues[:, self.channel[2]]
        return out


def leaking_channels(outputs: Sequence[str]) -> list[Change]:
    """Each ordered pair of outputs."""
    count = len(outputs) if len(outputs) <= MOST else 0
    return [
        Crosstalk("crosstalk", (outputs[a], outputs[b]), LEAK, channel=(0, a, b))
        for a in range(count) for b in range(count) if a != b
    ]  # fmt: skip
