r"""Causes beside a measured mode that is one too many, before it is known what made it one.

A fault of a channel or an element that is far off shows in many modes, and an attached oscillator most in the one that
it adds. Neither is seen while the other is unknown: pairs of a mode k that is left free and another cause are screened
by finite sizes u of the latter, over its usual one, for the least

.. math:: r_k^T\Sigma_k^{-1}r_k + u^2 - 2\log p_k,

with the differences :math:`r_k` of all features but those of the mode, their covariance :math:`\Sigma_k` by noise and
the general inaccuracy, and the density :math:`p_k` of any mode of the band. One cause by itself is screened likewise
(:func:`modalax.diagnose.modal_domain.search.screen.finite`).
"""

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import ChannelFactor, Swap
from modalax.diagnose.modal_domain.fitting.state import NONE, Setting, State, evidence_of_free
from modalax.diagnose.modal_domain.search.screen import Trials, cost_of_size, couples, distances, tolerance, trials_of

MODES = 3  # that are free, the nearest with a fault of a channel or none, beside which changes of matrices are tried

# A mode that is free, a cause beside it or none, and its sizes.
Pair = tuple[Change, tuple[Change, ...], np.ndarray]


def causes_beside_a_mode(setting: Setting, candidates: list[Change], most: int) -> list[Pair]:
    """Pairs of a free mode and another cause, or none, that come nearest to the measured modes, by rising distance.

    Empty where the simulation lacks more than one of the measured modes.

    Parameters
    ----------
    candidates
        Modes that may be free, and causes: of channels gains, signs, units, delays and exchanges; of matrices one each.
    most
        Pairs at most.
    """
    free = [c for c in candidates if c.freed is not None]
    try:
        nominal = [(mode, *tolerance(setting, (mode,))) for mode in free]
    except np.linalg.LinAlgError:
        return []
    if not nominal:
        return []
    state = nominal[0][1]
    each = lambda some: [(c, trials_of(setting, state, c)) for c in some if c.screened and not setting.late()]
    faults = each(c for c in candidates if isinstance(c, ChannelFactor | Swap))
    found = [(_beside(setting, *mode, faults), mode) for mode in nominal]
    found = sorted((one for one in found if one[0]), key=lambda one: one[0][0][0])
    changes = each(c for c in candidates if c.kind and not couples(c))
    for pairs, mode in found[:MODES]:
        pairs += [pair for pair in _beside(setting, *mode, changes) if pair[1][1]]
    every = sorted((pair for pairs, _ in found for pair in pairs), key=lambda one: one[0])
    return [pair for _, pair in every[:most]]


def _beside(
    setting: Setting, free: Change, state: State, shrink: np.ndarray, causes: list[tuple[Change, Trials]]
) -> list[tuple[float, Pair]]:
    """Every cause beside one mode that is free, and none, at the size of least distance of those that are tried."""
    trials = [((), 0.0, state.modes.poles, state.plain)]
    trials += [((cause,), *trial) for cause, some in causes for trial in some]
    left = distances(setting, shrink, [modes for _, _, *modes in trials], (free,))
    left -= 2 * evidence_of_free(setting, (free,))
    nearest: dict[tuple[Change, ...], tuple[float, Pair]] = {}
    for value, (cause, u, *_) in zip(left, trials, strict=True):
        whole = float(value + cost_of_size(u))
        if np.isfinite(whole) and (cause not in nearest or whole < nearest[cause][0]):
            nearest[cause] = whole, (free, cause, cause[0].of_size(u) if cause else NONE)
    return sorted(nearest.values(), key=lambda one: one[0])
