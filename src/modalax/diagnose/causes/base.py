r"""Base classes of causes: a slug, parameters, places, and a map at one stage of the prediction.

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

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax.diagnose.causes.parameter import Parameter
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.causes.signals import Channels, HumLines, ModalTerms, gather
from modalax.diagnose.overview import of_cause

RARE = 0.05  # prior, relative to other causes, of one that has no name in the answer


class Cause:
    """A thing that the simulation may lack: the base of all causes.

    The classes below, one a stage of the prediction, add the map by which a cause acts; all else is told here.

    Attributes
    ----------
    slug
        Name in the answer; forms of one cause share it.
    summary
        What the simulation lacks, in a few words.
    advice
        What to measure to tell this cause from others; empty where nothing in particular does.
    parameters
        Unknowns, the strength first; may be empty (a sign, a swap).
    named
        Whether the answer may give this name; the others are looked for only to refuse a name that is less likely.
    prior
        Weight of the cause before the data, relative to others.
    fidelity
        Relative error of the predicted effect itself; a misfit below it is no sign of an unknown cause.
    unseen
        Number of parameters that FRFs do not show to first order, and that therefore cost nothing.
    per_run
        Whether the effect depends on the run or its level.
    each_run
        Whether a run has parameters of its own, so that it cannot be predicted from the others.
    rows
        Number of outputs that the effect is confined to, the first of the place's numbers; 0 where it may be any.
    in_structure
        Whether the cause belongs to the structure, not to how it was measured.
    on_measured_channels
        Whether the effect is known on the measured channels only.
    only_one
        Whether a test can have only one cause of this stage.
    visible_when_free
        Whether the effect shows although the modal parameters are free.
    told_by_levels
        Whether tests at several force levels tell the cause from its like.
    has_threshold
        Whether the law is a stiffness that sets in or lets go at a displacement: a stiffness [N/m] and that [m].
    drifts
        Whether a spring changes from run to run, as a joint that follows the level seems to.
    needs_several_outputs
        Whether an effect at one output alone would be that sensor's fault and not this cause.
    strength_is_bounded
        Whether a strength far beyond those that are screened means that the cause is no explanation.
    leaves_out_lines
        Whether the effect is whole lines that are left out of every other fit.
    shortlist_by
        How its likeliest places are found where there are very many: as those of an ``element``, of a skew
        ``coupling``, of an ``exchange`` of outputs, an ``exchange of inputs``, or not at all (``none``).
    """

    slug: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    advice: ClassVar[str] = ""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    named: ClassVar[bool] = True
    prior: ClassVar[float] = 1.0
    fidelity: ClassVar[float] = 0.0
    unseen: ClassVar[int] = 0
    per_run: ClassVar[bool] = False
    each_run: ClassVar[bool] = False
    rows: ClassVar[int] = 0
    in_structure: ClassVar[bool] = False
    on_measured_channels: ClassVar[bool] = False
    only_one: ClassVar[bool] = False
    visible_when_free: ClassVar[bool] = False
    told_by_levels: ClassVar[bool] = False
    has_threshold: ClassVar[bool] = False
    drifts: ClassVar[bool] = False
    needs_several_outputs: ClassVar[bool] = False
    strength_is_bounded: ClassVar[bool] = True
    leaves_out_lines: ClassVar[bool] = False
    shortlist_by: ClassVar[Literal["element", "coupling", "exchange", "exchange of inputs", "none"]] = "none"

    @property
    def judged_by(self) -> Literal["scores", "patterns", "hum", "none"]:
        """The test that its significance is judged by."""
        return "scores"

    def places(self, scene: Scene) -> list[Place]:
        """Where the cause may sit."""
        return [Place(())]

    def weights(self, scene: Scene, places: Sequence[Place]) -> np.ndarray:
        """How likely each place is before the data, summing to 1."""
        return np.full(len(places), 1 / max(len(places), 1))

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Parameter vectors to screen at, shape ``(start, parameter)``; one and empty without unknowns."""
        if self.parameters:
            raise NotImplementedError(f"{type(self).__name__} needs grid(scene, place)")
        return np.zeros((1, 0))

    def fits(self, p: np.ndarray, scene: Scene) -> bool:
        """Whether fitted parameters still mean this cause at the lines that were measured."""
        return True

    def nearby(self, p: np.ndarray, place: Place, scene: Scene) -> np.ndarray:
        """Parameters ``(point, parameter)`` beside fitted ones where chi-square may be less, the nearest first."""
        return np.zeros((0, len(p)))

    def alike(self, other: "Cause", p: np.ndarray) -> np.ndarray | None:
        """Parameters with which FRFs hardly tell it from another cause at the same place; None where they do."""
        return None

    def likely(self, p: np.ndarray, scene: Scene) -> float:
        """How likely parameters are before the data, relative to the likeliest."""
        return 1.0

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """Parameters as reported in the answer: value and unit by name."""
        return {q.name: (p[k], q.unit) for k, q in enumerate(self.parameters)}

    def cost(self, extra: Any) -> float:
        """Number of unknowns that the cause costs, ``extra`` being its further data."""
        return float(len(self.parameters) - self.unseen)

    def promised_cost(self, extra: Any) -> float:
        """The :meth:`cost` of a trial that is not fitted yet, without its :meth:`free_sizes`."""
        return self.cost(extra)

    def free_sizes(self, extra: Any) -> int:
        """Number of sizes in the channels that a few lines tell each, not all lines together."""
        return 0

    def __str__(self) -> str:
        """Name, what it means, and its unknowns."""
        return of_cause(self)

    def __hash__(self) -> int:
        return hash((type(self), tuple(sorted(vars(self).items()))))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)


