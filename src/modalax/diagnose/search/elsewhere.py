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

from modalax.diagnose.causes.base import LocalCause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis, with_item
from modalax.diagnose.screening.local_elements import score
from modalax.diagnose.screening.products import at_places
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import smallest
from modalax.diagnose.search.compounds import free_directions, without_cause
from modalax.diagnose.search.singles import PATIENT

SLIGHT = 1.0  # chi-square by which a fit must come lower than before to be another
TIMES = (0.5, 1.0, 2.0)  # of the strength with the same effect, which are tried
NEAR = 12.0  # chi-square behind the place where it is, within which a place is fitted
MOST = 8  # other places that are fitted for each cause


def elsewhere(comparison: Comparison, h: Hypothesis) -> list[Hypothesis]:
    """The hypothesis with each of its linear elements at the other places that may explain as much, not fitted yet.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The hypothesis, fitted.
    """
    used = comparison if h.hum is None else comparison.without(h.hum.lines)
    return [
        replace(h, places=with_item(h.places, j, place), params=with_item(h.params, j, p), covariance=None, chi2=np.inf)
        for j, cause in enumerate(h.causes)
        if isinstance(cause, LocalCause) and not comparison.late()
        for place, p in _others(used, h, j, cause)
    ]


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
