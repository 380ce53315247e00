r"""Oscillators that may be attached, tried by finite sizes at all places once a measured mode is one too many.

A light one has the pole that was measured, and at each place just one mass makes the residue as large as it was
measured: residues of its own mode grow as the mass. A heavy one splits a mode into two, far apart, and neither is near
its own frequency: with the compliance :math:`H` of its place a mass :math:`m` makes a mode at :math:`\omega` just where

.. math:: \omega_0^2 = \frac{\omega^2}{1 - m\omega^2 H(\omega)}.
"""

from collections.abc import Callable

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.causes.further_causes import FACTOR, ZETA, TunedMass
from modalax.diagnose.modal_domain.fitting.attempts import attempt, explains, key_of, without
from modalax.diagnose.modal_domain.fitting.explanation import Prior, ranked_by
from modalax.diagnose.modal_domain.fitting.fit import Fit, Found, without_causes
from modalax.diagnose.modal_domain.fitting.state import NONE, Setting, changes_of
from modalax.diagnose.modal_domain.search.beside_modes import causes_beside_modes, with_free
from modalax.diagnose.modal_domain.search.screen import STILL, distances, tolerance
from modalax.diagnose.modal_domain.search.starts import in_place_of_one
from modalax.diagnose.modal_domain.search.steps import MOST

MASSES = np.array([0.1, 0.2, 0.3, 0.45, 0.65, 1.0, 1.5])  # roots of masses that are tried, over the usual
OFF = np.array([0.975, 1.0, 1.025])  # frequencies at which the compliance is taken, over that of the mode too many
FARTHEST = 1.6  # of the oscillator from that mode, by a factor in frequency, of those that are tried
LIGHT = 0.02  # root of a mass, over the usual, that changes no other mode
LEADING = 6  # places that are fitted, of light and of heavy ones each
TRIED = 3  # measured modes that are tried in an oscillator's place, the nearest to its frequency
ALIKE = 4  # further places that are fitted, which act on the modes most like the best so far
PAIRS, ASKED = 6, 2  # of a mode too many and another cause that are fitted, and of these asked what made the mode
NEAR = 20.0  # nats behind the first, of pairs of a mode too many and another cause that are asked so too
LEAST = 0.01  # of a mass beside a cause that takes some of it away, relative to that of the simulation
BROAD = 0.1  # width of the compliance by which that is judged, relative to the oscillator's frequency


Causes = tuple[tuple[Change, ...], np.ndarray]  # and their sizes
NOTHING: Causes = ((), NONE)


def oscillators(
    setting: Setting, candidates: list[Change], extra: Change, kept: Causes = NOTHING
) -> list[tuple[TunedMass, np.ndarray]]:  # fmt: skip
    """Leading places of an oscillator near the pole of the mode that is too many, with sizes to start from.

    Parameters
    ----------
    kept
        Causes beside it, and their sizes.
    """
    assert extra.freed is not None
    near_to = abs(setting.features.poles[extra.freed])
    free = tuple(c for c in kept[0] if c.freed is not None)
    shrink = tolerance(setting, free, lacking=(extra,))[1]
    heavy: list[tuple[float, TunedMass, np.ndarray]] = []
    light: list[tuple[float, TunedMass, np.ndarray]] = []
    for cause in candidates:
        if not isinstance(cause, TunedMass):
            continue
        trials = [*_heavy(setting, cause, near_to), _light(setting, cause, extra.freed, kept)]
        values = [
            float(distances(setting, shrink, [modes], free)[0]) + float(u @ u)
            for u, modes in zip(trials, _modes(setting, cause, trials, kept), strict=True)
        ]
        light.append((values[-1], cause, trials[-1]))
        if len(trials) > 1:
            best = int(np.argmin(values[:-1]))
            heavy.append((values[best], cause, trials[best]))
    # each kind by itself: a light one fits its own mode wherever it is, and would crowd out heavy ones
    leading = [sorted(kind, key=lambda one: one[0])[:LEADING] for kind in (light, heavy)]
    return [(cause, u) for kind in leading for _, cause, u in kind]


