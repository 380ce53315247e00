r"""Features of a measurement in the modal domain: a few numbers per mode, with their joint covariance.

Of each mode :math:`\ln|\lambda|`, :math:`\ln\zeta`, :math:`\ln|A|`, ``A`` the residues outputs x inputs, their phase
along the measured ones, and the real and imaginary parts of :math:`A/|A|` along the other directions in which a product
of a shape and a participation can move. (What :math:`A/|A|` loses along the measured residues is of second order: as a
feature it would hold nothing that the others do not, and bend every search.) This compresses a thousand times as many
FRF samples without loss, and shifts of fifty bandwidths are as easy to compare as shifts of a tenth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.optimize

from modalax._numerics.triangles import inverse_of
from modalax.diagnose.modal_domain.modes.free_residues import Projected
from modalax.diagnose.modal_domain.modes.repeated import Group, Origin, Together, group_of

# Deviations below which a feature says nothing about a model: ln frequency, ln damping, ln size, shape.
FLOOR = (2e-6, 2e-4, 1e-4, 5e-5)
CLOSE = 0.25  # change of ln frequency that counts as much against a pair of modes as shapes at right angles
SMEARED = 0.05  # standard deviation of ln frequency beyond which a mode is too uncertain to compare
FLAT = 1e-4  # square of the part along the measured residues below which its phase says nothing

LEAST = 1e-14  # eigenvalue of a covariance, relative to those of each feature, below which rounding tells it
ALIKE = 1e-12  # least variance of a combination of features, relative to that of each
FARTHEST = 10.0  # half-bandwidths by which a pole that was found can be off
NARROW = 1e-6  # least half-bandwidth of a pole, relative to its frequency
INVISIBLE = 1e-100  # size of residues, over their uncertainty, of a mode that no channel sees

SHOWN = 5.0  # size of a further shape in residues, over what noise makes of one, from which it is there
TOUCHING = 0.01  # half-bandwidths between two poles below which residues tell all that poles would

# Standard deviation of ln size beyond which a mode is too weak: its shape is no longer linear in its errors.
FAINT = 0.1


@dataclass(frozen=True)
class Features:
    """Features of the measured modes.

    Attributes
    ----------
    poles
        Shape ``(k,)`` [rad/s].
    residues
        Of the receptance, over ``units``, shape ``(k, o, i)``.
    units
        Uncertainty of the residues of each mode by outputs and inputs, shape ``(k, o, i)``.
    tangent
        Complex directions in which residues can move, shape ``(k, d, o, i)``.
    values
        Shape ``(k, 2 + 2 d)``.
    covariance
        Joint, shape ``(k (2 + 2 d), k (2 + 2 d))``.
    groups
        Modes of one frequency: their features are those of all of them together.
    origin
        Which of the identified poles they were made from; None where none were identified.
    """

    poles: np.ndarray
    residues: np.ndarray
    units: np.ndarray
    tangent: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    groups: tuple[Group, ...] = ()
    origin: Origin | None = None

    @property
    def width(self) -> int:
        """Features of each mode."""
        return self.values.shape[1]

    @property
    def grouped(self) -> np.ndarray:
        """Whether each mode is one of several of one frequency, shape ``(k,)``."""
        return np.isin(np.arange(len(self.poles)), [k for group in self.groups for k in group.rows])

    @cached_property
    def whitener(self) -> np.ndarray:
        """Inverse of a root of the covariance, for features of unlike size and of any correlation.

        It is upper triangular, but where combinations of features are known better than all others are.
        """
        size = np.sqrt(np.diag(self.covariance))
        unit = self.covariance / size[:, None] / size
        if _above(unit, ALIKE):  # a root from the last row up, whose inverse is an upper triangle
            return inverse_of(np.linalg.cholesky(unit[::-1, ::-1]))[::-1, ::-1] / size
        values, vectors = np.linalg.eigh(unit)
        return (vectors / np.sqrt(np.maximum(values, ALIKE))).T / size

    @cached_property
    def along(self) -> np.ndarray:
        """What residues are multiplied by and summed over for their part along the measured ones, ``(k, o, i)``."""
        return self.tangent[:, 0].conj() / self.units

    @property
    def seen(self) -> np.ndarray:
        """Measured residues as those that are compared with them, of groups both moments; shape ``(k, o, i)``."""
        out = self.residues.copy()
        for group in self.groups:
            out[list(group.rows)] = 0.0  # about the measured pole the first moment is none
            out[group.rows[0]] = group.shown.sum(axis=0)
        return out

    def predicted(self, poles: np.ndarray, residues: np.ndarray, sizes: np.ndarray | None = None) -> np.ndarray:
        """Features that other modes in the place of these have, as seen by :class:`Together`; see :func:`values_of`."""
        values = values_of(poles, residues, self.tangent, sizes)
        for group in self.groups:
            values[..., group.rows, :] = group.features(*(residues[..., k, :, :] for k in group.rows[:2]))
        return values

    def slopes(
        self, poles: np.ndarray, residues: np.ndarray, dpoles: np.ndarray, dresidues: np.ndarray,
        sizes: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Derivatives of what is predicted; arguments as those of :func:`slopes_of_values`."""
        out = slopes_of_values(poles, residues, self.tangent, dpoles, dresidues, sizes)
        for group in self.groups:
            out[list(group.rows)] = np.moveaxis(group.features(*(dresidues[k] for k in group.rows[:2])), 0, -1)
        return out


