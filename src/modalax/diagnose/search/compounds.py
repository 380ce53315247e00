"""Several causes together: screening the residual of a hypothesis for one cause more."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison, hum_of
from modalax.diagnose.decision.detection import detect
from modalax.diagnose.decision.omnibus import Omnibus, omnibus
from modalax.diagnose.decision.posterior import Ranked, promise
from modalax.diagnose.fitting.hypothesis import Hypothesis, searched
from modalax.diagnose.screening.every_cause import chosen, screen_all
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.search.candidates import best_of_each, cost_of, moderate, start_from, with_hum
from modalax.diagnose.search.pattern_sizes import settle_pattern
from modalax.diagnose.search.singles import PATIENT
from modalax.diagnose.search.tolerance import tolerated
from modalax.diagnose.setup.noise import TRUSTED
from modalax.diagnose.thresholds import THRESHOLDS

LEADING, BEHIND = 2, 40.0  # hypotheses that a further cause is added to, and nats that these may be behind the best
FURTHER = 3  # causes tried on each
SAME = 1.0  # chi-square within which the same causes at the same places are the same hypothesis
LOOKED_AT = 6  # hypotheses behind the leading ones that are screened for a further cause where these take up none


def fit_further(comparison: Comparison, base: Hypothesis, trials: list[Trial]) -> list[Hypothesis]:
    """Add each trial to a hypothesis, and fit everything together.

    Parameters
    ----------
    comparison
        Data and simulation.
    base
        The hypothesis.
    trials
        Causes at places.
    """
    found = fit_together(comparison, [start_from(base, t, t.start) for t in trials if not t.cause.leaves_out_lines])
    found = [h for h in found if moderate(h, comparison)]
    if base.hum is None:
        found += [with_hum(base, t.extra) for t in trials if t.cause.leaves_out_lines]
    return best_of_each(found, comparison)


def fit_together(comparison: Comparison, starts: list[Hypothesis]) -> list[Hypothesis]:
    """Fit hypotheses in full; where hum is among the causes, to the lines that it leaves alone."""
    hum = starts[0].hum if starts else None
    used = comparison if hum is None else comparison.without(hum.lines)
    fine = [settle_pattern(used, h) for h in used.fit(starts, PATIENT)]
    if hum is None:
        return fine
    out = []
    for h in fine:
        whole = comparison.residual(h)
        lines = hum_of(MainsHum(), Place((), (round(hum.frequency), -1, 0)), comparison, whole)
        chi2 = h.chi2 + float((np.abs(whole[:, : len(hum.lines)][:, hum.lines]) ** 2).sum())
        bare = replace(h, chi2=chi2, freedom=h.freedom - hum.freedom, hum=None)
        out.append(with_hum(bare, lines) if lines.lines.any() else bare)
    return out


def exchanged(
    comparison: Comparison, h: Hypothesis, rest: Callable[[Hypothesis], list[Trial]], count: int,
    done: Sequence[Hypothesis] = (),
) -> list[Hypothesis]:  # fmt: skip
    """Replace one of several causes after the other by the most promising others.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The hypothesis with several causes.
    rest
        Gives the promising further causes of a hypothesis.
    count
        How many of these are tried for each.
    done
        Hypotheses for which they have been tried before.
    """
    out: list[Hypothesis] = []
    for j in range(0 if comparison.late() else len(h.causes)):
        base = fit_together(comparison, [without_cause(h, j)])[0]
        known = any(set(k.names) == set(base.names) and abs(k.chi2 - base.chi2) < SAME for k in done)
        out += [base, *([] if known else fit_further(comparison, base, rest(base)[:count]))]
    return out


def without_cause(h: Hypothesis, j: int) -> Hypothesis:
    """The hypothesis without its cause of a number, not fitted again."""
    rest = lambda items: items[:j] + items[j + 1 :]
    causes, extras = rest(h.causes), rest(h.extras)
    return replace(
        h, causes=causes, places=rest(h.places), extras=extras, params=rest(h.params), covariance=None, fidelity=None,
        since=None, freedom=cost_of(causes, extras) + (h.hum.freedom if h.hum else 0.0),
    )  # fmt: skip


def alone(comparison: Comparison, h: Hypothesis) -> list[Hypothesis]:
    """Without one of its causes after the other, fitted; of two causes these are either alone."""
    return fit_together(comparison, [without_cause(h, j) for j in range(len(h.causes))])


def one_more_cause(
    comparison: Comparison, ranked: list[Ranked], rest: Callable[[Hypothesis], "Rest"], done: list[Hypothesis],
    weigh: Callable[[list[Hypothesis]], list[Ranked]],
) -> list[Hypothesis]:  # fmt: skip
    """Add one cause more to the leading hypotheses, and to others behind them that promise to overtake these with it.

    A tuned mass that stands for an added mass and a damper together may leave least of all single causes and yet
    nothing that a further cause takes up: the mass, some way behind, becomes right once the damper is there.

    Parameters
    ----------
    comparison
        Data and simulation.
    ranked
        Sets of causes by falling probability.
    rest
        Gives what a hypothesis leaves.
    done
        To which the hypotheses are added for which further causes have been tried.
    weigh
        Gives hypotheses their evidence.
    """

    def worthy(h: Hypothesis) -> bool:
        worth = _worth(comparison) if rest(ranked[0].best).p_value > THRESHOLDS.left else 0.0
        return bool(rest(h).trials) and rest(h).trials[0].gain > worth + rest(h).tolerated

    def tried(some: list[Hypothesis]) -> list[Hypothesis]:
        found: list[Hypothesis] = []
        for h in [h for h in some if not comparison.late() and worthy(h)]:
            if not comparison.late():
                found += fit_further(comparison, h, rest(h).trials[:FURTHER])
                done.append(h)
        return found

    leading = _different([r.best for r in ranked if r.log_evidence > ranked[0].log_evidence - BEHIND])[:LEADING]
    found = tried(leading)
    explained = rest(leading[0]).p_value > THRESHOLDS.left
    taken_up = any(r.log_evidence > ranked[0].log_evidence for r in weigh(found))
    if comparison.late() or taken_up or (explained and (found or not worthy(leading[0]))):
        return found
    least = leading[0].chi2 - _worth(comparison)
    for h in _promising([r.best for r in ranked], leading, rest, comparison, least):
        more = tried([h])
        found += more
        if any(one.chi2 < least for one in more):
            break
    return found


def _different(ranked: list[Hypothesis]) -> list[Hypothesis]:
    """Without the laws whose limit explains just what a simpler one at the same places does."""
    out: list[Hypothesis] = []
    for h in ranked:
        if not any(set(k.places) == set(h.places) and abs(k.chi2 - h.chi2) < SAME for k in out):
            out.append(h)
    return out


def _promising(
    ranked: list[Hypothesis], leading: list[Hypothesis], rest: Callable[[Hypothesis], "Rest"], comparison: Comparison,
    least: float,
) -> list[Hypothesis]:  # fmt: skip
    """Hypotheses of other causes than the leading ones that promise less than a chi-square with a further cause."""
    others: dict[Any, Hypothesis] = {}
    for h in ranked:
        if h.hum is None and not any(h is one for one in leading):
            others.setdefault(frozenset(slug for slug, _ in h.names), h)
    promised: list[tuple[float, Hypothesis]] = []
    for h in list(others.values())[:LOOKED_AT]:
        if not comparison.late() and rest(h).trials:
            promised.append((h.chi2 - max(t.gain for t in rest(h).trials), h))
    return [h for chi2, h in sorted(promised, key=lambda one: one[0]) if chi2 < least][:FURTHER]


@dataclass(frozen=True)
class Rest:
    """The residual of a hypothesis: further causes, the best first, its chance under noise, and the omnibus test.

    ``tolerated`` is the chi-square that the inexactness of the laws may leave and that the tests do not count.
    """

    trials: list[Trial]
    p_value: float
    omnibus: Omnibus
    tolerated: float = 0.0


def rest_of(comparison: Comparison, h: Hypothesis, null: Hypothesis, causes: Sequence[Cause]) -> Rest:
    """Screen the residual of a hypothesis, with an allowance for the inexactness of its laws.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The hypothesis.
    null
        The simulation alone.
    causes
        What to look for.
    """
    used = comparison if h.hum is None else comparison.without(h.hum.lines)
    allowed = tolerated(h, null.chi2)
    after = omnibus(used.residual(h), used.live(), comparison.noise.freedom, allowed)
    if comparison.late():
        return Rest([], after.p_value, after)
    state = score_state_of(used, h, free_directions(used, h))
    trials = screen_all(state, causes, finite=False).trials
    if h.hum is not None:
        trials = [t for t in trials if not t.cause.leaves_out_lines]
    if comparison.noise.freedom < TRUSTED:  # the noise is no better known than what the omnibus test would say of it
        after = replace(after, p_value=1.0)
    p_value = detect(trials, state.sides, after, comparison.noise.spread, allowed).p_value
    trials = [t for t in chosen(trials) if (t.cause.slug, t.place.where) not in h.names]
    samples = used.problem.samples
    return Rest(sorted(trials, key=lambda t: -promise(t, comparison.scene, samples)), p_value, after, allowed)


class Leavings:
    """What hypotheses leave, each screened once.

    Parameters
    ----------
    comparison
        Data and simulation.
    null
        The simulation alone.
    causes
        What to look for.
    """

    def __init__(self, comparison: Comparison, null: Hypothesis, causes: Sequence[Cause]):
        self._comparison, self._null, self._causes = comparison, null, causes
        self._known: dict[int, tuple[Hypothesis, Rest]] = {}  # the hypothesis is kept, so that its number stays its own

    def know(self, h: Hypothesis, rest: Rest) -> None:
        """Keep what is known already."""
        self._known[id(h)] = h, rest

    def __call__(self, h: Hypothesis) -> Rest:
        """What a hypothesis leaves."""
        if id(h) not in self._known:
            self.know(h, rest_of(self._comparison, h, self._null, self._causes))
        return self._known[id(h)][1]


def _worth(comparison: Comparison) -> float:
    """Chi-square that a further cause must promise."""
    return THRESHOLDS.further_cause + math.log(max(comparison.problem.samples, 30))


def free_directions(comparison: Comparison, h: Hypothesis) -> np.ndarray:
    """Directions of the fitted parameters, long enough to count as free, shape ``(unknown, o, i, run f 2)``."""
    problem = comparison.problem
    if not h.causes or not len(searched(h)):
        return np.zeros((0, *problem.data.shape[2:], 2 * problem.data.shape[0] * problem.data.shape[1]))
    J = comparison.slopes(h)
    norm = np.sqrt((J**2).sum(axis=(1, 2, 3), keepdims=True))
    return J / np.where(norm > 0, norm, 1.0) * 1e4
