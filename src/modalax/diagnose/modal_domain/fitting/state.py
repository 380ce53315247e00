"""A hypothesis at given sizes: predicted features and their derivatives by everything unknown."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dtrmm, dtrmv

from modalax.diagnose.deadline import NEVER, Deadline
from modalax.diagnose.modal_domain.causes.change import Change, hysteretic_share, with_sizes
from modalax.diagnose.modal_domain.causes.further_causes import MissingMode, hysteretic_poles
from modalax.diagnose.modal_domain.causes.line_forces import ModalForce, loads_of
from modalax.diagnose.modal_domain.fitting.directions import along_features, by_features
from modalax.diagnose.modal_domain.fitting.inaccuracy import KINDS, Inaccuracy
from modalax.diagnose.modal_domain.modes.features import Features, paired
from modalax.diagnose.modal_domain.modes.repeated import Together, further
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, Modes, modes_of
from modalax.diagnose.modal_domain.structure.factored import Factored
from modalax.diagnose.modal_domain.structure.slopes import (
    Slopes,
    direction_slopes,
    factored_slopes,
    load_slopes,
    pattern_slopes,
    slopes_of,
)

WILD = 1e12  # factor on a channel that no fault has
UNSEEN = 1e-12  # residues of a mode, relative to the largest of all, below which no channel sees it
FARTHEST = 5.0  # logarithm of a factor on a modal damping that is not exceeded on the way to a fit
HARDLY = 0.2  # size of a mode's residues, relative to the measured ones, below which the simulation hardly shows it
UNSIZED = 1.0  # deviation of the logarithm of a mode's size from which on its size is not known: of shapes alone
NONE = np.zeros(0)  # sizes where there is no cause
NO_TWO = np.zeros((0, 2), int)  # no modes of one pole


@dataclass(frozen=True)
class Setting:
    """Data and simulation, which all hypotheses share.

    Attributes
    ----------
    coordinates, inaccuracy, features
        The simulation, its possible inaccuracy, and the measured features.
    whitener
        Inverse of a root of the features' covariance, that of the rest included.
    rest
        Relative size of what no element explains (:mod:`modalax.diagnose.modal_domain.fitting.discrepancy`), as far as
        it is part of that covariance.
    sought
        Of what a factor throughout is looked for: ``stiffness``, ``mass``.
    uneven
        Whether elements may be off unevenly.
    late
        When fits end where they are.
    """

    coordinates: Coordinates
    inaccuracy: Inaccuracy
    features: Features
    whitener: np.ndarray
    rest: float = 0.0
    sought: tuple[str, ...] = ()
    uneven: bool = False
    late: Deadline = NEVER

    def patterns(self, causes: tuple[Change, ...] = (), u: np.ndarray = NONE) -> list[tuple[str, Factored]]:
        """Kind and patterns of each group; those of damping as causes turn them."""
        out = [(KINDS[g], p) for g, p in zip(self.inaccuracy.groups, self.inaccuracy.factors, strict=True)]
        for turn in filter(lambda T: T is not None, (cause.turn(size) for cause, size in with_sizes(causes, u))):
            out = [(kind, p.turned(turn) if kind == "C" else p) for kind, p in out]
        return out

    @cached_property
    def triangle(self) -> np.ndarray:
        """The upper triangular root that makes the same scalar products as ``whitener``, in half of the products."""
        W = self.whitener
        if not np.tril(W, -1).any() and (np.diag(W) > 0).all():
            return W
        R = np.linalg.qr(W, mode="r")
        return np.copysign(1.0, np.diag(R))[:, None] * R  # the only one, which changes little where a covariance does

    @cached_property
    def linear(self) -> np.ndarray:
        """Measured sizes of residues of modes that the simulation hardly shows, NaN of all others, shape ``(k,)``.

        Where a symmetric structure is measured, its simulation shows no mode whose node a force is at; what is
        measured of it is linear in the errors of elements. Shapes without a size show in any simulation.
        """
        c, f = self.coordinates, self.features
        modes = modes_of(c)
        residues = modes.residues(c)
        if len(modes.poles) < len(f.poles):
            return np.full(len(f.poles), np.nan)
        size = lambda A: np.sqrt((np.abs(A / f.units) ** 2).sum(axis=(1, 2)))
        measured = np.sqrt((np.abs(f.residues) ** 2).sum(axis=(1, 2)))
        shown_at_all = size(residues[paired(f, modes.poles, residues)])
        sized = np.diag(f.covariance).reshape(f.values.shape)[:, 2] < UNSIZED**2
        return np.where(sized & (shown_at_all < HARDLY * measured), measured, np.nan)


@dataclass(frozen=True)
class State:
    """Predictions of a simulation with given sizes of the inaccuracy and of causes.

    Attributes
    ----------
    difference
        Whitened measured less predicted features.
    sizes
        Of the inaccuracy's patterns.
    modes, together
        Predicted modes, and which of them are in the place of the measured ones.
    plain, residues
        Predicted residues without and with faults of channels, shape ``(m, o, i)``.
    """

    difference: np.ndarray
    sizes: np.ndarray
    modes: Modes
    together: Together
    plain: np.ndarray
    residues: np.ndarray

    @property
    def pairs(self) -> np.ndarray:
        """Number of the predicted mode that belongs to each measured one."""
        return self.together.pairs


def changes_of(setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...], u: np.ndarray) -> dict[str, np.ndarray]:
    """Changes of the matrices; ``sizes`` are those of the patterns, relative to the whole."""
    out = off_by(setting, sizes, causes, u)
    for cause, size in with_sizes(causes, u):
        for kind, change in cause.changes(size).items() if cause.local else ():
            out[kind] += change
    return {f"d{kind}": value for kind, value in out.items()}


def off_by(setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...], u: np.ndarray) -> dict[str, np.ndarray]:
    """What the matrices are off by beside causes, by ``K``, ``C`` and ``M``."""
    n = setting.coordinates.size
    out = {kind: np.zeros((n, n)) for kind in "KCM"}
    start, relative = 0, np.where(setting.inaccuracy.positive, np.expm1(np.minimum(sizes, FARTHEST)), sizes)
    for kind, patterns in setting.patterns(causes, u):
        out[kind] += patterns.combined(relative[start : start + len(patterns.first)])
        start += len(patterns.first)
    return out


def matrices_of(
    setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...], u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping and stiffness in modal coordinates; a hysteretic share of it makes the stiffness complex."""
    c, change = setting.coordinates, changes_of(setting, sizes, causes, u)
    M, C, K = np.eye(c.size) + change["dM"], c.damping + change["dC"], np.diag(c.frequencies**2) + change["dK"]
    share = hysteretic_share(causes, u)
    return (M, (1 - share) * C, K + 1j * share * hysteretic(c, C)) if share else (M, C, K)


