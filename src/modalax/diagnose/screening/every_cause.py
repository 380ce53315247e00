"""Every cause screened at every place, and the trials among them that are worth a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause, ElementCause, KernelCause, LinesCause, LocalCause, PatternCause
from modalax.diagnose.comparison import Comparison, hum_of
from modalax.diagnose.screening.local_elements import screen_elements
from modalax.diagnose.screening.patterns import screen_pattern
from modalax.diagnose.screening.products import at_places
from modalax.diagnose.screening.record_lengths import promising_lengths
from modalax.diagnose.screening.score_state import ScoreState, alike
from modalax.diagnose.screening.screen import Trial, screen_cause

A_KIND, LIKELY, ALTOGETHER = 3, 40, 150  # candidates refitted of one kind, of one kind near the best, and in all


@dataclass(frozen=True)
class Screening:
    """What every cause promises at every place.

    Attributes
    ----------
    trials
        All trials.
    unscreened
        Causes for which there was no time.
    """

    trials: list[Trial]
    unscreened: tuple[Cause, ...] = ()


@dataclass(frozen=True)
class _Screen:
    """The residual of a hypothesis, as it is screened for one kind of cause after the other.

    Attributes
    ----------
    finite
        Whether larger sizes of elements are tried too.
    products
        Products at the places of elements, kept for the next cause with the same places.
    likely
        Chi-square that linear elements take away at each of the same places.
    """

    state: ScoreState
    finite: bool
    products: dict[Any, Any] = field(default_factory=dict)
    likely: dict[Any, np.ndarray] = field(default_factory=dict)

    @property
    def comparison(self) -> Comparison:
        """Data and simulation."""
        return self.state.comparison

    def trials(self, cause: Cause) -> list[Trial]:
        """Trials of one cause at all its places."""
        if isinstance(cause, PatternCause):
            return self._pattern(cause)
        if isinstance(cause, LinesCause):
            return self._lines(cause)
        places = cause.places(self.comparison.scene)
        if not places:
            return []
        near = self.state.nearest(cause, places)
        if not near:
            return []
        if isinstance(cause, ElementCause) and self.state.reduced:
            found = self._element(cause, near, alike(places))
        else:
            problem, nuisance, _ = self.comparison.side(cause.per_run)
            residual, theta = self.state.sides[cause.per_run], self.state.hypothesis.theta
            assert theta is not None
            there = self.state.reduced[True].there if self.state.reduced else None
            scene = self.comparison.scene
            found = screen_cause(cause, scene, near, theta, residual, problem, nuisance, there)
            if isinstance(cause, KernelCause) and self.comparison.question == "fixed" and problem.held is None:
                found += self._cut_off(cause, near)
        return [replace(t, trials=round(t.trials * len(places) / len(near))) for t in found]

    def _cut_off(self, cause: KernelCause, places: list[Any]) -> list[Trial]:
        """Where a record is cut off, the best of all lengths that it may have had; the modes stay meanwhile."""
        residual, theta = self.state.sides[cause.per_run], self.state.hypothesis.theta
        problem, nuisance, _ = self.comparison.side(cause.per_run)
        assert theta is not None
        out = []
        for place in (p for p in places if p.index[2] == cause.cut_off):
            lengths, gains, count = promising_lengths(residual, problem, theta * nuisance.spread)
            starts = list(1 / lengths[:, None])
            if starts and gains[0] > 0:
                out.append(Trial(cause, place, float(gains[0]), np.nan, starts[0], starts, ripples=count))
        return out

    def _pattern(self, cause: PatternCause) -> list[Trial]:
        problem = self.comparison.side(cause.per_run)[0]
        if cause.several and min(problem.channels) < 2:  # nothing else than one
            return []
        return [screen_pattern(cause, self.comparison.scene, self.state.sides[cause.per_run], problem)]

    def _lines(self, cause: LinesCause) -> list[Trial]:
        places, found = cause.places(self.comparison.scene), []
        for place in places:
            lines = hum_of(cause, place, self.comparison, self.state.whole)
            if lines.lines.any():
                start = np.array([lines.amplitude])
                found.append(Trial(cause, place, -lines.chi2, np.nan, start, trials=len(places), extra=lines))
        return found

    def _element(self, cause: ElementCause, places: list[Any], key: Any) -> list[Trial]:
        side, reduced = cause.per_run, self.state.reduced
        if (side, key) not in self.products:
            apart = self.products.setdefault((True, key), at_places(reduced[True], places))
            one = self.comparison.pooled is self.comparison.problem
            self.products[False, key] = apart if one else at_places(reduced[False], places, apart=apart)
        weight = np.asarray(self.comparison.side(side)[0].weight)
        at = self.products[side, key]
        found = screen_elements(
            cause,
            self.comparison.scene,
            reduced[side],
            at,
            places,
            weight,
            self.finite,
            self.likely.get(key),
            not self.comparison.nuisance.active,
        )
        if isinstance(cause, LocalCause):
            gains = np.array([t.gain for t in found])
            self.likely[key] = np.maximum(self.likely.get(key, gains), gains)
        return found


def screen_all(state: ScoreState, causes: Sequence[Cause], finite: bool = True) -> Screening:
    """Screen every cause at every place on the residual of a hypothesis.

    Parameters
    ----------
    state
        The hypothesis and its residual, as :func:`~.score_state.score_state_of` gives them.
    causes
        What to look for.
    finite
        Whether larger sizes of elements are tried too.
    """
    screen = _Screen(state, finite)
    trials: list[Trial] = []
    for k, cause in enumerate(causes):
        if trials and state.comparison.late():
            return Screening(trials, tuple(causes[k:]))
        trials += screen.trials(cause)
    return Screening(trials)


def chosen(trials: list[Trial]) -> list[Trial]:
    """Trials worth a fit: the best few of each kind, unless the best of all explains far more."""
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
