"""Faults of single channels, or of all, that change how the structure shows and not the structure."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.causes import Cause, forces
from modalax.diagnose.causes.channels import CommonDelay
from modalax.diagnose.modal_domain.causes.change import Change

GAIN, DELAY = 0.3, 3e-2  # usual error of a channel's gain; of a delay, as phase at the highest mode over pi
LONGEST = 50.0  # decays of a mode in one delay, beyond which a delay is none
LEAK = 0.1  # usual share of another channel
RARE = 0.2  # chance of crosstalk relative to other kinds: only damaged or long shared cables show it
MOST = 24  # outputs beyond which there are too many pairs
OUTPUTS, INPUTS, ALL = 0, 1, 2  # axis of a channel; that of a fault of all channels


@dataclass(frozen=True)
class ChannelFactor(Change, ABC):
    """A factor on the FRFs of one channel, or of all: ``channel`` holds the axis and, on that, the number."""

    @abstractmethod
    def factor_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The factor at ``s`` [rad/s], shape ``(k,)``."""

    def factor_slope(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Its derivative by the size, shape ``(k,)``; none of what a channel either has or has not."""
        return np.zeros(len(s))

    def _own(self) -> tuple[slice | int, ...]:
        """Which of the residues ``(k, o, i)`` are its own."""
        every, (axis, number) = slice(None), self.channel
        return {OUTPUTS: (every, number), INPUTS: (every, every, number), ALL: (every,)}[axis]

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs at ``poles`` on the imaginary axis, as the channel shows them."""
        out, own = residues.copy(), self._own()
        factor = self.factor_at(u, poles)
        out[own] *= factor.reshape(-1, *[1] * (out[own].ndim - 1))
        return out

    def transform_slope(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by the size."""
        out, own = np.zeros_like(residues), self._own()
        factor = self.factor_slope(u, poles)
        out[own] = factor.reshape(-1, *[1] * (out[own].ndim - 1)) * residues[own]
        return out


@dataclass(frozen=True)
class Gain(ChannelFactor):
    """A sensor, or what measures a force, calibrated wrongly."""

    def factor_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """One and the relative error."""
        return np.full(len(s), 1 + self.scale * u[0])

    def factor_slope(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The usual error."""
        return np.full(len(s), self.scale)

    @property
    def scales_all(self) -> bool:
        """Where it is that of all channels."""
        return self.channel[0] == ALL

    def turned(self, u: np.ndarray) -> Change | None:
        """The sign of the same output."""
        return Sign("channel_sign", self.where, channel=self.channel) if self.size(u) < -1 else None


@dataclass(frozen=True)
class OfInputs(Change):
    """A fault of the force."""

    @property
    def at_inputs(self) -> bool:
        """Its places are inputs."""
        return True

    @property
    def in_shapes(self) -> bool:
        """Mode shapes have no force."""
        return False


@dataclass(frozen=True)
class ForceGain(OfInputs, Gain):
    """A hammer or load cell calibrated wrongly, or all of them."""

    def among(self, kept: np.ndarray) -> Change | None:
        """At its new number."""
        axis, number = self.channel
        if axis == ALL:
            return self
        return replace(self, channel=(axis, int(kept[:number].sum()))) if kept[number] else None

    def turned(self, u: np.ndarray) -> Change | None:
        """No cause of its own."""
        return None


@dataclass(frozen=True)
class Sign(ChannelFactor):
    """A sensor that points the other way."""

    @property
    def sized(self) -> bool:
        """It points one way or the other."""
        return False

    def factor_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Minus one."""
        return np.full(len(s), -1.0)


@dataclass(frozen=True)
class WrongUnits(ChannelFactor):
    """All outputs once integrated or differentiated: ``channel[1]`` is the power of s that they lack."""

    @property
    def sized(self) -> bool:
        """Units are right or wrong."""
        return False

    def factor_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """That power."""
        return s ** float(self.channel[1])

    @property
    def first_index(self) -> int | None:
        """That power."""
        return self.channel[1]


@dataclass(frozen=True)
class Swap(Change):
    """Two outputs exchanged: ``channel`` holds both numbers."""

    @property
    def sized(self) -> bool:
        """They are exchanged or not."""
        return False

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs, with both exchanged."""
        out, (a, b) = residues.copy(), self.channel
        out[:, [a, b]] = residues[:, [b, a]]
        return out


@dataclass(frozen=True)
class ForceSwap(OfInputs, Swap):
    """Two inputs exchanged, as hits at each other's points."""

    def among(self, kept: np.ndarray) -> Change | None:
        """At their new numbers, where both are left."""
        a, b = self.channel
        return replace(self, channel=(int(kept[:a].sum()), int(kept[:b].sum()))) if kept[a] and kept[b] else None

    @property
    def in_catalogue(self) -> Cause | None:
        """Of inputs it is one by itself."""
        return forces.ForceSwap()

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs, with both exchanged."""
        return super().transform(u, poles, residues.swapaxes(1, 2)).swapaxes(1, 2)


@dataclass(frozen=True)
class Delay(ChannelFactor):
    """A delay of one output, or of all."""

    def factor_at(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        r""":math:`e^{-s\tau}`."""
        x = -s * self.scale * u[0]
        return np.exp(np.clip(x.real, -LONGEST, LONGEST) + 1j * x.imag)

    def factor_slope(self, u: np.ndarray, s: np.ndarray) -> np.ndarray:
        """By the delay over the usual one."""
        return -self.scale * s * self.factor_at(u, s)

    @property
    def in_shapes(self) -> bool:
        """Mode shapes are in phase."""
        return False

    @property
    def in_catalogue(self) -> Cause | None:
        """A delay of all outputs is one by itself."""
        return None if self.where else CommonDelay()


def channel_faults(outputs: Sequence[str], inputs: Sequence[str], highest: float) -> list[Change]:
    """Each fault of each channel, and of all where there are several; ``highest`` is the end of the band [rad/s]."""
    delay = DELAY * np.pi / highest
    out: list[Change] = [Gain("channel_gain", (n,), GAIN, channel=(OUTPUTS, k)) for k, n in enumerate(outputs)]
    out += [Sign("channel_sign", (n,), channel=(OUTPUTS, k)) for k, n in enumerate(outputs)]
    out += [ForceGain("force_gain", (n,), GAIN, channel=(INPUTS, k)) for k, n in enumerate(inputs)]
    if len(inputs) > 1:  # a unit, of forces or sensors, is wrong in all FRFs
        out.append(ForceGain("force_gain", (), GAIN, channel=(ALL, 0), weight=float(len(inputs))))
    for swap, names in ((Swap, outputs), (ForceSwap, inputs)):
        pairs = itertools.combinations(range(len(names)), 2)
        out += [swap("channel_swap", (names[a], names[b]), channel=(a, b)) for a, b in pairs]
    out += [Delay("time_delay", (n,), delay, channel=(OUTPUTS, k)) for k, n in enumerate(outputs)]
    if len(outputs) > 1:
        out.append(Delay("time_delay", (), delay, channel=(ALL, 0), weight=float(len(outputs))))
    return out + [WrongUnits("units", (), channel=(ALL, k)) for k in (-1, 1)]


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
