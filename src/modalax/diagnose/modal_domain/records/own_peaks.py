r"""One output whose peaks are its own: the mass of a sensor that is at its place only while it measures there.

A sensor that roves loads the structure with its mass m, so that its FRFs are :math:`H_s/(1 + s^2 m H_{ss})`, with
peaks where the others have none. All outputs together then show nearly twice as many modes as without that one, which
tells it apart without a simulation. The structure is diagnosed from the others, which makes :math:`H_{ss}` known; the
mass that explains the output best is taken on to all lines, together with everything else.
"""

from dataclasses import replace

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.causes.change import with_sizes
from modalax.diagnose.modal_domain.causes.line_forces import RovingMass
from modalax.diagnose.modal_domain.fitting.explanation import Prior
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.free_residues import Channels, Projected, refine
from modalax.diagnose.modal_domain.modes.measured import Measured, channels_of
from modalax.diagnose.modal_domain.modes.mode_count import cost_of_mode, misfit, mode_gains, settled
from modalax.diagnose.modal_domain.on_lines.lines import Lines, lines_of
from modalax.diagnose.modal_domain.on_lines.polish import chi2_of, descended, frf_on_lines
from modalax.diagnose.modal_domain.records.forced import Forced, fitted_from, told_force
from modalax.diagnose.modal_domain.search.force_places import roving_mass
from modalax.diagnose.modal_domain.stage import Stage

FEWEST = 3  # outputs of which one can be told apart from the others
OWN = 2  # fewest modes that are an output's own beside all others; one more may be that of what the sensor sits on
HARDLY = 0.5  # part of what all FRFs show of a mode, below which some of them hardly do
ITS_OWN = 0.15  # part of what all FRFs show of a mode, below which that is no mode of one output alone
AS_WELL = 1.1  # how much more chi-square per sample the others may leave by themselves
MASSES = np.geomspace(1e-3, 30.0, 400)  # that are tried, over the usual one; a step moves no peak by half its width
TRIED = 3  # of them that are taken on to the lines


def own_peaks(measured: Measured, outputs: int, inputs: int) -> int | None:
    """The output without which fewer modes explain all others as well; None where none or several are such.

    A single mode of its own is enough where it is in the place of another, which that output lacks.
    """
    if outputs < FEWEST or len(measured.modes.poles) < 2 * OWN:
        return None
    rows = np.arange(outputs * inputs) // inputs
    own = _share(measured, rows)
    if own.max() < ITS_OWN:
        return None
    some = (own >= ITS_OWN) | (own >= np.sort(own)[-FEWEST])
    counts = np.array([_not_needed(measured, rows != k) if some[k] else 0 for k in range(outputs)])
    second, best = np.argsort(counts)[-2:]
    more = counts[best] - counts[second]
    return int(best) if more >= OWN or (more > 0 and _not_needed(measured, rows == best) > 0) else None


def _share(measured: Measured, rows: np.ndarray) -> np.ndarray:
    """Largest part that each output has in what all FRFs show of a mode; ``rows`` is the output of each FRF."""
    seen = np.abs(measured.modes.residues) ** 2 * measured.channels.weight.sum(axis=0)
    by_output = np.stack([seen[:, rows == k].sum(axis=1) for k in range(rows[-1] + 1)], axis=1)
    return (by_output / np.maximum(by_output.sum(axis=1, keepdims=True), 1e-300)).max(axis=0)


def _not_needed(measured: Measured, kept: np.ndarray) -> int:
    """How many of all modes those FRFs that are ``kept`` do without; none where they are explained worse."""
    c, found = measured.channels, measured.modes
    some = replace(c, data=c.data[:, kept], weight=c.weight[:, kept])
    seen = np.abs(found.residues) ** 2 * c.weight.sum(axis=0)
    hardly = found.poles[seen[:, kept].sum(axis=1) < HARDLY * seen.sum(axis=1)]
    fewer = _paired(settled(refine(found.poles, some), some), some, hardly)
    return len(found.poles) - len(fewer.poles) if misfit(fewer, some) < AS_WELL * measured.misfit else 0


