r"""Where an element of any law sits, and how large it is, read off the force that it must have.

An element at one place, linear or not, changes the motion by :math:`-H_b(\omega)\,q`, with one complex force
:math:`q` for every line, run and input. Whatever the law, this holds for changes of any size: no derivative is taken.
Fitting the force freely ranks the places; its ratio to the motion across the place, which follows from it, is the
element's impedance as measured, :math:`Z = q/x`, and each law is fitted to that before it is fitted to the data.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.causes.base import Cause, ElementCause, JointCause, LocalCause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.prediction.impedances import impedances
from modalax.diagnose.screening.modes_beside import Beside, modes_beside
from modalax.diagnose.search.candidates import cost_of

STRONG = 4.0  # chi-square per sample that the simulation leaves, from which on places are ranked by their force
PLACES, MORE = 3, 12  # places that are tried, and where a force at one place is known to explain the data
STARTS = 2  # starts of each law at each place
FITTED = 16  # starts in all
SURELY = 5.0  # standard deviations of a chi-square beyond which runs differ
REFINED, FIRST = 40, 15  # places at which the modes follow, and those by which it shows whether more are worth it
TELLING, ASKED, REWEIGHED = 100, 9, 10  # lines whose strengths are looked at, how many of these, and steps from each
STRONGEST, BELOW = 40, (0.98, 0.9, 0.7)  # lines of the largest force, and parts of their motion that are thresholds
LIKELIEST = 4  # joints that are fitted beside lines set aside
THRESHOLDS_TRIED = 12  # displacements at which a law may set in, over the range of those measured


@dataclass(frozen=True)
class MeasuredForce:
    """The force that an element at one place must have.

    Attributes
    ----------
    place
        Where it sits.
    chi2
        What the measurement leaves once the force is taken up, and the number of forces fitted is paid for.
    motion
        Displacement across the place [m], complex, shape ``(run, f, i)``.
    impedance
        Force over displacement [N/m], of the same shape.
    weight
        Inverse standard deviation of each impedance [m/N].
    theta
        Modal parameters beside the force, in units of their spread, shape ``(2, n)``.
    unit, information
        The force for a unit force at the input, and the inverse variance of its real part, of the same shape.
    """

    place: Place
    chi2: float
    motion: np.ndarray
    impedance: np.ndarray
    weight: np.ndarray
    theta: np.ndarray
    unit: np.ndarray
    information: np.ndarray

    def place_of(self, cause: ElementCause, scene: Scene) -> Place | None:
        """Where a cause is as an element at the same degrees of freedom; None where it cannot be there."""
        return next((p for p in cause.places(scene) if p.index[:2] == self.place.index[:2]), None)


def measured_forces(comparison: Comparison, places: Sequence[Place], enough: float = np.inf) -> list[MeasuredForce]:
    """The force that an element must have at each place that there is time for, the best place first.

    Parameters
    ----------
    comparison
        Data and simulation; its modes follow within the spread that is claimed.
    places
        Pairs of degrees of freedom, or single ones to the ground.
    enough
        Chi-square that one of the first places must come to, for modes to follow beside further ones.
    """

    def ranked(found: list[tuple[Place, float, Beside]]) -> list[MeasuredForce]:
        return sorted((force_beside(place, left, beside) for place, left, beside in found), key=lambda m: m.chi2)

    found = modes_beside(comparison, places, FIRST, comparison.late)
    first = ranked(found)
    if not first or not comparison.nuisance.active or first[0].chi2 >= enough:
        return first
    return ranked(modes_beside(comparison, places, REFINED, comparison.late, found))


def force_beside(place: Place, left: float, beside: Beside) -> MeasuredForce:
    """The force that is measured at a place, with the modes at given modal parameters.

    Parameters
    ----------
    place
        Where it acts.
    left
        Chi-square that data and modal parameters leave beside a free force.
    beside
        The modes.
    """
    problem = beside.comparison.problem
    level = np.asarray(problem.level)[:, : problem.lines, None]
    direction = beside.direction(place)
    length = (np.abs(direction) ** 2).sum(axis=2)
    unit = -(direction.conj() * beside.change).sum(axis=2) / np.maximum(length, 1e-300)  # for a unit force at the input
    motion = beside.motion(place) - beside.drive(place)[:, None] * unit
    size = np.abs(motion)
    return MeasuredForce(
        place, left + 2 * unit.size, level * motion, unit / np.where(size > 0, motion, 1.0), np.sqrt(length) * size,
        beside.theta, unit, length,
    )  # fmt: skip


def differs_by_run(force: MeasuredForce) -> bool:
    """Whether the force at a place, for a unit force at the input, differs from run to run by more than noise.

    That of a joint does by level. Many sensors tell a small force at one place that differences of all FRFs hide in
    their noise.
    """
    w = force.information
    mean = (w * force.unit).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300)
    chi2, freedom = float((w * np.abs(force.unit - mean) ** 2).sum()), 2 * (len(w) - 1) * mean.size
    return bool(chi2 - freedom > SURELY * np.sqrt(2 * max(freedom, 1)))


def starts_from_forces(comparison: Comparison, null: Hypothesis, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Elements at the places whose force explains most, sized by that force; none where the simulation is nearly right.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    causes
        What to look for.
    """
    problem = comparison.problem
    few = problem.channels[0] < 2 or problem.held is not None or comparison.question == "free"
    if few or (null.chi2 < STRONG * problem.samples and not comparison.only):
        return []
    laws = [c for c in causes if isinstance(c, JointCause | LocalCause) and c.parameters]
    ranked = measured_forces(comparison, comparison.joint_places())[: MORE if comparison.only else PLACES]
    out = []
    for force in ranked:
        for cause in laws:
            at = force.place_of(cause, comparison.scene)
            if at is not None and not cause.each_run:
                sized = sizes_by_force(comparison, cause, at, force)
                out += [(force.chi2 + m, cause, at, p, force.theta) for m, p in sized]
    out.sort(key=lambda one: one[0])
    follow = comparison.nuisance.active
    return [
        replace(
            null.with_cause(cause, at, None, p),
            freedom=cost_of((cause,), (None,)),
            theta=theta if follow else null.theta,
        )
        for _, cause, at, p, theta in out[:FITTED]
    ]


