"""Causes as finite changes in the modal domain, with their place, usual size and effect."""

from dataclasses import dataclass, field

import numpy as np

KIND_OF = {"added_mass": "M", "joint_stiffness": "K", "local_damper": "C", "modal_damping": "C"}
LONGEST = 50.0  # decays of a mode in one delay, beyond which a delay is none
ALL = 2  # axis of a fault of all channels


@dataclass(frozen=True)
class Change:
    """One cause at one place of the simulation.

    Attributes
    ----------
    slug, where
        As told in the answer.
    scale
        Usual size, the standard deviation before the data, in the unit of the cause.
    direction
        Of a local change ``b b'``, in modal coordinates, shape ``(n,)``.
    pattern
        Of a change of a whole element instead, shape ``(n, n)``; its size is relative.
    channel
        Of a channel's fault: axis (0 output, 1 input) and number; for two outputs exchanged both numbers; of a fault of
        all channels ``ALL`` and, for units, the power of ``s``.
    reference
        What the simulation has at this place, that a size may be compared with.
    weight
        Share among the places of its kind before the data.
    """

    slug: str
    where: tuple[str | int, ...]
    scale: float = 1.0
    direction: np.ndarray | None = field(default=None, compare=False)
    pattern: np.ndarray | None = field(default=None, compare=False)
    channel: tuple[int, ...] = ()
    reference: float = 0.0
    weight: float = 1.0

    @property
    def kind(self) -> str:
        """K, C or M of a local change; empty for a channel's fault."""
        return KIND_OF.get(self.slug, "")

    @property
    def sized(self) -> bool:
        """Whether it has a size; a sign, a swap or a unit has none."""
        return self.slug not in ("channel_sign", "channel_swap", "units")

    @property
    def matrix(self) -> np.ndarray:
        """Change of the matrix of its kind by its usual size, in modal coordinates."""
        if self.pattern is not None:
            return self.scale * self.pattern
        assert self.direction is not None, "a channel's fault changes no matrix"
        return self.scale * np.outer(self.direction, self.direction)

    def _turn(self, u: float, poles: np.ndarray) -> np.ndarray:
        x = -poles * self.scale * u
        return np.exp(np.clip(x.real, -LONGEST, LONGEST) + 1j * x.imag)[:, None]

    def transform(self, u: float, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)`` as this fault of a channel shows them."""
        if self.slug in ("channel_gain", "force_gain", "channel_sign"):
            factor = -1.0 if self.slug == "channel_sign" else 1 + self.scale * u
            out = residues.copy()
            if self.channel[0] == 0:
                out[:, self.channel[1]] *= factor
            else:
                out[:, :, self.channel[1]] *= factor
            return out
        if self.slug == "channel_swap":
            out = residues.copy()
            a, b = self.channel
            out[:, [a, b]] = residues[:, [b, a]]
            return out
        if self.slug == "units":
            return residues * (poles ** float(self.channel[1]))[:, None, None]
        if self.slug == "time_delay":
            turn = self._turn(u, poles)
            if self.channel[0] == ALL:
                return residues * turn[:, None]
            out = residues.copy()
            out[:, self.channel[1]] *= turn
            return out
        return residues

    def transform_slope(self, u: float, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by ``u``."""
        out = np.zeros_like(residues)
        if self.slug in ("channel_gain", "force_gain"):
            if self.channel[0] == 0:
                out[:, self.channel[1]] = self.scale * residues[:, self.channel[1]]
            else:
                out[:, :, self.channel[1]] = self.scale * residues[:, :, self.channel[1]]
        elif self.slug == "time_delay":
            turn = self._turn(u, poles)
            if self.channel[0] == ALL:
                return -self.scale * (poles[:, None] * turn)[:, None] * residues
            out[:, self.channel[1]] = -self.scale * poles[:, None] * turn * residues[:, self.channel[1]]
        return out
