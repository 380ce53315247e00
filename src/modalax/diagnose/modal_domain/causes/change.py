"""Causes as finite changes in the modal domain, with their place, usual size and effect."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.causes import Cause
from modalax.diagnose.decision.beyond import Names
from modalax.diagnose.modal_domain.causes.losses import Loss

KIND_OF = {
    "added_mass": "M", "joint_stiffness": "K", "local_damper": "C", "modal_damping": "C", "element_group": "K",
    "element_group_mass": "M", "exponential_window": "C",
}  # fmt: skip
MOST_LOSS = 2.0  # times the usual ratio of damping to stiffness or mass that goes with a change of these at most
UNITS = {
    "added_mass": ("mass", "kg"), "joint_stiffness": ("stiffness", "N/m"), "local_damper": ("damping", "N s/m"),
    "channel_gain": ("gain", "-"), "force_gain": ("gain", "-"), "time_delay": ("delay", "s"),
    "modal_damping": ("relative_change", "-"), "crosstalk": ("share", "-"), "exponential_window": ("decay", "1/s"),
}  # fmt: skip


@dataclass(frozen=True)
class Change:
    """One cause at one place of the simulation.

    A cause has ``count`` sizes ``u`` over the usual ones, each normal before the data
    (:func:`modalax.diagnose.modal_domain.fitting.fit.widths`). This class changes a matrix; classes made of
    it in modules of their own change what the channels show, and do other things.

    Attributes
    ----------
    slug, where
        As told in the answer.
    scale
        Usual size in the unit of the cause.
    direction
        Of a local change ``b b'``, in modal coordinates, shape ``(n,)``.
    pattern
        Of a change of a whole element instead, shape ``(n, n)``; its size is relative. Of a lumped mass that moves in
        several directions the sum of their ``b b'``; its size is a mass.
    factor
        F of such a change :math:`FF^T` over the DoFs that the simulation's elements know, shape ``(n, r)``.
    channel
        Of a channel's fault: which one (:mod:`modalax.diagnose.modal_domain.causes.channel_faults`).
    reference
        What the simulation has at this place, that a size may be compared with.
    weight
        Share among the places of its kind before the data.
    absent
        Whether it is a spring where the simulation has none, so that no general inaccuracy is an inaccuracy of it.
    piece
        Whether its pattern is only a piece of an element, as bending in the plane of its ``where``.
    along, loss
        Of a change of stiffness or mass that damping goes with: how in words, and how much it usually is. Empty where
        the damping stays as it is.
    """

    slug: str
    where: tuple[str | int, ...]
    scale: float = 1.0
    direction: np.ndarray | None = field(default=None, compare=False)
    pattern: np.ndarray | None = field(default=None, compare=False)
    factor: np.ndarray | None = field(default=None, compare=False)
    channel: tuple[int, ...] = ()
    reference: float = 0.0
    weight: float = 1.0
    absent: bool = False
    piece: bool = False
    along: str = ""
    loss: Loss | None = field(default=None, compare=False)

    @property
    def kind(self) -> str:
        """K, C or M of a change of one matrix; empty for all others."""
        return KIND_OF.get(self.slug, "")

    @property
    def local(self) -> bool:
        """Whether it changes matrices."""
        return bool(self.kind)

    @property
    def told_as(self) -> Names:
        """Names and places that the answer tells it by."""
        return ((self.slug, self.where),)

    def shares_place(self, causes: Iterable["Change"]) -> bool:
        """Whether one of several places that it is told at, or that one of ``causes`` is, is another's as well."""
        own = set(self.told_as)
        return any(own & set(c.told_as) for c in causes if len(own) > 1 or len(c.told_as) > 1)

    @property
    def in_structure(self) -> bool:
        """Whether a change of a whole element or of a node's mass, as which it is given, is one of the structure."""
        return self.pattern is not None

    @property
    def in_channels(self) -> bool:
        """Whether it changes how channels show the structure."""
        return not self.local

    @property
    def at_inputs(self) -> bool:
        """Whether its places are inputs."""
        return False

    def alike(self, u: np.ndarray) -> tuple[str, float | None] | None:
        """Slug and size of a cause at the same place that this one may be taken for; of its usual size where None."""
        return None

    def among(self, kept: np.ndarray) -> "Change | None":
        """The same where only the inputs ``kept``, shape ``(i,)``, are left; None where it sits on another."""
        return self

    @property
    def scales_all(self) -> bool:
        """Whether it is one factor on all FRFs, as one on stiffness, mass and damping alike is."""
        return False

    @property
    def in_shapes(self) -> bool:
        """Whether mode shapes show it, without the forces that they were measured by."""
        return True

    @property
    def screened(self) -> bool:
        """Whether it is looked for at all of its places, and not only where another cause leads."""
        return True

    @property
    def adds_mode(self) -> bool:
        """Whether the structure has a mode more with it."""
        return False

    @property
    def dissipates(self) -> bool:
        """Whether it takes energy at a place."""
        return self.slug == "local_damper"

    def turned(self, u: np.ndarray) -> "Change | None":
        """The cause without a size that it is in truth, where it has sizes as no cause of its kind has."""
        return None

    @property
    def limits(self) -> tuple[tuple[str, ...], float]:
        """What simpler causes it may be in a limit, and by how many nats the data must prefer it to be told."""
        return (), 0.0

    @property
    def relative(self) -> bool:
        """Whether its size is relative to what the simulation has."""
        return self.pattern is not None and self.slug != "added_mass"

    @property
    def whole(self) -> float:
        """What its size is compared with."""
        return 1.0 if self.relative else self.reference

    @property
    def sized(self) -> bool:
        """Whether it has a size; a sign, a swap or a unit has none."""
        return True

    @property
    def count(self) -> int:
        """Number of its sizes; 1 that does nothing for a cause without a size."""
        return 2 if self.along else 1

    @property
    def telling(self) -> int:
        """Number of its sizes, of the first, that tell whether it is there."""
        return 1

    @property
    def linear(self) -> bool:
        """Whether small sizes act in proportion, so that it can be scored without a fit."""
        return self.sized

    @property
    def signed(self) -> bool:
        """Whether its first size may be negative."""
        return True

    def possible(self, u: np.ndarray) -> bool:
        """Whether it may have these sizes: of its sign, and with no more damping than elements have."""
        return (self.signed or u[0] > 0) and not (self.along and abs(u[1]) > MOST_LOSS)

    def of_size(self, u: float) -> np.ndarray:
        """Its sizes where all but the first are as usual."""
        return np.append(u, np.zeros(self.count - 1))

    @property
    def freed(self) -> int | None:
        """Number of the measured mode that it leaves free."""
        return None

    @property
    def variant(self) -> int:
        """Number of its form, where the catalogue's cause of this name has several."""
        return 0

    @property
    def rarity(self) -> float:
        """Chance of its kind before the data, relative to other kinds."""
        return 1.0

    def hysteretic(self, u: np.ndarray) -> float:
        """Share of the damping that is hysteretic with it."""
        return 0.0

    @property
    def matrix(self) -> np.ndarray:
        """Change of the matrix of its kind by its usual size, in modal coordinates."""
        if self.pattern is not None:
            return self.scale * self.pattern
        assert self.direction is not None, "a channel's fault changes no matrix"
        return self.scale * np.outer(self.direction, self.direction)

    def changes(self, u: np.ndarray) -> dict[str, np.ndarray]:
        """Changes of the matrices, by ``K``, ``C`` and ``M``."""
        change = {self.kind: u[0] * self.matrix}
        return change if self.loss is None else change | {"C": u[1] * self.loss.change(float(u[0]), self.matrix)}

    def over_dofs(self, u: np.ndarray) -> np.ndarray:
        """Change of its matrix over the DoFs that the simulation's elements know, of one that has a factor."""
        assert self.factor is not None, "no change of the structure that elements know"
        return float(u[0]) * self.scale * self.factor @ self.factor.T

    def slopes(self, u: np.ndarray) -> list[dict[str, np.ndarray]]:
        """Derivatives of :meth:`changes` by each size."""
        A = self.matrix
        if self.loss is None:
            return [{self.kind: A}]
        x = float(u[0])
        return [{self.kind: A, "C": u[1] * self.loss.slope(x, A)}, {"C": self.loss.change(x, A)}]

    def turn(self, u: np.ndarray) -> np.ndarray | None:
        """Where what is off of the damping follows its changes, as :meth:`Loss.turn`."""
        return None if self.loss is None else self.loss.turn(float(u[0]), self.matrix)

    def size(self, u: np.ndarray) -> float:
        """The size that tells whether it stands out, in the unit of the cause."""
        return float(u[0]) * self.scale

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """Parameters as in the answer."""
        if self.slug not in UNITS:
            return {}
        name, unit = UNITS["modal_damping" if self.relative else self.slug]  # a whole element is so much off
        std = float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale
        name += "_in_plane" if self.piece else ""
        return {name: {"value": float(u[0]) * self.scale, "std": std, "unit": unit}}

    def told_each(self, u: np.ndarray, covariance: np.ndarray) -> list[dict[str, Any]]:
        """Name, place and parameters of what the answer tells it as."""
        return [{"name": self.slug, "where": list(self.where), "parameters": self.told(u, covariance)}]

    def said(self) -> str:
        """What it means, in a sentence, where its name does not tell."""
        return f"the damping changes with it, {self.along}" if self.along else ""

    def variance_beside(self, u: np.ndarray, off: Mapping[str, float]) -> np.ndarray | float:
        """What is added to the covariance of its sizes as the element that it acts on is itself ``off`` in general."""
        return 0.0

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], Any]:
        """Parameters of the catalogue's cause of this name, their standard deviations, and its shape over channels."""
        if not self.sized:
            return [], [], None
        return [float(u[0]) * self.scale], [float(np.sqrt(max(covariance[0, 0], 0.0))) * self.scale], None

    @property
    def in_catalogue(self) -> Cause | None:
        """Its form in the catalogue, where several there bear its name."""
        return None

    @property
    def first_index(self) -> int | None:
        """What the catalogue's cause has for the number of a channel, where that is none."""
        return None

    def added(self, s: np.ndarray) -> np.ndarray | float:
        """FRFs ``(f, o, i)`` that it adds to the simulation's, in the form of the measurement."""
        return 0.0

    def at_modes(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)`` of modes as they show with this cause, changes of matrices apart."""
        return self.transform(u, poles, residues)

    def slope_at_modes(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`at_modes` by the size."""
        return self.transform_slope(u, poles, residues)

    def transform(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Residues ``(k, o, i)``, or FRFs at ``poles`` on the imaginary axis, as channels with this fault show them."""
        return residues

    def transform_slope(self, u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`transform` by the size."""
        return np.zeros_like(residues)


class Followed(Change):
    """A cause of several sizes that is fitted where what was found leads to it, and not looked for at all places."""

    @property
    def screened(self) -> bool:
        """Not at all places."""
        return False

    @property
    def linear(self) -> bool:
        """It has several sizes, which act together."""
        return False


def with_sizes(causes: Sequence[Change], u: np.ndarray) -> Iterator[tuple[Change, np.ndarray]]:
    """Each cause with its own sizes of all, shape ``(count,)``."""
    start = 0
    for cause in causes:
        yield cause, u[start : start + cause.count]
        start += cause.count


def own_sizes(causes: Sequence[Change], which: int) -> slice:
    """Where the sizes of one cause stand among those of all."""
    start = sum(c.count for c in causes[:which])
    return slice(start, start + causes[which].count)


def hysteretic_share(causes: Sequence[Change], u: np.ndarray) -> float:
    """Share of all damping that is hysteretic."""
    return sum(cause.hysteretic(size) for cause, size in with_sizes(causes, u))


def shown(causes: Sequence[Change], u: np.ndarray, s: np.ndarray, H: np.ndarray) -> np.ndarray:
    """FRFs ``(f, o, i)`` of the structure as measured: with faults of channels, and with what the simulation lacks."""
    for cause, size in with_sizes(causes, u):
        H = cause.transform(size, s, H)
    return H + sum(cause.added(s) for cause in causes)
