r"""All causes at all places at once, linearised where the inaccuracy alone explains the measurement.

A score about the simulation itself means nothing once modes have moved by several bandwidths. But a cause is only a
particular change of the matrices, and the general inaccuracy can imitate nearly any: fitted without a cause it explains
the data, and each cause is scored by how much likelier it makes the change that was needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.optimize

from modalax._numerics.triangles import forward
from modalax.diagnose.modal_domain.causes.change import Change, own_sizes
from modalax.diagnose.modal_domain.causes.channel_faults import Gain
from modalax.diagnose.modal_domain.causes.line_forces import ModalForce
from modalax.diagnose.modal_domain.fitting.fit import Fit, hyperprior, scale_of
from modalax.diagnose.modal_domain.fitting.inaccuracy import KINDS
from modalax.diagnose.modal_domain.fitting.linear import SMALLEST, root_of_information, widths
from modalax.diagnose.modal_domain.fitting.state import (
    Setting,
    State,
    compared,
    evidence_of_free,
    pairs_with,
    screening_slopes,
    slopes_at,
    state_at,
    unseen,
    whitened,
)
from modalax.diagnose.modal_domain.structure.coordinates import Modes, with_loads
from modalax.diagnose.modal_domain.structure.loads import Load

SIZES = (0.015, 0.04, 0.1, 0.25, 0.5, 0.9, 2.0)  # sizes of a change that are tried, over its usual size, of either sign
SIDES = np.array([-s for s in SIZES[::-1]] + [*SIZES])
STRONG = (5.0, 15.0, 50.0, 200.0, 1000.0)  # and of a force or damper: one that holds two points together damps little
UNDAMPED = 1e-9  # damping ratio that rounding may make of none
FACTORS = np.array([0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2])  # multiples of a size that are tried to refine it
STILL = 1e-7  # least frequency of a mode, relative to the highest; a rigid body has none
UNUSABLE = 1e200  # distance that counts for a size that leaves no structure
NARROWER = 0.3, 0.1, 0.01  # parts of what was learnt of a kind of inaccuracy that a cause is tried beside
TOGETHER = 100  # sizes of causes, with their modes, that are compared together
TOLERANT = 3.0  # times the usual inaccuracy that finite changes are screened with

Trials = list[tuple[float, np.ndarray, np.ndarray]]  # size of a cause, poles and residues with it


def finite(setting: Setting, candidates: list[Change], told: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    r"""Screen by finite changes of the simulation itself: least :math:`r^T\Sigma^{-1}r + u^2` of each, and its size.

    Damping is taken mode by mode, which is exact enough to rank, but for what couples modes: forces and dampers at a
    place have modes of their own at each size.

    Parameters
    ----------
    told
        A further size of each change of one matrix that is tried, over the usual one; zero tries none.
    """
    state, shrink = tolerance(setting)
    best, where = np.full(len(candidates), np.inf), np.zeros(len(candidates))
    waiting: list[tuple[int, Trials]] = []  # those that are compared with the same modes, together

    def compare(some: list[tuple[int, Trials]], own: np.ndarray, causes: tuple[Change, ...]) -> None:
        values = distances(setting, own, [modes for _, trials in some for _, *modes in trials], causes)
        values -= 2 * evidence_of_free(setting, causes)
        ends = np.cumsum([len(trials) for _, trials in some])[:-1]
        for (k, trials), left in zip(some, np.split(values, ends), strict=True):
            u = np.array([u for u, _, _ in trials])
            left = left + cost_of_size(u) if candidates[k].sized else left
            least = int(np.argmin(np.where(np.isnan(left), np.inf, left)))
            if left[least] < np.inf:
                best[k], where[k] = left[least], u[least]

    for k, cause in enumerate(candidates):
        trials = trials_of(setting, state, cause, 0.0 if told is None else float(told[k])) if cause.screened else []
        if trials and cause.freed is not None:
            compare([(k, trials)], tolerance(setting, (cause,))[1], (cause,))
        elif trials:
            waiting.append((k, trials))
        if waiting and (k == len(candidates) - 1 or sum(len(t) for _, t in waiting) > TOGETHER):
            compare(waiting, shrink, ())
            waiting = []
    return best, where


def trials_of(setting: Setting, state: State, cause: Change, told: float = 0.0) -> Trials:
    """The simulation with each size of a cause that is tried; none of several sizes."""
    if couples(cause):
        return _loaded(setting, state.modes, cause, [*(SIDES if cause.signed else SIDES[SIDES > 0]), *STRONG])
    if cause.kind:
        return _changed(setting, cause, np.append(SIDES, told) if told else SIDES)
    if cause.local:  # it has a screening of its own
        return []
    poles, plain = state.modes.poles, state.plain
    sizes = np.append(SIDES, gain_asked(setting, cause, poles, plain)) if cause.sized else np.ones(1)
    return [(float(u), poles, cause.at_modes(np.array([u]), poles, plain)) for u in sizes]


def gain_asked(setting: Setting, cause: Change, poles: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """Size, over the usual one, of a gain that the median mode asks for; empty for any other fault of a channel.

    A unit is wrong by a factor of ten or a thousand, and a sensor that points the other way by -1.
    """
    if not isinstance(cause, Gain):
        return np.zeros(0)
    f = setting.features
    pairs = pairs_with(f, (cause,), poles, plain)
    own = cause.transform_slope(np.zeros(1), poles[pairs], plain[pairs]) / cause.scale
    energy = (np.abs(own) ** 2).sum(axis=(1, 2))
    seen = energy > 0
    factor = ((own.conj() * f.residues * f.units).real.sum(axis=(1, 2))[seen]) / energy[seen]
    return (np.median(factor, keepdims=True) - 1) / cause.scale if seen.any() else np.zeros(0)


def cost_of_size(u: np.ndarray | float) -> np.ndarray:
    """What a size over the usual one costs before the data: u^2 up to the usual one, and beyond it by its own width."""
    return np.where(np.abs(u) < 1, np.square(u), 1 + 2 * np.log(widths(np.asarray(u))))


def unchanged(setting: Setting) -> float:
    """The same of no change at all."""
    state, shrink = tolerance(setting)
    h = shrink @ state.difference
    return float(state.difference @ state.difference - h @ h)


def distances(
    setting: Setting, shrink: np.ndarray, trials: Sequence[Sequence[np.ndarray]], causes: tuple[Change, ...] = ()
) -> np.ndarray:
    """Chi-squares as :func:`distance`, of several trials' poles and residues, which are compared together."""
    f = setting.features
    pairs = [pairs_with(f, causes, p, r) for p, r in trials]
    seen = [compared(f, p, r, which)[1:] for (p, r), which in zip(trials, pairs, strict=True)]
    poles, residues = (np.stack(part) for part in zip(*seen, strict=True))
    values = f.predicted(poles, residues, setting.linear)
    r = whitened(setting, (f.values - values).reshape(len(pairs), -1).T, causes)
    h = shrink @ r
    beside = [unseen(f, causes, p, r, which) for (p, r), which in zip(trials, pairs, strict=True)]
    return (r**2).sum(axis=0) - (h**2).sum(axis=0) + beside


