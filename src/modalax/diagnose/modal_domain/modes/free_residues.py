r"""Poles of a measurement by variable projection, with a residue of its own for each pole in each channel.

All channels share one real basis: of each pole the kernels :math:`p = 1/(s-\lambda) + 1/(s-\lambda^*)` and
:math:`q = j/(s-\lambda) - j/(s-\lambda^*)`, so that a residue :math:`a + jb` gives :math:`ap + bq`, and residual terms
of modes beyond the band. The same with squared denominators are the derivatives by the poles. Golub and Pereyra (1973);
Kaufman (1975) for the Jacobian.

Here only the poles are searched for, and the covariance of every residue comes with them: the diagnosis compares
residues channel by channel and decides for itself whether they are those of modes. :mod:`modalax.identify.projection`
fits the stricter model, a residue that is a shape times a participation, and searches for the participations as well;
both take their Gram matrices from :func:`modalax._numerics.grams.weighted_grams`.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from modalax._numerics.grams import weighted_grams
from modalax.diagnose.modal_domain.modes.windows import Sweep, Window

STEPS = 25  # most Gauss-Newton steps of one refinement
SETTLED = 1e-3  # decrease of chi-square per number of poles' parameters at which a refinement has ended
ROUNDING = 1e-24  # information on a pole, relative to the best known one, that counts as none
WIDEST = 1e6  # damping of a step, relative to the information, at which there is no way on
POWERS = 0, 1, 2, -1, -2, -3  # of s in the residual terms of modes beyond the band
CANCELLED = 1e-12  # sum of squares of which rounding may leave so much, above which chi-square is summed over the lines
BLOCK = 20_000_000  # numbers that the products of columns may take at once


@dataclass(frozen=True)
class Channels:
    """Measured FRFs as they are fitted.

    Attributes
    ----------
    s
        Laplace variable of each line [rad/s], shape ``(f,)``.
    data
        Shape ``(f, channel)``, in the form of the measurement.
    weight
        One over the variance of a real part, shape ``(f, channel)``; 0 leaves a sample out.
    order
        Derivatives of the displacement that were measured: basis functions are multiplied by ``s**order``.
    outside
        Fixed poles of modes beyond the band, shape ``(m,)`` [rad/s].
    window
        The finite record, or the fast sweep, through which modes are seen; None where they show as they are.
    """

    s: np.ndarray
    data: np.ndarray
    weight: np.ndarray
    order: int
    outside: np.ndarray
    window: Window | Sweep | None = None

    @property
    def samples(self) -> int:
        """Number of real numbers that count."""
        return 2 * int(np.count_nonzero(self.weight))

    def kernels(self, poles: np.ndarray, power: int = 1) -> np.ndarray:
        """Columns p and q of each pole, shape ``(f, 2 n)``, each pole's two side by side."""
        if self.window is None:
            u, v = (self.s[:, None] ** self.order / (self.s[:, None] - x) ** power for x in (poles, poles.conj()))
        else:
            u, v = (self._seen(x, power) for x in (poles, poles.conj()))
        return np.stack([u + v, 1j * (u - v)], axis=2).reshape(len(self.s), -1)

    def _seen(self, poles: np.ndarray, power: int) -> np.ndarray:
        r"""The windowed derivative of :math:`e^{\lambda t}` that was measured, or its slope by :math:`\lambda`."""
        kernel, slope = self.window.transform(self.s[:, None] - poles) if self.window else (0, 0)
        if power == 1:
            return kernel * poles**self.order
        return self.order * poles ** (self.order - 1) * kernel - poles**self.order * slope

    def background(self) -> np.ndarray:
        """Columns of the modes beyond the band, shape ``(f, columns)``.

        The highest power of ``1/s`` is that of a free body once too often integrated, as wrong units have it.
        """
        mid = np.sqrt(np.abs(self.s[0] * self.s[-1]))
        x = self.s / mid
        terms = np.stack([x**power for power in POWERS], axis=1) * self.s[:, None] ** self.order
        return np.concatenate([terms, self.kernels(self.outside)], axis=1)


@dataclass(frozen=True)
class Projected:
    """A fit of poles with everything linear eliminated.

    Attributes
    ----------
    poles
        Shape ``(n,)`` [rad/s].
    residues
        Of the receptance, shape ``(n, channel)``.
    background
        Sizes of the residual terms, shape ``(columns, channel)``.
    chi2
        Weighted sum of squares.
    information
        Of the real and imaginary parts of the poles, everything linear eliminated, shape ``(2 n, 2 n)``.
    linear
        Inverse Gram matrix of each channel, shape ``(channel, columns, columns)``, columns p, q of each pole first.
    sensitivity
        Change of the linear unknowns of each channel by the poles' parts, shape ``(channel, columns, 2 n)``.
    """

    poles: np.ndarray
    residues: np.ndarray
    background: np.ndarray
    chi2: float
    information: np.ndarray
    linear: np.ndarray
    sensitivity: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Of each residue, shape ``(n, channel)``."""
        R = len(self.poles)
        return np.einsum("ckk->kc", self.linear)[: 2 * R].reshape(R, 2, -1).sum(axis=1)

    def made(self, channels: Channels) -> np.ndarray:
        """FRFs of the fit, shape ``(f, channel)``."""
        x = np.stack([self.residues.real, self.residues.imag], axis=1).reshape(-1, self.residues.shape[1])
        return channels.kernels(self.poles) @ x + channels.background() @ self.background


def _grams(columns: np.ndarray, channels: Channels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted Gram matrices ``(channel, k, k)``, products with the data ``(channel, k)``, and energies."""
    gram = weighted_grams(columns.real, columns.imag, channels.weight.T, BLOCK)
    weighted = channels.weight * channels.data
    right = (columns.real.T @ weighted.real + columns.imag.T @ weighted.imag).T
    return gram, right, (channels.weight * np.abs(channels.data) ** 2).sum(axis=0)