def sizes_by_force(
    comparison: Comparison, cause: ElementCause, place: Place, force: MeasuredForce
) -> list[tuple[float, np.ndarray]]:
    r"""Parameters of a law that come nearest to a measured impedance, each after the chi-square by which it misses it.

    The strength, to which every law is proportional, is solved for each trial of the other parameters,
    :math:`s = \mathrm{Re}\sum w^2 Z_1^* Z / \sum w^2 |Z_1|^2`.

    Parameters
    ----------
    comparison
        Data and simulation.
    cause, place
        The law, and where it sits.
    force
        The force that was measured there.
    """
    scene, found = comparison.scene, []
    everything = float((np.abs(force.weight * force.impedance) ** 2).sum())
    shapes = _shapes(cause, cause.grid(scene, place), np.abs(force.motion))
    for shape, Z in zip(shapes, _of_unit_strength(cause, shapes, np.abs(force.motion), scene), strict=True):
        with np.errstate(all="ignore"):
            whitened = np.nan_to_num(force.weight * Z)
            norm = float((np.abs(whitened) ** 2).sum())
            gain = float((whitened.conj() * force.weight * force.impedance).real.sum())
        if norm > 0:
            low, high = cause.parameters[0].lower, cause.parameters[0].upper
            strength = float(np.clip(gain / norm, low, high))
            found.append((everything + strength**2 * norm - 2 * strength * gain, np.array([strength, *shape])))
    found = [f for f in found if f[1][0] != 0]
    return sorted(found, key=lambda f: f[0])[:STARTS]