def features_of(
    found: Projected, outputs: int, inputs: int, misfit: float = 1.0, close: Sequence[tuple[int, ...]] = (),
    directions: int | None = None,
) -> Features:  # fmt: skip
    """Features of identified modes; covariances are widened by ``misfit``, chi-square per sample.

    Of poles that are ``close``, by their numbers, only what all make together is told: as many modes as their residues
    show shapes and participations, none where that are more than the poles. Of ``directions`` in which residues can
    move some may do.
    """
    R = len(found.poles)
    raw = found.residues.reshape(R, outputs, inputs)
    units = _units(found, raw, close)
    own, ranks = raw / units, shapes_shown(found, outputs, inputs, close)
    ranks = [min(rank, len(some)) * (rank <= len(some)) for rank, some in zip(ranks, close, strict=True)]
    more = {m: some[0] for rank, some in zip(ranks, close, strict=True) for m in some[max(rank, 1) :]}
    first = np.delete(np.arange(R), list(more))
    row = {int(m): k for k, m in enumerate(first)}
    groups = tuple(
        group_of(tuple(row[m] for m in some[:rank]), found.poles[list(some)].mean(), own[list(some)].sum(axis=0))
        for rank, some in zip(ranks, close, strict=True) if rank > 1
    )  # fmt: skip
    together = Together(first, np.array([row[m] for m in more.values()], int), np.array(list(more), int), groups)
    whole = own[first]
    np.add.at(whole, together.rows, own[together.numbers])
    for group in groups:
        whole[list(group.rows)] = group.shown
    tangent = np.stack([tangent_of(A)[:directions] for A in whole]) if R else np.zeros((0, 1, outputs, inputs), complex)
    poles, seen = together.seen(tangent[:, 0].conj(), found.poles, own)
    origin, width = Origin(together, np.zeros(R, bool)), 2 + 2 * tangent.shape[1]
    values = np.zeros((len(first), width))
    f = Features(poles, whole, units[first], tangent, values, np.zeros((0, 0)), groups, origin)
    floor = np.concatenate([FLOOR[:3], np.full(width - 3, FLOOR[3])])
    covariance = _covariance(found, own, f, close) * misfit + np.diag(np.tile(floor**2, len(first)))
    told = np.ones(len(first), bool)
    told[[row[some[0]] for rank, some in zip(ranks, close, strict=True) if not rank]] = False
    return chosen(replace(f, values=f.predicted(poles, seen), covariance=covariance), told)


def chosen(f: Features, which: np.ndarray) -> Features:
    """Some modes only; of those of one frequency all or none."""
    which = which.copy()
    for group in f.groups:
        which[list(group.rows)] = which[list(group.rows)].all()
    index = (np.flatnonzero(which)[:, None] * f.width + np.arange(f.width)).ravel()
    number = np.cumsum(which) - 1
    kept = (group for group in f.groups if which[group.rows[0]])
    groups = tuple(replace(group, rows=tuple(int(number[k]) for k in group.rows)) for group in kept)
    origin = f.origin
    if origin is not None:
        t = origin.together
        some = which[t.rows]
        origin = replace(origin, together=Together(t.pairs[which], number[t.rows[some]], t.numbers[some], groups))
    return Features(
        f.poles[which], f.residues[which], f.units[which], f.tangent[which], f.values[which],
        f.covariance[np.ix_(index, index)], groups, origin,
    )  # fmt: skip