def hysteretic(c: Coordinates, C: np.ndarray) -> np.ndarray:
    """Damping of modes at their own frequencies as an imaginary stiffness, shape ``(..., n, n)``."""
    root = np.sqrt(c.frequencies)
    return root[:, None] * C * root


def free_directions(setting: Setting, causes: tuple[Change, ...]) -> np.ndarray | None:
    """Orthonormal whitened directions of the modes that causes leave free; None where there are none."""
    freed = [c.freed for c in causes if c.freed is not None]
    if not freed:
        return None
    width = setting.features.width
    return np.linalg.qr(setting.triangle[:, np.concatenate([np.arange(width) + width * k for k in freed])])[0]


def whitened(setting: Setting, values: np.ndarray, causes: tuple[Change, ...]) -> np.ndarray:
    """Whitened features, or derivatives of them, less what is free."""
    turned = setting.triangle.T  # as the library stores matrices
    out = dtrmv(turned, values, lower=1, trans=1) if values.ndim == 1 else dtrmm(1.0, turned, values.T, 1, 1).T
    free = free_directions(setting, causes)
    return out if free is None else out - free @ (free.T @ out)


def evidence_of_free(setting: Setting, causes: tuple[Change, ...]) -> float:
    r"""Log evidence of the features of modes that are left free, :math:`p\,(2\pi)^{w/2}\det(W^TW)^{-1/2}` of each."""
    width, total = setting.features.width, 0.0
    for cause in causes:
        if isinstance(cause, MissingMode):
            block = setting.whitener[:, width * cause.number : width * (cause.number + 1)]
            size = np.abs(np.diag(np.linalg.qr(block, mode="r")))
            total += cause.log_density + 0.5 * width * math.log(2 * math.pi) - float(np.log(size).sum())
    return total


