r"""Causes beside measured modes that are too many, before it is known what made them so.

A fault of a channel or an element that is far off shows in many modes, and an attached oscillator most in the one that
it adds. Neither is seen while the other is unknown: some modes that are left free and another cause are screened by
finite sizes u of the latter, over its usual one, for the least

.. math:: r_S^T\Sigma_S^{-1}r_S + u^2 - 2\sum_{k\in S}\log p_k,

with the differences :math:`r_S` of all features but those of the modes S, their covariance :math:`\Sigma_S` by noise
and the general inaccuracy, and the density :math:`p_k` of any mode of the band. Where the simulation has several modes
fewer than were measured, further ones are left free beside the best. One cause by itself is screened likewise
(:func:`modalax.diagnose.modal_domain.search.screen.finite`).
"""

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import ChannelFactor, Swap
from modalax.diagnose.modal_domain.fitting.state import NONE, Setting, State, evidence_of_free
from modalax.diagnose.modal_domain.search.screen import Trials, cost_of_size, couples, distances, tolerance, trials_of

MODES = 3  # sets of free modes, the nearest with a channel's fault or none, beside which changes of matrices are tried
LACKING = 3  # measured modes at most that are left free together
BEYOND = 0.05  # relative distance from the measured modes within which modes of the simulation may be among them
NEAR = 4.0  # chi-square per feature of the nearest up to which no further mode is left free

Free = tuple[Change, ...]
# Modes that are free, a cause beside them or none, and its sizes.
Pair = tuple[Free, tuple[Change, ...], np.ndarray]


def shortage(setting: Setting) -> int:
    """How many modes fewer than were measured the simulation has about the measured ones; at least 0."""
    w, size = setting.coordinates.frequencies[:-1], np.abs(setting.features.poles)
    near = (w > size.min() * (1 - BEYOND)) & (w < size.max() * (1 + BEYOND))
    return max(len(size) - int(np.count_nonzero(near)), 0)


def causes_beside_modes(setting: Setting, candidates: list[Change], most: int) -> list[Pair]:
    """Modes that are free with another cause, or none, that come nearest to the measured ones, by rising distance.

    Parameters
    ----------
    candidates
        Modes that may be free, and causes: of channels gains, signs, units, delays and exchanges; of matrices one each.
    most
        Pairs at most; the same modes without another cause are added where they are not among them.

    Returns
    -------
    list
        Modes, the cause beside them or none, and its sizes over the usual ones, shape ``(count,)``.
    """
    free = [c for c in candidates if c.freed is not None]
    try:
        state = tolerance(setting, tuple(free[:LACKING]))[0]
    except np.linalg.LinAlgError:  # the simulation has far fewer modes than were measured
        return []
    each = lambda some: [(c, trials_of(setting, state, c)) for c in some if c.screened and not setting.late()]
    faults = each(c for c in candidates if isinstance(c, ChannelFactor | Swap))
    changes = each(c for c in candidates if c.kind and not couples(c))
    every: list[tuple[float, Pair]] = []
    leading: list[Free] = [()]
    in_time = lambda modes: _beside(setting, modes, state, faults) if not (every and setting.late()) else []
    for _ in range(min(max(shortage(setting), 1), LACKING)):
        sets = _with_one_more(leading, free)
        found = [pairs for pairs in map(in_time, sets) if pairs]
        nearest = sorted(found, key=lambda pairs: pairs[0][0])[:MODES]
        leading = [pairs[0][1][0] for pairs in nearest] or sets  # with too few modes for any of them more are left free
        every.extend(pair for pairs in found for pair in pairs)
        every.extend(p for modes in leading for p in _beside(setting, modes, state, changes) if p[1][1])
        every.sort(key=lambda one: one[0])
        if every and every[0][0] < NEAR * setting.features.values.size or setting.late():
            break
    chosen, others = ([pair for _, pair in some] for some in (every[:most], every[most:]))
    told = {modes for modes, _, _ in chosen}
    return chosen + [(modes, other, u) for modes, other, u in others if modes in told and not other]


def with_free(u: np.ndarray, free: Free) -> np.ndarray:
    """Sizes of causes and of modes that are free beside them."""
    return np.append(u, np.zeros(sum(c.count for c in free)))


def _with_one_more(leading: list[Free], free: list[Change]) -> list[Free]:
    """Each set of modes with each further one, once."""
    sets = (tuple(sorted((*some, c), key=lambda c: c.freed or 0)) for some in leading for c in free if c not in some)
    return list(dict.fromkeys(sets))


def _beside(
    setting: Setting, free: Free, state: State, causes: list[tuple[Change, Trials]]
) -> list[tuple[float, Pair]]:
    """Every cause beside modes that are free, and none, at the size of least distance of those that are tried.

    Nothing where the simulation has fewer modes than are left.
    """
    try:
        shrink = tolerance(setting, free)[1]
    except np.linalg.LinAlgError:
        return []
    trials = [((), 0.0, state.modes.poles, state.plain)]
    trials += [((cause,), *trial) for cause, some in causes for trial in some]
    left = distances(setting, shrink, [modes for _, _, *modes in trials], free)
    left -= 2 * evidence_of_free(setting, free)
    nearest: dict[tuple[Change, ...], tuple[float, Pair]] = {}
    for value, (cause, u, *_) in zip(left, trials, strict=True):
        whole = float(value + cost_of_size(u))
        if np.isfinite(whole) and (cause not in nearest or whole < nearest[cause][0]):
            nearest[cause] = whole, (free, cause, cause[0].of_size(u) if cause else NONE)
    return sorted(nearest.values(), key=lambda one: one[0])
