"""Which of the two methods gives the answer: line by line about the simulation as it is, or in the modal domain.

Line by line is exact: it sees effects of a ten-thousandth, provided that everything but the causes is exact. Where
every element of a simulation is a little off, that assumption fails, and the modal domain, which learns the general
inaccuracy beside each cause, answers instead. Large problems go to the modal domain as well, because line by line the
work grows with the number of places times the number of samples.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from modalax.diagnose.thresholds import THRESHOLDS

Route = Literal["lines", "modes"]


@dataclass(frozen=True)
class Task:
    """What is asked, as far as the choice of the method depends on it.

    Attributes
    ----------
    has_modes
        Whether the modal domain can answer: the simulation has matrices and names all measured degrees of freedom, and
        the question is about this simulation.
    places
        Number of pairs of degrees of freedom, each with itself (to ground) included.
    samples
        Number of real samples.
    elements_off, modes_off
        Whether the author claims an inaccuracy of elements (stiffness or mass), or of modes (frequency or damping).
    whole_catalogue
        Whether every cause of the catalogue is looked for.
    groups
        Whether parameters of groups of elements are looked for, which only the modal domain knows.
    known_to_modes
        Whether the modal domain knows all causes of a part of the catalogue that is asked for.
    massless
        Whether DoFs of the simulation have no mass, with which only the modal domain can do.
    elements_show
        Whether the measured modes show that its elements are off, where the author claims an inaccuracy of modes.
    undamped
        Whether the simulation has no damping of its own, which line by line would be taken as exact.
    modes_alone
        Whether the simulation is given as modes, which end at some mode: lines are never explained to the last.
    """

    has_modes: bool
    places: float = 0.0
    samples: int = 0
    elements_off: bool = False
    modes_off: bool = False
    whole_catalogue: bool = True
    groups: bool = False
    known_to_modes: bool = True
    massless: bool = False
    elements_show: bool = False
    undamped: bool = False
    modes_alone: bool = False


@dataclass(frozen=True)
class Outcome:
    """What one method found, as far as the choice depends on it.

    Attributes
    ----------
    verdict
        ``clean``, ``named``, ``ambiguous`` or ``unknown``.
    held_out
        Chi-square per real sample that the extended simulation leaves on the held-out block.
    unforeseen
        The same, allowing for the errors of all that was fitted without that block; NaN where that is not told.
    throughout
        By how much all of the stiffness, mass or damping is too high, as in the answer; empty where none surely is.
    left
        Chance under noise alone of what the extended simulation leaves.
    probability
        Of the causes in the answer; 0 where there are none.
    alternatives
        Number of rivals in the answer.
    inaccuracy
        General inaccuracy as in the answer, by ``stiffness``, ``mass`` and ``damping``.
    places
        Number of places, or sets of channels, at which the causes in the answer are.
    joint
        Whether the force levels differ by a joint, whose law in the modal domain is inexact by its higher harmonics.
    group
        Whether a parameter of a group of elements is among the causes.
    of_elements
        Whether a change of a whole element, how its end is connected, or one that damping goes with is among the
        causes: lines have none of these.
    passed_over
        Whether a cause explains the data best, but is no larger than what is usual of a simulation.
    scaled
        Whether stiffness and mass are off by what may be one factor on both, so that no frequency is off.
    askew
        Whether it is told beyond doubt that a force or a sensor also acts or measures elsewhere, which has no name.
    exact_near
        Whether a few causes of a simulation that is exact in all else explain the modes about as well.
    """

    verdict: str
    held_out: float
    left: float = 1.0
    probability: float = 0.0
    alternatives: int = 0
    inaccuracy: Mapping[str, Mapping[str, Any]] | None = None
    places: int = 0
    joint: bool = False
    group: bool = False
    of_elements: bool = False
    unforeseen: float = math.nan
    throughout: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    passed_over: bool = False
    scaled: bool = False
    askew: bool = False
    exact_near: bool = False

    @property
    def predicts(self) -> float:
        """Chi-square per real sample on the held-out block that no error of what was fitted explains."""
        return self.held_out if math.isnan(self.unforeseen) else self.unforeseen


def order(task: Task) -> tuple[Route, ...]:
    """Methods in the order in which they are tried."""
    if not task.has_modes or not (task.known_to_modes or task.groups):  # what is not looked for is not told as absent
        return ("lines",)
    if needs_modes(task) or task.groups or task.massless or task.undamped:
        return "modes", "lines"
    if not task.whole_catalogue:  # what a part of the catalogue leaves must not be taken for inaccuracy
        return ("lines",)
    return ("lines", "modes") if by_claim(task) and not task.elements_show else ("modes", "lines")


def one_place_first(task: Task) -> bool:
    """Whether a force at one place is looked for before anything else.

    Not where elements are off, nor where modes may move and line by line takes minutes: they move beside every place.
    """
    elsewhere = task.elements_off or task.elements_show or task.massless or task.undamped
    return task.has_modes and task.whole_catalogue and not (elsewhere or task.modes_off and needs_modes(task))


def by_claim(task: Task) -> bool:
    """Whether lines come first only because the author claims that modes are off, not elements."""
    return _only_modes_off(task) and not needs_modes(task)


def claim_compared(task: Task) -> bool:
    """Whether the measured modes are asked first what they say of such a claim, and lines about what they name."""
    return _only_modes_off(task) and in_time(task)


def _only_modes_off(task: Task) -> bool:
    """Whether an inaccuracy of modes is claimed, and nothing else that only the modal domain knows."""
    other = task.elements_off or task.groups or task.massless or task.undamped or not task.whole_catalogue
    return task.has_modes and task.modes_off and not other


def in_time(task: Task) -> bool:
    """Whether a search line by line takes half a minute at most."""
    return task.places <= THRESHOLDS.places_in_time and task.places * task.samples <= THRESHOLDS.work_in_time


def needs_modes(task: Task) -> bool:
    """Whether the author says that every element is off, or line by line would take too long."""
    large = task.places > THRESHOLDS.places_by_lines or task.places * task.samples > THRESHOLDS.work_by_lines
    return large or task.elements_off


def suffices(route: Route, found: Outcome, task: Task) -> bool:
    """Whether the answer of the method that was tried first is given without trying the other."""
    if route == "lines":
        return explained(found)
    if task.massless or found.askew or task.undamped and found.verdict != "unknown":
        return True
    if task.modes_alone and found.verdict != "unknown" and certainly_off(found):
        return True
    if found.of_elements and surely_named(found):  # lines have no such cause, and would find nothing beside it
        return True
    if needs_modes(task):
        unsettled = found.verdict == "unknown" or found.verdict == "clean" and not nothing_left(found)
        hopeful = unsettled and may_be_exact(found) and task.places <= THRESHOLDS.places_in_time
        return task.elements_off or not (hopeful or sharper_by_lines(found, task))
    if found.group and found.verdict != "unknown" and nothing_left(found):
        return True
    if found.exact_near or found.verdict == "ambiguous" and in_time(task) and not surely_off(found):
        return False
    off = off_everywhere(found) or damping_off(found) or off_throughout(found)
    return off or decisive(found, task)


def hardly_off(found: Outcome) -> bool:
    """Whether all is explained by stiffness and mass that are certainly off, by less than is usual, and no joint."""
    explained = found.verdict in ("clean", "named") and not found.joint
    return explained and bool(certainly_off(found)) and not surely_off(found)


def surely_off(found: Outcome) -> bool:
    """Whether stiffness or mass is off in general by more than a few small causes of an exact simulation look like."""
    return any(p["interval"][0] >= THRESHOLDS.surely_off for p in certainly_off(found).values())


def sharper_by_lines(found: Outcome, task: Task) -> bool:
    """Whether by its modes a simulation may be exact in all else: single lines see smaller things that are wrong."""
    return found.verdict != "unknown" and may_be_exact(found) and not dampings_off(found) and in_time(task)


def choice(found: Mapping[Route, Outcome]) -> Route:
    """The method whose answer is given, of those that gave one."""
    if len(found) == 1:
        return next(iter(found))
    lines, modes = found["lines"], found["modes"]
    least = 0.0 if modes.exact_near else THRESHOLDS.as_noise
    ahead = modes.verdict != "unknown" and lines.predicts > max(least, modes.predicts)
    if explained(lines) and not ahead:
        return "lines"
    if modes.verdict == "unknown":  # of two attempts that explain nothing, the one that predicts better
        return "modes" if lines.verdict == "unknown" and modes.held_out < lines.held_out else "lines"
    # lines that explain nothing tell nothing where the simulation is certainly off, which they take for exact
    told = lines.verdict == "unknown" and modes.verdict != "clean" and bool(certainly_off(modes))
    return "modes" if told or modes.held_out < lines.held_out else "lines"


def explained(found: Outcome) -> bool:
    """Whether a search line by line found an explanation that predicts the held-out block."""
    return found.verdict != "unknown" and found.predicts <= THRESHOLDS.unexplained


def nothing_left(found: Outcome) -> bool:
    """Whether the extended simulation leaves no more than noise and predicts the held-out block."""
    return found.left > THRESHOLDS.left_by_modes and found.predicts < THRESHOLDS.as_noise


def settled(found: Outcome) -> bool:
    """Whether a search at the places of one force, which is exact but looks nowhere else, leaves nothing to explain.

    Forces at several places that explain a thing together may stand for one that is no force.
    """
    one = found.verdict in ("named", "ambiguous") and found.places == 1
    return one and found.left > THRESHOLDS.doubtful and nothing_left(found)


def law_is_exact(modes: Outcome) -> bool:
    """Whether the modal domain names a joint that predicts the highest level, where lines have no law that fits."""
    return modes.verdict == "named" and modes.joint and modes.held_out < THRESHOLDS.unexplained


def off_everywhere(found: Outcome) -> bool:
    """Whether stiffness or mass is certainly off everywhere, and with that nothing is left that lines could explain.

    What little is left beside a cause that is named and frequencies that are off is for no line to explain. Where
    nothing is named, one thing may only seem to be general: masses seem off where the peaks of a shaker that drops out
    are low, and all of them where a record leaks.
    """
    parts = certainly_off(found)
    if found.verdict == "unknown" or not parts:
        return False
    if found.joint:
        return found.held_out < THRESHOLDS.unexplained
    surely = any(p["interval"][0] > THRESHOLDS.surely_off for p in parts.values())
    return nothing_left(found) or found.verdict == "named" and surely and found.predicts < THRESHOLDS.as_noise


def damping_off(found: Outcome) -> bool:
    """Whether nothing is left, and the dampings, which lines take as exact, are certainly off.

    Where stiffness is certainly right, all may be exact but a damper, which lines can tell; where no damper is named
    though, dampings that are far off are so in general, unless one thing explains them better.
    """
    parts = found.inaccuracy or {}
    if not parts.keys() >= {"stiffness", "damping"}:
        return False
    if found.verdict == "clean":
        one = found.passed_over and may_be_exact(found)
        return parts["damping"]["interval"][0] > THRESHOLDS.damping_far and not one and nothing_left(found)
    off = parts["damping"]["interval"][0] > THRESHOLDS.damping_off
    right = parts["stiffness"]["interval"][1] < THRESHOLDS.surely_off
    return off and not right and found.verdict == "named" and nothing_left(found)


def off_throughout(found: Outcome) -> bool:
    """Whether nothing is left beside a factor on all of the stiffness, mass or damping, which lines take as exact."""
    least = {"stiffness": THRESHOLDS.surely_off, "mass": THRESHOLDS.surely_off, "damping": THRESHOLDS.damping_far}
    off = any(abs(v["value"]) > least[name] for name, v in found.throughout.items())
    return off and not found.scaled and found.verdict != "unknown" and nothing_left(found)


def certainly_off(found: Outcome) -> Mapping[str, Mapping[str, Any]]:
    """General inaccuracy of stiffness and mass, where one of them is certainly off; else nothing.

    Masses are known better than stiffnesses: mass that seems a little off where stiffness may be exact is more likely
    one thing that is wrong. So is what only makes all FRFs larger or smaller.
    """
    if found.scaled:
        return {}
    parts = {name: part for name, part in (found.inaccuracy or {}).items() if name in ("stiffness", "mass")}
    least = {"stiffness": 0.0, "mass": THRESHOLDS.surely_off}
    off = any(p["interval"][0] > least[name] and p["value"] > THRESHOLDS.off for name, p in parts.items())
    return parts if off else {}


def may_be_exact(found: Outcome) -> bool:
    """Whether stiffness and mass may be right everywhere, so that lines can show what modes do not."""
    parts = [part for name, part in (found.inaccuracy or {}).items() if name in ("stiffness", "mass")]
    return bool(parts) and all(p["interval"][0] <= 0 for p in parts)


def dampings_off(found: Outcome) -> bool:
    """Whether the dampings are certainly off in general.

    By less than any simulation's are, one thing that is wrong elsewhere is more likely what seems to be all of them.
    """
    damping = (found.inaccuracy or {}).get("damping", {"value": 0.0, "interval": (0.0, 0.0)})
    return damping["interval"][0] > 0 and damping["value"] > THRESHOLDS.damping_off


def decisive(found: Outcome, task: Task) -> bool:
    """Whether a cause of a large problem is named beyond doubt, and nothing is left to explain.

    Beside a simulation that is exact in all else, a smaller one may show on lines alone.
    """
    exact = not certainly_off(found) and not dampings_off(found)
    spared = task.places > THRESHOLDS.places_spared and not (exact and in_time(task))
    return spared and surely_named(found)


def elements_surely(found: Outcome) -> bool:
    """Whether causes are named beyond doubt beside elements that are certainly off, whatever is claimed of modes."""
    return surely_named(found) and off_everywhere(found)


def surely_named(found: Outcome) -> bool:
    """Whether causes are named beyond doubt, and nothing is left to explain."""
    return surely_foretold(found) and nothing_left(found)


def surely_foretold(found: Outcome) -> bool:
    """Whether causes are named beyond doubt that predict the held-out block."""
    sure = found.verdict == "named" and found.probability >= THRESHOLDS.decisive and not found.alternatives
    return sure and found.predicts < THRESHOLDS.as_noise
