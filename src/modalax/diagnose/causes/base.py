r"""What a cause is: a slug, parameters, places, and a map at one stage of the prediction.

A cause of your own is a class with its parameters, its places and one map. A fractional-derivative joint::

    class Fractional(LocalCause):
        slug = "fractional_joint"
        parameters = (Parameter("coefficient", "N s^a/m"), Parameter("order", "-", 0.1, 0.9, log=False))

        def impedance(self, s, p):
            return p[0] * s ** p[1]

        def grid(self, scene, place):
            return strengths(scene.stiffness_scale(place), [[0.3], [0.5], [0.7]])

    modalax.diagnose.diagnose(measurement, simulation, causes=[*catalogue(), Fractional()])

The first parameter is the strength: at 0 the cause is not there. Places and parameters are data, so each class is
compiled once for all of them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.data.dofs import parse_dof

INFINITE = float("inf")
NEIGHBOURS, GROUND = 0.6, 0.2  # shares of joints between coupled DoFs, and to ground
UNLIKE = 0.02  # weight of a pair of DoFs of unlike directions


@dataclass(frozen=True)
class Parameter:
    """One unknown of a cause: name, SI unit, bounds, and whether it is searched on a logarithmic scale."""

    name: str
    unit: str
    lower: float = -INFINITE
    upper: float = INFINITE
    log: bool = False


@dataclass(frozen=True)
class Place:
    """Where a cause sits: names for the answer, and integers (DoFs, channel, mode or variant) for the map."""

    where: tuple[Any, ...]
    index: tuple[int, int, int] = (0, -1, 0)


@dataclass
class Scene:
    """What causes may look at when they choose places and starting values; numpy, unpadded.

    Attributes
    ----------
    freq, omega
        Lines [Hz], [rad/s], shape ``(f,)``.
    dofs, outputs, inputs
        Names.
    frequency_hz, damping_ratio
        Of the modes of the simulation.
    receptance
        Between all DoFs and themselves or pairs: ``drive(a, b)`` gives :math:`b^T H b`, shape ``(f,)`` [m/N].
    levels
        Force amplitudes [N].
    coupled
        Which DoFs a spring or damper of the simulation couples, shape ``(dof, dof)``; None where it does not say.
    """

    freq: np.ndarray
    dofs: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    levels: np.ndarray
    modal_form: Any
    scaled: bool = True
    form: str = "receptance"
    coupled: np.ndarray | None = None
    cache: dict[Any, Any] = field(default_factory=dict)

    @property
    def omega(self) -> np.ndarray:
        """Circular frequencies [rad/s]."""
        return 2 * np.pi * self.freq

    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        if "gains" not in self.cache:
            s, poles = 1j * self.omega[:, None], np.asarray(self.modal_form.poles)
            self.cache["gains"] = 1 / (s - poles), 1 / (s - poles.conj())
        return self.cache["gains"]

    def _direction(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        psi, part = np.asarray(self.modal_form.shapes), np.asarray(self.modal_form.participation)
        a, b = place.index[:2]
        return (psi[:, a] - psi[:, b], part[:, a] - part[:, b]) if b >= 0 else (psi[:, a], part[:, a])

    def drive(self, place: Place) -> np.ndarray:
        """Receptance across a place, shape ``(f,)`` [m/N]."""
        u, v = self._gains()
        psi, part = self._direction(place)
        return u @ (psi * part) + v @ (psi * part).conj()

    def motion(self, place: Place) -> np.ndarray:
        """Relative displacement across a place for each input, shape ``(f, i)`` [m/N]."""
        u, v = self._gains()
        psi, _ = self._direction(place)
        part = np.asarray(self.modal_form.participation)[:, [self.dofs.index(name) for name in self.inputs]]
        return u @ (psi[:, None] * part) + v @ (psi[:, None] * part).conj()

    def stiffness_scale(self, place: Place) -> float:
        """A stiffness [N/m] that would matter at a place: one over the median receptance across it."""
        key = ("stiffness", place.index)
        if key not in self.cache:
            self.cache[key] = float(1 / max(np.median(np.abs(self.drive(place))), 1e-300))
        return self.cache[key]

    def amplitudes(self, place: Place, fractions: Sequence[float]) -> np.ndarray:
        """Amplitudes [m] across a place, as fractions of the largest undisturbed one of the largest level."""
        key = ("amplitude", place.index)
        if key not in self.cache:
            self.cache[key] = float(np.abs(self.motion(place)).max()) * float(self.levels.max())
        return self.cache[key] * np.asarray(fractions)

    def pairs(self, ground: bool = True, both: bool = True) -> list[Place]:
        """Every DoF to ground and every pair."""
        key = ("pairs", ground, both)
        if key not in self.cache:
            names = self.dofs if self.scaled else ()
            single = [Place((name,), (k, -1, 0)) for k, name in enumerate(names)] if ground else []
            pairs = [Place((names[a], names[b]), (a, b, 0)) for a, b in itertools.combinations(range(len(names)), 2)]
            self.cache[key] = single + (pairs if both else [])
        return self.cache[key]

    def weights(self, places: Sequence[Place]) -> np.ndarray:
        """How likely each place is before the data, summing to 1.

        Between DoFs that the simulation couples ``NEIGHBOURS``, to ground ``GROUND``, the rest anywhere else; a
        displacement less a rotation, or one along another axis, is hardly a joint's motion.
        """
        a, b = np.array([p.index[:2] for p in places]).reshape(-1, 2).T
        if (b < 0).all() or not len(places):
            return np.full(len(places), 1 / max(len(places), 1))
        _, direction = np.unique([str(parse_dof(name).direction) for name in self.dofs], return_inverse=True)
        other = np.maximum(b, 0)
        alike = (b < 0) | (direction[a] == direction[other])
        near = np.zeros(len(a), bool) if self.coupled is None else (b >= 0) & self.coupled[a, other]
        kinds = ((near & alike, NEIGHBOURS), (b < 0, GROUND), (np.ones(len(a), bool), 1 - NEIGHBOURS - GROUND))
        out = np.zeros(len(a))
        for mask, share in kinds:
            part = mask * np.where(alike, 1.0, UNLIKE)
            out += share * part / part.sum() if part.any() else 0.0
        return out / out.sum()

    def channels(self) -> list[Place]:
        """Every measured output."""
        return [Place((name,), (k, -1, 0)) for k, name in enumerate(self.outputs)]


def strengths(
    scale: float, shapes: Sequence[Sequence[float]] = ((),), sizes: Sequence[float] = (1e-4, 0.03, 0.2, 1.0),
    both: bool = True,
) -> np.ndarray:  # fmt: skip
    """Starting values: the first parameter at ``sizes`` times ``scale`` (and its negatives), the others at ``shapes``.

    Shape ``(start, parameter)``; the first size stands for the derivative at zero, which has one sign only.
    """
    signed = [*sizes, *(-size for size in sizes[1:])] if both else sizes
    return np.array([[size * scale, *shape] for shape in shapes for size in signed])


class Cause:
    """Base of all causes; see the module's docstring for an example.

    Attributes
    ----------
    slug
        Name in the answer.
    stage
        Where the map acts: ``laplace``, ``undamped``, ``modes``, ``kernel``, ``local``, ``joint``, ``channels``.
    parameters
        Unknowns, the strength first; may be empty (a sign, a swap).
    per_run
        Whether the effect depends on the run or its level.
    each_run
        Whether a run has parameters of its own, so that it cannot be predicted from the others.
    fidelity
        Relative error of the predicted effect itself; a misfit below it is no sign of an unknown cause.
    prior
        Weight of the cause before the data, relative to others.
    rows
        Number of outputs that the effect is confined to, the first of the place's numbers; 0 where it may be any.
    unseen
        Number of parameters that FRFs do not show to first order, and that therefore cost nothing.
    """

    slug: ClassVar[str] = ""
    stage: ClassVar[str] = ""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    per_run: ClassVar[bool] = False
    each_run: ClassVar[bool] = False
    fidelity: ClassVar[float] = 0.0
    prior: ClassVar[float] = 1.0
    unseen: ClassVar[int] = 0
    rows: ClassVar[int] = 0
    summary: ClassVar[str] = ""

    def places(self, scene: Scene) -> list[Place]:
        """Where the cause may sit."""
        return [Place(())]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Parameter vectors to screen at, shape ``(start, parameter)``."""
        raise NotImplementedError(f"{type(self).__name__} needs grid(scene, place)")

    def fits(self, p: np.ndarray, scene: Scene) -> bool:
        """Whether fitted parameters still mean this cause at the lines that were measured."""
        return True

    def nearby(self, p: np.ndarray, place: Place, scene: Scene) -> np.ndarray:
        """Parameters beside fitted ones where chi-square may have a deeper minimum, the nearest first.

        Shape ``(point, parameter)``.
        """
        return np.zeros((0, len(p)))

    def likely(self, p: np.ndarray, scene: Scene) -> float:
        """How likely parameters are before the data, relative to the likeliest."""
        return 1.0

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """Parameters as told in the answer: value and unit by name."""
        return {q.name: (p[k], q.unit) for k, q in enumerate(self.parameters)}

    def __hash__(self) -> int:
        return hash((type(self), tuple(sorted(vars(self).items()))))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)


