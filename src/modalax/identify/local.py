r"""Modes fitted each where it dominates, for data that no one linear model explains.

Noise read off the residual weighs every row of the FRF matrix by its own size. Where rows contradict each other, as
those of a hammer that roves over a structure whose frequencies depend on the amplitude, many quiet rows then outvote
the few loud ones that hold most of the response. Least squares over all lines is no way out, for modes that are hardly
excited run off to absorb what the loud ones leave. So every group of close modes is fitted in a window of its own.
"""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.refine import CONTRADICTION, OUT_OF_STEPS, UNIT, Refined, refine, whiteness_of
from modalax.identify.residues import residues
from modalax.model.modal import ModalModel

WIDTH, LINES = 8.0, 16  # reach of a mode's window in half-bandwidths, and at least in lines, on either side
SWEEPS = 3  # over all groups, each with the responses of the others taken out
GAIN = 0.01  # part of the FRFs' sum of squares that other poles must explain to be taken
FOLDS = 8  # of the rows, for the errors
SLOTS = 4  # numbers of modes are rounded up to multiples of this, so that few functions are compiled


class _Group(NamedTuple):
    """Close modes, as indices into the model, and the lines of their window."""

    modes: np.ndarray
    window: slice


class Moved(NamedTuple):
    """A group of modes with its poles by least squares, and their deviations from row to row."""

    modes: np.ndarray
    model: ModalModel
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
    groups = _groups(frf, refined.model)
    moved = _moved(frf, refined.model, groups, **options)
    if not moved:
        return refined
    poles = np.array(refined.model.poles)
    for group in moved:
        poles[group.modes] = np.asarray(group.model.poles)
    parts = _shapes(frf, poles, groups, **options)
    rank = np.concatenate([g.modes for g in groups])
    order = np.argsort(np.abs(poles[rank]))
    join = lambda name: jnp.concatenate([getattr(p, name) for p in parts])[order]  # noqa: E731
    bare = parts[0].replace(
        poles=join("poles"), shapes=join("shapes"), participation=join("participation"), upper=0 * parts[0].upper,
        lower=0 * parts[0].lower, frequency_std=0.0, damping_std=0.0,
    )  # fmt: skip
    upper, lower = _terms(_without(frf, [bare]), options.get("residuals", "complex"))
    whole = bare.replace(upper=upper, lower=lower).normalised("max")
    return _with_model(frf, _with_errors(refined, moved), whole, rank[order])


