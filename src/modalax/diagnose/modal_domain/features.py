r"""Features of a measurement in the modal domain: a few numbers per mode, with their joint covariance.

Of each mode :math:`\ln|\lambda|`, :math:`\ln\zeta`, :math:`\ln|A|`, ``A`` the residues outputs x inputs, their phase
along the measured ones, and the real and imaginary parts of :math:`A/|A|` along the other directions in which a product
of a shape and a participation can move. (What :math:`A/|A|` loses along the measured residues is of second order: as a
feature it would hold nothing that the others do not, and bend every search.) This compresses a thousand times as many
FRF samples without loss, and shifts of fifty bandwidths are as easy to compare as shifts of a tenth.
"""

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from modalax.diagnose.modal_domain.free_residues import Projected

# Deviations below which a feature says nothing about a model: ln frequency, ln damping, ln size, shape.
FLOOR = (2e-6, 2e-4, 1e-4, 5e-5)
CLOSE = 0.25  # change of ln frequency that counts as much against a pair of modes as shapes at right angles
SMEARED = 0.05  # standard deviation of ln frequency beyond which a mode is too uncertain to compare
FLAT = 1e-4  # square of the part along the measured residues below which its phase says nothing

ALIKE = 1e-12  # least variance of a combination of features, relative to that of each
FARTHEST = 10.0  # half-bandwidths by which a pole that was found can be off
NARROW = 1e-6  # least half-bandwidth of a pole, relative to its frequency
INVISIBLE = 1e-100  # size of residues, over their uncertainty, of a mode that no channel sees

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
    """

    poles: np.ndarray
    residues: np.ndarray
    units: np.ndarray
    tangent: np.ndarray
    values: np.ndarray
    covariance: np.ndarray

    @property
    def width(self) -> int:
        """Features of each mode."""
        return self.values.shape[1]


def features_of(found: Projected, outputs: int, inputs: int, misfit: float = 1.0) -> Features:
    """Features of identified modes; covariances are widened by ``misfit``, chi-square per sample."""
    R = len(found.poles)
    raw = found.residues.reshape(R, outputs, inputs)
    units = _units(found, raw)
    residues = raw / units
    tangent = np.stack([tangent_of(A) for A in residues]) if R else np.zeros((0, 1, outputs, inputs), complex)
    covariance = _covariance(found, residues, units, tangent) * misfit
    values = values_of(found.poles, residues, tangent)
    width = values.shape[1]
    floor = np.concatenate([FLOOR[:3], np.full(width - 3, FLOOR[3])])
    covariance += np.diag(np.tile(floor**2, R))
    return Features(found.poles, residues, units, tangent, values, covariance)


def chosen(f: Features, which: np.ndarray) -> Features:
    """Some modes only."""
    index = (np.flatnonzero(which)[:, None] * f.width + np.arange(f.width)).ravel()
    return Features(
        f.poles[which], f.residues[which], f.units[which], f.tangent[which], f.values[which],
        f.covariance[np.ix_(index, index)],
    )  # fmt: skip


def whitener_of(f: Features) -> np.ndarray:
    """Inverse of a root of the covariance, for features of unlike size and of any correlation."""
    size = np.sqrt(np.diag(f.covariance))
    values, vectors = np.linalg.eigh(f.covariance / size[:, None] / size)
    return (vectors / np.sqrt(np.maximum(values, ALIKE))).T / size


def sure(f: Features) -> np.ndarray:
    """Whether each mode is known well enough to compare."""
    std = np.sqrt(np.maximum(np.diag(f.covariance), 0.0)).reshape(f.values.shape)
    return (std[:, 0] < SMEARED) & (std[:, 2] < FAINT)


def _units(found: Projected, raw: np.ndarray) -> np.ndarray:
    """Uncertainties of residues, a product over outputs and inputs so that a shape times a participation stays one."""
    R = len(raw)
    own = np.einsum("ckk->kc", found.linear)[: 2 * R].reshape(R, 2, -1).sum(axis=1).reshape(raw.shape)
    size = (np.abs(raw) ** 2).mean(axis=(1, 2), keepdims=True)
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
    relative = dpoles / poles[:, None]
    real = poles.real[:, None]
    size, linear = _sizes(np.sqrt(own2), sizes)
    change = dresidues.reshape(*dresidues.shape[:2], -1).transpose(0, 2, 1)
    flat, axes = residues.reshape(len(poles), -1), tangent.conj().reshape(*tangent.shape[:2], -1)
    dsize = np.where(linear[:, None], 0.0, np.matmul(flat.conj()[:, None], change)[:, 0].real / own2[:, None])
    along = np.matmul(axes, flat[:, :, None])[:, :, 0] / size[:, None]
    moved = np.matmul(axes, change) / size[:, None, None]
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


def _covariance(found: Projected, residues: np.ndarray, units: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Joint covariance of the features, to first order."""
    R, o, i = residues.shape
    if not R:
        return np.zeros((0, 0))
    poles = found.poles
    half = np.repeat(np.maximum(-poles.real, NARROW * np.abs(poles)), 2)
    sizes, directions = np.linalg.eigh(found.information * half[:, None] * half)
    # of poles on top of each other, or at an end of the band, there may be no information, or by rounding less than
    # none; what is not known of them must not make all other modes unknown
    spread = (directions / np.maximum(sizes, FARTHEST**-2)) @ directions.T * half[:, None] * half
    # derivatives by the parts of each mode's pole, (k, f, 2), and of its residues, (k, f, channel, 2)
    part = np.array([1.0, 1j])
    still = np.zeros((R, 2, o, i), complex)
    by_pole = slopes_of_values(poles, residues, tangent, np.broadcast_to(part, (R, 2)), still)
    one = (part[:, None, None] * np.eye(o * i)[None]).transpose(1, 0, 2).reshape(1, -1, o, i) / units[:, None]
    by_residue = slopes_of_values(poles, residues, tangent, np.zeros((R, 2 * o * i)), one).reshape(R, -1, o * i, 2)
    width = by_pole.shape[1]
    through = np.zeros((R, width, 2 * R))
    for k in range(R):
        through[k, :, 2 * k : 2 * k + 2] += by_pole[k]
    reaction = found.sensitivity[:, : 2 * R].reshape(o * i, R, 2, 2 * R)
    through += np.einsum("kfcp,ckpl->kfl", by_residue, reaction, optimize=True)
    through = through.reshape(R * width, 2 * R)
    own = found.linear[:, : 2 * R, : 2 * R].reshape(o * i, R, 2, R, 2)
    covariance = through @ spread @ through.T
    linear = np.zeros((R, width, R, width))
    for k in range(R):
        left = np.einsum("fcp,cplq->lfcq", by_residue[k], own[:, k], optimize=True)
        for m in range(R):
            linear[k, :, m] = left[m].reshape(width, -1) @ by_residue[m].reshape(width, -1).T
    return _positive(covariance + linear.reshape(R * width, R * width))


