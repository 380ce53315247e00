r"""What errors of single elements are not: one factor throughout, or elements that are off unevenly.

A modulus or a thickness that is wrong is no scatter of elements. Where the data are clearly likelier with such a factor
:math:`e^x` on all of the stiffness, mass or damping, x is fitted beside the errors of single elements, which are then
told as much smaller as they are.

What a matrix shows as one element between two nodes may be several, such as four columns under a floor, each off by
itself. Where elements that are off as a whole do not explain the modes, each :math:`K_e=FF^T` may change to
:math:`F(I+\epsilon Z)F^T` with ``Z`` symmetric and random (Soize 2000).
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modalax._numerics.text import with_error
from modalax._numerics.triangles import forward
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.fitting.discrepancy import beside
from modalax.diagnose.modal_domain.fitting.explanation import Prior
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found, by_data, fit, scale_of, without_causes
from modalax.diagnose.modal_domain.fitting.inaccuracy import THROUGHOUT, TOLD, UNKNOWN, USUAL, WITHIN, with_group
from modalax.diagnose.modal_domain.fitting.linear import root_of_information
from modalax.diagnose.modal_domain.fitting.state import Setting, slopes_at
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.thresholds import THRESHOLDS

CLEARER = 5.0  # nats of log evidence that each such factor must gain
WIDER = 3.0  # a factor throughout before the data, relative to the usual errors of single elements
FEWEST, SURE = 4, 4.0  # modes, and standard errors of their mean, from which on all dampings may be off alike
FEW = 3  # channels of which the gain of one may be taken for factors throughout
RANK = 1e-9  # stiffness in one motion, relative to the stiffest, below which an element does not resist it
MOST = 400  # patterns of uneven errors beyond which fits take too long
BASE = len(TOLD) + 1  # groups that every inaccuracy begins with


def with_more(setting: Setting, alone: Fit) -> Setting:
    """The setting with factors throughout and uneven errors that the data ask for beside the causes of ``alone``."""
    there = setting.inaccuracy.groups
    if alone.chi2 > THRESHOLDS.misfit * alone.state.difference.size:
        uneven = [(WITHIN[name],) for name in setting.sought if setting.uneven and WITHIN[name] not in there]
        setting, alone = _likeliest(setting, alone, uneven)
    sought = (*setting.sought, "damping") if _alike(setting, alone) else setting.sought
    left = [(THROUGHOUT[name],) for name in sought if THROUGHOUT[name] not in there]
    while left:
        wider, alone = _likeliest(setting, alone, left)
        if wider is setting:
            break
        setting, single = wider, [g for g in left if len(g) == 1 and g[0] not in wider.inaccuracy.groups]
        left = [*single, *([tuple(g for (g,) in single)] if len(single) > 1 else [])]
    return setting


def _damped(setting: Setting, f: Fit) -> tuple[Setting, Fit]:
    """The same with a factor on all of the damping, where that is likelier."""
    return _likeliest(setting, f, [(THROUGHOUT["damping"],)]) if _alike(setting, f) else (setting, f)


def _alike(setting: Setting, f: Fit) -> bool:
    """Whether the dampings of modes are surely off in the mean, over their scatter."""
    a = setting.inaccuracy
    off = f.sizes[(a.group_of == a.groups.index("damping")) & a.positive]
    off = off[np.unique(f.state.pairs[f.state.pairs < len(off)])]
    spread = float(off.std()) / math.sqrt(max(len(off) - 1, 1))
    return len(off) >= FEWEST and abs(float(off.mean())) > SURE * spread


def _likeliest(setting: Setting, alone: Fit, trials: list[tuple[str, ...]]) -> tuple[Setting, Fit]:
    """The setting with the groups, of several trials, that make the data likeliest, and the fit in it."""
    best, top = (setting, alone), alone.log_evidence
    for groups in trials:
        wider = with_groups(setting, groups)
        if wider is None:
            continue
        starts: list[Fit | None] = [start_in(wider, alone)] if alone.causes else []
        if not alone.causes or alone.chi2 > THRESHOLDS.misfit * alone.state.difference.size:
            starts.append(None)  # errors of single elements may have stood for what they are not
        for start in starts:
            trial = fit(wider, alone.causes, start, alone.u, **({"temperatures": (3.0,)} if start else {}))
            if trial is not None and trial.log_evidence - CLEARER * len(groups) > top:
                best, top = (wider, trial), trial.log_evidence - CLEARER * len(groups)
    return best


def nats_over_a_factor(setting: Setting, f: Fit, which: int) -> float:
    """By how much the data prefer a cause to a factor on all of the mass or the stiffness in its place."""
    a, cause = setting.inaccuracy, f.causes[which]
    others = tuple(c for c in f.causes if c is not cause)
    u = np.delete(f.u, np.arange(len(f.u))[own_sizes(f.causes, which)])
    found = [-math.inf]
    for name, slug in (("mass", "added_mass"), ("stiffness", "joint_stiffness")):
        pattern = a.patterns[a.groups.index(name)].sum(axis=0)
        factor = Change(slug, (), WIDER * USUAL[name], pattern=pattern)
        trial = fit(setting, (*others, factor), without_causes(f), np.append(u, 0.0), temperatures=(3.0,))
        found += [] if trial is None else [by_data(trial, (*others, factor), factor)]
    return by_data(f, f.causes, cause) - max(found)


def all_scaled(setting: Setting) -> bool:
    """Whether stiffness and mass may be off by factors throughout, as one on all FRFs is told from no data then."""
    return {THROUGHOUT["stiffness"], THROUGHOUT["mass"]} <= set(setting.inaccuracy.groups)


def beside_one_factor(
    bare: Setting, setting: Setting, null: Fit, candidates: Sequence[Change], prior: Prior
) -> tuple[Setting, Found]:
    r"""The setting and its first fits: with a factor on FRFs in place of one on the mass, where that is likelier.

    Factors :math:`a` on all of K, M and C make FRFs :math:`1/a` times as large, so that a gain of all FRFs says what
    they do; with factors on stiffness and mass both there must be none beside them. Of few channels, a gain of one and
    such factors are the gain of another.
    """
    if not all_scaled(setting):
        return setting, {(): null}
    (k,) = np.flatnonzero(setting.inaccuracy.group_of == setting.inaccuracy.groups.index(THROUGHOUT["mass"]))
    best = null.log_evidence + prior.of(())
    chosen: tuple[Setting, Found] = setting, {(): null}
    for gain in _of_all_or_few(candidates):
        u = gain.of_size(float(np.expm1(-null.sizes[k])) / gain.scale)
        for simpler in filter(None, (bare, with_groups(bare, (THROUGHOUT["stiffness"],)))):
            trial = fit(simpler, (gain,), None, u)
            if trial is not None:
                simpler, trial = _damped(simpler, trial)
            if trial is None or trial.log_evidence + prior.of((gain,)) < best:
                continue
            best, plain = trial.log_evidence + prior.of((gain,)), fit(simpler) or start_in(simpler, null)
            chosen = simpler, {(): plain, (gain,): trial}
    return chosen


def _of_all_or_few(candidates: Sequence[Change]) -> list[Change]:
    """Gains of all FRFs, and of inputs and outputs of which there are few."""
    gains = [c for c in candidates if c.slug in ("channel_gain", "force_gain")]
    count = Counter(c.slug for c in gains if not c.scales_all)
    return [c for c in gains if c.scales_all or count[c.slug] <= FEW]


def instead_of_a_gain(setting: Setting, bare: Setting, f: Fit, prior: Prior) -> tuple[Setting, Fit] | None:
    """The setting with factors on stiffness and mass, and a fit there without the gain of all FRFs, if likelier.

    ``bare`` is the setting without any factor, which tells for what one is sought.
    """
    kept = [k for k, c in enumerate(f.causes) if not c.scales_all]
    if "mass" not in bare.sought or len(kept) == len(f.causes):
        return None
    causes = tuple(f.causes[k] for k in kept)
    u = np.concatenate([np.zeros(0), *(f.u[own_sizes(f.causes, k)] for k in kept)])
    wider = with_groups(replace(setting, inaccuracy=bare.inaccuracy), (THROUGHOUT["stiffness"], THROUGHOUT["mass"]))
    found = None if wider is None else fit(wider, causes, None, u)
    if wider is None or found is None:
        return None
    wider, found = _damped(wider, found)
    better = found.log_evidence + prior.of(causes) > f.log_evidence + prior.of(f.causes)
    return (wider, found) if better else None


def start_in(setting: Setting, f: Fit) -> Fit:
    """The errors of single elements of a fit as a start in a setting with other groups beside them."""
    count = int(np.count_nonzero(setting.inaccuracy.group_of < BASE))
    few = replace(f, sizes=f.sizes[:count], epsilon=f.epsilon[:BASE], determined=f.determined[:BASE])
    return beside(setting, without_causes(few))


def with_groups(setting: Setting, groups: tuple[str, ...]) -> Setting | None:
    """The setting with further groups; None where one of them is empty or too large."""
    a = setting.inaccuracy
    for group in groups:
        name = group.split()[0]
        own = a.patterns[a.groups.index(name)]
        factor = group == THROUGHOUT[name]
        whole = _whole(setting.coordinates, name) if name == "damping" or a.between_modes else own.sum(axis=0)
        patterns = whole[None] if factor else _within(own, a.elements.get(name))
        if not 0 < len(patterns) <= MOST:
            return None
        a = with_group(a, group, patterns, (WIDER if factor else 1.0) * USUAL[name], UNKNOWN, positive=factor)
    return replace(setting, inaccuracy=a)


def _whole(c: Coordinates, name: str) -> np.ndarray:
    """All of a matrix in modal coordinates, without the spare one, shape ``(n, n)``."""
    if name == "damping":
        return c.damping
    there = np.arange(c.size) < c.size - c.spares - c.local
    return np.diag(there * c.frequencies**2 if name == "stiffness" else there)


def _within(own: np.ndarray, elements: np.ndarray | None) -> np.ndarray:
    """Uneven changes of :func:`coupled_elements`."""
    return uneven_patterns(coupled_elements(own, elements))


def coupled_elements(own: np.ndarray, elements: np.ndarray | None) -> np.ndarray:
    """Pieces of elements or, where each is a spring, the whole elements that they are of, shape ``(p, n, n)``.

    Of a symmetric building the columns of a storey are three springs, for either sway and the twist, that only such
    changes couple.
    """
    if elements is None or any(len(ways_of(P)) > 1 for P in own):
        return own
    return np.stack([own[elements == k].sum(axis=0) for k in range(elements.max() + 1)])


def ways_of(P: np.ndarray) -> np.ndarray:
    """Ways in which an element can be strained: rows ``f`` of ``P``, the sum of their ``f f'``, shape ``(r, n)``."""
    values, vectors = np.linalg.eigh(P)
    kept = values > RANK * values[-1]
    return (vectors[:, kept] * np.sqrt(values[kept])).T