def pairs_with(features: Features, causes: tuple[Change, ...], poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """Predicted mode of each measured one; of those left free just the nearest."""
    kept = np.ones(len(features.poles), bool)
    kept[[c.freed for c in causes if c.freed is not None]] = False
    if kept.all():
        return paired(features, poles, residues)
    apart = np.abs(np.log(np.abs(features.poles))[:, None] - np.log(np.abs(poles)))
    out = np.argmin(np.where(np.abs(residues).max(axis=(1, 2)) > 0, apart, np.inf), axis=1)
    if kept.any():
        out[kept] = paired(features, poles, residues, kept)
    return out


def unseen(
    features: Features, causes: tuple[Change, ...], poles: np.ndarray, residues: np.ndarray, pairs: np.ndarray
) -> float:
    """Chi-square of modes that are predicted among the measured ones, and not measured.

    Only where a measured mode is left free: it has not one too few where it lacks another. Residues that were not
    measured count as measured to be nothing, with the uncertainty of the others.
    """
    freed = [c.freed for c in causes if c.freed is not None]
    if not freed:
        return 0.0
    size = np.abs(features.poles)
    lone = np.ones(len(poles), bool)
    lone[np.delete(pairs, freed)] = False
    lone &= (np.abs(poles) > size.min()) & (np.abs(poles) < size.max())
    return float((np.abs(residues[lone] / np.median(features.units, axis=0)) ** 2).sum())


def factors_of(setting: Setting, sizes: np.ndarray) -> np.ndarray:
    """Derivatives of the relative changes of patterns by their sizes, which may be logarithms."""
    return np.where(setting.inaccuracy.positive, np.exp(np.minimum(sizes, FARTHEST)), 1.0)


def state_at(setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...] = (), u: np.ndarray = NONE) -> State:
    """Predict the features.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the changed mass is not positive, or fewer modes are left than were measured.
    """
    c, f = setting.coordinates, setting.features
    modes = modes_of(c, **changes_of(setting, sizes, causes, u), loads=loads_of(causes, u))
    plain = modes.residues(c)
    share = hysteretic_share(causes, u)
    if share:
        modes = replace(modes, poles=hysteretic_poles(modes.poles, share))
    seen = np.abs(plain[np.abs(modes.poles) < c.end]).max(axis=(1, 2), initial=0.0)
    needed = np.isnan(setting.linear).sum() - sum(cause.freed is not None for cause in causes)
    if np.count_nonzero(seen > UNSEEN * seen.max(initial=0.0)) < needed:  # the spare coordinate is none
        raise np.linalg.LinAlgError("fewer modes than measured")
    residues = plain
    for cause, size in with_sizes(causes, u):
        residues = cause.at_modes(size, modes.poles, residues)
    if not np.abs(residues).max(initial=0.0) < WILD * np.abs(plain).max(initial=1.0):
        raise np.linalg.LinAlgError("a channel out of all bounds")
    pairs = pairs_with(f, causes, modes.poles, residues)
    if (np.abs(modes.poles[pairs]) > c.end).any():
        raise np.linalg.LinAlgError("a mode measured has no partner but the spare coordinate")
    together, mean, whole = compared(f, modes.poles, residues, pairs)
    difference = (f.values - f.predicted(mean, whole, setting.linear)).ravel()
    return State(whitened(setting, difference, causes), sizes, modes, together, plain, residues)