def _positive(covariance: np.ndarray) -> np.ndarray:
    """A covariance without eigenvalues that rounding makes negative, as for two modes that are nearly one."""
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2 / size[:, None] / size)
    return (vectors * np.maximum(values, 1e-14)) @ vectors.T * size[:, None] * size


def paired(f: Features, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    """Number of the predicted mode that belongs to each measured one, by residues and frequency, shape ``(k,)``.

    Parameters
    ----------
    poles, residues
        Predicted, shapes ``(m,)`` and ``(m, o, i)``; at least as many as measured.
    """
    size = lambda A: np.sqrt((np.abs(A) ** 2).sum(axis=(1, 2)))
    k, m = len(f.poles), len(poles)
    product = np.abs((f.residues.conj() / f.units).reshape(k, -1) @ residues.reshape(m, -1).T)
    sizes = np.sqrt((1 / f.units**2).reshape(k, -1) @ (np.abs(residues) ** 2).reshape(m, -1).T)
    alike = (product / size(f.residues)[:, None] / np.maximum(sizes, 1e-300)) ** 2
    apart = np.log(np.abs(f.poles))[:, None] - np.log(np.abs(poles))
    rows, columns = scipy.optimize.linear_sum_assignment(1 - alike + (apart / CLOSE) ** 2)
    out = np.zeros(len(f.poles), int)
    out[rows] = columns
    return out
