r"""How much channels and lines disagree on the pole of a mode, and the error of the pole where they do.

A change of a pole by :math:`\delta` changes the response of channel :math:`c` by :math:`\delta R_c/(s-\lambda)^2`. Each
part of the data (an input, an output, a flank of the resonance) so asks for a change of its own. What these differ by
beyond their noise is misfit: hits that find the structure changed, a sensor whose mass moves with it, a record too
short. It enters the deviation of the pole as in a random-effects mean (DerSimonian and Laird 1986). The pole of maximum
likelihood is the groups' mean weighed by their noise, most of all that of the strongest; how far it is from the mean
of all groups, the noise and the scatter of each counted, is known and enters too. Modes that disagree in one
test do so for one reason, so that all of them together tell whether they do (Fisher 1925, section 21.1).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Float

from modalax.identify.neighbourhood import PLAIN, Neighbourhood, squares

FLANKS = (-1.0, 0.0, 1.0)  # half-bandwidths from the resonance at which its lines are parted
CERTAIN = 1e-4  # chance of disagreement that noise makes, below which it counts

FAR = 2.0  # half-bandwidths from which on what a group asks for is no shift of the mode
SURE = 4.0  # standard deviations by noise from which on the shift of a group is no noise


class Spread(NamedTuple):
    r"""Changes of a pole that groups of the data ask for, and their scatter.

    Attributes
    ----------
    shift
        Change of the pole's frequency that each group asks for, shape ``(g,)`` [Hz]; NaN for a group without say.
    std
        Their standard deviations by noise, shape ``(g,)`` [Hz].
    between
        Standard deviation of frequency [Hz] and of the decay over :math:`2\pi` [Hz] between groups, beyond noise.
    error
        Deviation of the pole, for frequency [Hz] and decay [Hz]: the distance to the mean of all groups, and the
        standard deviation of that.
    chance
        Chance that noise alone makes them differ so.
    """

    shift: Float[np.ndarray, " g"]
    std: Float[np.ndarray, " g"]
    between: tuple[float, float]
    error: tuple[float, float]
    chance: float

    @property
    def largest(self) -> float:
        """Largest shift [Hz] of a group that its noise does not explain; 0 where noise explains all."""
        if self.chance >= CERTAIN:
            return 0.0
        sure = np.abs(self.shift) > SURE * self.std
        return float(np.max(np.abs(self.shift), where=sure, initial=0.0))


def of_channels(hood: Neighbourhood, groups: np.ndarray) -> Spread:
    """Changes of a pole that groups of channels ask for.

    Parameters
    ----------
    hood
        The lines around one mode.
    groups
        Number of the group of each channel, shape ``(c,)``.

    Notes
    -----
    A channel in which another pole still leaves more than the noise counts by what it leaves.
    """
    change = hood.weight * hood.s**hood.power / (hood.s - hood.poles[0]) ** 2
    Q = np.linalg.qr(hood.columns(hood.poles))[0]
    own = change - Q @ (Q.conj().T @ change)
    R = hood.residues[0]
    norm = max(float(np.vdot(own, own).real), 1e-300)
    size, along = np.abs(R) ** 2 * norm, own.conj() @ hood.data
    asked = R.conj() * along
    level = _left(hood.data, Q, own, along / norm) / max(len(own) - Q.shape[1] - 1, 1)
    sure = 1 / np.maximum(level, 1.0)
    count = int(groups.max()) + 1
    weight, decay, frequency = (np.bincount(groups, a * sure, count) for a in (size, asked.real, asked.imag))
    weight = np.maximum(weight, 1e-300)
    return _spread(frequency / weight, decay / weight, 2 * weight, FAR * -hood.poles[0].real)


def _left(data: np.ndarray, Q: np.ndarray, own: np.ndarray, part: np.ndarray) -> Float[np.ndarray, " c"]:
    """Sums of squares of what a basis and a part of one more column, orthogonal to it, leave of each channel.

    As a difference where that loses no digit in use.
    """
    seen = Q.conj().T @ data
    whole = np.einsum("mc,mc->c", data.real, data.real) + np.einsum("mc,mc->c", data.imag, data.imag)
    left = whole - np.sum(squares(seen), axis=0) - float(np.vdot(own, own).real) * squares(part)
    few = left <= PLAIN * whole
    if few.any():
        rest = data[:, few] - Q @ seen[:, few] - own[:, None] * part[few]
        left[few] = np.sum(squares(rest), axis=0)
    return left


def of_lines(hood: Neighbourhood) -> Spread:
    """Changes of a pole that the parts of a resonance below, around and above its peak ask for."""
    pole = hood.poles[0]
    change = hood.weight * hood.s**hood.power / (hood.s - pole) ** 2
    part = np.digitize((hood.s.imag - pole.imag) / -pole.real, FLANKS)
    parted = change[:, None] * (part[:, None] == np.arange(len(FLANKS) + 1))
    Q = np.linalg.qr(hood.columns(hood.poles))[0]
    own = parted - Q @ (Q.conj().T @ parted)
    R = hood.residues[0]
    gram = own.conj().T @ own * np.sum(np.abs(R) ** 2)
    right = own.conj().T @ (hood.data @ R.conj())
    seen = np.real(np.diag(gram)) > 1e-9 * max(float(np.real(np.trace(gram))), 1e-300)
    shift = np.full(len(seen), np.nan, complex)
    weight = np.zeros(len(seen))
    if seen.any():
        inverse = np.linalg.pinv(gram[np.ix_(seen, seen)], rcond=1e-9)
        shift[seen] = inverse @ right[seen]
        weight[seen] = 2 / np.maximum(np.real(np.diag(inverse)), 1e-300)
    return _spread(shift.imag, shift.real, weight, FAR * -pole.real)


def _spread(frequency: np.ndarray, decay: np.ndarray, weight: np.ndarray, far: float) -> Spread:
    """Random-effects spread of the groups' shifts [rad/s], of weights inverse to their variances by noise.

    A group that asks for more than ``far`` [rad/s] does not show the mode but something else.
    """
    seen = weight > 1e-6 * max(float(weight.max(initial=0.0)), 1e-300)
    seen &= np.hypot(np.nan_to_num(frequency), np.nan_to_num(decay)) < far
    w = weight[seen]
    unit = 2 * np.pi
    shift = np.where(seen, frequency, np.nan) / unit
    std = np.where(seen, 1 / np.sqrt(np.where(seen, weight, 1.0)), np.nan) / unit
    if len(w) < 2:
        return Spread(shift, std, (0.0, 0.0), (0.0, 0.0), 1.0)
    between, error, statistic = [], [], 0.0
    for values in (frequency[seen], decay[seen]):
        mean = np.sum(w * values) / np.sum(w)
        q = float(np.sum(w * (values - mean) ** 2))
        statistic += q
        tau2 = max(0.0, (q - (len(w) - 1)) / (np.sum(w) - np.sum(w**2) / np.sum(w)))
        between.append(np.sqrt(tau2) / unit)
        both = 1 / (1 / w + tau2)
        error.append(np.hypot(np.sum(both * values) / np.sum(both), 1 / np.sqrt(np.sum(both))) / unit)
    chance = float(scipy.special.chdtrc(2 * (len(w) - 1), statistic))
    return Spread(
        shift, std, (float(between[0]), float(between[1])), (float(error[0]), float(error[1])), chance
    )  # fmt: skip


def together(chances: Sequence[float]) -> float:
    """Chance that noise alone makes several independent comparisons differ so (Fisher's method)."""
    if not chances:
        return 1.0
    statistic = -2 * np.sum(np.log(np.maximum(chances, np.finfo(float).tiny)))
    return float(scipy.special.chdtrc(2 * len(chances), statistic))