def uneven_patterns(patterns: np.ndarray) -> np.ndarray:
    """Changes within each element that is no single spring, shape ``(p, n, n)``; empty if there are too many."""
    out: list[np.ndarray] = []
    for P in patterns:
        F = ways_of(P).T
        rank = F.shape[1]
        if rank > 1 and len(out) + rank * (rank + 1) // 2 > MOST:
            return np.zeros((0, *P.shape))
        for a in range(rank if rank > 1 else 0):
            out.append(np.outer(F[:, a], F[:, a]))
            for b in range(a):
                both = np.outer(F[:, a], F[:, b]) / np.sqrt(2)
                out.append(both + both.T)
    return np.array(out).reshape(-1, *patterns.shape[1:])


def throughout_told(setting: Setting, f: Fit) -> dict[str, dict[str, float]]:
    """By how much the simulation's stiffness, mass or damping is too high throughout, where it surely is off.

    The value is :math:`e^{-x}-1`, the simulation relative to the structure: positive where the simulation is too stiff.
    It is surely off where both ``x`` and the value are many of their deviations from zero: a factor that leaves next to
    nothing of a matrix is known to no accuracy.
    """
    names, x, covariance = _factors(setting, f)
    told = {}
    for name, value, std in zip(names, x.tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True):
        off, error = float(np.expm1(-value)), float(np.exp(-value) * std)
        if abs(value) > THRESHOLDS.stands_out * std and abs(off) > THRESHOLDS.stands_out * error:
            told[name] = {"value": off, "std": error}
    return told


