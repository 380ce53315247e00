r"""Peaks that no pole makes, as of a structure that is not linear: one mode each, as uncertain as they are bent.

About a pole, let ``e`` be what it leaves of the response, root mean square and relative. Of one mode with a weak drag,
cubic spring or dry friction, :math:`H = 1/(\delta + i + h(|H|))` over the detuning, a pole fitted to all lines leaves

.. math:: \delta\ln\zeta\approx 5\text{ to }9\,e\ (\text{drag, friction}),\qquad
          \delta f\approx 4\,e\,\zeta f\ (\text{cubic}),\qquad \delta\ln|A|\approx 0.1\text{ to }0.3\,e,

the size and shape of a residue being those of the flanks. So much are the features of a bent peak off as those of the
structure without its joint.
"""

from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, refine

NEARBY, BENT = 3.0, 2.0  # half-bandwidths about a pole, and chi-square per sample there from which it is no mode
TOGETHER = 1.5  # sums of half-bandwidths within which two bent poles may be one peak
ALIKE = 0.8  # agreement (MAC) of the residues of two such poles
DAMPING, FREQUENCY = 8.0, 4.0  # deviation of ln damping, and of frequency in half-bandwidths, over what a pole leaves


def about_poles(found: Projected, channels: Channels) -> tuple[np.ndarray, np.ndarray]:
    """Chi-square per sample about each pole, and what is left there relative to the response, shapes ``(n,)``."""
    left = (channels.weight * np.abs(channels.data - found.made(channels)) ** 2).sum(axis=1)
    whole = (channels.weight * np.abs(channels.data) ** 2).sum(axis=1)
    count = 2 * np.count_nonzero(channels.weight, axis=1)
    w, least = np.abs(channels.s), NEARBY * np.median(np.diff(np.abs(channels.s)))
    chi2, relative = np.ones(len(found.poles)), np.zeros(len(found.poles))
    for k, pole in enumerate(found.poles):
        near = np.abs(w - abs(pole)) < max(NEARBY * abs(pole.real), least)
        if count[near].sum():
            chi2[k] = left[near].sum() / count[near].sum()
            relative[k] = np.sqrt(left[near].sum() / max(whole[near].sum(), 1e-300))
    return chi2, relative


def bent(found: Projected, channels: Channels) -> np.ndarray:
    """Whether each pole is part of a peak that no poles make, shape ``(n,)``."""
    return about_poles(found, channels)[0] > BENT


def one_each(found: Projected, channels: Channels) -> Projected:
    """Modes with one pole for each bent peak, where a sum of several was found."""
    for _ in range(len(found.poles)):
        part = bent(found, channels)
        p, R = found.poles, found.residues
        size = np.maximum(np.linalg.norm(R, axis=1), 1e-300)
        alike = np.abs(R.conj() @ R.T / size[:, None] / size) ** 2
        apart = np.abs(p[:, None] - p) / TOGETHER / np.abs(p.real[:, None] + p.real)
        other = np.where((alike > ALIKE) & part[:, None] & part & ~np.eye(len(p), dtype=bool), apart, np.inf)
        if not (other < 1).any():
            break
        k, m = np.unravel_index(int(other.argmin()), other.shape)
        poles = np.append(np.delete(p, (k, m)), _middle(p[[k, m]]))
        found = refine(poles[np.argsort(np.abs(poles))], channels)
    return found


def _middle(poles: np.ndarray) -> complex:
    """A pole for two: between them in frequency, of the damping of the wider."""
    return complex(poles.real.min() + 1j * poles.imag.mean())


def widened(f: Features, modes: Projected, channels: Channels) -> Features:
    """Features of bent peaks as uncertain as those of a structure without its joint."""
    chi2, relative = about_poles(modes, channels)
    own = np.abs(modes.poles[None] - f.poles[:, None]).argmin(axis=1)
    e = np.where(chi2[own] > BENT, relative[own], 0.0)
    std = np.repeat(e[:, None], f.width, axis=1)
    std[:, 0] *= FREQUENCY * np.abs(f.poles.real) / np.abs(f.poles)
    std[:, 1] *= DAMPING
    return replace(f, covariance=f.covariance + np.diag(std.ravel() ** 2))
