r"""A structure that changes from run to run: each run has natural frequencies and dampings of its own.

Against a joint's law stands that nothing depends on the amplitude: from one run to the next all frequencies shift by
one share (temperature, loosened supports), or each mode by its own. The identified modes are moved by
:math:`\delta\ln|\lambda|` and :math:`\delta\ln\zeta`. Masses and shapes stay, so that a residue
:math:`\varphi\varphi^T/(2j\,\mathrm{Im}\,\lambda)` falls as its mode's frequency rises.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from modalax.diagnose.modal_domain.levels.change import Levels
from modalax.diagnose.modal_domain.modes.free_residues import POWERS, Channels, Projected

STEPS = 8  # Gauss-Newton steps
FARTHEST = 0.5  # longest step, in half-bandwidths
SMALL = 1e-6  # part of a shift, in which the slope of what is beyond the band is taken
GROWTH = 0.05  # prior standard deviation of a shift of frequency; of damping ten times that


@dataclass(frozen=True)
class Drift:
    """Shifts of the modes from the first run or the lowest level.

    Attributes
    ----------
    frequency, std
        Common relative shift of all frequencies at the last run, and its standard deviation.
    together
        Whether all modes shift by one share.
    log_evidence
        Up to what joints share.
    chi2
        Of the changes from level to level that it leaves.
    shifts
        Of the logarithms of frequency and damping ratio at each later run or level, shape ``(run - 1, 2, 1 or modes)``.
    """

    frequency: float
    std: float
    together: bool
    log_evidence: float
    chi2: float = 0.0
    shifts: np.ndarray | None = field(default=None, compare=False)


def change_of(d: Drift, modes: Projected, channels: Channels) -> np.ndarray:
    """By what each run or level differs from the first, shape ``(run, f, channel)``."""
    assert d.shifts is not None
    later = [_moved(modes, channels, shift)[0] for shift in d.shifts]
    return np.stack([np.zeros_like(channels.data), *later])


def drifts(levels: Levels, modes: Projected, channels: Channels) -> list[Drift]:
    """Both kinds of drift fitted to the changes from level to level."""
    return [_fitted(levels, modes, channels, together) for together in (True, False)]


def _fitted(levels: Levels, modes: Projected, channels: Channels, together: bool) -> Drift:
    runs, count = len(levels.force) - 1, len(modes.poles)
    kinds = 1 if together else count
    x = np.zeros((runs, 2, kinds))
    prior = np.broadcast_to(np.array([GROWTH, 10 * GROWTH])[None, :, None], x.shape).ravel()
    w, total = levels.weight, np.maximum(levels.weight.sum(axis=0), 1e-300)
    best = None
    for _ in range(STEPS):
        made, slopes = [], []
        for k in range(runs):
            value, slope = _moved(modes, channels, x[k])
            made.append(value.reshape(levels.H.shape[1:]))
            slopes.append(slope.sum(axis=1, keepdims=True) if together else slope)
        e = levels.H.copy()
        e[1:] -= np.array(made)
        rest = w * (e - (w * e).sum(axis=0) / total)
        chi2 = float((e.conj() * rest).real.sum())
        J = np.array(slopes).reshape(runs, 2 * kinds, *levels.H.shape[1:])
        right = np.einsum("lkfoi,lfoi->lk", J.conj(), rest[1:], optimize=True).real.ravel()
        G = np.zeros((runs, 2 * kinds, runs, 2 * kinds))
        for a in range(runs):
            for b in range(a, runs):
                own = w[a + 1] * (a == b) - w[a + 1] * w[b + 1] / total
                flat = (2 * kinds, -1)
                G[a, :, b] = (J[a].conj().reshape(flat) @ (own * J[b]).reshape(flat).T).real
                G[b, :, a] = G[a, :, b].T
        inner = G.reshape(runs * 2 * kinds, -1) + np.diag(1 / prior**2)
        cost = chi2 + float(((x.ravel() / prior) ** 2).sum())
        volume = float(np.linalg.slogdet(inner)[1]) + 2 * float(np.log(prior).sum())
        cov = np.linalg.inv(inner)
        if best is None or cost < best[0]:
            std = math.sqrt(cov.reshape(x.shape + x.shape)[-1, 0, :, -1, 0, :].sum()) / kinds
            best = cost, Drift(float(x[-1, 0].mean()), std, together, -0.5 * cost - 0.5 * volume, chi2, x)
        step = (cov @ (right - x.ravel() / prior**2)).reshape(x.shape)
        half = float(np.median(-modes.poles.real / np.abs(modes.poles)))
        x = x + np.clip(step, -FARTHEST * np.array([half, 1.0])[:, None], FARTHEST * np.array([half, 1.0])[:, None])
        if cost - best[0] > 1.0:
            break
    assert best is not None
    return best[1]


def _moved(modes: Projected, channels: Channels, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change of FRFs ``(f, channel)`` by shifts ``(2, 1 or modes)``, and its derivatives ``(2, modes, f, channel)``."""
    size = np.abs(modes.poles)
    zeta = np.minimum(-modes.poles.real / size * np.exp(shift[1]), 0.9)
    w = size * np.exp(shift[0])
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    by_size = poles
    by_zeta = w * zeta * (-1 - 1j * zeta / np.sqrt(1 - zeta**2))
    s, order = channels.s, channels.s[:, None] ** channels.order
    upper, lower = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    old = [1 / (s[:, None] - p) for p in (modes.poles, modes.poles.conj())]
    R = modes.residues * (modes.poles.imag / poles.imag)[:, None]
    beyond = _beyond(modes, channels, shift[0])
    change = beyond + order * (upper @ R - old[0] @ modes.residues + lower @ R.conj() - old[1] @ modes.residues.conj())
    slopes = []
    for d, falls in ((by_size, np.ones(len(zeta))), (by_zeta, -(zeta**2) / (1 - zeta**2))):
        up, down = (order * (upper**2 * d - upper * falls)).T, (order * (lower**2 * d.conj() - lower * falls)).T
        slopes.append(up[:, :, None] * R[:, None] + down[:, :, None] * R.conj()[:, None])
    if shift.shape[1] == 1:
        slopes[0][0] += (_beyond(modes, channels, shift[0] + SMALL) - beyond) / SMALL
    return change, np.stack(slopes)


def _beyond(modes: Projected, channels: Channels, shift: np.ndarray) -> np.ndarray | float:
    r"""Change of what modes beyond the band add, where one shift moves all modes.

    A structure stiffer by :math:`g^2` throughout has the receptance :math:`H(s/g)/g^2`.
    """
    if len(shift) > 1:
        return 0.0
    g, apart = float(np.exp(shift[0])), channels.background()
    moved = apart.copy()
    moved[:, : len(POWERS)] /= g ** np.array(POWERS, float)
    scaled = Channels(channels.s / g, channels.data, channels.weight, 0, channels.outside)
    moved[:, len(POWERS) :] = scaled.kernels(channels.outside) * channels.s[:, None] ** channels.order
    return (moved / g**2 - apart) @ modes.background


def by_run(H: np.ndarray, sigma: np.ndarray) -> Levels:
    """Every run as it is, where their force is not known."""
    weight = np.where(sigma > 0, 2 / np.maximum(sigma, 1e-300) ** 2, 0.0)
    return Levels(np.ones(len(H)), H, weight)
