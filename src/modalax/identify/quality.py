r"""Quality of each mode: how far it stands out of the noise, and how well the parts of the data agree on it.

All of it comes from the lines around the mode with everything else taken out (:mod:`modalax.identify.neighbourhood`),
so that the same numbers exist with and without a refinement.
"""

from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Float

from modalax.data.frf import FRF
from modalax.identify.best_poles import best_poles
from modalax.identify.disagreement import Spread, of_channels, of_lines
from modalax.identify.neighbourhood import Left, Neighbourhood, around, left_of, line_noise
from modalax.identify.one_mode import NOTHING_LEFT, Rest, rest_of
from modalax.identify.tables import PoleTable
from modalax.model.modal import ModalModel

CHANCE = 1e-6  # chance at which a mode is found in noise alone
CLEAR = 10.0  # times the gain by chance from which on a mode is clear, however far its pole is off
CORE = 2.0  # half-bandwidths about a resonance within which a mode is compared with what is left there
REACH = 0.02  # part of a frequency within which a pole of another order may be the same mode
LATE = 0.5  # part of the orders, from the highest down, whose poles tell the scatter


class ModeQuality(NamedTuple):
    """Quality of one mode, from the lines around it.

    Attributes
    ----------
    gain
        Rise of twice the log-likelihood of these lines by the mode, in units of the noise or of what is left if more.
    chance_gain
        The gain that a pole put anywhere into noise alone exceeds with a probability of ``CHANCE``.
    share
        Part of the response about the peak that is the mode's rather than left: 1 where nothing is left.
    peak
        Largest response of the mode over the noise's standard deviation at any line and channel.
    channels
        Number of channels that its response is spread over, the inverse participation ratio of their energies: in the
        FRFs' units or over the noise, whichever is more.
    lines, inputs, outputs
        What the flanks of the resonance, the inputs and the outputs ask for; None where there is only one.
    rest
        What one mode leaves of the lines around it, as a second one beside it would.
    """

    gain: float
    chance_gain: float
    share: float
    peak: float
    channels: float
    lines: Spread
    inputs: Spread | None
    outputs: Spread | None
    rest: Rest = NOTHING_LEFT

    def error(self) -> tuple[float, float]:
        """Largest standard deviation of frequency and of decay over 2 pi [Hz] that misfit gives the pole."""
        told = [s for s in (self.lines, self.inputs, self.outputs) if s is not None and len(s.shift) > 1]
        return max((s.error[0] for s in told), default=0.0), max((s.error[1] for s in told), default=0.0)


def quality_of(frf: FRF, model: ModalModel, left: Left | None = None) -> list[ModeQuality]:
    """Quality of each mode of a model, with what it leaves of the FRF if that is known."""
    residual, scatter = left_of(frf, model) if left is None else left
    return [_one(frf, around(frf, model, residual, [r], True, scatter)) for r in range(model.poles.size)]