class LocalCause(Cause):
    r"""A linear impedance :math:`Z(s)` [N/m] on a direction: :math:`H - H b (1/Z + b^T H b)^{-1} b^T H`."""

    stage = "local"

    def places(self, scene: Scene) -> list[Place]:
        """Every DoF to ground and every pair."""
        return scene.pairs()

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        """Force a unit relative displacement [N/m], each line by itself: it is asked at one line as at many."""
        raise NotImplementedError(f"{type(self).__name__} needs impedance(s, p)")


class JointCause(Cause):
    """A non-linear joint, by its law in :mod:`modalax.simulate`."""

    stage = "joint"
    per_run = True

    def places(self, scene: Scene) -> list[Place]:
        """Every DoF to ground and every pair."""
        return scene.pairs()

    def law(self, p: Float[Array, " p"]) -> Any:
        """The joint with parameters ``p``."""
        raise NotImplementedError(f"{type(self).__name__} needs law(p)")

    def impedance(self, A: Array, omega: Array, p: Float[Array, " p"]) -> Complex[Array, "..."]:
        """Describing function at amplitude ``A`` [m], [N/m], shape ``(run, f, i)`` as ``A``, each entry by itself.

        Only where ``each_run`` is set may a run depend on its number, the first axis of ``A``.
        """
        return self.law(p).describing(A, omega)


def gather(columns: Array, index: Array, axis: int = -1) -> Array:
    """Column of a direction: that of the first DoF less that of the second, where there is one."""
    first = jnp.take(columns, index[0], axis=axis)
    second = jnp.take(columns, jnp.maximum(index[1], 0), axis=axis)
    return first - jnp.where(index[1] >= 0, 1.0, 0.0) * second


def is_element(cause: Cause) -> bool:
    """Whether a cause acts on one relative displacement."""
    return cause.stage == "joint" or (cause.stage == "local" and not hasattr(cause, "matrix"))
