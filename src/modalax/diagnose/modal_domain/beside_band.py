"""Modes beside the band that nobody told of: their tails in it are no matter of residual terms where they are near."""

from dataclasses import replace

import numpy as np
import scipy.optimize

from modalax.diagnose.modal_domain.free_residues import Channels, Projected, project
from modalax.diagnose.modal_domain.mode_count import cost_of_mode, misfit

MOST = 4  # such modes
PLACES = np.array([0.35, 0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97])  # frequencies tried, over the lower end of the band
FEW = 4  # lines on which a mode that is narrower than their distance is seen
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
        trial = _best(found.poles, channels)
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


def _best(poles: np.ndarray, channels: Channels) -> Channels:
    """The channels with one more pole in their background, at the best of all places on either side."""

    def beside(w: float) -> Channels:
        return replace(channels, outside=np.append(channels.outside, (1j - DAMPING) * w))

    def left(w: float) -> float:
        return project(poles, beside(w))[0].chi2

    low, high = np.abs(channels.s[[0, -1]])
    sides = low * PLACES, high / PLACES[::-1]
    places = np.concatenate(sides)
    best = int(np.argmin([left(w) for w in places]))
    own = sides[0] if best < len(PLACES) else sides[1]
    at = best % len(PLACES)
    bounds = float(own[max(at - 1, 0)]), float(own[min(at + 1, len(own) - 1)])
    found = scipy.optimize.minimize_scalar(left, bounds=bounds, method="bounded", options={"maxiter": 10})
    return beside(float(found.x) if found.fun < left(places[best]) else float(places[best]))
