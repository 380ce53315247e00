"""Check whether a cause that has no name in the answer explains the data better than those found."""

from collections.abc import Sequence

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.score_state import ScoreState
from modalax.diagnose.search.singles import fit_single
from modalax.diagnose.thresholds import THRESHOLDS

SHARE = 0.5  # share of what the leading hypothesis explains, below which a trial is not fitted
FITS = 6  # most trials of one kind that are fitted


def imitations(state: ScoreState, best: Hypothesis, imitators: Sequence[Cause]) -> list[Hypothesis]:
    """Fit each imitator alone at its best places.

    Parameters
    ----------
    state
        The simulation alone, and its residual.
    best
        The leading hypothesis, beside which an imitator must stand.
    imitators
        Causes without a name in the answer.
    """
    least = SHARE * (state.hypothesis.chi2 - best.chi2)
    kept, count = [], dict.fromkeys(imitators, 0)
    for t in sorted(screen_all(state, imitators).trials, key=lambda t: -t.gain):
        if t.gain > least and count[t.cause] < FITS:
            count[t.cause] += 1
            kept.append(t)
    return fit_single(state, kept)


def apart(ranked: Sequence[Ranked]) -> tuple[list[Ranked], list[Ranked]]:
    """Sets whose causes all have a name in the answer, and the other sets."""
    nameless = [r for r in ranked if not all(c.named for c in r.best.causes)]
    return [r for r in ranked if r not in nameless], nameless


def likeness(nameless: Sequence[Ranked]) -> tuple[str, ...]:
    """A sentence on what the data looks like, if that is likely enough."""
    if not nameless or sum(r.probability for r in nameless) < THRESHOLDS.likeness:
        return ()
    cause, place = nameless[0].best.causes[0], nameless[0].best.places[0]
    where = f" at {' and '.join(str(w) for w in place.where)}" if place.where else ""
    return (
        f"beside the catalogue, {cause.summary}{where} would explain the data "
        f"({cause.slug}, probability {sum(r.probability for r in nameless):.2f})",
    )