def project(poles: np.ndarray, channels: Channels) -> tuple[Projected, np.ndarray]:
    """Eliminate everything linear at given poles; also the gradient of half chi-square by the poles' parts."""
    n = len(poles)
    first, second, rest = channels.kernels(poles), channels.kernels(poles, 2), channels.background()
    columns = np.concatenate([first, rest, second], axis=1)
    scale = 1 / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    gram, right, energy = _grams(columns * scale, channels)
    k = 2 * n + rest.shape[1]
    inner = gram[:, :k, :k]
    size = np.sqrt(np.maximum(np.einsum("cii->ci", inner), 1e-300))
    unit = inner / size[:, :, None] / size[:, None] + 1e-13 * np.eye(k)
    inverse = np.linalg.inv(unit) / size[:, :, None] / size[:, None]
    x = np.einsum("cij,cj->ci", inverse, right[:, :k])
    if CANCELLED * float(((x * size) ** 2).sum()) < channels.data.size:
        chi2 = float((energy - 2 * (x * right[:, :k]).sum(axis=1) + np.einsum("ci,cij,cj->c", x, inner, x)).sum())
    else:  # columns that nearly depend on each other have sizes whose squares cancel
        left = channels.data - (columns[:, :k] * scale[:k]) @ x.T
        chi2 = float((channels.weight * np.abs(left) ** 2).sum())
    cross = gram[:, k:, :k]
    schur = gram[:, k:, k:] - cross @ inverse @ cross.transpose(0, 2, 1)
    slope = right[:, k:] - np.einsum("cij,cj->ci", cross, x)
    # a residue a + jb moves with the pole as (a p2 + b q2) dx + (a q2 - b p2) dy
    parts = (x[:, : 2 * n] * scale[: 2 * n]).reshape(len(x), n, 2)
    a, b = parts[..., 0], parts[..., 1]
    turn = np.zeros((len(x), 2 * n, 2 * n))
    even = 2 * np.arange(n)
    turn[:, even, even], turn[:, even + 1, even] = a, b
    turn[:, even, even + 1], turn[:, even + 1, even + 1] = -b, a
    turn /= scale[k:][None, :, None]
    information = np.einsum("cki,ckl,clj->ij", turn, schur, turn, optimize=True)
    gradient = np.einsum("cki,ck->i", turn, slope)
    sensitivity = -np.einsum("cij,ckj,ckl->cil", inverse, cross, turn, optimize=True) * scale[None, :k, None]
    found = Projected(
        poles, (a + 1j * b).T, (x[:, 2 * n :] * scale[2 * n : k]).T, chi2, information,
        inverse * scale[:k, None] * scale[:k], sensitivity,
    )  # fmt: skip
    return found, gradient


def refine(poles: np.ndarray, channels: Channels, steps: int = STEPS) -> Projected:
    """Poles of least chi-square near the given ones."""
    found, gradient = project(poles, channels)
    if not len(poles):
        return found
    damping = 1e-3
    for _ in range(steps):
        known = np.diag(found.information)  # of a pole that is nearly real it is lost in rounding, to either sign
        scale = np.sqrt(np.maximum(known, ROUNDING * np.abs(known).max()))
        unit = found.information / scale[:, None] / scale
        try:
            step = scipy.linalg.solve(unit + damping * np.eye(len(unit)), gradient / scale, assume_a="pos") / scale
        except np.linalg.LinAlgError:  # two poles on top of each other
            damping = 100 * damping
            if damping > WIDEST:
                break
            continue
        # a step of more than a half-bandwidth leaves what the derivatives know
        parts = step.reshape(-1, 2) @ np.array([1, 1j])
        half = np.abs(found.poles.real)
        parts = parts * np.minimum(1.0, 1.0 * half / np.maximum(np.abs(parts), 1e-300))
        moved = found.poles + parts
        moved = np.minimum(moved.real, -0.2 * half) + 1j * np.maximum(moved.imag, 0.1 * found.poles.imag)
        trial, slope = project(moved, channels)
        if trial.chi2 <= found.chi2:
            gained = found.chi2 - trial.chi2
            found, gradient, damping = trial, slope, max(damping / 10, 1e-8)
            if gained < SETTLED * 2 * len(poles):
                break
        else:
            damping *= 10
            if damping > WIDEST:
                break
    return found