def _paired(found: Projected, channels: Channels, hardly: np.ndarray) -> Projected:
    """Modes of which none stands beside another in one peak that one of them explains once it has moved there.

    Only modes nearest to poles that are ``hardly`` seen are done without: two close modes may well be two.
    """
    while len(found.poles) > 1 and len(hardly):
        apart = np.abs(found.poles[:, None] - found.poles) + np.where(np.eye(len(found.poles)), np.inf, 0.0)
        weaker = np.argsort(mode_gains(found))
        some = set(np.abs(found.poles - hardly[:, None]).argmin(axis=1).tolist())
        close = [k for k in weaker if apart[k].min() < -found.poles[[k, apart[k].argmin()]].real.sum() and k in some]
        trials = (refine(np.delete(found.poles, k), channels) for k in close)
        most = found.chi2 + cost_of_mode(channels) * misfit(found, channels)
        fewer = next((trial for trial in trials if trial.chi2 < most), None)
        if fewer is None:
            break
        found = fewer
    return found


def without_output(measurement: Measurement, which: int) -> Measurement:
    """All outputs but one."""
    kept = [k for k in range(len(measurement.outputs)) if k != which]
    take = lambda a: None if a is None else np.asarray(a)[:, :, kept]
    return measurement.replace(
        H=take(measurement.H), variance=take(measurement.variance), coherence=take(measurement.coherence),
        outputs=tuple(measurement.outputs[k] for k in kept),
    )  # fmt: skip


def mass_of_sensor(
    stage: Stage, measurement: Measurement, measured: Measured, which: int, late: Deadline
) -> Forced | None:  # fmt: skip
    """The mass at an output that a ``stage`` was diagnosed without; None where no mass explains its FRFs.

    Parameters
    ----------
    measurement, measured
        All outputs.
    which
        The output.
    """
    name, c = measurement.outputs[which], stage.coordinates
    row = c.shapes[stage.simulation.dofs.index(name)]
    order = [k for k in range(len(measurement.outputs)) if k != which] + [which]  # numbers of the others stay
    setting = replace(stage.setting, coordinates=replace(c, outputs=np.concatenate([c.outputs, row[None]])))
    own = measured.channels
    H, sigma = np.asarray(measurement.H)[measured.runs], measured.noise.sigma[measured.runs]
    channels = channels_of(own.s, H[:, :, order], sigma[:, :, order], own.order, own.outside)
    lines = lines_of(channels, setting, measured.misfit)
    others = replace(lines, H=lines.H[:, :-1], weight=lines.weight[:, :-1])
    low, high = (float(abs(own.s[k])) for k in (0, -1))
    cause = roving_mass(c, name, len(order) - 1, row, low, high)
    base = stage.best.fit
    if cause is None:
        return None
    level = max(1.0, chi2_of(stage.setting, base, others) / max(others.samples, 1))
    starts = [(base, cause, np.array([m])) for m in _masses(setting, base, cause, lines)]
    trials = fitted_from(setting, starts, lines, late)
    without = descended(setting, base, lines, late)  # it has to stand for the output as well, as the fit with a mass
    n = len(base.sizes)
    bases = [base if without is None else replace(base, sizes=without.x[:n], u=without.x[n:])]
    forced = told_force(setting, trials, bases, Prior(stage.candidates), [cause], lines, own.s, level)
    return None if forced is None else replace(forced, effect=forced.effect[:, np.argsort(order)])


def _masses(setting: Setting, base: Fit, cause: RovingMass, lines: Lines) -> list[float]:
    """Sizes that leave locally the least of the output's FRFs, the best first."""
    s, row = lines.s, cause.row
    inside = [(k, u) for k, u in with_sizes(base.causes, base.u) if k.local and not k.in_channels]
    kept, u = tuple(k for k, _ in inside), np.concatenate([np.zeros(0), *(u for _, u in inside)])
    assert row is not None
    own = replace(setting, coordinates=replace(setting.coordinates, outputs=cause.basis.T, inputs=cause.basis.T))
    drive = frf_on_lines(own, kept, base.sizes, u, s, 0)[:, 0, 0]
    H, weight = lines.H[:, row], lines.weight[:, row]
    plain = frf_on_lines(setting, base.causes, base.sizes, base.u, s, lines.order)[:, row]
    left = np.array([
        (weight * np.abs(H - plain / (1 + s**2 * cause.scale * m * drive)[:, None]) ** 2).sum() for m in MASSES
    ])  # fmt: skip
    padded = np.concatenate([[np.inf], left, [np.inf]])
    low = np.flatnonzero((left <= padded[:-2]) & (left < padded[2:]))
    return [float(MASSES[k]) for k in low[np.argsort(left[low])][:TRIED]]
