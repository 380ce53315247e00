r"""Sweeps too fast for the resonances, told by the FRFs alone, and taken out of them.

A linear sweep of S rad/s in a second sees the impulse response times :math:`e^{jSt^2/2}`
(:mod:`modalax.diagnose.modal_domain.modes.windows`): each mode keeps its pole and its residue, its peak gets beats on
the far side. Without knowing of the sweep these take several poles in each peak. Where some lie so close, one pole a
peak is fitted through sweeps of rates of all sizes up and down; the one that explains all FRFs with fewer modes is what
happened.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize

from modalax.data import Measurement
from modalax.diagnose.causes.records import FastSweep
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, refine
from modalax.diagnose.modal_domain.modes.measured import Measured, prepared
from modalax.diagnose.modal_domain.modes.mode_count import blind_modes, cost_of_mode, misfit, mode_gains
from modalax.diagnose.modal_domain.modes.windows import Sweep
from modalax.diagnose.modal_domain.records.forced import Forced
from modalax.diagnose.modal_domain.records.short_records import strongest
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.diagnose.modal_domain.structure.modes_only import Simulation
from modalax.diagnose.thresholds import THRESHOLDS

TOGETHER = 2.0  # half-bandwidths of two poles, added, over their distance, from which on they are in one peak
RATES = np.geomspace(1e-3, 3.0, 20)  # sweep rates that are tried, over the square of the width of a beating peak
SEVERAL = 1.5  # poles to a peak, on average, from which on a sweep is looked for
BETTER = 0.5  # part of the chi-square of one pole a peak without a sweep that the best rate tried must come below
SHARE = 0.2  # of the time, after which no sweep is looked for any more
FEW, TURNS = 6, 2  # steps of a refinement at each rate, and turns of finding the rate and the modes
NEARER = np.array([1.0, 0.1, 0.02])  # of the distance of rates that are tried, within which the best is sought in turns
STEP = 0.03  # of such a distance, to which the best is found
BENT = np.geomspace(1e-3, 0.5, 10)  # relative steps of the rate, of which the first tells its standard deviation
RISE = 4.0  # by which chi-square rises with it, more than refinements end apart


@dataclass(frozen=True)
class Swept(Change):
    """A sweep of a rate [rad/s^2], with its standard deviation."""

    rate: float = 0.0
    std: float = 0.0

    @property
    def sized(self) -> bool:
        """Its rate was found before."""
        return False

    @property
    def in_catalogue(self) -> FastSweep:
        """The same line by line."""
        return FastSweep()

    def told(self, u: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
        """The rate."""
        values, spread, _ = self.as_catalogue(u, covariance)
        return {"sweep_rate": {"value": values[0], "std": spread[0], "unit": "Hz/s"}}

    def as_catalogue(self, u: np.ndarray, covariance: np.ndarray) -> tuple[list[float], list[float], None]:
        """The rate in Hz/s."""
        return [self.rate / 2 / math.pi], [self.std / 2 / math.pi], None


def fast_sweep(
    measurement: Measurement, simulation: Simulation, measured: Measured, late: Deadline, tell: Callable[[str], None]
) -> Forced | None:  # fmt: skip
    """What a sweep too fast for the resonances adds to the FRFs; None where none explains them with fewer modes.

    Looked for where all runs agree, and modes leave something or several lie in a peak. What modes without a sweep
    leave is no noise, so that this is taken as it was before any mode was known.
    """
    H = np.asarray(measurement.H)
    explained = measured.misfit < THRESHOLDS.as_noise and not beats(measured.modes.poles)
    if explained or len(measured.runs) < len(H):
        return None
    highest = 2 * np.pi * float(measurement.freq[-1])
    c = coordinates_of(simulation, measurement.outputs, measurement.inputs, highest)
    return sweep_in(prepared(measurement, c)[0], H.shape[1:], late.part(SHARE), tell)


def sweep_in(
    channels: Channels, shape: tuple[int, ...], late: Deadline, tell: Callable[[str], None]
) -> Forced | None:  # fmt: skip
    """What a sweep adds to FRFs ``(f, o, i)``; None where none explains them with fewer modes."""
    few = strongest(channels)
    plain = blind_modes(few)
    if not beats(plain.poles):
        return None
    groups = peaks(plain.poles)
    tell("looking for a sweep too fast for the resonances, as several modes seem to lie in one peak")
    gains = mode_gains(plain)
    poles = np.array([plain.poles[g[np.argmax(gains[g])]] for g in groups])
    width = min(np.ptp(plain.poles[g].imag) - plain.poles[g].real.mean() for g in groups if len(g) > 1)
    rate, modes = _tried(few, poles, width**2, late)
    if late() or modes.chi2 > BETTER * refine(poles, few).chi2:
        return None
    for _ in range(TURNS):
        rate, modes = _settled_rate(few, modes.poles, rate, 1)
        modes = blind_modes(_through(few, rate))
    if modes.chi2 + _cost(modes, few) > plain.chi2 + _cost(plain, few):
        return None
    rate, modes = _settled_rate(channels, blind_modes(_through(channels, rate), modes.poles).poles, rate)
    through = _through(channels, rate)
    plain = blind_modes(channels)
    nats = 0.5 * (plain.chi2 + _cost(plain, channels) - modes.chi2 - _cost(modes, channels))
    if misfit(modes, through) > THRESHOLDS.as_noise or nats < THRESHOLDS.further_cause:
        return None
    effect = modes.made(through) - modes.made(_through(channels, 0.0))
    cause = Swept("fast_sweep", (), rate=rate, std=_error(channels, modes, rate))
    return Forced(cause, np.zeros(1), np.zeros((1, 1)), 1.0, nats, (), effect.reshape(shape))


def beats(poles: np.ndarray) -> bool:
    """Whether most peaks have several poles, as a sweep makes them; single pairs of close modes are nothing unusual."""
    return len(poles) >= SEVERAL * len(peaks(poles)) > 0


def peaks(poles: np.ndarray) -> list[np.ndarray]:
    """Numbers of the poles in each peak: those that others of it are as close to as they are wide."""
    order, groups = np.argsort(poles.imag), []
    for k in order:
        near = groups and abs(poles[k] - poles[groups[-1][-1]]) < -TOGETHER * (poles[k] + poles[groups[-1][-1]]).real
        groups = [*groups[:-1], [*groups[-1], k]] if near else [*groups, [k]]
    return [np.array(g) for g in groups]


def _through(channels: Channels, rate: float) -> Channels:
    return replace(channels, window=Sweep(rate))


def _cost(modes: Projected, channels: Channels) -> float:
    """Chi-square that modes are to gain, so that they count as more than noise."""
    return cost_of_mode(channels) * len(modes.poles)


def _tried(channels: Channels, poles: np.ndarray, usual: float, late: Callable[[], bool]) -> tuple[float, Projected]:
    """The rate that leaves least, up or down, with poles that follow it from rate to rate."""
    found = []
    for way in (1, -1):
        at = poles
        for rate in way * usual * RATES:
            if found and late():
                break
            trial = refine(at, _through(channels, float(rate)), FEW)
            at = trial.poles
            found.append((float(rate), trial))
    return min(found, key=lambda one: one[1].chi2)


def _settled_rate(
    channels: Channels, poles: np.ndarray, rate: float, turns: int = len(NEARER)
) -> tuple[float, Projected]:  # fmt: skip
    """The rate of least chi-square near one of those tried, and the modes with it."""
    for far in NEARER[:turns] * math.log(RATES[1] / RATES[0]):
        best = scipy.optimize.minimize_scalar(
            lambda x, poles=poles, rate=rate: refine(poles, _through(channels, rate * math.exp(x)), FEW).chi2,
            bounds=(-far, far), method="bounded", options={"xatol": STEP * far},
        )  # fmt: skip
        rate *= math.exp(float(best.x))
        poles = refine(poles, _through(channels, rate)).poles
    return rate, refine(poles, _through(channels, rate))


def _error(channels: Channels, modes: Projected, rate: float) -> float:
    """Standard deviation of the rate, everything else fitted beside it."""
    for step in BENT * abs(rate):
        sides = [refine(modes.poles, _through(channels, rate + x)).chi2 for x in (-step, step)]
        rise = sum(sides) / 2 - modes.chi2
        if rise > RISE:
            return float(step / math.sqrt(rise))
    return math.inf