def alike(setting: Setting, candidates: list[Change], to: TunedMass, u: np.ndarray) -> list[TunedMass]:
    """Other places of an oscillator, by how much its force there moves the structure as at the place that it has.

    Modes count by their compliance about the oscillator's frequency. What is off in the simulation may make a place
    seem poor until it is fitted; those next to the best are.
    """
    others = [c for c in candidates if isinstance(c, TunedMass) and c.where != to.where]
    if not others:
        return []
    w, at = setting.coordinates.frequencies[:-1], to.values(u)[1]
    weight = 1 / np.sqrt(np.abs(w**2 - at**2 + 1j * BROAD * w * at))
    unit = []
    for cause in (to, *others):
        assert cause.direction is not None
        moved = weight * cause.direction[:-1]
        unit.append(moved / max(float(np.linalg.norm(moved)), 1e-300))
    like = np.abs(np.array(unit[1:]) @ unit[0])
    return [others[k] for k in np.argsort(-like)[:ALIKE]]


def _heavy(setting: Setting, cause: TunedMass, near_to: float) -> list[np.ndarray]:
    """Sizes of oscillators of each mass, tuned so that one mode comes to where one is too many.

    The simulation is off by some per cent, so that the compliance is taken on either side as well.
    """
    assert cause.direction is not None
    c, trials = setting.coordinates, []
    at = near_to * OFF
    moved = cause.direction[:-1] ** 2
    compliance = (moved / (c.frequencies[:-1] ** 2 - at[:, None] ** 2)).sum(axis=1)
    for u in MASSES:
        stretched = 1 - cause.scale * u**2 * near_to**2 * compliance
        for own in near_to / np.sqrt(stretched[stretched > 0]):
            if near_to / FARTHEST < own < near_to * FARTHEST:
                trials.append(np.array([u, np.log(own / cause.middle) / cause.width, 0.0]))
    return trials


def _light(setting: Setting, cause: TunedMass, mode: int, kept: Causes) -> np.ndarray:
    """Sizes of a light oscillator whose own mode is as large as a measured one."""
    f = setting.features
    pole = f.poles[mode]
    zeta = np.log(max(-pole.real / abs(pole), 1e-6) / ZETA) / FACTOR
    u = np.array([LIGHT, np.log(abs(pole) / cause.middle) / cause.width, zeta])
    ((poles, residues),) = _modes(setting, cause, [u], kept)
    own = residues[np.argmin(np.abs(poles - pole))] / f.units[mode]
    larger = np.linalg.norm(f.residues[mode]) / max(float(np.linalg.norm(own)), 1e-300)
    return np.array([min(LIGHT * np.sqrt(larger), MASSES[-1]), *u[1:]])