def tolerance(
    setting: Setting, causes: tuple[Change, ...] = (), lacking: tuple[Change, ...] = ()
) -> tuple[State, np.ndarray]:
    """The nominal simulation, and a matrix whose product with a difference is the part that the inaccuracy explains.

    Measured modes that the simulation is ``lacking`` are taken to move as its nearest mode does.
    """
    a, none = setting.inaccuracy, np.zeros(len(causes))
    state = state_at(setting, np.zeros(len(a.group_of)), (*causes, *lacking), np.zeros(len(causes) + len(lacking)))
    W = slopes_at(setting, state, causes, none)[:, : len(a.group_of)] * (TOLERANT * a.usual)[a.group_of]
    L = root_of_information(W, W.T @ W, np.ones(W.shape[1]))
    return state, forward(L, W.T)


def refined(setting: Setting, causes: list[Change], sizes: list[float]) -> list[float]:
    """Sizes of least distance near those of :func:`finite`, with the damping in full."""
    still = np.zeros(len(setting.inaccuracy.group_of))
    _, shrink = tolerance(setting)

    def left(u: float, cause: Change) -> float:
        try:
            r = state_at(setting, still, (cause,), cause.of_size(u)).difference
        except np.linalg.LinAlgError:
            return UNUSABLE
        h = shrink @ r
        return float(r @ r - h @ h) + float(cost_of_size(u))

    out = []
    for cause, u in zip(causes, sizes, strict=True):
        if cause.sized and u != 0:
            trials = u * FACTORS
            best = int(np.argmin([left(t, cause) for t in trials]))
            low, high = trials[max(best - 1, 0)], trials[min(best + 1, len(trials) - 1)]
            found = scipy.optimize.minimize_scalar(
                left, args=(cause,), bounds=sorted((low, high)), method="bounded", options={"maxiter": 12}
            )
            u = float(found.x) if found.fun < UNUSABLE else u
        out.append(u)
    return out