def robust_sizes(
    comparison: Comparison, cause: JointCause, place: Place, force: MeasuredForce
) -> tuple[float, np.ndarray] | None:
    r"""Parameters of a law that most lines agree on, by a misfit in which lines far off count little more than others.

    The misfit is that of Cauchy's distribution, :math:`\sum\ln(1 + w^2|Z - sZ_1|^2)`; the strength s starts from those
    that single lines ask for, and each step weighs every line by how well it agrees.

    Parameters
    ----------
    comparison
        Data and simulation.
    cause, place
        The law, and where it sits.
    force
        The force that was measured there.
    """
    scene, best = comparison.scene, None
    low, high = cause.parameters[0].lower, cause.parameters[0].upper
    seen, motion = (force.weight * force.impedance).ravel(), np.abs(force.motion)
    everything = np.abs(seen) ** 2
    shapes = _shapes(cause, cause.grid(scene, place), motion)
    if cause.has_threshold and motion.any():
        loudest = motion.ravel()[np.argsort(everything)[-STRONGEST:]]
        shapes = np.concatenate([shapes, np.outer(loudest[loudest > 0], BELOW).reshape(-1, 1)])
    for shape, Z in zip(shapes, _of_unit_strength(cause, shapes, motion, scene), strict=True):
        unit = np.nan_to_num(force.weight * Z).ravel()
        cost, strength = _agreed(unit, seen, everything, low, high)
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = cost, np.array([strength, *shape])
    return best


def _agreed(unit: np.ndarray, seen: np.ndarray, everything: np.ndarray, low: float, high: float) -> tuple[float, float]:
    """Misfit and strength that most lines agree on, for a law's whitened impedance at unit strength, ``(n,)``.

    ``everything`` is the square of what was ``seen``; strengths keep between ``low`` and ``high``, and are not zero.
    """
    size, along = np.abs(unit) ** 2, (unit.conj() * seen).real
    told = np.argsort(size)[-TELLING:]
    with np.errstate(all="ignore"):
        asked = np.nan_to_num(np.quantile(along[told] / size[told], np.linspace(0.05, 0.95, ASKED)))
    s = np.clip(asked, low, high)[:, None]

    def missed(s: np.ndarray) -> np.ndarray:
        return np.maximum(everything - 2 * s * along + s**2 * size, 0.0)

    for _ in range(REWEIGHED):
        w = 1 / (1 + missed(s))
        s = np.clip((w @ along) / np.maximum(w @ size, 1e-300), low, high)[:, None]
    cost = np.where(s[:, 0] != 0, np.log1p(missed(s)).sum(axis=1), np.inf)
    k = int(np.argmin(cost))
    return float(cost[k]), float(s[k, 0])


def robust_starts(comparison: Comparison, null: Hypothesis, causes: Sequence[Cause]) -> list[Hypothesis]:
    """Joints at the places whose force explains most, sized so that most lines agree; the likeliest first.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    causes
        What to look for.
    """
    laws = [c for c in causes if isinstance(c, JointCause) and not c.each_run and type(c).law is not JointCause.law]
    found = []
    for force in measured_forces(comparison, comparison.joint_places())[:PLACES]:
        for cause in laws:
            at = force.place_of(cause, comparison.scene)
            sized = None if at is None else robust_sizes(comparison, cause, at, force)
            if at is not None and sized is not None:
                about = replace(null, theta=force.theta)
                found.append((sized[0] + 0.5 * force.chi2, about.with_cause(cause, at, None, sized[1])))
    found.sort(key=lambda one: one[0])
    return [replace(h, freedom=cost_of(h.causes, h.extras)) for _, h in found[:LIKELIEST]]


def _of_unit_strength(cause: ElementCause, shapes: np.ndarray, motion: np.ndarray, scene: Scene) -> np.ndarray:
    """Impedances of an element at trials of the parameters besides its strength, shape ``(trial, run, f, i)``."""
    return impedances(cause, np.column_stack([np.ones(len(shapes)), shapes]), scene.omega, motion)


def _shapes(cause: ElementCause, grid: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Parameters besides the strength: those screened at, or thresholds over the range of displacements measured."""
    shapes = np.unique(grid[:, 1:], axis=0) if grid.shape[1] > 1 else np.zeros((1, 0))
    if not cause.has_threshold or not motion.any():
        return shapes
    within = np.geomspace(np.quantile(motion[motion > 0], 0.05), motion.max(), THRESHOLDS_TRIED)
    return within[:, None]
