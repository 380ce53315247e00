"""Causes beside a measured mode that is one too many, before it is known what made it one.

A fault of a channel or an element that is far off shows in many modes, and an attached oscillator most in the one that
it adds. Neither is seen while the other is unknown: pairs of a mode that is left free and another cause are screened
by the finite sizes of the latter.
"""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.channel_faults import ChannelFactor, Swap
from modalax.diagnose.modal_domain.screen import Trials, cost_of_size, couples, distances, tolerance, trials_of
from modalax.diagnose.modal_domain.state import NONE, Setting, evidence_of_free

MODES = 3  # that are free, the nearest with a fault of a channel or none, beside which changes of matrices are tried

# A mode that is free, a cause beside it or none, and its sizes.
Pair = tuple[Change, tuple[Change, ...], np.ndarray]


def causes_beside_a_mode(setting: Setting, candidates: list[Change], most: int) -> list[Pair]:
    """Pairs of a free mode and another cause, or none, that come nearest to the measured modes, by rising distance."""
    free = [c for c in candidates if c.freed is not None]
    if not free:
        return []
    state = tolerance(setting, free[:1])[0]
    each = lambda some: [(c, trials_of(setting, state, c)) for c in some if c.screened and not setting.late()]
    faults = each(c for c in candidates if isinstance(c, ChannelFactor | Swap))
    found = [_beside(setting, mode, faults) for mode in free]
    found.sort(key=lambda pairs: pairs[0][0])
    changes = each(c for c in candidates if c.kind and not couples(c))
    for pairs in found[:MODES]:
        pairs += [pair for pair in _beside(setting, pairs[0][1][0], changes) if pair[1][1]]
    return [pair for _, pair in sorted((pair for pairs in found for pair in pairs), key=lambda one: one[0])[:most]]


def _beside(setting: Setting, free: Change, causes: list[tuple[Change, Trials]]) -> list[tuple[float, Pair]]:
    """Every cause beside one mode that is free, and none, at the size of least distance of those that are tried."""
    state, shrink = tolerance(setting, (free,))
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
