"""The diagnosis in the modal domain as one call: identify, screen, fit, weigh, within a budget of time."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import leaking_channels
from modalax.diagnose.modal_domain.causes.further_causes import StructuralDamping, missing_modes, tuned_masses
from modalax.diagnose.modal_domain.causes.impact_window import impact_windows
from modalax.diagnose.modal_domain.causes.places import FEW, candidates_of, springs_of
from modalax.diagnose.modal_domain.causes.sensor_filters import sensor_filters
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found
from modalax.diagnose.modal_domain.fitting.inaccuracy import forces_of_errors, inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.levels.change import levels_differ
from modalax.diagnose.modal_domain.levels.explain import Spot
from modalax.diagnose.modal_domain.levels.laws import NAMED
from modalax.diagnose.modal_domain.levels.seen import Look, Seen, felt, force_taken, joint_and_structure, look_at_levels
from modalax.diagnose.modal_domain.levels.slipping import Whole, whole_joint
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.modes.measured import Measured, identify, told_one_by_one
from modalax.diagnose.modal_domain.odd_channels.askew import askew_channel
from modalax.diagnose.modal_domain.odd_channels.odd_channel import is_of_the_structure, odd_channel
from modalax.diagnose.modal_domain.on_lines.damping_on_lines import damping_by_lines
from modalax.diagnose.modal_domain.on_lines.further_modes import with_further_modes
from modalax.diagnose.modal_domain.on_lines.polish import leading_on_lines
from modalax.diagnose.modal_domain.search.beside_modes import shortage
from modalax.diagnose.modal_domain.search.explain import explain
from modalax.diagnose.modal_domain.search.force_places import KINDS, line_forces
from modalax.diagnose.modal_domain.search.lacking_modes import lacking_modes
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, coordinates_of, is_large
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation
from modalax.diagnose.modal_domain.structure.turns import nodes_at
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import Structure

# causes that are looked for here; all others show on lines only
KNOWN = frozenset({
    "added_mass", "joint_stiffness", "local_damper", "modal_damping", "structural_damping", "tuned_mass",
    "missing_mode", "channel_gain", "channel_sign", "channel_swap", "force_gain", "time_delay", "units",
    "sensor_filter", "time_varying", "crosstalk", "exponential_window", "mains_hum",
    *KINDS, *(law.slug for law in NAMED),
})  # fmt: skip
BEYOND = 1.2  # frequency, over that of the highest measured mode, up to which errors of elements are made exact
FIRST_SHARE = 0.6  # of the time for linear causes, where runs may have to be told apart after them,
ALONE_SHARE = 0.85  # and where not: channels that no cause explains are looked for after them


@dataclass(frozen=True)
class Stage:
    """What the modal domain tells.

    Attributes
    ----------
    measurement, simulation
        As they came, the measurement (:class:`Measurement`) without a line at 0 Hz.
    coordinates, measured, setting
        The simulation's modal coordinates, the measurement's own modes (:class:`Measured`), and what hypotheses share.
        Where modes alone were given, what stands for measurement and measured tells names, band and features only.
    candidates
        Every cause at every place that was screened.
    explanations
        By falling probability; empty where the simulation has no modes to compare.
    in_time
        Whether every step was done before time was up.
    seen
        What force levels or repeated runs tell; None where there is one run.
    odd
        A channel that differs from all others as no cause explains; None where there is none, or where it is not told.
    whole
        The leading joint, where the simulation lacks it altogether and the linear structure shows its spring.
    """

    measurement: Any
    simulation: Simulation
    coordinates: Coordinates
    measured: Any
    setting: Setting
    candidates: list[Change]
    explanations: list[Explanation]
    in_time: bool
    seen: Seen | None = None
    odd: OddChannel | None = None
    whole: Whole | None = None

    @property
    def best(self) -> Explanation:
        """The likeliest explanation."""
        return self.explanations[0]

    @property
    def jointed(self) -> bool:
        """Whether force levels tell of a joint."""
        return self.seen is not None and self.seen.joint is not None


def further_of(
    simulation: Simulation, c: Coordinates, measured: Measured, outputs: tuple[str, ...]
) -> list[Change]:  # fmt: skip
    """Causes that only lines, and not a table of modes, are asked about.

    Where modes do not explain a measurement, as of a structure that is not linear, one too many is no mode.
    """
    low, high = (float(abs(measured.channels.s[k])) for k in (0, -1))
    inside = np.flatnonzero((c.frequencies > low) & (c.frequencies < high))
    few = inside if len(inside) else np.arange(1)
    found: list[Change] = [StructuralDamping("structural_damping", ()), *leaking_channels(outputs)]
    found += impact_windows(c, few, measured.channels.order)
    if measured.misfit < THRESHOLDS.as_noise:
        found += tuned_masses(simulation.dofs, c, few, low, high)
        found += missing_modes(measured.features, measured.channels.order, low, high)
        found += sensor_filters(outputs, low, high)
    return found


def identified(measurement: Measurement, simulation: Simulation, tell: Callable[[str], None]) -> Measured:
    """The measurement's own modes."""
    tell("identifying the measurement's own modes")
    highest = 2 * np.pi * float(measurement.freq[-1])
    return identify(measurement, coordinates_of(simulation, measurement.outputs, measurement.inputs, highest))