def shapes_shown(found: Projected, outputs: int, inputs: int, close: Sequence[tuple[int, ...]]) -> list[int]:
    """How many shapes and participations the residues of some poles show together; at least one."""
    raw = found.residues.reshape(-1, outputs, inputs)
    units, noise = _units(found, raw, close), np.sqrt(outputs) + np.sqrt(inputs)
    sizes = (np.linalg.svd(raw[list(some)].sum(axis=0) / units[some[0]], compute_uv=False) for some in close)
    return [max(1, int(np.count_nonzero(size > SHOWN * noise))) for size in sizes]


def whitener_of(f: Features) -> np.ndarray:
    """As :attr:`Features.whitener`."""
    return f.whitener


def sure(f: Features) -> np.ndarray:
    """Whether each mode is known well enough to compare."""
    std = np.sqrt(np.maximum(np.diag(f.covariance), 0.0)).reshape(f.values.shape)
    return (std[:, 0] < SMEARED) & (std[:, 2] < FAINT)


def _units(found: Projected, raw: np.ndarray, close: Sequence[tuple[int, ...]]) -> np.ndarray:
    """Uncertainties of residues, a product over outputs and inputs so that a shape times a participation stays one."""
    own = found.variance.reshape(raw.shape)
    size = (np.abs(raw) ** 2).mean(axis=(1, 2), keepdims=True)
    for some in map(list, close):  # of all together
        parts = [found.linear[:, 2 * np.array(some)[:, None] + j, 2 * np.array(some) + j] for j in (0, 1)]
        own[some] = np.sum(parts, axis=(0, 2, 3)).reshape(raw.shape[1:])
        size[some] = (np.abs(raw[some].sum(axis=0)) ** 2).mean()
    level = 0.5 * np.log(own + FLOOR[3] ** 2 * np.maximum(size, 1e-300) + 1e-300)
    mean = level.mean(axis=(1, 2), keepdims=True)
    return np.exp(level.mean(axis=2, keepdims=True) + level.mean(axis=1, keepdims=True) - mean)


def tangent_of(A: np.ndarray) -> np.ndarray:
    """Orthonormal directions ``u' v*``, ``u v'*`` about the leading pair of singular vectors, ``(o + i - 1, o, i)``."""
    u, _, vh = np.linalg.svd(A, full_matrices=True)
    first = np.einsum("oa,i->aoi", u, vh[0])
    second = np.einsum("o,bi->boi", u[:, 0], vh[1:])
    return np.concatenate([first, second])


def values_of(
    poles: np.ndarray, residues: np.ndarray, tangent: np.ndarray, sizes: np.ndarray | None = None
) -> np.ndarray:
    """Features of modes, shape ``(..., k, 2 + 2 d)``, from their poles and residues in units of the channels.

    Parameters
    ----------
    poles, residues
        Of one or more sets of modes, shapes ``(..., k)`` and ``(..., k, o, i)``.
    sizes
        Measured sizes of residues about which the features are linear in the residues, so that a mode may show not at
        all or with the other sign; NaN for modes whose features are as above, shape ``(k,)``.
    """
    own = np.maximum(np.sqrt((np.abs(residues) ** 2).sum(axis=(-2, -1))), INVISIBLE)
    size, linear = _sizes(own, sizes)
    flat, axes = residues.reshape(*own.shape, -1), tangent.reshape(*tangent.shape[:2], -1)
    along = np.matmul(axes, flat.conj()[..., None])[..., 0].conj() / size[..., None]
    zeta = np.maximum(-poles.real / np.abs(poles), 1e-9)
    grown = np.log(size) + np.where(linear, along[..., 0].real - 1, 0.0)
    turned = np.where(linear, along[..., 0].imag, np.angle(along[..., 0]))
    first = np.stack([np.log(np.abs(poles)), np.log(zeta), grown, turned], axis=-1)
    return np.concatenate([first, along[..., 1:].real, along[..., 1:].imag], axis=-1)


