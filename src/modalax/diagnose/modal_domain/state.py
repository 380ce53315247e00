"""A hypothesis at given sizes: predicted features and their derivatives by everything unknown."""

from dataclasses import dataclass

import numpy as np

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.coordinates import (
    Coordinates,
    Modes,
    Slopes,
    direction_slopes,
    modes_of,
    pattern_slopes,
    slopes_of,
)
from modalax.diagnose.modal_domain.features import Features, paired, slopes_of_values, values_of
from modalax.diagnose.modal_domain.inaccuracy import KINDS, Inaccuracy

WILD = 1e12  # factor on a channel that no fault has
FARTHEST = 5.0  # logarithm of a factor on a modal damping that is not exceeded on the way to a fit
NONE = np.zeros(0)  # sizes where there is no cause


@dataclass(frozen=True)
class Setting:
    """Data and simulation, which all hypotheses share.

    Attributes
    ----------
    coordinates, inaccuracy, features
        The simulation, its possible inaccuracy, and the measured features.
    whitener
        Inverse of the triangular factor of the features' covariance.
    """

    coordinates: Coordinates
    inaccuracy: Inaccuracy
    features: Features
    whitener: np.ndarray

    def patterns(self) -> list[tuple[str, np.ndarray]]:
        """Kind and patterns of each group."""
        return [(KINDS[g], p) for g, p in zip(self.inaccuracy.groups, self.inaccuracy.patterns, strict=True)]


@dataclass(frozen=True)
class State:
    """Predictions of a simulation with given sizes of the inaccuracy and of causes.

    Attributes
    ----------
    difference
        Whitened measured less predicted features.
    sizes
        Of the inaccuracy's patterns.
    modes, pairs
        Predicted modes, and the number of the predicted mode that belongs to each measured one.
    plain, residues
        Predicted residues without and with faults of channels, shape ``(m, o, i)``.
    """

    difference: np.ndarray
    sizes: np.ndarray
    modes: Modes
    pairs: np.ndarray
    plain: np.ndarray
    residues: np.ndarray


def changes_of(setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...], u: np.ndarray) -> dict[str, np.ndarray]:
    """Changes of the matrices; ``sizes`` are those of the patterns, relative to the whole."""
    n = setting.coordinates.size
    out = {kind: np.zeros((n, n)) for kind in "KCM"}
    start, relative = 0, np.where(setting.inaccuracy.positive, np.expm1(np.minimum(sizes, FARTHEST)), sizes)
    for kind, patterns in setting.patterns():
        part = relative[start : start + len(patterns)]
        out[kind] += np.tensordot(part, patterns, 1)
        start += len(patterns)
    for cause, size in zip(causes, u, strict=True):
        if cause.kind:
            out[cause.kind] += size * cause.matrix
    return {f"d{kind}": value for kind, value in out.items()}


def factors_of(setting: Setting, sizes: np.ndarray) -> np.ndarray:
    """Derivatives of the relative changes of patterns by their sizes, which may be logarithms."""
    return np.where(setting.inaccuracy.positive, np.exp(np.minimum(sizes, FARTHEST)), 1.0)


def state_at(
    setting: Setting, sizes: np.ndarray, causes: tuple[Change, ...] = (), u: np.ndarray = NONE,
    pairs: np.ndarray | None = None,
) -> State:  # fmt: skip
    """Predict the features; measured and predicted modes are paired unless ``pairs`` is given.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the changed mass is not positive, or fewer modes are left than were measured.
    """
    c, f = setting.coordinates, setting.features
    modes = modes_of(c, **changes_of(setting, sizes, causes, u))
    if len(modes.poles) < len(f.poles):
        raise np.linalg.LinAlgError("fewer modes than measured")
    plain = np.einsum("ko,ki->koi", modes.vectors @ c.outputs.T, modes.vectors @ c.inputs.T)
    residues = plain
    for cause, size in zip(causes, u, strict=True):
        residues = cause.transform(size, modes.poles, residues)
    if not np.abs(residues).max(initial=0.0) < WILD * np.abs(plain).max(initial=1.0):
        raise np.linalg.LinAlgError("a channel out of all bounds")
    if pairs is None:
        pairs = paired(f, modes.poles, residues)
    values = values_of(modes.poles[pairs], residues[pairs] / f.units, f.tangent)
    return State(setting.whitener @ (f.values - values).ravel(), sizes, modes, pairs, plain, residues)


def slopes_at(setting: Setting, state: State, causes: tuple[Change, ...] = (), u: np.ndarray = NONE) -> np.ndarray:
    """Whitened derivatives of the features by the sizes of all patterns and all causes, shape ``(m, p + causes)``."""
    t = slopes_of(setting.coordinates, state.modes, state.pairs)
    parts = [pattern_slopes(t, kind, patterns) for kind, patterns in setting.patterns()]
    columns = [feature_slopes(setting, state, t, causes, u, *part) for part in parts]
    columns = [np.concatenate(columns, axis=1) * factors_of(setting, state.sizes)]
    for k, cause in enumerate(causes):
        if cause.kind:
            moved = pattern_slopes(t, cause.kind, cause.matrix[None])
            columns.append(feature_slopes(setting, state, t, causes, u, *moved))
        else:
            columns.append(_channel_slope(setting, state, t, causes, u, k))
    return setting.whitener @ np.concatenate(columns, axis=1)


def screening_slopes(
    setting: Setting, state: State, candidates: list[Change], causes: tuple[Change, ...] = (),
    u: np.ndarray = NONE,
) -> np.ndarray:  # fmt: skip
    """Whitened derivatives by sizes of further causes at zero, ``(m, candidates)``; zero for causes without a size."""
    t = slopes_of(setting.coordinates, state.modes, state.pairs)
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
    for k, c in enumerate(candidates):
        if not c.kind and c.sized:
            out[:, k] = _channel_slope(setting, state, t, (*causes, c), np.append(u, 0.0), len(causes))[:, 0]
    return setting.whitener @ out


def feature_slopes(
    setting: Setting, state: State, t: Slopes, causes: tuple[Change, ...], u: np.ndarray,
    dpoles: np.ndarray, dout: np.ndarray, dinn: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Derivatives of the features by changes of poles and shapes."""
    f = setting.features
    moved = dout[..., None] * t.shape_inputs[:, None, None, :] + t.shape_outputs[:, None, :, None] * dinn[:, :, None]
    k, p = dpoles.shape
    for cause, size in zip(causes, u, strict=True):
        if not cause.kind:
            flat = moved.reshape(k * p, *moved.shape[2:])
            moved = cause.transform(size, np.repeat(t.poles, p), flat).reshape(moved.shape)
    slopes = slopes_of_values(
        t.poles, state.residues[state.pairs] / f.units, f.tangent, dpoles, moved / f.units[:, None]
    )
    return slopes.reshape(-1, p)


def _channel_slope(
    setting: Setting, state: State, t: Slopes, causes: tuple[Change, ...], u: np.ndarray, which: int
) -> np.ndarray:
    """Derivative by the size of one channel's fault."""
    f = setting.features
    residues = state.plain[state.pairs]
    for k, (cause, size) in enumerate(zip(causes, u, strict=True)):
        act = cause.transform_slope if k == which else cause.transform
        residues = act(size, t.poles, residues)
    still = np.zeros((len(t.poles), 1), complex)
    moved = (residues / f.units)[:, None]
    return slopes_of_values(t.poles, state.residues[state.pairs] / f.units, f.tangent, still, moved).reshape(-1, 1)
