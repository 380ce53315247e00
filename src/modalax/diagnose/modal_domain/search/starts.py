"""Which causes are fitted, and from where: the leading ones of four screenings.

Finite changes of the simulation itself tell causes that move modes far; of many places those by which the measured
frequencies come about at one size are tried so, for a linear score means nothing there. Linear scores where the
inaccuracy alone explains the data tell those that it takes up; the same with the inaccuracy held to its usual size
those that hide in it, and with that of one matrix, or all, held to less than was learnt those that are all that is
wrong there. Where the inaccuracy alone explains the data and none of these promises anything, nothing else is tried.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.causes.channel_faults import Swap
from modalax.diagnose.modal_domain.fitting.attempts import explains
from modalax.diagnose.modal_domain.fitting.fit import Fit, without_causes
from modalax.diagnose.modal_domain.fitting.state import Setting, state_at
from modalax.diagnose.modal_domain.search.matched import (
    FOLLOWED,
    missed_by_elements,
    missed_dampings,
    missed_frequencies,
)
from modalax.diagnose.modal_domain.search.screen import (
    SIZES,
    STRONG,
    About,
    about,
    couples,
    finite,
    narrower,
    refined,
    scores,
    unchanged,
)
from modalax.diagnose.modal_domain.structure.coordinates import modes_of

MATCHED, PRESCREENED = 60, 40  # places by frequencies, and by each of two linear scores, that are tried at finite sizes
MISSED = 0.1  # squared miss of a frequency, over what counts as close, from which on no place has it
SWAPS = 200  # exchanges of two outputs that are tried so
FORCES = 8  # places of forces of each kind, of each of these scores, that are tried so
FITTED, NEXT = 6, 4  # leading places of each screening that are fitted, and of the screening about the winner
PROMISING = math.log(0.05)  # odds, by linear scores where the inaccuracy explains the data, that are worth a search
FARTHER = 2.0  # times as far from the data as the simulation as it is, beyond which no kind of cause is fitted

EITHER = np.array([-s for s in SIZES] + [*SIZES, *STRONG])

# A cause, its size over the usual one, and a fit to start from; the simulation itself if None.
Start = tuple[Change, float, Fit | None]


def starts(
    setting: Setting, null: Fit, candidates: list[Change], share: np.ndarray, far: float = 0.0
) -> Iterator[Start]:
    """Causes worth a fit, with sizes and inaccuracies to start from; first the leading ones by finite changes.

    Parameters
    ----------
    null
        The general inaccuracy alone.
    share
        Logarithmic prior probability of each candidate.
    far
        Share of what the simulation leaves as it is, below which another change of the structure makes it needless to
        try forces as well.
    """
    at = about(setting, null, candidates)
    gain, size = scores(setting, null, at)
    start = without_causes(null)
    linear = [k for k in np.argsort(-(gain + share)) if np.isfinite(gain[k]) and gain[k] > 0][:NEXT]
    taken = narrower(setting, null, at)
    if explains(null) and not (np.maximum(gain, taken[0]) + share > PROMISING).any():
        yield from ((candidates[k], 0.0, start) for k in linear)
        return
    as_it_is = _nominal(setting, null)
    nominal, _ = scores(setting, as_it_is, about(setting, as_it_is, candidates))
    few = set(np.argsort(-(gain + share))[:PRESCREENED]) | set(np.argsort(-(nominal + share))[:PRESCREENED])
    f = setting.features
    missed, told = missed_frequencies(f, modes_of(setting.coordinates), candidates, EITHER)
    if min(missed, default=0.0) > MISSED * len(f.poles):  # no change of rank one has the frequencies
        whole = [k for k, c in enumerate(candidates) if c.kind in ("K", "M") and c.pattern is not None]
        missed[whole], told[whole] = missed_by_elements(f, setting.coordinates, [candidates[k] for k in whole])
    matched = missed - 2 * share
    few |= {k for k in np.argsort(matched)[:MATCHED] if np.isfinite(matched[k])}
    few |= {k for k, c in enumerate(candidates) if not c.local} - _unlikely_swaps(setting, candidates)
    forces = {k for k, c in enumerate(candidates) if couples(c)}
    some = [k for k in few - forces if candidates[k].count == 1]
    distance, where = finite(setting, [candidates[k] for k in some], told[some])
    local = np.array([candidates[k].local for k in some], bool)
    if not distance[local].min(initial=np.inf) < far * unchanged(setting):
        coupling = _leading_forces(candidates, matched, gain, nominal, -_dampings(setting, candidates))
        more = finite(setting, [candidates[k] for k in coupling])
        some += coupling
        distance, where = np.append(distance, more[0]), np.append(where, more[1])
    least = dict(zip(some, distance, strict=True))
    value = dict(zip(some, -0.5 * distance + share[some], strict=True))
    order = sorted(some, key=lambda k: -value[k])
    chosen = order[:FITTED]
    far = FARTHER * unchanged(setting)
    leading = {candidates[k].slug: k for k in reversed(order)}
    chosen += [leading[slug] for slug in sorted(leading) if least[leading[slug]] < far]
    u = dict(zip(some, where, strict=True))
    # of changes beyond all that are usual the simulation as it is says little; the frequencies that they give say more
    by_frequency = [int(k) for k in np.argsort(matched)[:NEXT] if np.isfinite(matched[k])]
    large = [k for k in by_frequency if abs(told[k]) > SIZES[-1]]
    u |= {k: float(told[k]) for k in large}
    first = list(dict.fromkeys([*chosen, *large]))
    near = refined(setting, [candidates[k] for k in first], [float(u[k]) for k in first])
    yield from ((candidates[k], v, None) for k, v in zip(first, near, strict=True))
    told = [float(np.clip(size[k], -3, 3)) for k in linear]
    near = refined(setting, [candidates[k] for k in linear], told)
    yield from ((candidates[k], v, None) for k, v in zip(linear, near, strict=True))
    yield from ((candidates[k], 0.0, start) for k in linear)
    yield from _hidden(setting, start, at, share)
    yield from _taken_up(at, share, *taken)


def _unlikely_swaps(setting: Setting, candidates: list[Change]) -> set[int]:
    r"""Of many exchanges of two outputs, or of two inputs, all but those that bring shapes nearest.

    Outputs a and b are as far apart as :math:`\sum_k w_{ka}|A_{ka} - \alpha_k P_{kb}|^2`, with measured and predicted
    residues A and P, the factor :math:`\alpha_k` between the whole of both, and one over the variances w.
    """
    out: set[int] = set()
    for at_inputs in (False, True):
        own = [k for k, c in enumerate(candidates) if isinstance(c, Swap) and c.at_inputs == at_inputs]
        if len(own) <= SWAPS:
            continue
        f, state = setting.features, state_at(setting, np.zeros(len(setting.inaccuracy.group_of)))
        P, A, w = state.plain[state.pairs], f.residues * f.units, 1 / np.abs(f.units) ** 2
        energy = np.maximum((w * np.abs(P) ** 2).sum(axis=(1, 2)), 1e-300)
        P = P * ((w * P.conj() * A).sum(axis=(1, 2)) / energy)[:, None, None]
        if at_inputs:
            P, A, w = (x.swapaxes(1, 2) for x in (P, A, w))
        alone = (w * np.abs(A) ** 2).sum(axis=(0, 2))
        apart = alone[:, None] + np.einsum("kai,kbi->ab", w, np.abs(P) ** 2, optimize=True)
        apart -= 2 * np.einsum("kai,kbi->ab", w * A.conj(), P, optimize=True).real
        a, b = np.array([candidates[k].channel for k in own]).T
        nearer = apart[a, a] + apart[b, b] - apart[a, b] - apart[b, a]
        out |= {own[k] for k in np.argsort(-nearer)[SWAPS:]}
    return out


def _dampings(setting: Setting, candidates: list[Change]) -> np.ndarray:
    """How far measured dampings are from those with a damper at each place; infinite of all other candidates."""
    state = state_at(setting, np.zeros(len(setting.inaccuracy.group_of)))
    return missed_dampings(setting.features, state.modes, state.pairs, candidates)


def _leading_forces(candidates: list[Change], matched: np.ndarray, *gains: np.ndarray) -> list[int]:
    """Forces and dampers of each kind that are tried with finite sizes, each of which needs modes of its own.

    Besides the leading ones of each of several scores, those where a spring gives the measured frequencies: a strong
    damper too holds two points together.
    """
    springs = [int(k) for k in np.argsort(matched) if candidates[k].kind == "K" and np.isfinite(matched[k])][:FORCES]
    held = {candidates[k].where for k in springs}
    out: set[int] = set()
    for slug in {c.slug for c in candidates if couples(c)}:
        own = [k for k, c in enumerate(candidates) if c.slug == slug]
        for gain in gains:
            out |= set(sorted((k for k in own if np.isfinite(gain[k])), key=lambda k: -gain[k])[:FORCES])
        out |= {k for k in own if candidates[k].kind == "C" and candidates[k].where in held}
    return sorted(out)


def _hidden(setting: Setting, null: Fit, at: About, share: np.ndarray) -> list[Start]:
    """Causes that hide in the inaccuracy: one part far beyond the others makes all seem as inaccurate as itself.

    They show from where the inaccuracy alone stands, once it is held to its usual size.
    """
    usual = replace(null, epsilon=np.minimum(null.epsilon, setting.inaccuracy.usual))
    gain, _ = scores(setting, usual, at)
    leading = [k for k in np.argsort(-(gain + share))[:NEXT] if np.isfinite(gain[k]) and gain[k] > 0]
    return [(at.candidates[k], 0.0, usual) for k in leading]  # from where the data are, without the cause


def _taken_up(
    at: About, share: np.ndarray, gain: np.ndarray, which: np.ndarray, narrow: list[Fit]
) -> list[Start]:  # fmt: skip
    """Causes that are all that is wrong with a matrix, or with a simulation which is exact but for them.

    They show from where the inaccuracy alone stands, once that of their kind is held to less than was learnt.
    """
    leading = [k for k in np.argsort(-(gain + share))[:NEXT] if np.isfinite(gain[k]) and gain[k] > 0]
    return [(at.candidates[k], 0.0, without_causes(narrow[which[k]])) for k in leading]


def _nominal(setting: Setting, null: Fit) -> Fit:
    """The simulation as it is, with its usual inaccuracy."""
    sizes = np.zeros_like(null.sizes)
    return replace(null, sizes=sizes, epsilon=setting.inaccuracy.usual, state=state_at(setting, sizes))


def as_signs(fits: Sequence[Fit], candidates: list[Change]) -> Iterator[tuple[tuple[Change, ...], np.ndarray, Fit]]:
    """Causes of each fit with the sign of an output in place of a negative gain; sizes and fit to start from.

    A sign has no size that a linear score could tell, so that beside another cause it shows as a gain of -2.
    """
    for f in fits:
        for k, cause in enumerate(f.causes):
            sign = cause.turned(f.u[own_sizes(f.causes, k)])
            if sign in candidates:
                yield _instead(f, k, sign, 0.0)


def as_alike(fits: Sequence[Fit], candidates: list[Change]) -> Iterator[tuple[tuple[Change, ...], np.ndarray, Fit]]:
    """Causes of each fit with what one of them may be taken for in its place; sizes and fit to start from."""
    for f in fits:
        for k, (cause, u) in enumerate(with_sizes(f.causes, f.u)):
            slug, size = cause.alike(u) or ("", None)
            others = [c for c in candidates if c.slug == slug and c.where == cause.where and c.count == 1]
            if others and others[0] not in f.causes:
                yield _instead(f, k, others[0], 1.0 if size is None else size / others[0].scale)


def _instead(f: Fit, k: int, cause: Change, u: float) -> tuple[tuple[Change, ...], np.ndarray, Fit]:
    """Causes and sizes of a fit with another of one size in place of cause ``k``, and where to start."""
    own = own_sizes(f.causes, k)
    sizes = np.concatenate([f.u[: own.start], [u], f.u[own.stop :]])
    return (*f.causes[:k], cause, *f.causes[k + 1 :]), sizes, without_causes(f)


def in_place_of_one(setting: Setting, f: Fit, candidates: list[Change], share: np.ndarray) -> list[Start]:
    """Causes that may have moved a mode which a fit leaves free, with the sizes that its frequency asks for."""
    missed, size = missed_frequencies(setting.features, f.state.modes, candidates, np.zeros(1), FOLLOWED)
    leading = [int(k) for k in np.argsort(missed - 2 * share)[:NEXT] if np.isfinite(missed[k]) and size[k] != 0]
    return [(candidates[k], float(size[k]), without_causes(f)) for k in leading]
