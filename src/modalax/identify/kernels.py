r"""Responses of modes in one real basis, for computations on the host.

A mode's residue :math:`z_{oi} = \psi_o L_i` enters every channel through the same functions of :math:`s`,

.. math:: z k + z^* \tilde k = \mathrm{Re}\,z\,(k + \tilde k) + \mathrm{Im}\,z\,j(k - \tilde k), \qquad
          k = \frac{s^p}{s - \lambda}, \quad \tilde k = \frac{s^p}{s - \lambda^*},

and a change of its pole through the same with :math:`s^p/(s-\lambda)^2`. So :math:`4R` columns with real coefficients
hold the responses of :math:`R` modes and all their derivatives, whatever the number of channels.
"""

from typing import NamedTuple

import numpy as np

UNDAMPED = 1e-7  # damping ratio below which a mode has none
GROWING = 1e-3  # damping ratio that a pole gets whose motion grows or lasts
FAR = (-20.0, 25.0)  # logarithms of the circular frequencies that a mode may run off to


def pack(poles: np.ndarray, participation: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    r"""Real unknowns ``(n, 2 + 2 (i - 1))``: :math:`\ln\omega, \ln\zeta`, and participation relative to the pivot's.

    A pole without damping counts as one that has ``GROWING``.
    """
    omega = np.abs(poles)
    relative = participation / np.take_along_axis(participation, pivot[:, None], axis=1)
    rest = np.take_along_axis(relative, others(pivot, participation.shape[1]), axis=1)
    own = np.stack([np.log(omega), np.log(np.where(poles.real < 0, -poles.real / omega, GROWING))], axis=1)
    return np.concatenate([own, rest.real, rest.imag], axis=1)


def others(pivot: np.ndarray, count: int) -> np.ndarray:
    """References that are not the pivot, in their order, shape ``(n, count - 1)``."""
    index = np.arange(max(count - 1, 0))[None, :]
    return index + (index >= pivot[:, None])


def turned_to_largest(theta: np.ndarray, pivot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same modes with the reference of the largest participation as pivot: unknowns and pivots."""
    free = (theta.shape[1] - 2) // 2
    participation = np.ones((len(theta), free + 1), complex)
    np.put_along_axis(participation, others(pivot, free + 1), theta[:, 2 : 2 + free] + 1j * theta[:, 2 + free :], 1)
    largest = np.argmax(np.abs(participation), axis=1)
    relative = participation / np.take_along_axis(participation, largest[:, None], axis=1)
    rest = np.take_along_axis(relative, others(largest, free + 1), axis=1)
    return np.concatenate([theta[:, :2], rest.real, rest.imag], axis=1), largest


def limits(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the logarithms of frequency and damping are beyond their limits, where they have no effect."""
    gone = (theta[:, 0] <= FAR[0]) | (theta[:, 0] >= FAR[1])
    return gone, (theta[:, 1] <= np.log(UNDAMPED)) | (theta[:, 1] >= np.log(0.999))


class Modes(NamedTuple):
    r"""Modes at given unknowns.

    Attributes
    ----------
    poles, participation
        Shapes ``(n,)`` and ``(n, i)``, the participation 1 at the pivot.
    unit
        Residue at the pivot of each unknown of a shape component, shape ``(n, c)``: 1 and j, or one of real modes.
    slope
        Derivatives of the poles in :math:`\ln\omega` and :math:`\ln\zeta`, shape ``(n, 2)``.
    growth
        Relative derivatives of ``unit`` in the same, shape ``(n, 2)``.
    """

    poles: np.ndarray
    participation: np.ndarray
    unit: np.ndarray
    slope: np.ndarray
    growth: np.ndarray


def unpack(theta: np.ndarray, pivot: np.ndarray, real_modes: bool) -> Modes:
    """The modes at real unknowns; frequencies and dampings beyond their limits are set to them, with slope zero."""
    omega = np.exp(np.clip(theta[:, 0], *FAR))
    zeta = np.clip(np.exp(np.minimum(theta[:, 1], 1.0)), UNDAMPED, 0.999)
    root = np.sqrt(1 - zeta**2)
    poles = omega * (-zeta + 1j * root)
    gone, stuck = limits(theta)
    slope = np.stack([np.where(gone, 0, poles), np.where(stuck, 0, -zeta * omega * (1 + 1j * zeta / root))], axis=1)
    n, free = len(theta), (theta.shape[1] - 2) // 2
    participation = np.ones((n, free + 1), complex)
    np.put_along_axis(participation, others(pivot, free + 1), theta[:, 2 : 2 + free] + 1j * theta[:, 2 + free :], 1)
    if not real_modes:
        return Modes(poles, participation, np.tile([1.0, 1j], (n, 1)), slope, np.zeros((n, 2)))
    growth = np.stack([np.where(gone, 0.0, -1.0), np.where(stuck, 0.0, zeta**2 / root**2)], axis=1)
    return Modes(poles, participation, 1 / (2j * poles.imag)[:, None], slope, growth)


def coefficients(modes: Modes) -> np.ndarray:
    """Residue of each unknown of a shape component at each reference, shape ``(n, i, c)``."""
    return modes.participation[:, :, None] * modes.unit[:, None, :]


def coefficient_slopes(modes: Modes, pivot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the columns: residues on the kernels, and on their squares, both of shape ``(n, i, c, q)``."""
    n, i = modes.participation.shape
    residue = coefficients(modes)
    plain = np.zeros((*residue.shape, 2 * i), complex)
    plain[..., :2] = residue[..., None] * modes.growth[:, None, None, :]
    rows, free = np.arange(n), i - 1
    for k, reference in enumerate(others(pivot, i).T):
        plain[rows, reference, :, 2 + k] = modes.unit
        plain[rows, reference, :, 2 + free + k] = 1j * modes.unit
    squared = np.zeros_like(plain)
    squared[..., :2] = residue[..., None] * modes.slope[:, None, None, :]
    return plain, squared


def pairs(z: np.ndarray) -> np.ndarray:
    """Real and imaginary part along a last axis of their own."""
    return np.stack([z.real, z.imag], axis=-1)


def kernels(s: np.ndarray, power: int, poles: np.ndarray, squares: bool = True) -> np.ndarray:
    """Columns of the basis, complex with real coefficients, shape ``(f, 2 n)`` or with squares ``(f, 4 n)``.

    Mode after mode the pairs of the kernels, then mode after mode those of their squares.
    """
    found = np.empty((len(s), 1 + squares, len(poles), 2), complex)
    inverse = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    near, far = (s**power)[:, None] * inverse[0], (s**power)[:, None] * inverse[1]
    for part in range(1 + squares):
        if part:
            near, far = near * inverse[0], far * inverse[1]
        found[:, part, :, 0] = near + far
        found[:, part, :, 1] = 1j * (near - far)
    return found.reshape(len(s), -1)


def residual_terms(s: np.ndarray, power: int, kind: str) -> np.ndarray:
    r"""Columns of the residual terms of one channel, real coefficients, scaled by the highest frequency.

    :math:`(s/\omega_{max})^p` and :math:`(s/\omega_{max})^{p-2}`, and j times these for complex terms: ``(f, 0|2|4)``.
    """
    if kind == "none":
        return np.zeros((len(s), 0), complex)
    top = np.max(s.imag)
    safe = np.where(s == 0, 1j * top, s)
    terms = np.stack([(s / top) ** power, (safe / top) ** (power - 2)], axis=1)
    return np.concatenate([terms, 1j * terms], axis=1) if kind == "complex" else terms