class WindowCause(Cause):
    """Stage 1: a shift of the Laplace variable, as an exponential window has."""

    def shift(self, p: Float[Array, " p"]) -> Array:
        """Shift of the Laplace variable [rad/s]."""
        raise NotImplementedError(f"{type(self).__name__} needs shift(p)")


class UndampedCause(Cause):
    """Stage 2: other frequencies or damping ratios of the undamped modes, which complex modes follow."""

    in_structure = True

    def undamped(self, theta: Float[Array, "2 n"], where: Array, p: Float[Array, " p"]) -> Float[Array, "2 n"]:
        """Change of the logarithms of frequencies and damping ratios of the undamped modes."""
        raise NotImplementedError(f"{type(self).__name__} needs undamped(theta, where, p)")


class ModesCause(Cause):
    """Stage 3: other terms of the modal equations."""

    in_structure = True

    def modes(self, modes: ModalTerms, where: Array, p: Float[Array, " p"], runs: int) -> ModalTerms:
        """The terms with the cause in place."""
        raise NotImplementedError(f"{type(self).__name__} needs modes(modes, where, p, runs)")


class HystereticCause(ModesCause):
    """Stage 3, where viscous damping goes and with it the coupling of the modes by dampers."""

    def viscous(self, p: Float[Array, " p"]) -> Any:
        """Share of the viscous damping that stays, coupling of the modes included."""
        raise NotImplementedError(f"{type(self).__name__} needs viscous(p)")


class KernelCause(Cause):
    """Stage 4: what a finite record or a sweep makes of the decay of each mode."""

    only_one = True
    visible_when_free = True
    cut_off: ClassVar[int | None] = None  # variant of its place in which all that comes after a length of 1/p is lost

    def kernel(self, x: Complex[Array, "..."], where: Array, p: Float[Array, " p"]) -> Complex[Array, "..."]:
        r"""What :math:`1/x`, the transform of :math:`e^{-xt}`, becomes."""
        raise NotImplementedError(f"{type(self).__name__} needs kernel(x, where, p)")


class ElementCause(Cause):
    """An element that acts on one relative displacement, of two DoFs or of one and the ground."""

    in_structure = True
    shortlist_by = "element"

    def places(self, scene: Scene) -> list[Place]:
        """Every DoF to ground and every pair."""
        return scene.pairs()

    def weights(self, scene: Scene, places: Sequence[Place]) -> np.ndarray:
        """Likelier between DoFs that the simulation couples than anywhere else."""
        return scene.weights(places)

    def ends(self, columns: Array, where: Array) -> Array:
        """Motion across the element in modal columns ``(m, dof)``: their difference, shape ``(m, 1)``."""
        return gather(columns, where)[:, None]


