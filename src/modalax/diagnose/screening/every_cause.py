"""Every cause screened at every place, and the trials among them that are worth a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, is_element
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.missing_modes import PatternCause
from modalax.diagnose.comparison import Comparison, hum_of
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.local_elements import at_places, screen_elements
from modalax.diagnose.screening.patterns import screen_pattern
from modalax.diagnose.screening.score_state import ScoreState, alike
from modalax.diagnose.screening.screen import Trial, screen_cause

A_KIND, LIKELY, ALTOGETHER = 3, 40, 150  # candidates refitted of one kind, of one kind near the best, and in all


@dataclass(frozen=True)
class Screening:
    """All trials, and the trial directions of each side (all runs together, or apart)."""

    trials: list[Trial]
    theta: np.ndarray

    @property
    def ranked(self) -> list[Trial]:
        """By falling gain."""
        return sorted(self.trials, key=lambda t: -t.gain)


def screen_all(
    comparison: Comparison, h: Hypothesis, causes: Sequence[Cause], state: ScoreState, finite: bool = True
) -> Screening:
    """Screen every cause at every place on what a hypothesis leaves; ``finite`` tries larger sizes of joints too."""
    assert h.theta is not None
    trials: list[Trial] = []
    products: dict[Any, Any] = {}
    for cause in causes:
        side = cause.per_run
        problem, nuisance, _ = comparison.side(side)
        if isinstance(cause, PatternCause):
            if cause.several and min(problem.channels) < 2:  # nothing else than one
                continue
            trials.append(screen_pattern(cause, comparison.scene, state.sides[side], problem))
        elif isinstance(cause, MainsHum):
            mains = cause.places(comparison.scene)
            for place in mains:
                lines, size = hum_of(cause, place, comparison, state.whole), len(mains)
                if lines.lines.any():
                    start = np.array([lines.amplitude])
                    trials.append(Trial(cause, place, -lines.chi2, np.nan, start, trials=size, extra=lines))
        elif not (places := cause.places(comparison.scene)):
            continue
        elif is_element(cause) and state.reduced:
            near, key = state.nearest(comparison, cause, places), alike(places)
            if (side, key) not in products:
                apart = products.setdefault((True, key), at_places(state.reduced[True], near))
                one = comparison.pooled is comparison.problem
                products[False, key] = apart if one else at_places(state.reduced[False], near, apart=apart)
            at = products[side, key]
            weight = np.asarray(problem.weight)
            found = screen_elements(cause, comparison.scene, state.reduced[side], at, near, weight, finite)
            trials += [replace(t, trials=round(t.trials * len(places) / len(near))) for t in found]
        else:
            near = state.nearest(comparison, cause, places)
            found = screen_cause(cause, comparison.scene, near, h.theta, state.sides[side], problem, nuisance, True)
            trials += [replace(t, trials=round(t.trials * len(places) / len(near))) for t in found]
    return Screening(trials, h.theta)


def chosen(trials: list[Trial]) -> list[Trial]:
    """Trials worth a fit: the best few of each kind, if they are not hopeless beside the best of all."""
    ranked = sorted((t for t in trials if t.gain > 0), key=lambda t: -t.gain)
    if not ranked:
        return []
    best, count, out = ranked[0].gain, {}, []
    for t in ranked:
        seen = count.get(t.cause, 0)
        if seen < (LIKELY if t.gain > 0.6 * best else A_KIND) and (
            t.gain > 0.15 * best or (seen == 0 and t.gain > 0.02 * best)
        ):
            out.append(t)
            count[t.cause] = seen + 1
    return out[:ALTOGETHER]
