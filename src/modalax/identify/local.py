r"""Fits of each group of modes where it dominates, for data that no single linear model explains.

Noise estimated from the residual weighs every row of the FRF matrix by its own size. Where rows contradict each other,
as those of a hammer that roves over a structure whose frequencies depend on the amplitude, many quiet rows then outvote
the few loud ones that hold most of the response. Least squares over all lines is no way out, for modes that are hardly
excited run off to absorb what the loud ones leave. So every group of close modes is fitted in a window of its own.
"""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import as_array
from modalax.data.frf import FRF
from modalax.identify.ascent import STATISTICAL
from modalax.identify.host import PRECISE
from modalax.identify.information import covariance
from modalax.identify.kernels import residual_terms
from modalax.identify.maximum import Maximum, Modal, Samples, linear_fit, maximise, response
from modalax.identify.plain import modal_of, model_of, samples_of, shorter_side
from modalax.identify.refine import CONTRADICTION, CORRELATED, OUT_OF_STEPS, UNIT, Refined
from modalax.identify.whiteness import whiteness_of

WIDTH, LINES = 8.0, 16  # reach of a mode's window in half-bandwidths, and at least in lines, on either side
SWEEPS = 3  # passes over all groups, each fitted with the responses of the others taken out
GAIN = 0.01  # part of the FRFs' sum of squares that other poles must explain to be taken
FOLDS = 8  # groups of rows, of which one is left out at a time, for the standard deviations


class _Group(NamedTuple):
    """Close modes, as indices into the model, and the lines of their window."""

    modes: np.ndarray
    window: slice


class Moved(NamedTuple):
    """A group of modes with its poles by least squares, and deviations of frequency [Hz] and damping."""

    modes: np.ndarray
    poles: np.ndarray
    frequency_std_hz: np.ndarray
    damping_std: np.ndarray


def fit_where_dominant(frf: FRF, refined: Refined, **options: Any) -> Refined:
    r"""The result with poles and shapes by least squares in windows where that explains far more of the response.

    In a window of ``WIDTH`` half-bandwidths about each group of close modes the responses of all others are taken out,
    and :math:`\sum|H - \hat H|^2` is minimised there; residual terms of the window's own stand for what lies around.
    If other poles explain ``GAIN`` or more of the FRFs' whole sum of squares, they are taken. Then shapes are fitted in
    the same windows, every channel weighed by its own residual there, and last the residual terms of the whole band.

    Parameters
    ----------
    frf
        The FRF.
    refined
        A result of maximum likelihood for it.
    options
        ``residuals`` and ``real_modes``, as for :func:`residues`.

    Returns
    -------
    Refined
        As it was if no group gains so much. Else deviations of the poles that were taken are the larger of the robust
        ones and those of a delete-a-group jackknife over ``FOLDS`` groups of neighbouring rows of the longer axis
        (Efron 1982); those of the other poles, of shapes and modal masses, and the evidence, stay as they were.
    """
    samples, model = samples_of(frf, **options), modal_of(refined.model)
    groups = _groups(samples, model)
    moved = _moved(samples, model, groups)
    if not moved:
        return refined
    poles = model.poles.copy()
    for group in moved:
        poles[group.modes] = group.poles
    parts = _shapes(samples, poles, groups)
    rank = np.concatenate([g.modes for g in groups])
    order = np.argsort(np.abs(poles[rank]))
    join = lambda k: np.concatenate([part[k] for part in parts])[order]
    bare = Modal(join(0), join(1), join(2), 0 * model.upper, 0 * model.lower)
    upper, lower = _terms(_without(samples, [bare]))
    whole = bare._replace(upper=upper, lower=lower)
    return _with_model(frf, samples, _with_errors(refined, moved), whole.normalised(), rank[order])