class LocalCause(ElementCause):
    r"""Stage 5: a linear impedance :math:`Z(s)` [N/m] on a direction, :math:`H - H b (1/Z + b^T H b)^{-1} b^T H`."""

    def impedance(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, " f"]:
        """Force a unit relative displacement [N/m], each line by itself: it is asked at one line as at many."""
        raise NotImplementedError(f"{type(self).__name__} needs impedance(s, p)")

    def block(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 1 1"]:
        """The impedance as a matrix at every line."""
        return self.impedance(s, p)[:, None, None]


class CouplingCause(Cause):
    """Stage 5: a linear coupling of two DoFs that is no element between them, such as a skew one."""

    in_structure = True
    shortlist_by = "coupling"

    def places(self, scene: Scene) -> list[Place]:
        """Every pair."""
        return scene.pairs(ground=False)

    def matrix(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """Impedance between the two DoFs [N/m]."""
        raise NotImplementedError(f"{type(self).__name__} needs matrix(s, p)")

    def block(self, s: Complex[Array, " f"], p: Float[Array, " p"]) -> Complex[Array, "f 2 2"]:
        """The impedance :meth:`matrix`, under the name that elements have for it."""
        return self.matrix(s, p)

    def ends(self, columns: Array, where: Array) -> Array:
        """Motions that the coupling joins, from modal columns ``(m, dof)``: both DoFs, shape ``(m, 2)``."""
        return columns[:, where[:2]]


class JointCause(ElementCause):
    """Stage 6: a non-linear joint, by its law in :mod:`modalax.simulate`.

    Attributes
    ----------
    rigid
        Whether the force does not follow from the motion where the joint sticks; its one parameter is where it slips.
    """

    rigid: ClassVar[bool] = False
    per_run = True
    visible_when_free = True
    told_by_levels = True

    def law(self, p: Float[Array, " p"]) -> Any:
        """The joint with parameters ``p``."""
        raise NotImplementedError(f"{type(self).__name__} needs law(p)")

    def impedance(self, A: Array, omega: Array, p: Float[Array, " p"]) -> Complex[Array, "..."]:
        """Describing function at amplitude ``A`` [m], [N/m], shape ``(run, f, i)`` as ``A``, each entry by itself.

        Only where ``each_run`` is set may a run depend on its number, the first axis of ``A``.
        """
        return self.law(p).describing(A, omega)

    def simpler(self, p: np.ndarray) -> "tuple[JointCause, np.ndarray] | None":
        """The law, with parameters, that it becomes and cannot be told from as its strength grows; None without one."""
        return None

    def untold(self, p: np.ndarray) -> list[np.ndarray]:
        """Groups, ``(point, p)``, of parameters alike by one harmonic; the best of each is a start with more."""
        return [np.asarray(p, float)[None]]

    def impedance_in_series(self, A: Array, omega: Array, p: Array, compliance: Array) -> Complex[Array, "..."]:
        """The :meth:`impedance` of joint and spring together, of a rigid joint; of any other, its own."""
        return self.impedance(A, omega, p)


class ChannelCause(Cause):
    """Stage 7: a map of the predicted FRF, shape ``(run, f, o, i)``, as a fault of the measurement makes."""

    on_measured_channels = True

    def channels(
        self, H: Complex[Array, "run f o i"], at: Channels, where: Array, extra: Any, p: Float[Array, " p"]
    ) -> Complex[Array, "run f o i"]:
        """The FRF as measured."""
        raise NotImplementedError(f"{type(self).__name__} needs channels(H, at, where, extra, p)")


class PatternCause(ChannelCause):
    """Stage 7: terms whose real size in each channel is estimated from the data, ``extra``, shape ``(term, o, i)``.

    Attributes
    ----------
    terms
        Number of terms.
    several
        Whether a term stands for several modes, whose shapes together leave its sizes free; else it has rank one.
    """

    terms: int = 1
    several: bool = False
    needs_several_outputs = True
    strength_is_bounded = False

    @property
    def judged_by(self) -> Literal["scores", "patterns", "hum", "none"]:
        """The largest singular value; one mode shows nearly all that several would."""
        return "none" if self.several else "patterns"

    def shapes(self, scene: Scene) -> np.ndarray:
        """Trial values of the shape parameters, shape ``(trial, parameter - terms)``."""
        raise NotImplementedError(f"{type(self).__name__} needs shapes(scene)")

    def curves(self, s: Any, q: Any) -> Any:
        """The terms over frequency for shape parameters ``q``, shape ``(term, f)``."""
        raise NotImplementedError(f"{type(self).__name__} needs curves(s, q)")

    def cost(self, extra: Any) -> float:
        """Number of unknowns: the sizes, and the shape parameters."""
        return float(self.free_sizes(extra) + len(self.parameters) - self.terms)

    def promised_cost(self, extra: Any) -> float:
        """The shape parameters."""
        return float(len(self.parameters) - self.terms)

    def free_sizes(self, extra: Any) -> int:
        """Number of sizes: for each term a shape over outputs and inputs, or one for each channel."""
        outputs, inputs = extra.shape[1:]
        return self.terms * (outputs * inputs if self.several else outputs + inputs - 1)

    def channels(
        self, H: Complex[Array, "run f o i"], at: Channels, where: Array, extra: Any, p: Float[Array, " p"]
    ) -> Complex[Array, "run f o i"]:
        """Add the terms."""
        curves = self.curves(at.s, p[self.terms :])
        return H + jnp.einsum("t,tf,toi->foi", p[: self.terms], curves, extra)


class LinesCause(Cause):
    """Stage 8: narrow lines with an error of their own, which are left out of every other fit."""

    visible_when_free = True
    leaves_out_lines = True

    @property
    def judged_by(self) -> Literal["scores", "patterns", "hum", "none"]:
        """Draws of noise alone at such lines."""
        return "hum"

    def explain(
        self, freq: np.ndarray, fundamental: float, residual: np.ndarray, live: np.ndarray, known: float = np.inf
    ) -> HumLines:
        """Which lines are reached, and what that explains of whitened residuals ``(column, o, f)``."""
        raise NotImplementedError(f"{type(self).__name__} needs explain(freq, fundamental, residual, live)")

    def promised_cost(self, extra: HumLines) -> float:
        """The unknown sizes, one a harmonic."""
        return extra.freedom

    def told(self, lines: HumLines) -> dict[str, tuple[Any, str]]:
        """Parameters of the lines as reported in the answer: value and unit by name."""
        raise NotImplementedError(f"{type(self).__name__} needs told(lines)")