def slopes_of_values(
    poles: np.ndarray, residues: np.ndarray, tangent: np.ndarray, dpoles: np.ndarray, dresidues: np.ndarray,
    sizes: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Derivatives of the features, shape ``(k, 2 + 2 d, p)``, by changes ``(k, p)`` and ``(k, p, o, i)``."""
    own2 = np.maximum((np.abs(residues) ** 2).sum(axis=(1, 2)), INVISIBLE**2)
    change = dresidues.reshape(*dresidues.shape[:2], -1).transpose(0, 2, 1)
    flat, axes = residues.reshape(len(poles), -1), tangent.conj().reshape(*tangent.shape[:2], -1)
    grown = np.matmul(flat.conj()[:, None], change)[:, 0].real / own2[:, None]
    along, moved = np.matmul(axes, flat[:, :, None])[:, :, 0], np.matmul(axes, change)
    return slopes_along(poles, dpoles, np.sqrt(own2), grown, along, moved, sizes)


def slopes_along(
    poles: np.ndarray, dpoles: np.ndarray, own: np.ndarray, grown: np.ndarray, along: np.ndarray, moved: np.ndarray,
    sizes: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """The same by the sizes of residues ``own``, shape ``(k,)``, and by what changes make them grow by, ``(k, p)``.

    And by the parts of residues and of their changes along the tangent, shapes ``(k, d)`` and ``(k, d, p)``.
    """
    relative = dpoles / poles[:, None]
    real = poles.real[:, None]
    size, linear = _sizes(own, sizes)
    dsize = np.where(linear[:, None], 0.0, grown)
    along, moved = along / size[:, None], moved / size[:, None, None]
    first = along[:, :1]
    turned = (first.conj() * moved[:, 0]).imag / np.maximum(np.abs(first) ** 2, FLAT)
    grown, turned = np.where(linear[:, None], (moved[:, 0].real, moved[:, 0].imag), (dsize, turned))
    moved = (moved - along[:, :, None] * dsize[:, None, :])[:, 1:]
    dzeta = dpoles.real / real - relative.real
    leading = np.stack([relative.real, dzeta, grown, turned], axis=1)
    return np.concatenate([leading, moved.real, moved.imag], axis=1)


def _sizes(own: np.ndarray, measured: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Sizes that residues are taken relative to, and of which modes the features are linear in them."""
    if measured is None:
        return own, np.zeros(own.shape, bool)
    return np.where(np.isnan(measured), own, measured), ~np.isnan(measured)


def _covariance(found: Projected, residues: np.ndarray, f: Features, close: Sequence[tuple[int, ...]]) -> np.ndarray:
    """Joint covariance of the features, to first order; ``residues`` are those found, in units of the channels."""
    R, o, i = residues.shape
    if not R:
        return np.zeros((0, 0))
    half = np.maximum(-found.poles.real, NARROW * np.abs(found.poles))
    for some in map(list, close):
        if np.ptp(np.abs(found.poles[some])) < TOUCHING * half[some[0]]:
            half[some] = 0.0
    half = np.repeat(half, 2)
    sizes, directions = np.linalg.eigh(found.information * half[:, None] * half)
    # of poles on top of each other, or at an end of the band, there may be no information, or by rounding less than
    # none; what is not known of them must not make all other modes unknown
    spread = (directions / np.maximum(sizes, FARTHEST**-2)) @ directions.T * half[:, None] * half
    count, width = f.values.shape
    through, every = np.zeros((count, width, 2 * R)), []
    reaction = found.sensitivity[:, : 2 * R].reshape(o * i, R, 2, 2 * R)
    for m in range(R):
        rows, slopes = _by_source(f, found.poles, residues, m)
        by_residue = slopes[:, :, 2:].reshape(len(rows), width, o * i, 2)
        through[rows, :, 2 * m : 2 * m + 2] += slopes[:, :, :2]
        through[rows] += np.einsum("kfcp,cpl->kfl", by_residue, reaction[:, m], optimize=True)
        every.append((rows, by_residue))
    own = found.linear[:, : 2 * R, : 2 * R].reshape(o * i, R, 2, R, 2)
    linear = np.zeros((count, width, count, width))
    for m, (rows, by_residue) in enumerate(every):
        left = np.einsum("kfcp,cplq->lkfcq", by_residue, own[:, m], optimize=True).reshape(R, len(rows) * width, -1)
        for part, (others, slope) in zip(left, every, strict=True):
            block = (part @ slope.reshape(len(others) * width, -1).T).reshape(len(rows), width, len(others), width)
            for k, row in enumerate(rows):
                for n, other in enumerate(others):
                    linear[row, :, other] += block[k, :, n]
    through = through.reshape(count * width, 2 * R)
    return _positive(through @ spread @ through.T + linear.reshape(count * width, -1))


def _by_source(f: Features, poles: np.ndarray, residues: np.ndarray, m: int) -> tuple[list[int], np.ndarray]:
    """Numbers of the modes that one identified pole is part of, and derivatives of their features.

    By the parts of the pole, then those of its residue in each channel in turn, shape ``(k, width, 2 + 2 channel)``.
    """
    assert f.origin is not None
    t, (o, i), part = f.origin.together, residues.shape[1:], np.array([1.0, 1j])
    k = int(t.row[t.every == m][0])
    dpole, moved = np.zeros((1, 2 + 2 * o * i), complex), np.zeros((1, 2 + 2 * o * i, o, i), complex)
    dpole[0, :2], moved[0, 2:] = part, (np.eye(o * i)[:, None] * part[:, None]).reshape(-1, o, i) / f.units[k]
    for group in f.groups:
        if k == group.rows[0]:
            first = (poles[m] - group.pole) * moved[0] + dpole[0, :, None, None] * residues[m]
            return list(group.rows), np.moveaxis(group.features(moved[0], first), 0, -1)
    own = t.every[t.row == k]
    mean, whole = poles[[m]], residues[[m]]
    if len(own) > 1:
        along, whole = f.tangent[k, 0].conj(), residues[own].sum(axis=0, keepdims=True)
        weight, mean = np.einsum("oi,moi->m", along, residues[own]), f.poles[[k]]
        dpole = (
            weight[own == m, None] * dpole + (poles[m] - mean) * np.einsum("oi,mpoi->mp", along, moved)
        ) / weight.sum()
    return [k], slopes_of_values(mean, whole, f.tangent[[k]], dpole, moved)


def _positive(covariance: np.ndarray) -> np.ndarray:
    """A covariance without eigenvalues that rounding makes negative, as for two modes that are nearly one."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    unit = (covariance + covariance.T) / 2 / size[:, None] / size
    if _above(unit, LEAST):
        return unit * size[:, None] * size
    values, vectors = np.linalg.eigh(unit)
    return (vectors * np.maximum(values, LEAST)) @ vectors.T * size[:, None] * size


def _above(unit: np.ndarray, least: float) -> bool:
    """Whether all eigenvalues of a symmetric matrix are above some value."""
    try:
        np.linalg.cholesky(unit - least * np.eye(len(unit)))
    except np.linalg.LinAlgError:
        return False
    return True


def paired(f: Features, poles: np.ndarray, residues: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
    """Number of the predicted mode that belongs to each measured one, by residues and frequency, shape ``(k,)``.

    Parameters
    ----------
    poles, residues
        Predicted, shapes ``(m,)`` and ``(m, o, i)``; at least as many as measured.
    kept
        Which of the measured modes are looked at; all if None.
    """
    size = lambda A: np.sqrt((np.abs(A) ** 2).sum(axis=(1, 2)))
    k, m = len(f.poles), len(poles)
    product = np.abs((f.residues.conj() / f.units).reshape(k, -1) @ residues.reshape(m, -1).T)
    sizes = np.sqrt((1 / f.units**2).reshape(k, -1) @ (np.abs(residues) ** 2).reshape(m, -1).T)
    alike = (product / size(f.residues)[:, None] / np.maximum(sizes, 1e-300)) ** 2
    for group in f.groups:  # any shapes in the space of these
        alike[list(group.rows)] = group.alike(residues / f.units[group.rows[0]])
    apart = np.log(np.abs(f.poles))[:, None] - np.log(np.abs(poles))
    some = np.arange(k) if kept is None else np.flatnonzero(kept)
    rows, columns = scipy.optimize.linear_sum_assignment((1 - alike + (apart / CLOSE) ** 2)[some])
    out = np.zeros(len(some), int)
    out[rows] = columns
    return out