def _groups(samples: Samples, model: Modal) -> list[_Group]:
    """Modes of which one lies in the window of another, and so on from one to the next."""
    freq = samples.omega / (2 * np.pi)
    f, width = np.abs(model.poles) / (2 * np.pi), -model.poles.real / (2 * np.pi)
    reach = np.maximum(WIDTH * width, LINES * np.median(np.diff(freq)))
    label = np.arange(len(f))
    for a in range(len(f)):
        for b in range(a):
            if abs(f[a] - f[b]) < max(reach[a], reach[b]):
                label[label == label[a]] = label[b]
    groups = []
    for k in np.unique(label):
        g = np.flatnonzero(label == k)
        first, last = np.searchsorted(freq, (f[g] - reach[g]).min()), np.searchsorted(freq, (f[g] + reach[g]).max())
        # A neighbour's resonance must stay out, so the window is rather too narrow.
        size = int(2 ** (np.floor(4 * np.log2(max(last - first, 4 * len(g)))) / 4))
        size = min(max(size, 4 * len(g)), len(freq))
        start = int(np.clip((first + last - size) // 2, 0, len(freq) - size))
        groups.append(_Group(g, slice(start, start + size)))
    return groups


def _moved(samples: Samples, model: Modal, groups: list[_Group]) -> list[Moved]:
    """The groups that explain far more with other poles."""
    need = GAIN * float(np.sum(np.abs(samples.H) ** 2))
    if float(np.sum(np.abs(samples.H - response(model, samples)) ** 2)) < need:
        return []
    parts = [_bare(model.pick(g.modes)) for g in groups]
    taken: dict[int, tuple[Samples, Maximum]] = {}
    for _ in range(SWEEPS):
        start, taken = list(parts), {}
        for k, g in enumerate(groups):
            if float(np.sum(np.abs(samples.H[g.window]) ** 2)) < need:
                continue
            rest = _rest(samples, parts, k, g.window)
            parts[k], error = linear_fit(rest, rest.projection(np.ones(rest.H.shape)), model.poles[g.modes])
            left = float(np.sum(np.abs(error) ** 2))
            if left < need:
                continue
            free = _free(rest, start[k].poles, shorter_side(parts[k], rest))
            if free is not None and left - float(np.sum(np.abs(free.error) ** 2)) > need:
                parts[k] = free.model
                taken[k] = rest, free
    return [Moved(groups[k].modes, free.model.poles, *_jackknife(rest, free)) for k, (rest, free) in taken.items()]


def _bare(model: Modal) -> Modal:
    """Without residual terms, which each window has of its own."""
    return model._replace(upper=0 * model.upper, lower=0 * model.lower)


def _shapes(samples: Samples, poles: np.ndarray, groups: list[_Group]) -> list[Modal]:
    """Shapes in each window; from the second sweep on every channel is weighed by its own residual there."""
    parts: list[Modal] = []
    for sweep in range(1 + SWEEPS):
        for k, g in enumerate(groups):
            rest = _rest(samples, parts, k, g.window)
            sigma = np.ones(rest.H.shape)
            if sweep:
                left = rest.H - response(parts[k], rest)
                floor = 1e-24 * np.max(np.abs(rest.H)) ** 2 + 1e-300
                sigma = np.sqrt(np.maximum(np.mean(np.abs(left) ** 2, axis=0), floor)) * sigma
            part, _ = linear_fit(rest, rest.projection(sigma), poles[g.modes])
            parts = [*parts[:k], part, *parts[k + 1 :]]
    return parts


def _rest(samples: Samples, parts: list[Modal], own: int, window: slice) -> Samples:
    """A window less the responses of the other groups, without the residual terms that were fitted beside them."""
    cut = samples._replace(s=samples.s[window], H=samples.H[window])
    return _without(cut, [p for j, p in enumerate(parts) if j != own])


def _without(samples: Samples, parts: list[Modal]) -> Samples:
    H = samples.H
    for part in parts:
        H = H - response(_bare(part), samples)
    return samples._replace(H=H)


def _free(samples: Samples, poles: np.ndarray, participation: np.ndarray, tol: float = PRECISE) -> Maximum | None:
    """Least squares with free poles; None where it found none in the neighbourhood of the start."""
    result = maximise(samples, poles, participation, np.ones(samples.H.shape), known=False, tol=tol)
    return result if result.reason in (0, OUT_OF_STEPS) else None


def _jackknife(samples: Samples, whole: Maximum) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of frequencies [Hz] and damping ratios, a group of neighbouring rows left out at a time."""
    axis = 2 if samples.turned else 1
    cov = covariance(
        whole.projection, whole.at, kind="robust", inflate=whole.inflate, white=whole.whiteness >= CORRELATED
    )  # fmt: skip
    std = np.sqrt(np.maximum(np.diag(cov), 0)).reshape(whole.at.theta.shape)
    stated = whole.frequency_hz * std[:, 0], whole.damping_ratio * std[:, 1]
    if samples.H.shape[axis] < FOLDS:
        return stated
    found: list[np.ndarray] = []
    for fold in np.array_split(np.arange(samples.H.shape[axis]), FOLDS):
        cut = np.moveaxis(samples.H.copy(), axis, 0)
        cut[fold] = 0.0  # a row of zeros counts nothing
        part = samples._replace(H=np.moveaxis(cut, 0, axis))
        result = _free(part, whole.model.poles, shorter_side(whole.model, samples), STATISTICAL)
        if result is not None:
            found.append(np.stack([result.frequency_hz, result.damping_ratio]))
    values = np.array(found).reshape(-1, 2, len(stated[0]))
    n = max(len(values), 2)
    spread = np.sqrt((n - 1) / n * np.sum((values - values.mean(axis=0)) ** 2, axis=0)) if len(values) else stated
    return np.maximum(spread[0], stated[0]), np.maximum(spread[1], stated[1])


def _terms(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower residual terms of each channel by least squares over the band."""
    lines, n_out, n_in = samples.H.shape
    zero = np.zeros((n_out, n_in), complex)
    if samples.residuals == "none":
        return zero, zero
    use = (samples.s != 0) | (samples.power == 2)
    top = np.max(samples.omega)
    columns = residual_terms(samples.s[use], samples.power, "real")
    data = samples.H[use].reshape(int(use.sum()), -1)
    if samples.residuals == "real":
        columns, data = (np.concatenate([a.real, a.imag]) for a in (columns, data))
    x = np.linalg.lstsq(columns, data, rcond=None)[0].astype(complex).reshape(2, n_out, n_in)
    return x[0] / top**samples.power, x[1] / top ** (samples.power - 2)


def _with_errors(refined: Refined, moved: list[Moved]) -> Refined:
    """Deviations of moved poles in the place of those they had; correlations stay."""
    f_std, zeta_std = np.array(refined.frequency_std_hz), np.array(refined.damping_std)
    scale = np.ones((len(f_std), 2))
    for group in moved:
        k = group.modes
        size = np.abs(group.poles)
        new = (2 * np.pi * group.frequency_std_hz / size, -group.damping_std * size / group.poles.real)
        old = np.sqrt(np.diag(np.asarray(refined.covariance)).reshape(-1, 2)[k])
        scale[k] = np.where(old > 0, np.stack(new, axis=1) / np.where(old > 0, old, 1.0), 1.0)
        f_std[k], zeta_std[k] = group.frequency_std_hz, group.damping_std
    flat = scale.ravel()
    return dataclasses.replace(
        refined, frequency_std_hz=as_array(f_std), damping_std=as_array(zeta_std),
        covariance=as_array(flat[:, None] * np.asarray(refined.covariance) * flat),
    )  # fmt: skip


def _with_model(frf: FRF, samples: Samples, refined: Refined, model: Modal, rank: np.ndarray) -> Refined:
    """The result with another model, its modes the old ones in the order ``rank``, and its plain residual."""
    sigma = UNIT * np.sqrt(np.mean(np.abs(samples.H) ** 2))
    residual = (samples.H - response(model, samples)) / sigma
    chi2 = 2 * np.sum(np.abs(residual) ** 2)
    pairs = (2 * rank[:, None] + np.arange(2)).ravel()
    take = lambda a, k=rank: None if a is None else as_array(np.asarray(a)[k])
    return dataclasses.replace(
        refined, model=model_of(model, frf), frequency_std_hz=take(refined.frequency_std_hz),
        damping_std=take(refined.damping_std), shape_std=take(refined.shape_std),
        modal_mass_std=take(refined.modal_mass_std), covariance=take(refined.covariance, np.ix_(pairs, pairs)),
        evidence=take(refined.evidence), chi2=as_array(chi2), residual=as_array(residual),
        noise_scale=as_array(np.sqrt(chi2 / float(refined.dof)) * sigma),
        whiteness=as_array(whiteness_of(residual)),
        log_likelihood=as_array(-0.5 * chi2 + 2 * residual.size * np.log(np.sqrt(2.0) / sigma)),
        success=jnp.array(True), reason_code=jnp.array(CONTRADICTION),
    )  # fmt: skip
