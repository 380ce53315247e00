"""Modes beside the band that nobody told of: their tails in it are no matter of residual terms where they are near."""

from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, project
from modalax.diagnose.modal_domain.modes.mode_count import cost_of_mode, misfit

MOST = 4  # such modes
PLACES = np.array([0.35, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97])  # frequencies tried, over the lower end of the band
FINER = 9  # places about the best of these, twice
FEW = 4  # lines on which a mode that is narrower than their distance is seen
NEW = 1e-10  # part of a kernel that is not in others, below which it is rounding
DAMPING = 0.01  # ratio, which tails hardly tell


def with_modes_beside(found: Projected, channels: Channels) -> Channels:
    """The channels with poles beside the band in their background, as many as the data surely ask for.

    Their frequencies are those of least chi-square with the poles ``found`` as they are.
    """
    for _ in range(MOST):
        unknowns = found.linear.shape[0] * found.linear.shape[1] + 2 * len(found.poles)
        least = cost_of_mode(channels) * misfit(found, channels)
        if found.chi2 - (channels.samples - unknowns) < least:
            break
        trial = replace(channels, outside=np.append(channels.outside, (1j - DAMPING) * _best(found, channels)))
        again = project(found.poles, trial)[0]
        if _gained(found, channels, again, trial) < least:
            break
        found, channels = again, trial
    return channels


def _gained(found: Projected, channels: Channels, again: Projected, trial: Channels) -> float:
    """Chi-square gained beside the lines at which most is: a tail is seen on many, a mode between two lines on few."""
    left, now = (
        (channels.weight * np.abs(channels.data - modes.made(by)) ** 2).sum(axis=1)
        for modes, by in ((found, channels), (again, trial))
    )
    return float(np.sort(left - now)[:-FEW].sum())


def _best(found: Projected, channels: Channels) -> float:
    """Frequency [rad/s] beside the band at which one more pole takes off most."""
    low, high = np.abs(channels.s[[0, -1]])
    places = np.concatenate([low * PLACES, high / PLACES[::-1]])
    for finer in (FINER, FINER, 0):
        best = int(np.argmax(gains_beside(found, channels, places)))
        ends = places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)]
        if ends[0] < low < ends[1]:  # on either side of the band
            ends = (ends[0], places[best]) if places[best] < low else (places[best], ends[1])
        if not finer:
            break
        places = np.linspace(*ends, finer)
    return float(places[best])


def gains_beside(found: Projected, channels: Channels, w: np.ndarray) -> np.ndarray:
    """Chi-square that each further pole takes off with all that is linear fitted again, shape ``(n,)``.

    ``w`` are their circular frequencies [rad/s], shape ``(n,)``.
    What a pole's two kernels have in common with those that are there is taken out of them, channel by channel.
    """
    new = channels.kernels((1j - DAMPING) * w)
    there = np.concatenate([channels.kernels(found.poles), channels.background()], axis=1)
    rest, gain = channels.data - found.made(channels), np.zeros(len(w))
    for k, weight in enumerate(channels.weight.T):
        heavy = weight[:, None] * new
        b = heavy.real.T @ rest[:, k].real + heavy.imag.T @ rest[:, k].imag
        cross = there.real.T @ heavy.real + there.imag.T @ heavy.imag
        apart = (cross * (found.linear[k] @ cross)).reshape(len(cross), -1, 2)
        whole = (new.conj() * heavy).real.sum(axis=0).reshape(-1, 2)
        both = whole - apart.sum(axis=0)
        mixed = (new[:, ::2].conj() * heavy[:, 1::2]).real.sum(axis=0)
        mixed -= np.einsum("xp,xp->p", cross[:, ::2], (found.linear[k] @ cross)[:, 1::2])
        det = both[:, 0] * both[:, 1] - mixed**2
        sound = (both > NEW * whole).all(axis=1) & (det > NEW * both[:, 0] * both[:, 1])
        p, q = b.reshape(-1, 2).T
        taken = p**2 * both[:, 1] - 2 * p * q * mixed + q**2 * both[:, 0]
        gain[sound] += taken[sound] / det[sound]
    return gain