def compared(
    f: Features, poles: np.ndarray, residues: np.ndarray, pairs: np.ndarray
) -> tuple[Together, np.ndarray, np.ndarray]:
    """Predicted modes in the place of the measured ones, and their poles and residues in units of the channels."""
    together = further(f.groups, f.along, poles, residues, pairs)
    mean, whole = together.seen(f.along, poles, residues)
    return together, mean, whole / f.units


def _slopes_of(setting: Setting, state: State, causes: tuple[Change, ...]) -> Slopes:
    """Slopes along the directions of the features, where these are fewer than the channels, which have no faults."""
    t, f = slopes_of(setting.coordinates, state.modes, state.together.every), setting.features
    o, i = f.residues.shape[1:]
    if f.tangent.shape[1] >= o + i - 1 or any(c.in_channels for c in causes):
        return t
    return by_features(t, f, state.together, _whole(f, state))


def _whole(f: Features, state: State) -> np.ndarray:
    """Residues in the place of the measured ones, in units of the channels, shape ``(k, o, i)``."""
    return state.together.seen(f.along, state.modes.poles, state.residues)[1] / f.units


def slopes_at(setting: Setting, state: State, causes: tuple[Change, ...] = (), u: np.ndarray = NONE) -> np.ndarray:
    """Whitened derivatives of the features by the sizes of all patterns and those of causes, shape ``(m, p + u)``."""
    t = _slopes_of(setting, state, causes)
    moves = zip(*(factored_slopes(t, kind, patterns) for kind, patterns in setting.patterns(causes, u)), strict=True)
    every = (np.concatenate(part, axis=1) for part in moves)
    columns = [feature_slopes(setting, state, t, causes, u, *every) * factors_of(setting, state.sizes)]
    for k, (cause, size) in enumerate(with_sizes(causes, u)):
        if not cause.local:
            columns.append(_channel_slope(setting, state, t, causes, u, k))
            continue
        if isinstance(cause, ModalForce):
            for change, slope in cause.slopes_at(size, t.poles):
                moved = load_slopes(t, cause.basis[None], change[:, None], slope[:, None])
                columns.append(feature_slopes(setting, state, t, causes, u, *moved))
            continue
        for by in cause.slopes(size):
            moves = zip(*(pattern_slopes(t, kind, change[None]) for kind, change in by.items()), strict=True)
            columns.append(feature_slopes(setting, state, t, causes, u, *(sum(m) for m in moves)))
        if cause.in_channels:
            columns[-1] = columns[-1] + _channel_slope(setting, state, t, causes, u, k)
    return whitened(setting, np.concatenate(columns, axis=1), causes)


def screening_slopes(
    setting: Setting, state: State, candidates: list[Change], causes: tuple[Change, ...] = (),
    u: np.ndarray = NONE,
) -> np.ndarray:  # fmt: skip
    """Whitened derivatives by sizes of further causes at zero, ``(m, candidates)``; zero for causes without a size."""
    t = _slopes_of(setting, state, causes)
    out = np.zeros((len(setting.whitener), len(candidates)))
    for kind in "KCM":
        which = [k for k, c in enumerate(candidates) if c.kind == kind and c.pattern is None]
        for start in range(0, len(which), 200):
            some = which[start : start + 200]
            moved = direction_slopes(t, kind, np.array([candidates[k].direction for k in some]))
            scales = np.array([candidates[k].scale for k in some])
            out[:, some] = feature_slopes(setting, state, t, causes, u, *moved) * scales
        whole = [k for k, c in enumerate(candidates) if c.kind == kind and c.pattern is not None]
        if whole:
            moved = pattern_slopes(t, kind, np.stack([candidates[k].matrix for k in whole]))
            out[:, whole] = feature_slopes(setting, state, t, causes, u, *moved)
    for some in _alike([k for k, c in enumerate(candidates) if isinstance(c, ModalForce)], candidates):
        forces = [candidates[k] for k in some]
        by = [f.slopes_at(f.of_size(0.0), t.poles)[0] for f in forces if isinstance(f, ModalForce)]
        change, slope = (np.stack(parts, axis=1) for parts in zip(*by, strict=True))
        basis = np.stack([f.basis for f in forces if isinstance(f, ModalForce)])
        out[:, some] = feature_slopes(setting, state, t, causes, u, *load_slopes(t, basis, change, slope))
    for k, c in enumerate(candidates):
        if c.in_channels and c.linear:
            out[:, k] += _channel_slope(setting, state, t, (*causes, c), np.append(u, 0.0), len(causes))[:, 0]
    return whitened(setting, out, causes)