def couples(cause: Change) -> bool:
    """Whether it is a force or a damper at a place, whose effect is no matter of one mode after the other."""
    return isinstance(cause, ModalForce) or (cause.kind == "C" and cause.direction is not None)


def _load(cause: Change, u: float) -> Load:
    """A force of some size; a damper's is in proportion to the velocity across its place."""
    if isinstance(cause, ModalForce):
        return cause.load(cause.of_size(u))
    assert cause.direction is not None, "a force acts in a direction"
    return Load(cause.direction[:, None], np.zeros((1, 1)), np.full((1, 1), cause.scale * u))


def _loaded(
    setting: Setting, modes: Modes, cause: Change, sizes: Sequence[float]
) -> list[tuple[float, np.ndarray, np.ndarray]]:  # fmt: skip
    """Size, poles and residues of the simulation with each size of a force; all of its modes decay."""
    out = []
    for u in sizes:
        try:
            changed = with_loads(modes, (_load(cause, float(u)),))
        except np.linalg.LinAlgError:
            continue
        if (changed.poles.real > UNDAMPED * np.abs(changed.poles)).any():
            continue
        if len(changed.poles) >= len(setting.features.poles):
            out.append((float(u), changed.poles, changed.residues(setting.coordinates)))
    return out


def _changed(setting: Setting, cause: Change, sizes: np.ndarray) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Size, poles and residues of the simulation with each size of a change of one matrix."""
    c = setting.coordinates
    m, count = c.solved, c.size
    change = cause.matrix
    size = float(np.trace(change))
    whole = cause.kind == "M" and cause.pattern is not None
    b, V = np.linalg.eigh(change) if whole else (np.array([size]), np.eye(1))
    if cause.kind == "M":
        sizes = sizes[sizes * b.max() > -0.95]
    if cause.kind == "C":
        w = np.broadcast_to(c.frequencies[:m], (len(sizes), m))
        Q = np.broadcast_to(np.eye(count)[:, :m], (len(sizes), count, m))
    else:
        A = np.diag(c.frequencies**2)
        if cause.kind == "K":
            values, Q = np.linalg.eigh(A + sizes[:, None, None] * change)
        else:
            # (I + u B)^{-1/2}; of rank one it is I + g B, 1 + g t = (1 + u t)^{-1/2}, t the trace of B
            if whole:
                half = V / np.sqrt(1 + sizes[:, None, None] * b) @ V.T
            else:
                half = np.eye(count) + ((1 / np.sqrt(1 + sizes * size) - 1) / size)[:, None, None] * change
            values, Q = np.linalg.eigh(half @ A @ half)
            Q = half @ Q
        w, Q = np.sqrt(np.maximum(values[:, :m], 0.0)), Q[:, :, :m]
    w = np.maximum(w, STILL * c.frequencies[m - 1])
    own = np.einsum("knr,nm,kmr->kr", Q, c.damping, Q, optimize=True)
    if cause.kind == "C":
        own = own + sizes[:, None] * np.diag(change)[:m]
    own = np.clip(own, 1e-6 * w, 1.9 * w)
    poles = -own / 2 + 1j * np.sqrt(w**2 - own**2 / 4)
    out, inn = c.outputs @ Q, c.inputs @ Q
    plain = np.einsum("kom,kim->kmoi", out, inn) / (2j * poles.imag)[:, :, None, None]
    return [(float(u), p, r) for u, p, r in zip(sizes, poles, plain, strict=True)]


@dataclass(frozen=True)
class About:
    """Whitened features and derivatives where a fit stands, which sizes of the inaccuracy do not change.

    Attributes
    ----------
    fitted
        Derivatives by all sizes of the fit.
    target
        Measured less predicted features, were all of these zero.
    candidates, further
        Further causes, and the derivatives by the size of each.
    """

    fitted: np.ndarray
    target: np.ndarray
    candidates: list[Change]
    further: np.ndarray

    @cached_property
    def products(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scalar products of the derivatives by further causes with those of the fit, the target, and themselves."""
        G = self.further
        return self.fitted.T @ G, G.T @ self.target, np.einsum("mk,mk->k", G, G)


def about(setting: Setting, f: Fit, candidates: list[Change]) -> About:
    """What each candidate does beside a fit, linearised."""
    J = slopes_at(setting, f.state, f.causes, f.u)
    target = f.state.difference + J @ np.concatenate([f.sizes, f.u])
    return About(J, target, candidates, screening_slopes(setting, f.state, candidates, f.causes, f.u))