def _groups(frf: FRF, model: ModalModel) -> list[_Group]:
    """Modes of which one lies in the window of another, and so on from one to the next."""
    f, width, freq = np.asarray(model.frequency_hz), -np.asarray(model.poles.real) / (2 * np.pi), np.asarray(frf.freq)
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
        # One of few sizes, so that few functions are compiled; not more, for a neighbour's resonance must stay out.
        size = int(2 ** (np.floor(4 * np.log2(max(last - first, 4 * len(g)))) / 4))
        size = min(max(size, 4 * len(g)), len(freq))
        start = int(np.clip((first + last - size) // 2, 0, len(freq) - size))
        groups.append(_Group(g, slice(start, start + size)))
    return groups


def _moved(frf: FRF, model: ModalModel, groups: list[_Group], **options: Any) -> list[Moved]:
    """The groups that explain far more with other poles."""
    need = GAIN * float(jnp.sum(jnp.abs(frf.H) ** 2))
    parts = [_pick(model, g.modes) for g in groups]
    taken: dict[int, tuple[FRF, Refined]] = {}
    for _ in range(SWEEPS):
        start, taken = list(parts), {}
        for k, g in enumerate(groups):
            rest = _rest(frf, parts, k, g.window)
            if float(jnp.sum(jnp.abs(frf.H[g.window]) ** 2)) < need:
                continue
            parts[k] = residues(rest, model.poles[g.modes], weights="unit", **options)
            if _left(rest, parts[k]) < need:
                continue
            free = _free(rest, parts[k].replace(poles=start[k].poles), **options)
            if free is not None and _left(rest, parts[k]) - _left(rest, free.model) > need:
                parts[k] = free.model
                taken[k] = rest, free
    return [Moved(groups[k].modes, free.model, *_jackknife(rest, free, **options)) for k, (rest, free) in taken.items()]


def _pick(model: ModalModel, which: np.ndarray) -> ModalModel:
    return model.replace(
        poles=model.poles[which], shapes=model.shapes[which], participation=model.participation[which],
        frequency_std=0.0, damping_std=0.0,
    )  # fmt: skip


def _shapes(frf: FRF, poles: np.ndarray, groups: list[_Group], **options: Any) -> list[ModalModel]:
    """Shapes in each window; from the second sweep on every channel is weighed by its own residual there."""
    parts: list[ModalModel] = []
    for sweep in range(1 + SWEEPS):
        for k, g in enumerate(groups):
            rest = _rest(frf, parts, k, g.window)
            weights = "unit"
            if sweep:
                power = jnp.mean(jnp.abs(rest.H - _made(rest, parts[k])) ** 2, axis=0)
                floor = 1e-24 * jnp.max(jnp.abs(rest.H)) ** 2 + 1e-300
                weights = jnp.broadcast_to(jnp.sqrt(jnp.maximum(power, floor)), rest.H.shape)
            part = residues(rest, poles[g.modes], weights=weights, **options)
            parts = [*parts[:k], part, *parts[k + 1 :]]
    return parts


def _rest(frf: FRF, parts: list[ModalModel], own: int, window: slice) -> FRF:
    return _without(frf.lines(window), [p for j, p in enumerate(parts) if j != own])


def _without(frf: FRF, parts: list[ModalModel]) -> FRF:
    """The FRF less the responses of other modes, without the residual terms that were fitted beside them.

    By NumPy, for there are as many sizes as groups and each would be compiled.
    """
    s = np.asarray(frf.added_decay + 1j * frf.omega)
    H = np.array(frf.H)
    for part in parts:
        residue = np.asarray(part.residues)
        for poles, R in ((np.asarray(part.poles), residue), (np.asarray(part.poles).conj(), residue.conj())):
            kernel = s[:, None] ** DERIVATIVES[frf.form] / (s[:, None] - poles)
            H -= np.tensordot(kernel, R, 1)
    return frf.replace(H=H, variance=None)


def _made(frf: FRF, model: ModalModel) -> Array:
    return model.frf(frf.freq, form=frf.form, outputs=frf.outputs, inputs=frf.inputs, added_decay=frf.added_decay).H


def _left(frf: FRF, model: ModalModel) -> float:
    return float(jnp.sum(jnp.abs(frf.H - _made(frf, model)) ** 2))


def _free(frf: FRF, start: ModalModel, **options: Any) -> Refined | None:
    """Least squares with free poles; None where it found none in the neighbourhood of the start."""
    slots = SLOTS * -(-start.poles.size // SLOTS)
    result = refine(frf, start, weights="unit", covariance="robust", slots=slots, **options)
    return result if int(result.reason_code) in (0, OUT_OF_STEPS) else None


def _jackknife(frf: FRF, whole: Refined, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of frequencies [Hz] and damping ratios, a group of neighbouring rows left out at a time."""
    axis = 2 if frf.shape[2] > frf.shape[1] else 1
    stated = np.asarray(whole.frequency_std_hz), np.asarray(whole.damping_std)
    if frf.shape[axis] < FOLDS:
        return stated
    found: list[np.ndarray] = []
    for fold in np.array_split(np.arange(frf.shape[axis]), FOLDS):
        # A row of zeros counts nothing, and keeps the shapes that functions are compiled for.
        cut = jnp.moveaxis(jnp.moveaxis(frf.H, axis, 0).at[fold].set(0.0), 0, axis)
        result = _free(frf.replace(H=cut), whole.model, **options)
        if result is not None:
            found.append(np.stack([result.model.frequency_hz, result.model.damping_ratio]))
    values = np.array(found).reshape(-1, 2, len(stated[0]))
    n = max(len(values), 2)
    spread = np.sqrt((n - 1) / n * np.sum((values - values.mean(axis=0)) ** 2, axis=0)) if len(values) else stated
    return np.maximum(spread[0], stated[0]), np.maximum(spread[1], stated[1])


def _terms(frf: FRF, kind: str) -> tuple[Array, Array]:
    """Upper and lower residual terms of each channel by least squares over the band."""
    lines, n_out, n_in = frf.shape
    zero = jnp.zeros((n_out, n_in), jnp.complex128)
    if kind == "none":
        return zero, zero
    power, s = DERIVATIVES[frf.form], np.asarray(frf.added_decay + 1j * frf.omega)
    use = (s != 0) | (power == 2)
    top, s = np.abs(s).max(), s[use]
    columns = np.stack([(s / top) ** power, (s / top) ** (power - 2)], axis=1)
    data = np.asarray(frf.H)[use].reshape(len(s), -1)
    if kind == "real":
        columns, data = (np.concatenate([a.real, a.imag]) for a in (columns, data))
    x = np.linalg.lstsq(columns, data, rcond=None)[0].astype(complex).reshape(2, n_out, n_in)
    return jnp.asarray(x[0] / top**power), jnp.asarray(x[1] / top ** (power - 2))


def _with_errors(refined: Refined, moved: list[Moved]) -> Refined:
    """Deviations of moved poles in the place of those they had; correlations stay."""
    f_std, zeta_std = np.array(refined.frequency_std_hz), np.array(refined.damping_std)
    scale = np.ones((len(f_std), 2))
    for group in moved:
        k = group.modes
        new = (group.frequency_std_hz / group.model.frequency_hz, group.damping_std / group.model.damping_ratio)
        old = np.sqrt(np.asarray(jnp.diag(refined.covariance)).reshape(-1, 2)[k])
        scale[k] = np.where(old > 0, np.stack(new, axis=1) / np.where(old > 0, old, 1.0), 1.0)
        f_std[k], zeta_std[k] = group.frequency_std_hz, group.damping_std
    flat = jnp.asarray(scale.ravel())
    return dataclasses.replace(
        refined, frequency_std_hz=jnp.asarray(f_std), damping_std=jnp.asarray(zeta_std),
        covariance=flat[:, None] * refined.covariance * flat,
    )  # fmt: skip


def _with_model(frf: FRF, refined: Refined, model: ModalModel, rank: np.ndarray) -> Refined:
    """The result with another model, its modes the old ones in the order ``rank``, and its plain residual."""
    sigma: Float[Array, ""] = UNIT * jnp.sqrt(jnp.mean(jnp.abs(frf.H) ** 2))
    residual = (frf.H - _made(frf, model)) / sigma
    chi2 = 2 * jnp.sum(jnp.abs(residual) ** 2)
    pairs = (2 * rank[:, None] + np.arange(2)).ravel()
    mass = refined.modal_mass_std
    return dataclasses.replace(
        refined, model=model, frequency_std_hz=refined.frequency_std_hz[rank], damping_std=refined.damping_std[rank],
        shape_std=refined.shape_std[rank], modal_mass_std=None if mass is None else mass[rank],
        covariance=refined.covariance[pairs][:, pairs], evidence=refined.evidence[rank], chi2=chi2, residual=residual,
        noise_scale=jnp.sqrt(chi2 / refined.dof) * sigma, whiteness=whiteness_of(residual),
        log_likelihood=-0.5 * chi2 + 2 * residual.size * jnp.log(jnp.sqrt(2.0) / sigma), success=jnp.array(True),
        reason_code=jnp.array(CONTRADICTION),
    )  # fmt: skip