@dataclass(frozen=True)
class Posed:
    """What measured modes are compared with.

    Attributes
    ----------
    coordinates, setting
        The simulation's modal coordinates, and what hypotheses share.
    candidates
        Every cause at every place.
    places
        Of springs, as :func:`springs_of` tells them.
    """

    coordinates: Coordinates
    setting: Setting
    candidates: list[Change]
    places: list[Any]


def posed(
    measurement: Measurement, simulation: Simulation, measured: Measured, exact: tuple[str, ...] = (),
    errors: np.ndarray | None = None,
) -> Posed:  # fmt: skip
    """What modes that were identified are compared with; a large simulation as :func:`coordinates_of` makes it."""
    highest = 2 * np.pi * float(measurement.freq[-1])
    c = coordinates_of(simulation, measurement.outputs, measurement.inputs, highest, exact, errors)
    whitener = whitener_of(measured.features)
    setting = Setting(c, inaccuracy_of(simulation, c, highest), measured.features, whitener)
    if simulation.groups is None:  # all of the mass and stiffness is, where there is one force, its constant as well
        sought = ("stiffness", "mass") if len(measurement.inputs) > 1 else ("stiffness",)
        setting = replace(
            setting, sought=sought, uneven=isinstance(simulation, Structure) and simulation.elements is None
        )
    pairs = None if simulation.pairs is None else list(simulation.pairs)
    every = candidates_of(simulation, c, measurement.outputs, measurement.inputs, pairs, highest)
    every += further_of(simulation, c, measured, measurement.outputs)
    anywhere = simulation.dofs if isinstance(simulation, ModesOnly) and len(simulation.dofs) <= FEW else ()
    places = springs_of(simulation, c, nodes_at(simulation), pairs, highest, anywhere)
    low, high = (float(abs(measured.channels.s[k])) for k in (0, -1))
    forces = line_forces(c, simulation.dofs, measurement.outputs, measurement.inputs, places, low, high)
    return Posed(c, setting, [*every, *forces], places)


def _forces(simulation: Simulation, setting: Setting, f: Fit) -> np.ndarray:
    """Forces of the errors of single elements in the modes of a fit that are near the measured ones, ``(n, r)``."""
    a, (shapes, squares, _) = setting.inaccuracy, f.state.modes.low
    single = f.sizes[: len(a.group_of)]  # before those of groups that the data have asked for
    sizes = {name: single[a.group_of == a.groups.index(name)] for name in ("stiffness", "mass")}
    few = squares < (BEYOND * np.abs(setting.features.poles).max()) ** 2
    return forces_of_errors(simulation, sizes, setting.coordinates.everywhere @ shapes[few].T, squares[few])


@dataclass
class _Early:
    """Whether the lowest level holds the force of a joint too, for which further causes would stand."""

    look: Look
    measured: Measured
    level: np.ndarray
    differ: bool
    seen: list[Seen] = field(default_factory=list)

    def __call__(self, setting: Setting, explanations: list[Explanation]) -> bool:
        raw = self.look(self.measured, setting, explanations[0].fit, None, False) if self.differ else None
        if raw is not None and raw.joint is not None:
            if felt(force_taken(raw, self.level, self.measured.runs), self.measured):
                self.seen.append(raw)
        return bool(self.seen)


def _spots(tasks: list[Posed], setting: Setting) -> list[Spot]:
    """Where a joint may be, in the coordinates of a setting."""
    task = next(t for t in tasks if t.coordinates.shapes is setting.coordinates.shapes)
    return [Spot(where, b, w, held) for where, b, _, w, held in task.places]


def _odd(
    measurement: Measurement,
    simulation: Simulation,
    setting: Setting,
    explanations: list[Explanation],
    late: Deadline,
) -> OddChannel | None:
    """A channel that differs from all others as no cause explains, where the structure does not."""
    if is_of_the_structure(explanations, setting.features):
        return None
    channels = measurement.outputs, measurement.inputs
    odd = None if late() else odd_channel(setting, explanations, *channels)
    turned = None if late() else askew_channel(setting, explanations, simulation.dofs, *channels)
    return max((o for o in (odd, turned) if o is not None), key=lambda o: o.nats, default=None)


