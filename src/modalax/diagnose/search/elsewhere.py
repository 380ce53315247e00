r"""A cause of the leading set at other places, begun from what was fitted where it is.

An oscillator that was fitted at one place tells its frequency and damping for every other: from a grid of frequencies
the search may end in another minimum there, and the place is missing among those that explain as much. With the same
effect, the strength at another place follows from the lengths of the two changes of the whitened FRFs. Which places are
worth a fit is told by what a change e there takes from chi-square, :math:`2\langle e, r\rangle - |e|^2`, where r is
left without the cause.

Beside a joint modes that are off as claimed follow, and a fit at another place may end in another minimum of these, far
above the one that it reaches from the modes beside the leading set.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.causes.base import Cause, JointCause, LocalCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis, with_item
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.local_elements import score
from modalax.diagnose.screening.products import at_places
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import Trial, smallest
from modalax.diagnose.search.candidates import cost_of
from modalax.diagnose.search.compounds import free_directions, without_cause
from modalax.diagnose.search.singles import PATIENT

SLIGHT = 1.0  # chi-square by which a fit must come lower than before to be another
TIMES = (0.5, 1.0, 2.0)  # of the strength with the same effect, which are tried
NEAR = 12.0  # chi-square behind the place where it is, within which a place is fitted
SHORT = 0.15  # share of the whole effect by which the screening of a joint, at a few strengths, may fall short
MOST, ALIKE = 8, 40  # other places that are fitted for each linear element, and for a joint beside other causes


def elsewhere(comparison: Comparison, h: Hypothesis, causes: Sequence[Cause] = ()) -> list[Hypothesis]:
    """The hypothesis with each of its elements at the other places that may explain as much, not fitted yet.

    A joint that is not alone was found beside one other cause after the other, at few places and by few laws each time:
    other laws may explain as much, too.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The hypothesis, fitted.
    causes
        What is looked for; laws of a joint are taken from it.
    """
    used = comparison if h.hum is None else comparison.without(h.hum.lines)
    out: list[Hypothesis] = []
    for j, cause in enumerate(h.causes):
        if comparison.late():
            break
        if isinstance(cause, LocalCause):
            out += [_at(h, j, place, p) for place, p in _others(used, h, j, cause)]
        elif isinstance(cause, JointCause) and len(h.causes) > 1:
            out += [_with_joint(h, j, trial) for trial in _joints(used, h, j, causes)]
    return out


def _at(h: Hypothesis, j: int, place: Place, p: np.ndarray) -> Hypothesis:
    """The hypothesis with one of its causes at another place, not fitted yet."""
    return replace(
        h, places=with_item(h.places, j, place), params=with_item(h.params, j, p), covariance=None, chi2=np.inf
    )


def _with_joint(h: Hypothesis, j: int, trial: Trial) -> Hypothesis:
    """The hypothesis with another joint for one of its own, by one harmonic, not fitted yet."""
    causes, extras = with_item(h.causes, j, trial.cause), with_item(h.extras, j, None)
    freedom = cost_of(causes, extras) + (h.hum.freedom if h.hum else 0.0)
    h = replace(h, causes=causes, extras=extras, freedom=freedom, fidelity=None, since=None)
    return _at(h, j, trial.place, trial.start)


def restarted(comparison: Comparison, best: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fits of the leading causes at other places, and of other causes at its places, from the modes beside it.

    Parameters
    ----------
    comparison
        Data and simulation.
    best
        The leading hypothesis, fitted.
    others
        Other hypotheses, fitted; those that come no lower from there are left out.
    """
    alike = [h for h in others if h.hum is None and (h.causes == best.causes or h.places == best.places)]
    if not (comparison.nuisance.active and alike):
        return []
    again = comparison.fit([replace(h, theta=best.theta) for h in alike], PATIENT)
    return [now for h, now in zip(alike, again, strict=True) if now.chi2 < h.chi2 - SLIGHT]


def _others(comparison: Comparison, h: Hypothesis, j: int, cause: LocalCause) -> list[tuple[Place, np.ndarray]]:
    """Places and parameters to begin from, those that promise most first."""
    base = without_cause(h, j)
    state = score_state_of(comparison, base, free_directions(comparison, base))
    if not state.reduced:
        return []
    here, reduced = h.places[j], state.reduced[True]
    places = [here, *(p for p in state.nearest(cause, cause.places(comparison.scene)) if p.index != here.index)]
    at = at_places(reduced, places)
    grids = [cause.grid(comparison.scene, place) for place in places]
    small = [np.array([[g[smallest(g)][0, 0], *h.params[j][1:]]]) for g in grids]
    length = np.sqrt(np.maximum(np.concatenate(score(cause, reduced, at, small, False)[0]), 0.0))
    if not length[0] > 0:  # the other causes do all that this one does
        return []
    unit = np.array([s[0, 0] for s in small]) / np.where(length > 0, length, np.inf)
    strength = h.params[j][0] * unit / unit[0]
    sizes = [np.array([[t * size, *h.params[j][1:]] for t in TIMES]) for size in strength]
    square, product, _ = score(cause, reduced, at, sizes, True)
    gains = 2 * np.stack(product) - np.stack(square)
    best = gains.max(axis=1)
    order = [k for k in np.argsort(-best[1:])[:MOST] + 1 if length[k] > 0 and best[k] > best[0] - NEAR]
    return [(places[k], sizes[k][gains[k].argmax()]) for k in order]


def _joints(comparison: Comparison, h: Hypothesis, j: int, causes: Sequence[Cause]) -> list[Trial]:
    """Trials of a joint that screening beside the other causes shows to be about as good as it is, the best first.

    They are the same law elsewhere, and each other law at its best place and at that of the joint.
    """
    own, here, base = h.causes[j], h.places[j].index, without_cause(h, j)
    laws = [own, *(c for c in causes if isinstance(c, JointCause) and c != own)]
    state = score_state_of(comparison, base, free_directions(comparison, base))
    trials = sorted(screen_all(state, laws).trials, key=lambda t: -t.gain)
    promised = max((t.gain for t in trials if t.cause == own and t.place.index == here), default=np.inf)
    near = [t for t in trials if t.gain > (1 - SHORT) * promised - NEAR]
    others = [t for t in near if t.cause == own and t.place.index != here][:ALIKE]
    best = {t.cause: t for t in reversed(near) if t.cause != own}
    at_home = {t.cause: t for t in reversed(near) if t.cause != own and t.place.index == here}
    return [*others, *{id(t): t for t in (*best.values(), *at_home.values())}.values()]