def _modes(
    setting: Setting, cause: TunedMass, trials: list[np.ndarray], kept: Causes
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poles and residues of the simulation with an oscillator, damping mode by mode, which is exact enough to rank."""
    c, still = setting.coordinates, np.zeros(len(setting.inaccuracy.group_of))
    beside = changes_of(setting, still, *kept)
    b, V = np.linalg.eigh(np.eye(c.size) + beside["dM"])
    T = V / np.sqrt(np.maximum(b, LEAST))  # coordinates of unit mass
    changes = [cause.changes(u) for u in trials]
    K = np.diag(c.frequencies**2) + beside["dK"] + np.stack([change["K"] for change in changes])
    values, Q = np.linalg.eigh(T.T @ K @ T)
    m = c.solved
    w, Q = np.sqrt(np.maximum(values[:, :m], 0.0)), T @ Q[:, :, :m]
    w = np.maximum(w, STILL * c.frequencies[-2])
    damping = c.damping + beside["dC"] + np.stack([change["C"] for change in changes])
    own = np.clip(np.einsum("knr,knr->kr", Q, damping @ Q), 1e-6 * w, 1.9 * w)
    poles = -own / 2 + 1j * np.sqrt(w**2 - own**2 / 4)
    residues = np.einsum("kom,kim->kmoi", c.outputs @ Q, c.inputs @ Q) / (2j * poles.imag)[:, :, None, None]
    for other, u in with_sizes(*kept):
        residues = np.stack([other.at_modes(u, *modes) for modes in zip(poles, residues, strict=True)])
    return list(zip(poles, residues, strict=True))


def attached(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Where a measured mode is one too many, try what may have moved one so far, and oscillators as what makes it."""
    ranked = ranked_by(found, prior)
    if not explains(ranked[0].fit):  # which mode is too many shows beside other errors that are too large as well
        ranked = [e for e in ranked if any(c.freed is not None for c in e.causes)]
    freed = [c for c in ranked[0].causes if c.freed is not None] if ranked else []
    if len(freed) != 1:  # beside several each is asked about together with the others
        return
    best = ranked[0].fit
    for cause, u, start in in_place_of_one(setting, best, candidates, prior.each(candidates)):
        if late():
            return
        attempt(setting, found, (cause,), cause.of_size(u), start, gentle=False)
    for cause, u in oscillators(setting, candidates, freed[0]):
        if late():
            return
        attempt(setting, found, (cause,), u, None)
    acting_alike(setting, found, candidates, prior, late)


def attached_beside(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior, late: Callable[[], bool]
) -> None:
    """Seek an oscillator beside what else leads where one mode is too many, and together with another cause.

    The latter where what leads is no explanation, or one of many causes: while either is unknown the other is hidden by
    it, and several causes of other kinds come nearer to the modes.
    """
    for f in _with_a_mode_too_many(setting, found, candidates, prior, late):
        for k in (k for k, c in enumerate(f.causes) if c.freed is not None):
            kept, own = f.causes[:k] + f.causes[k + 1 :], without(f, k)
            for cause, u in oscillators(setting, candidates, f.causes[k], (kept, own)):
                if late():
                    return
                attempt(setting, found, (*kept, cause), np.append(own, u), None)
    acting_alike(setting, found, candidates, prior, late)
    _a_mode_instead(setting, found, candidates, prior, late)


def _a_mode_instead(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior, late: Callable[[], bool]
) -> None:
    """Fit measured modes near an oscillator that leads beside others as ones too many in its place.

    An oscillator may be found before the others are known, and then hides that no place explains its mode.
    """
    best = ranked_by(found, prior)[0].fit
    k = next((k for k, c in enumerate(best.causes) if isinstance(c, TunedMass)), None)
    if k is None or len(best.causes) == 1:
        return
    oscillator, kept, own = best.causes[k], best.causes[:k] + best.causes[k + 1 :], without(best, k)
    at = np.log(oscillator.values(best.u[own_sizes(best.causes, k)])[1])
    off = {c: abs(np.log(abs(setting.features.poles[c.freed])) - at) for c in candidates if c.freed is not None}
    for mode in sorted(off, key=lambda c: off[c])[:TRIED]:
        if late():
            return
        if key_of((*kept, mode)) not in found:
            attempt(setting, found, (*kept, mode), with_free(own, (mode,)), None)


def _with_a_mode_too_many(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior, late: Callable[[], bool]
) -> list[Fit]:
    """Fits in which a mode is one too many beside something else, likelier ones first; they are kept as well."""
    ranked = ranked_by(found, prior)
    best, near = ranked[0].fit, [e.fit for e in ranked if e.log_posterior > ranked[0].log_posterior - NEAR]
    few = lambda f: sum(c.freed is None for c in f.causes) < MOST  # one cause at most beside modes that are free
    lacking = [f for f in near if few(f) and len(f.causes) > 1 and any(c.freed is not None for c in f.causes)]
    if explains(best) and (few(best) or len(best.causes) == MOST):
        return lacking[:ASKED] if any(c.freed is not None for c in best.causes) else []
    free: Found = {key_of(f.causes): f for f in lacking}
    for extra, other, u in causes_beside_modes(setting, candidates, PAIRS):
        if late():
            break
        attempt(setting, free, (*other, *extra), with_free(u, extra), None)
    for key, f in free.items():
        if key not in found or f.log_evidence > found[key].log_evidence:
            found[key] = f
    return [e.fit for e in ranked_by(free, prior)[:ASKED]] if free else []


def acting_alike(
    setting: Setting, found: Found, candidates: list[Change], prior: Prior,
    late: Callable[[], bool],
) -> None:  # fmt: skip
    """Fit an oscillator that leads at places that act like its own, until none of them is likelier."""
    while True:
        best = ranked_by(found, prior)[0].fit
        k = next((k for k, c in enumerate(best.causes) if isinstance(c, TunedMass)), None)
        if k is None:
            return
        kept, own = tuple(c for j, c in enumerate(best.causes) if j != k), best.u[own_sizes(best.causes, k)]
        for cause in alike(setting, candidates, best.causes[k], own):
            if late():
                return
            if key_of((*kept, cause)) not in found:
                u = np.append(without(best, k), own)
                attempt(setting, found, (*kept, cause), u, without_causes(best), gentle=False)
        if ranked_by(found, prior)[0].fit is best:
            return