def only_scaled(setting: Setting, f: Fit) -> bool:
    """Whether stiffness and mass are off throughout by what may be one factor, which only makes all FRFs larger.

    So do a record that leaks, a gain and much else that is nothing of the structure; no frequency is off then.
    """
    if not all_scaled(setting):
        return False
    names, x, covariance = _factors(setting, f)
    apart = np.array([{"stiffness": 1.0, "mass": -1.0}.get(name, 0.0) for name in names])
    return abs(float(apart @ x)) < THRESHOLDS.stands_out * float(np.sqrt(apart @ covariance @ apart))


def _factors(setting: Setting, f: Fit) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names of the matrices with a factor throughout, the logarithms of these and their covariance."""
    a = setting.inaccuracy
    names = [name for name, group in THROUGHOUT.items() if group in a.groups]
    if not names:
        return [], np.zeros(0), np.zeros((0, 0))
    J, scale = slopes_at(setting, f.state, f.causes, f.u), scale_of(setting, f)
    root = root_of_information(J, J.T @ J, scale)
    own = np.concatenate([np.flatnonzero(a.group_of == a.groups.index(THROUGHOUT[name])) for name in names])
    columns = forward(root, np.diag(scale)[:, own])
    return names, f.sizes[own], columns.T @ columns


def throughout_said(told: dict[str, Any]) -> list[str]:
    """The same in sentences."""
    off = [
        f"the {name} of the simulation is {with_error(abs(v['value']), v['std'], 100)} % too "
        f"{'high' if v['value'] > 0 else 'low'}"
        for name, v in told.items()
    ]
    beside = "what elements are off, and the sizes of causes, are told beside that"
    return [f"throughout, {' and '.join(off)}; {beside}"] if off else []
