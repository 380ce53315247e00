r"""The method of the diagnosis, from a measurement and a simulation to an answer.

1. **Prepare.** The measurement becomes receptances with a noise level for each sample; the simulation becomes
   its modes, so that the receptance between any two places is at hand whatever kind of simulation it is. The residual
   is whitened: divided by the noise, so that chi-square is its plain sum of squares. The modal frequencies and damping
   ratios may move within the spread that the author claims (``comparison``, ``setup``).
2. **Detect.** Is anything wrong at all? Every cause at every place is screened by its efficient score, and tests that
   know no cause look at the same residual. Their chances under noise alone, corrected for the number of tests, give one
   chance; where that is not small, the answer is *clean* (``search.look``, ``screening``, ``decision.detection``).
3. **Explain.** The most promising trials are fitted by damped Gauss-Newton, each alone; where one leaves more than
   noise, the pairs that promise most together (``search.in_pairs``), then one cause more as long as what is left asks
   for one. Sets of causes are weighed by Schwarz's criterion and by what is known of causes and places before the data
   (``search``, ``fitting``, ``decision.posterior``).
4. **Check for imitations.** Causes that the answer has no name for are fitted as well; where one of them is likelier,
   no name is given (``search.imitator_check``).
5. **Predict.** Simulation and extended simulation are fitted without a block of the data, a force level if there are
   several, and compared on it (``holdout``).
6. **Decide.** One ordered list of rules gives the verdict and its reasons (``decision.verdict``, ``thresholds``).

Steps 2 to 5 work line by line and take everything but the causes as exact. Where every element of the simulation is a
little off, as the measured modes show also where an inaccuracy of modes is claimed (``modal_domain.claimed_modes``), or
the problem is large, the modal domain answers instead (``decision.route``, ``modal_domain``): the modes
of the measurement are identified, the general inaccuracy is estimated together with every cause, and the answer holds
both. Where one force at one place explains all data, only elements and joints at such places are searched, line by
line, whatever the size of the problem unless modes may move (``screening.one_force``).
Where nothing of this explains several force levels of
a few modes, a joint is fitted together with the modes, as the lowest level is bent by it too: first without a law,
then by laws that come near to that, judged by the highest level (``jointed``). It comes first where a quick fit shows
that no joint of any law explains the levels with the modes as they are (``jointed.bent``).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from modalax._numerics.checks import require_double
from modalax._numerics.programs import release_programs
from modalax._numerics.threads import one_thread
from modalax.data import FRF, Measurement
from modalax.diagnose.causes import as_causes, catalogue, imitators
from modalax.diagnose.causes.base import Cause, LocalCause
from modalax.diagnose.comparison import Comparison, as_measurement, causes_of, make_comparison, with_noise_beside
from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.decision.beliefs import beliefs
from modalax.diagnose.decision.route import (
    Outcome,
    Route,
    Task,
    choice,
    claim_compared,
    elements_surely,
    law_is_exact,
    nothing_left,
    one_place_first,
    order,
    settled,
    suffices,
    surely_foretold,
)
from modalax.diagnose.extend import ExtendedSimulation, as_given
from modalax.diagnose.gains_said import gains_said
from modalax.diagnose.jointed.answer import diagnose_joint, joint_comes_first, may_have_joint
from modalax.diagnose.modal_domain.answer import ModalDiagnosis
from modalax.diagnose.modal_domain.claimed_modes import ClaimCompared, compared
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.modes.measured import Measured
from modalax.diagnose.modal_domain.stage import identified
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, modes_only
from modalax.diagnose.modal_domain.table import by_table
from modalax.diagnose.result import Diagnosis
from modalax.diagnose.routes import (
    GROUP_SLUGS,
    all_in_general,
    check_groups,
    has_levels,
    may_tell_joints,
    named_before,
    named_beside_claim,
    of_elements,
    outcome_beside_few,
    outcome_of,
    task_of,
)
from modalax.diagnose.screening.one_force import places_of_one_force
from modalax.diagnose.search.explain import check_imitations, explain
from modalax.diagnose.search.look import look
from modalax.diagnose.search.measured_force import differs_by_run, measured_forces
from modalax.diagnose.search.named_before import NamedCause
from modalax.diagnose.search.one_place import explain_force, law_leaves_noise
from modalax.diagnose.setup.turned import turned, turned_modes
from modalax.diagnose.told import told
from modalax.diagnose.undamped import with_damping
from modalax.model import ModalModel, Structure
from modalax.model.entry import check_comparable, check_simulation
from modalax.model.mode_table import ModeTable
from modalax.model.receptance import dof_names

FIRST_SHARE = 0.6  # of the time for a search line by line that the modal domain or a free joint may have to follow
FITTED_EACH = 30  # places at each of which every law is fitted to the force; more are screened together
NAMED_SHARE = 0.85  # of the time for what is in the catalogue, before what is not is looked at
MODES_ALONE = "the simulation is given as modes, which tell of no elements: where its matrices are known, give these"


@one_thread
def diagnose(
    measurement: Measurement | FRF | ModeTable,
    simulation: Structure | ModalModel | ExtendedSimulation,
    *,
    question: str = "auto",
    causes: Sequence[Cause | str] | None = None,
    time: float = 120.0,
    modal_std: tuple[float, float, float] | None = None,
    prior: Mapping[str, float] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find what a simulation gets wrong, name the cause, extend the simulation and measure the gain.

    Parameters
    ----------
    measurement
        Runs of FRFs, of any form; force levels [N] where joints are in question. Or modes alone, a
        :class:`modalax.model.mode_table.ModeTable`, against matrices or real modes: chi-squares and gain then do not
        exist (NaN).
    simulation
        What was expected; its DoFs hold all measured ones by name, in either direction (``8:-Z`` is ``8:+Z`` turned).
        An extended simulation keeps what it has, at the parameters it has, and what is found comes on top.
    question
        ``fixed``: does the data agree with *this* simulation, within the spread its author claims? ``free``: does any
        linear modal model explain the data? ``auto`` takes ``free`` for a modal fit (a modal model with residual
        terms), else ``fixed``.
    causes
        What to look for, by name or as causes; the whole catalogue if None.
    time
        Seconds after which the search begins no further step and gives the best answer so far. An interrupt (Ctrl-C)
        does the same, once there is an answer.
    modal_std
        Of modes alone: relative standard deviations of frequency and damping ratio where the table states none, and
        that of shapes over their largest component.
    prior
        Factors by name of the cause: how much likelier than by itself you hold it to be before the data, such as
        ``{"joint_stiffness": 10}`` where a mount is suspected. A factor multiplies the odds of what holds the cause;
        hum beside modes is judged by a test alone.
    progress
        Called with each stage, in words.

    Returns
    -------
    Diagnosis
        With ``to_dict()``, the extended simulation, and residuals before and after.

    Raises
    ------
    ValueError
        If double precision is off, a measured DoF is not in the simulation, groups of elements are asked about that it
        does not name, the data holds too few lines to tell, or data or simulation are of no passive structure
        (:func:`modalax.model.entry.check_comparable`).
    """
    require_double("diagnose")
    asked = as_causes(causes)
    check_groups(simulation, asked)
    with beliefs(prior, every_name() | {c.slug for c in asked or ()}):
        return _diagnosed(measurement, simulation, question, asked, time, modal_std, progress)


