"""Faults of channels beside a measured mode that is one too many, before it is known what made it one.

A fault of a channel shows in every mode and an attached oscillator most in the one that it adds. Neither is seen while
the other is unknown: all pairs of a mode that is left free and a fault of a channel are screened by their finite sizes.
"""

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.channel_faults import ChannelFactor, Swap
from modalax.diagnose.modal_domain.screen import channel_trials, cost_of_size, distances, tolerance
from modalax.diagnose.modal_domain.state import Setting, evidence_of_free

# A mode that is free, a fault of a channel or none, and its size.
Pair = tuple[Change, tuple[Change, ...], np.ndarray]


def faults_beside_a_mode(setting: Setting, candidates: list[Change], most: int) -> list[Pair]:
    """Pairs of a free mode and a fault of a channel, or none, that come nearest to the measured modes."""
    faults = [c for c in candidates if isinstance(c, ChannelFactor | Swap) and c.screened]
    found = [pair for mode in candidates if mode.freed is not None for pair in _beside(setting, mode, faults)]
    return [pair for _, pair in sorted(found, key=lambda one: one[0])[:most]]


def _beside(setting: Setting, free: Change, faults: list[Change]) -> list[tuple[float, Pair]]:
    """Every fault beside one mode that is free, and none, with the least distance of the sizes that are tried."""
    state, shrink = tolerance(setting, (free,))
    nominal = state.modes.poles, state.plain
    trials = [((), np.zeros(0), *nominal)]
    for fault in faults:
        some = channel_trials(setting, fault, *nominal)
        trials += [((fault,), np.full(fault.count, u), *modes) for u, *modes in some]
    left = distances(setting, shrink, [modes for _, _, *modes in trials], (free,))
    left -= 2 * evidence_of_free(setting, (free,))
    nearest: dict[tuple[Change, ...], tuple[float, Pair]] = {}
    for value, (fault, u, *_) in zip(left, trials, strict=True):
        whole = float(value + cost_of_size(u).sum())
        if np.isfinite(whole) and (fault not in nearest or whole < nearest[fault][0]):
            nearest[fault] = whole, (free, fault, u)
    return list(nearest.values())
