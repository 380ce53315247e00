"""Test whether anything is wrong at all: the simulation alone compared with the data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.comparison import Comparison, empty
from modalax.diagnose.decision.detection import Detection, detect
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.fitting.gauss_newton import ROUNDS
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import Screening, screen_all
from modalax.diagnose.screening.score_state import ScoreState, score_state_of

CENTRED = 3  # times that complex modes are made exact about what was fitted


@dataclass(frozen=True)
class Look:
    """The simulation compared with the data before any cause is added.

    Attributes
    ----------
    state
        The simulation alone, its modal parameters fitted, and its residual.
    omnibus
        Test of that residual that knows no cause.
    screening
        Every cause screened at every place.
    detection
        Chance, under noise alone, of what the tests saw.
    again
        Where dampers couple the modes: the same with complex modes that are exact about the fitted parameters.
    """

    state: ScoreState
    omnibus: Omnibus
    screening: Screening
    detection: Detection
    again: "Look | None" = None

    @property
    def comparison(self) -> Comparison:
        """Data and simulation."""
        return self.state.comparison

    @property
    def null(self) -> Hypothesis:
        """The simulation alone, its modal parameters fitted."""
        return self.state.hypothesis


def look(comparison: Comparison, causes: Sequence[Cause], finite: bool = True) -> Look:
    """Compare the simulation alone with the data, and test whether anything is wrong.

    Parameters
    ----------
    comparison
        Data and simulation.
    causes
        What to look for.
    finite
        Whether finite sizes of joints are tried, or their derivatives alone, which is faster.
    """
    first = _look(comparison, causes, finite)
    coupled = comparison.problem.modal_form.mixing is not None and comparison.nuisance.active
    if not first.detection.anything or not coupled or comparison.late():
        return first
    # complex modes follow undamped ones to first order only: what that leaves is no finding
    about = comparison
    for _ in range(CENTRED):
        about = about.centred(about.fit([empty(comparison)], ROUNDS)[0])
    again = _look(about, causes, finite)
    return replace(first, again=again) if again.detection.anything else again


def _look(comparison: Comparison, causes: Sequence[Cause], finite: bool) -> Look:
    null = comparison.fit([empty(comparison)], ROUNDS)[0]
    before = omnibus(comparison.residual(null), comparison.live(), comparison.noise.freedom)
    state = score_state_of(comparison, null)
    screening = screen_all(state, causes, finite)
    found = detect(screening.trials, state.sides, before, comparison.noise.spread)
    return Look(state, before, screening, found)