def _alike(which: list[int], candidates: list[Change]) -> list[list[int]]:
    """Forces of as many directions each, a number of them at once."""
    kinds = {candidates[k].slug for k in which}
    groups = [[k for k in which if candidates[k].slug == slug] for slug in sorted(kinds)]
    return [group[start : start + 200] for group in groups for start in range(0, len(group), 200)]


def feature_slopes(
    setting: Setting, state: State, t: Slopes, causes: tuple[Change, ...], u: np.ndarray,
    dpoles: np.ndarray, dout: np.ndarray, dinn: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Derivatives of the features by changes of poles and shapes."""
    if t.along:
        own = np.linalg.norm(_whole(setting.features, state), axis=(1, 2))
        return along_features(t, state.together, own, dpoles, dout, dinn, setting.linear)
    moved = dout[..., None] * t.shape_inputs[:, None, None, :] + t.shape_outputs[:, None, :, None] * dinn[:, :, None]
    k, p = dout.shape[:2]
    moved = _in_channels(causes, u, np.repeat(t.poles, p), moved.reshape(k * p, *moved.shape[2:])).reshape(moved.shape)
    a, b = t.two
    both = np.einsum("ro,ri->roi", t.shape_outputs[a], t.shape_inputs[b])
    both = both + np.einsum("ro,ri->roi", t.shape_outputs[b], t.shape_inputs[a])
    turned = dpoles[k:, :, None, None] * _in_channels(causes, u, t.poles[a], both)[:, None]
    return in_features(setting, state, dpoles[:k], moved, t.repeated, turned).reshape(-1, p)


def _in_channels(causes: tuple[Change, ...], u: np.ndarray, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """Changes of residues as faults of channels show them."""
    for cause, size in with_sizes(causes, u):
        if cause.in_channels:
            residues = cause.at_modes(size, poles, residues)
    return residues


def in_features(
    setting: Setting, state: State, dpoles: np.ndarray, dresidues: np.ndarray, repeated: np.ndarray = NO_TWO,
    turned: np.ndarray = NO_TWO,
) -> np.ndarray:  # fmt: skip
    """Derivatives of the features by those of all modes in their place, and by what those of one pole turn."""
    f, seen, row, more = setting.features, state.together, state.together.row, {}
    for (a, b), change in zip(repeated, turned, strict=True):
        if row[a] == row[b]:
            more[row[a]] = more.get(row[a], 0.0) + change
    poles, residues = state.modes.poles, state.residues
    mean, whole = seen.seen(f.along, poles, residues)
    dmean, dwhole = seen.moved(f.along, poles, residues, dpoles, dresidues, more)
    return f.slopes(mean, whole / f.units, dmean, dwhole / f.units[:, None], setting.linear)


def _channel_slope(
    setting: Setting, state: State, t: Slopes, causes: tuple[Change, ...], u: np.ndarray, which: int
) -> np.ndarray:
    """Derivative by the size of one channel's fault."""
    residues = state.plain[state.together.every]
    for k, (cause, size) in enumerate(with_sizes(causes, u)):
        act = cause.slope_at_modes if k == which else cause.at_modes
        residues = act(size, t.poles, residues)
    return in_features(setting, state, np.zeros((len(t.poles), 1), complex), residues[:, None]).reshape(-1, 1)