def every_name() -> set[str]:
    """Names of all causes that an answer can hold."""
    return {c.slug for c in (*catalogue(), *imitators())} | GROUP_SLUGS | {"sensor_place"}


def _diagnosed(
    measurement: Measurement | FRF | ModeTable, simulation: Structure | ModalModel | ExtendedSimulation, question: str,
    causes: Sequence[Cause] | None, time: float, modal_std: tuple[float, float, float] | None,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """The answer, with what is known besides said beside it."""
    release_programs()
    check_simulation(simulation, Structure, ModalModel, ExtendedSimulation)
    simulation = as_given(simulation)
    names = dof_names(simulation.base if isinstance(simulation, ExtendedSimulation) else simulation)
    if isinstance(measurement, ModeTable):
        table, renamed = turned_modes(measurement, names)
        simulation, damped = with_damping(table, simulation)
        found = by_table(table, simulation, causes, modal_std, time, progress)
        return replace(found, reasons=(*found.reasons, *([damped] if damped else []), *renamed))
    check_comparable(measurement, simulation)
    measurement, renamed = turned(measurement, names)  # pyrefly: ignore[bad-specialization]
    simulation, damped = with_damping(as_measurement(measurement), simulation, progress)
    found = by_frfs(measurement, simulation, question, causes, Deadline(time), progress, undamped=bool(damped))
    said = [damped] if damped else []
    said += gains_said(found.causes) if found.verdict in ("named", "ambiguous") else []
    if found.verdict == "unknown" and found.question == "fixed" and isinstance(simulation, ModalModel):
        said.append(MODES_ALONE)
    return replace(found, reasons=(*found.reasons, *said, *renamed)) if said or renamed else found


def by_frfs(
    measurement: Measurement | FRF, simulation: Structure | ModalModel | ExtendedSimulation, question: str,
    causes: Sequence[Cause] | None, late: Deadline, progress: Callable[[str], None], undamped: bool = False,
) -> Diagnosis:  # fmt: skip
    """Diagnose FRFs; a joint whose law is free comes first or last where the levels tell of one."""
    data = as_measurement(measurement)
    follows = question != "fixed" and may_have_joint(data, simulation)
    if follows and joint_comes_first(data, simulation):
        joint = diagnose_joint(data, simulation, causes, late, progress)
        if joint is not None:
            return joint
    found = by_routes(measurement, simulation, question, causes, progress, late, follows, undamped)
    if follows and found.verdict == "unknown" and not late():
        return diagnose_joint(data, simulation, causes, late, progress) or found
    return found


def by_routes(
    measurement: Measurement | FRF, simulation: Structure | ModalModel | ExtendedSimulation, question: str,
    causes: Sequence[Cause] | None, progress: Callable[[str], None], late: Deadline, follows: bool,
    undamped: bool = False,
) -> Diagnosis:  # fmt: skip
    """Diagnose line by line, in the modal domain or both; a free joint that ``follows`` is left some of the time."""
    data = as_measurement(measurement)
    task = replace(task_of(data, simulation, question, causes), undamped=undamped)
    claimed = claim_compared(task)
    measured, shown = by_modes_or_elements(data, simulation, late, progress) if claimed else (None, ClaimCompared())
    task = replace(task, elements_show=shown.elements_show)
    lines = partial(line_by_line, measurement, simulation, question, causes, progress)
    modal = cache(partial(in_modal_domain, data, simulation, causes, late, progress, measured))
    said = beside_claim(lines, modal, shown, task, late) if claimed else None
    if said is not None:
        return said
    found = (
        at_one_place(measurement, simulation, question, task, progress, late, modal) if one_place_first(task) else None
    )
    said = None if found is None else sufficient(found, modal, late)
    if said is not None:
        return said
    answers: dict[Route, Diagnosis] = {}
    outcomes: dict[Route, Outcome] = {}
    for route in order(task):
        asked = bool(modal.cache_info().currsize)  # what modes say is known then, and takes no more time
        if answers and late() and not (route == "modes" and asked):
            break
        more = route == "lines" and not answers and ("modes" in order(task) and not asked or follows)
        until = late.part(FIRST_SHARE) if more else late
        try:
            found = modal() if route == "modes" else lines(until, named_before(answers.get("modes")))
        except KeyboardInterrupt:  # what has been found is told
            if not answers:
                raise
            break
        if found is not None:
            answers[route], outcomes[route] = found, outcome_beside_few(found, task, late)
            if suffices(route, outcomes[route], task):
                break
    return answers[choice(outcomes)]


def beside_claim(
    lines: Callable[..., Diagnosis | None], modal: Callable[[], ModalDiagnosis | None], shown: ClaimCompared,
    task: Task, late: Deadline,
) -> Diagnosis | None:  # fmt: skip
    """The answer where modes are claimed to be off and causes are beyond doubt, which modes tell in seconds.

    By lines where they explain these beside modes that are off as claimed; by modes where elements are surely off, and
    modes as claimed do not explain what was measured, or where a force or a sensor surely is askew, which no cause is.
    """
    named = named_beside_claim(shown)
    found = lines(late, named, only_named=True) if named else None
    if found is not None and suffices("lines", outcome_of(found), task):
        return found
    modes = None if late() else modal()
    surely = modes is not None and (modes.askew or not shown.explained and elements_surely(outcome_of(modes)))
    return modes if surely else None


def sufficient(found: Diagnosis, modal: Callable[[], ModalDiagnosis | None], late: Deadline) -> Diagnosis | None:
    """The answer where a force at one place is what is missing; None where the whole of the data is to be asked."""
    if isinstance(found, ModalDiagnosis):
        return found
    if found.verdict == "ambiguous" and found.found.leftover.inexact and not late():
        modes = modal()
        said = None if modes is None else outcome_of(modes)
        return modes if said is not None and (law_is_exact(said) or surely_foretold(said)) else found
    return found if found.found.by_force or settled(outcome_of(found)) or late() else None


def by_modes_or_elements(
    measurement: Measurement, simulation: object, late: Deadline, progress: Callable[[str], None]
) -> tuple[Measured | None, ClaimCompared]:
    """The measurement's own modes, and what they say where modes are claimed to be off."""
    if not isinstance(simulation, Structure):
        return None, ClaimCompared()
    try:
        measured = identified(measurement, simulation, progress)
        progress("comparing modes that are off by themselves with elements that are off")
        return measured, compared(measurement, simulation, measured, late)
    except (np.linalg.LinAlgError, ValueError) as error:  # line by line says what is wrong with the data
        progress(f"modes could not be compared: {error}")
        return None, ClaimCompared()


def in_modal_domain(
    measurement: Measurement, simulation: Structure | ModalModel | ExtendedSimulation, causes: Sequence[Cause] | None,
    late: Deadline, progress: Callable[[str], None], measured: Measured | None = None,
) -> ModalDiagnosis | None:  # fmt: skip
    """Diagnose by the modes of the measurement; None where there is no mode to compare."""
    asked = None if causes is None else {c.slug for c in causes}
    modes = modes_only(simulation) if isinstance(simulation, ModalModel) else simulation
    if not isinstance(modes, Structure | ModesOnly):
        return None
    wanted = (lambda _: True) if asked is None else asked.__contains__
    try:
        return diagnose_modes(measurement, modes, late=late, wanted=wanted, tell=progress, measured=measured)
    except (np.linalg.LinAlgError, ValueError) as error:  # line by line says what is wrong with the data
        progress(f"modes could not be compared: {error}")
        return None


def line_by_line(
    measurement: Measurement | FRF, simulation: Structure | ModalModel | ExtendedSimulation, question: str,
    causes: Sequence[Cause] | None, progress: Callable[[str], None], late: Deadline = NEVER,
    named: Sequence[NamedCause] = (), only_named: bool = False,
) -> Diagnosis | None:  # fmt: skip
    """Diagnose about the simulation as it is, from what the modal domain has named."""
    progress("preparing measurement and simulation")
    comparison = replace(with_noise_beside(make_comparison(measurement, simulation, question)), late=late)
    return searched(comparison, causes, progress, named, only_named)


def at_one_place(
    measurement: Measurement | FRF, simulation: Structure | ModalModel | ExtendedSimulation, question: str,
    task: Task, progress: Callable[[str], None], late: Deadline, modal: Callable[[], ModalDiagnosis | None],
) -> Diagnosis | None:  # fmt: skip
    """Diagnose line by line by elements and joints alone, where a force at one place is all that is missing.

    Where none of them is that force, as none is a beam that is softer as a whole, the modal domain is asked, which
    takes seconds; elements that are all off may look like one force too. If modes leave something to explain, the force
    may stand for several things, and all places are open again: None. Where places are too many to fit each, the whole
    catalogue is searched at these.
    """
    data = as_measurement(measurement)
    progress("looking for a place at which one force explains the data")
    comparison = make_comparison(measurement, simulation, question)
    places = places_of_one_force(comparison, late.part(FIRST_SHARE))
    if not places:
        return None
    comparison = replace(comparison, late=late, only=places)
    found = None
    if len(places) <= FITTED_EACH:
        progress("fitting elements and joints to the force that is measured there")
        elements = causes_of(None, comparison, [*catalogue(comparison.problem.data.shape[0]), *imitators()])
        alone = look(comparison, ())
        near = explain_force(alone, [c for c in elements if isinstance(c, LocalCause)])
        if near is not None:
            nearly = near.leftover.inexact
        else:
            nearly = not (may_tell_joints(data) or differs_by_run(measured_forces(comparison, places)[0]))
        modes = modal() if nearly and not late() else None
        if modes is not None and not has_levels(data) and all_in_general(modes, task, late):
            return modes
        # a spring, mass or damper that damping goes with, for one; at several levels a law may explain as much
        foretold = modes is not None and of_elements(modes) and surely_foretold(outcome_of(modes))
        if foretold and not may_tell_joints(data):  # laws that depend on the level are none where levels agree
            elements = [c for c in elements if not c.told_by_levels]
        found = explain_force(alone, elements) if not foretold or has_levels(data) else None
        if foretold and not (found is not None and law_leaves_noise(found)):
            return modes
    said = None if found is None else told(found, progress)
    if said is not None and said.verdict in ("named", "ambiguous"):
        return said
    modes = None if late() else modal()
    said = None if modes is None else outcome_of(modes)
    named = said is not None and said.verdict == "named" and nothing_left(said) and suffices("modes", said, task)
    if named or modes is not None and all_in_general(modes, task, late):
        return modes
    few = len(places) <= FITTED_EACH and found is None and not late()
    return None if few else searched(comparison, None, progress)


def searched(
    comparison: Comparison, causes: Sequence[Cause] | None, progress: Callable[[str], None],
    named: Sequence[NamedCause] = (), only_named: bool = False,
) -> Diagnosis | None:  # fmt: skip
    """Screen, fit, check, predict and decide, line by line; ``named`` is where the search begins.

    None where it is to end there as well (``only_named``) and something is left to explain.
    """
    wanted = causes_of(causes, comparison, catalogue(comparison.problem.data.shape[0]))
    progress("screening every cause at every place and fitting the leading ones")
    late = comparison.late
    comparison = replace(comparison, late=late.part(NAMED_SHARE) if causes is None else late)
    found = explain(look(comparison, wanted, finite=not named), wanted, named, only_named)
    if only_named and not found.ranked:
        return None
    if causes is None:
        progress("checking whether an unlisted cause explains the data better")
        found = check_imitations(found, causes_of(None, comparison, imitators()), late)
    return told(found, progress)