def gains_of(
    frf: FRF, model: ModalModel, which: np.ndarray | None = None, searched: bool = False, left: Left | None = None
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each mode, or some of them by their indices, ``gain`` and ``chance_gain`` of :class:`ModeQuality` alone.

    With ``searched`` the gain of a mode that is not clear is that of the best pole near its own, which may be off.
    """
    residual, scatter = left_of(frf, model) if left is None else left
    both = np.zeros((model.poles.size if which is None else len(which), 2))
    for k, r in enumerate(np.arange(model.poles.size) if which is None else which):
        hood = around(frf, model, residual, [int(r)], True, scatter)
        gain, by_chance = _gain(hood, hood.squares_left(hood.poles)), _chance_gain(frf, hood.data.size)
        if searched and gain < CLEAR * by_chance:
            gain = _gain(hood, best_poles(hood, hood.poles)[1])
        both[k] = gain, by_chance
    return both[:, 0], both[:, 1]


def _gain(hood: Neighbourhood, rest: float) -> float:
    """Rise of twice the log-likelihood by the mode, which leaves this sum of squares."""
    lines, channels = hood.data.shape
    samples = max(2 * (lines - 1 - hood.fixed.shape[1]) * channels - 2, 1)
    return 2 * (hood.squares_left(np.zeros(0)) - rest) / max(2 * rest / samples, 1.0)


def _one(frf: FRF, hood: Neighbourhood) -> ModeQuality:
    _, n_out, n_in = frf.shape
    count = hood.data.shape[1]
    left = hood.left(hood.poles)
    own = (hood.pole_kernel(hood.s, complex(hood.poles[0])) * hood.weight)[:, None] * hood.residues
    width = -float(hood.poles[0].real)
    distance = np.abs(hood.s.imag - hood.poles[0].imag)
    core = distance <= max(CORE * width, float(np.partition(distance, 2)[2]))
    mine, rest = np.sum(np.abs(own[core]) ** 2), np.sum(np.abs(left[core]) ** 2)
    # Where the noise of one sensor is far below that of the others, these may still show the mode plainly.
    spread = max(_spread_over(hood.residues[0]), _spread_over(hood.residues[0] * hood.noise))
    out, into = np.divmod(np.arange(count), n_in)
    gain, twin = _gain(hood, float(np.vdot(left, left).real)), hood.beside_twins()
    asked = None if twin is None else _gain(twin, twin.squares_left(twin.poles))
    alone = twin if asked is not None and asked > gain else None
    return ModeQuality(
        gain=gain if alone is None or asked is None else asked,
        chance_gain=_chance_gain(frf, left.size),
        share=float(mine / max(mine + rest, 1e-300)),
        peak=float(np.abs(own).max()),
        channels=spread,
        lines=of_lines(hood if alone is None else alone),
        inputs=of_channels(hood, into) if n_in > 1 and alone is None else None,
        outputs=of_channels(hood, out) if n_out > 1 and alone is None else None,
        rest=rest_of(hood),
    )


def _spread_over(residues: np.ndarray) -> float:
    energy = np.abs(residues / max(float(np.abs(residues).max()), 1e-300)) ** 2
    return float(energy.sum() ** 2 / max(np.sum(energy**2), 1e-300))


def _chance_gain(frf: FRF, samples: int) -> float:
    """Gain by chance: an F quantile where the noise was read off so many samples, shared among the lines."""
    unknowns = 2 * (frf.shape[1] + frf.shape[2])
    chance = CHANCE / len(frf.freq)
    if frf.variance is not None:
        return float(scipy.special.chdtri(unknowns, chance))
    rest = scipy.special.betaincinv(
        samples / 2, unknowns / 2, chance
    )  # of a beta variable, 1 / (1 + unknowns F / samples)
    return float(samples * (1 - rest) / rest)


def noise_part(frf: FRF, residual: np.ndarray, even: bool = False) -> float:
    """Part of the FRFs' sum of squares that is noise in the residual, by the variance or else from line to line.

    Where misfit is known to be as narrow as the lines, ``even`` takes the noise of a typical line for that of all.
    """
    rest = np.sum(np.abs(residual) ** 2)
    if frf.variance is not None:
        noise = np.sum(np.asarray(frf.variance))
    else:
        lines = line_noise(residual.reshape(len(residual), -1))
        # The powers of complex noise are exponentially distributed: their median is ln 2 of their mean.
        noise = np.sum(np.median(lines, axis=0)) * len(lines) / np.log(2) if even else np.sum(lines)
    return float(min(float(noise), float(rest)) / np.sum(np.abs(np.asarray(frf.H)) ** 2))


def scatter_over_orders(table: PoleTable, poles: np.ndarray) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """How much frequency [Hz] and damping ratio of each mode scatter over the higher orders of the diagram.

    Half the distance between the 16 % and 84 % points of the nearest poles, within ``REACH``; NaN where fewer than
    three orders have one.
    """
    physical = np.asarray(table.physical(max_damping=0.5))
    late = range(int(LATE * len(table.orders)), len(table.orders))
    f_scatter, z_scatter = np.full(len(poles), np.nan), np.full(len(poles), np.nan)
    found = np.asarray(table.poles)
    for r, pole in enumerate(poles):
        seen = []
        for row in late:
            own = found[row][physical[row]]
            near = own[np.abs(own - pole) < REACH * abs(pole)]
            if len(near):
                seen.append(near[np.argmin(np.abs(near - pole))])
        if len(seen) >= 3:
            f, zeta = np.abs(seen) / (2 * np.pi), -np.real(seen) / np.abs(seen)
            f_scatter[r], z_scatter[r] = (0.5 * np.diff(np.percentile(a, [16, 84]))[0] for a in (f, zeta))
    return f_scatter, z_scatter