def told_wrongly(by_modes: float, by_lines: float) -> bool:
    """Whether measured modes that an explanation misses are not what the lines show: no channel is odd for that."""
    return by_lines < THRESHOLDS.misfit < by_modes


def _lacking(
    measurement: Measurement, simulation: Simulation, measured: Measured, wanted: Callable[[str], bool], several: bool,
) -> tuple[Measured, Posed, Found] | None:  # fmt: skip
    """What is compared where modes surely are none of the simulation's, one of two close ones or ``several``; and fits.

    Close modes are then told one by one.
    """
    apart = told_one_by_one(measured) or (measured if several else None)
    if apart is None or not wanted("missing_mode"):
        return None
    task = posed(measurement, simulation, apart)
    found = lacking_modes(task.setting, [k for k in task.candidates if wanted(k.slug)], measured.features)
    return (apart, task, found) if found else None


def run_stage(
    measurement: Measurement, simulation: Simulation, late: Deadline, wanted: Callable[[str], bool],
    tell: Callable[[str], None], measured: Measured | None = None,
) -> Stage | None:  # fmt: skip
    """Diagnose a measurement in the modal domain; None where it shows no mode to compare.

    Parameters
    ----------
    late
        When no further step begins.
    wanted
        Which causes to look for, by slug.
    tell
        Called with each step.
    measured
        The measurement as :func:`identified`, where that is known.
    """
    measured = measured or identified(measurement, simulation, tell)
    if not len(measured.features.poles):
        return None
    task = posed(measurement, simulation, measured)
    few = shortage(task.setting)
    apart = _lacking(measurement, simulation, measured, wanted, few > 1) if few else None
    stage = _searched(measurement, simulation, late, wanted, tell, *(apart or (measured, task, None)))
    if apart or late() or (stage is not None and (stage.jointed or stage.best.misfit < THRESHOLDS.misfit)):
        return stage
    apart = _lacking(measurement, simulation, measured, wanted, False)
    other = None if apart is None else _searched(measurement, simulation, late, wanted, tell, *apart)
    cut_short = other is None or (other.seen is not None and other.seen.found.untried)
    return stage if cut_short else other


def _searched(
    measurement: Measurement, simulation: Simulation, late: Deadline, wanted: Callable[[str], bool],
    tell: Callable[[str], None], measured: Measured, task: Posed, known: Found | None,
) -> Stage | None:  # fmt: skip
    """What explains the modes, ``known`` fits to begin with; None where nothing can be compared with them."""
    tasks, candidates = [task], [k for k in task.candidates if wanted(k.slug)]

    def finer(exact: tuple[str, ...], f: Fit) -> tuple[Setting, list[Change]]:
        tasks.append(posed(measurement, simulation, measured, exact, _forces(simulation, tasks[0].setting, f)))
        return tasks[-1].setting, [k for k in tasks[-1].candidates if wanted(k.slug)]

    H, level = np.asarray(measurement.H), np.asarray(measurement.level)
    first = late.part(FIRST_SHARE if len(H) > 1 else ALONE_SHARE)

    def look(measured: Measured, setting: Setting, f: Fit, earlier: Seen | None, there: bool) -> Seen | None:
        places = _spots(tasks, setting) if earlier is None or not there else earlier.found.places
        drift = None if earlier is None else earlier.found.drift
        return look_at_levels(H, level, measured, setting, f, places, wanted, tell, late, drift)

    early = _Early(look, measured, level, levels_differ(H, measured.noise.sigma, level))
    also = (finer, None) if is_large(simulation) else (None, early)

    setting, candidates, explanations = explain(task.setting, candidates, first, tell, *also, known)
    if not explanations:
        return None
    alone = isinstance(simulation, ModesOnly)
    if alone:
        setting = with_further_modes(setting, explanations[0].fit, measured)
    c, odd, seen = setting.coordinates, None, None
    if not early.seen:
        if not alone:  # whose lines hold further modes, the phase of which nobody knows
            explanations = damping_by_lines(setting, explanations, measured, late)
        odd, missed = _odd(measurement, simulation, setting, explanations, late), explanations[0].misfit
        setting, explanations = leading_on_lines(setting, explanations, measured, late)
        odd = None if told_wrongly(missed, explanations[0].misfit) else odd
    try:
        before = explanations
        measured, setting, explanations, seen = joint_and_structure(
            H, level, measured, setting, explanations, candidates, look, late, tell, early.seen
        )
        if explanations is not before:
            setting, explanations = leading_on_lines(setting, explanations, measured, late)
    except KeyboardInterrupt:
        late.stop()
    whole = None
    if seen is not None and seen.joint is not None:  # which bends the modes themselves
        odd, whole = None, whole_joint(explanations[0], seen.joint, Prior(candidates))
    in_time = not (late() or first())
    return Stage(measurement, simulation, c, measured, setting, candidates, explanations, in_time, seen, odd, whole)