def scores(setting: Setting, f: Fit, at: About) -> tuple[np.ndarray, np.ndarray]:
    """Gain of log evidence by adding each candidate to a fit, and its size over the usual one; -inf without a size."""
    return _scores(setting, f, at, np.arange(len(f.sizes) + len(f.u)))


def replaced(setting: Setting, f: Fit, which: int, at: About) -> tuple[np.ndarray, np.ndarray]:
    """Gain as :func:`scores` by each candidate in place of one cause of a fit, linearised about that fit."""
    if not f.causes[which].sized:
        return np.full(len(at.candidates), -np.inf), np.zeros(len(at.candidates))
    own = np.arange(len(f.u))[own_sizes(f.causes, which)] + len(f.sizes)
    return _scores(setting, f, at, np.delete(np.arange(len(f.sizes) + len(f.u)), own))


def _scores(setting: Setting, f: Fit, at: About, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same beside those unknowns of a fit that are kept."""
    _, gain, size = _beside(at, scale_of(setting, f), keep)
    gain[impossible(at.candidates, size)] = -np.inf
    return gain, size


def narrower(setting: Setting, f: Fit, at: About) -> tuple[np.ndarray, np.ndarray, list[Fit]]:
    """What each candidate gains where the inaccuracy is smaller than was learnt without it.

    A cause that little else is wrong beside is taken up by what is learnt of its kind: one damper makes all dampings
    seem off. Each kind of inaccuracy is narrowed in turn, and all together; what is lost without the cause counts.

    Returns
    -------
    gain, best
        Of log evidence, and in which narrower inaccuracy, for each candidate; -inf without a size.
    narrow
        The fit with each narrower inaccuracy, as a start.
    """
    a = setting.inaccuracy
    kinds = np.array([KINDS[g] for g in a.groups])
    narrow = [np.where(kinds == kind, f.epsilon * part, f.epsilon) for kind in "KMC" for part in NARROWER]
    sizes = [np.maximum(e, np.minimum(SMALLEST, f.epsilon)) for e in narrow]
    before = [hyperprior(setting, e, f.u) for e in [f.epsilon, *sizes]]
    if not any(a.claimed):  # it may be exact, which costs nothing before the data
        sizes.append(np.full(len(kinds), SMALLEST))
        before.append(hyperprior(setting, a.usual, f.u))
    without, gains = [], []
    for epsilon, prior in zip([f.epsilon, *sizes], before, strict=True):
        alone, gain, size = _beside(at, scale_of(setting, f, epsilon))
        gain[impossible(at.candidates, size)] = -np.inf
        without.append(alone + prior)
        gains.append(gain + alone + prior)
    total = np.array(gains[1:]) - max(without)
    return total.max(axis=0), total.argmax(axis=0), [replace(f, epsilon=e) for e in sizes]


def _beside(
    at: About, scale: np.ndarray, keep: np.ndarray | slice = slice(None)
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log evidence of some unknowns of a fit, what each further one gains beside them, and its size."""
    across, along, energy = at.products
    W = (at.fitted * scale)[:, keep]
    L = root_of_information(W, W.T @ W, np.ones(W.shape[1]))
    apart, own = forward(L, scale[keep, None] * across[keep]), forward(L, W.T @ at.target)
    product = along - apart.T @ own
    energy = np.maximum(energy - np.einsum("pk,pk->k", apart, apart), 0.0)
    alone = 0.5 * float(own @ own - at.target @ at.target) - float(np.log(L.diagonal()).sum())
    return alone, 0.5 * product**2 / (1 + energy) - 0.5 * np.log1p(energy), product / (1 + energy)


def impossible(candidates: list[Change], size: np.ndarray) -> np.ndarray:
    """Which causes have no size that acts in proportion, or none of its sign."""
    return np.array([not c.linear or (u < 0 and not c.signed) for c, u in zip(candidates, size, strict=True)], bool)


def errors_of(setting: Setting, f: Fit, candidates: list[Change]) -> np.ndarray:
    """Standard deviation of each candidate's size when added to a fit, over its usual size; NaN without one size."""
    at = about(setting, f, candidates)
    W = at.fitted * scale_of(setting, f)
    L = root_of_information(W, W.T @ W, np.ones(W.shape[1]))
    apart = forward(L, W.T @ at.further)
    energy = np.maximum(at.products[2] - np.einsum("pk,pk->k", apart, apart), 1e-300)
    return np.where([c.linear for c in candidates], 1 / np.sqrt(energy), np.nan)
