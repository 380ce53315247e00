r"""Phases of residues, which a delay or a wrong form changes for all modes alike.

For modes that are nearly real the residues of the receptance lie on the imaginary axis. A delay :math:`\tau` turns
them by :math:`-\omega_r\tau`; one derivative too few or too many turns all of them by 90 degrees, two of them turn all
by 180, which only a drive point can show.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import CLEAR, Study

# Angle by which the residues of complex modes may scatter [rad].
SCATTER = 0.10
# Least standard deviation of an angle [rad].
FLOOR = 0.03
# A delay is reported from this angle at the highest mode on [rad], and from this reduction of the sum of squares on.
SMALLEST_ANGLE, GAIN = 0.2, 30.0
# Sum of squares per residue that a good explanation may leave, and the number of modes that it takes.
LEFT, FEWEST_MODES = 3.0, 3


class Angles(NamedTuple):
    """Angles of residues off the imaginary axis, an entry for each mode, output and input.

    Attributes
    ----------
    angle
        Of :math:`jA_r` [rad]; at a drive point 0 is sound, elsewhere 0 or pi.
    weight
        Inverse square of its scatter.
    drive
        Whether the entry is of a drive point.
    """

    mode: np.ndarray
    o: np.ndarray
    i: np.ndarray
    omega: np.ndarray
    angle: np.ndarray
    weight: np.ndarray
    drive: np.ndarray

    def take(self, which: np.ndarray) -> "Angles":
        """The entries selected by ``which``."""
        return Angles(*(a[which] for a in self))


def angles_of(study: Study) -> Angles:
    """Angles of all residues that are well above their noise."""
    omega, residues, std = study.summed
    r, o, i = np.nonzero(np.abs(residues) > CLEAR * std)
    signs = np.ones(residues.shape[1:])
    drive = np.zeros(residues.shape[1:], bool)
    for p in study.drive_points:
        signs[p.o, p.i], drive[p.o, p.i] = p.sign, True
    values = 1j * residues[r, o, i] * signs[o, i]
    scatter = (std[r, o, i] / np.abs(values)) ** 2 + SCATTER**2
    return Angles(r, o, i, omega[r], np.angle(values), 1 / scatter, drive[o, i])


def misfit(angles: Angles, tau: float, turn: float = 0.0) -> float:
    """Sum of squares that a delay [s] and a turn [rad] leave; signs are free except at drive points."""
    rest = angles.angle + angles.omega * tau - turn
    free = np.where(angles.drive, 0.5 * (1 - np.cos(rest)) * 4, 0.5 * (1 - np.cos(2 * rest)))
    return float(np.sum(angles.weight * free))


def best_delay(angles: Angles, turn: float = 0.0) -> tuple[float, float, float]:
    """Delay [s] that leaves the least sum of squares, that sum, and the standard deviation of the delay."""
    top = angles.omega.max()
    grid = np.linspace(-1, 1, 241) * 0.95 * np.pi / top
    left = np.array([misfit(angles, t, turn) for t in grid])
    best = int(np.argmin(left))
    fine = grid[best] + np.linspace(-1, 1, 41) * (grid[1] - grid[0])
    values = np.array([misfit(angles, t, turn) for t in fine])
    k = int(np.argmin(values))
    std = 1 / np.sqrt(np.sum(angles.weight * angles.omega**2))
    return float(fine[k]), float(values[k]), float(std)


def delay(study: Study) -> Iterator[Finding]:
    """Find outputs, or a force, that are delayed or early by a constant time."""
    angles = angles_of(study) if study.explained else None
    if angles is None or len(np.unique(angles.mode)) < FEWEST_MODES:
        return
    common = _late(_middles(angles))
    if common is not None:
        yield _delay_finding(study, angles, (), common)
        angles = angles._replace(angle=angles.angle + angles.omega * common[0])
    for k, name in enumerate(study.outputs):
        own = angles.take(angles.o == k)
        found = _late(_beside(own, angles.take(angles.o != k)))
        if found is not None:
            yield _delay_finding(study, own, (name,), found)


def _middles(angles: Angles) -> Angles:
    """The median angle of each mode over all channels, as one entry for each mode."""
    entries = []
    for r in np.unique(angles.mode):
        own = angles.take(angles.mode == r)
        middle = _middle(own)
        scatter = np.sum(_apart(own.angle - middle) ** 2) + 2 * SCATTER**2
        # Complex modes turn many channels the same way, so that many channels are no better than a few.
        weight = 1 / (scatter / (len(own.angle) + 1) / min(len(own.angle), 3) + FLOOR**2)
        entries.append((r, 0, 0, own.omega[0], middle, weight, False))
    return Angles(*(np.array(column) for column in zip(*entries, strict=True)))


def _beside(own: Angles, others: Angles) -> Angles:
    """Angles of one channel relative to the median of the others, weighted by how these scatter in each mode."""
    angle, weight = own.angle.copy(), own.weight.copy()
    for k, r in enumerate(own.mode):
        rest = others.take(others.mode == r)
        scatter = FLOOR**2 + 2 * SCATTER**2 / (len(rest.angle) + 1)
        if len(rest.angle):
            middle = _middle(rest)
            angle[k] -= middle
            scatter += np.sum(_apart(rest.angle - middle) ** 2) / (len(rest.angle) + 1)
        weight[k] = 1 / (1 / own.weight[k] - SCATTER**2 + scatter)
    return own._replace(angle=angle, weight=weight, drive=np.zeros_like(own.drive))


def _middle(angles: Angles) -> float:
    """Angle about which undirected angles lie [rad]: of the entries the one that is closest to all others."""
    gaps = np.abs(_apart(angles.angle[:, None] - angles.angle[None, :]))
    return float(_apart(angles.angle[np.argmin(gaps @ np.minimum(angles.weight, 1 / FLOOR**2))]))


def _apart(angle: Any) -> Any:
    """Angles of undirected lines, from -pi/2 to pi/2."""
    return (angle + np.pi / 2) % np.pi - np.pi / 2


def _late(angles: Angles) -> tuple[float, float, float] | None:
    """Delay, its standard deviation and the reduction of the sum of squares; None where no delay explains them."""
    if len(np.unique(angles.mode)) < FEWEST_MODES:
        return None
    before = misfit(angles, 0.0)
    tau, left, std = best_delay(angles)
    gain = before - left
    count = len(angles.angle)
    top = angles.omega.max()
    if gain < GAIN or left > LEFT * count or left > 0.3 * before or abs(tau) * top < SMALLEST_ANGLE:
        return None
    return tau, std * max(1.0, np.sqrt(left / max(count - 1, 1))), gain


def _delay_finding(study: Study, angles: Angles, where: tuple[str, ...], found: tuple[float, float, float]) -> Finding:
    tau, std, gain = found
    frequency = angles.omega / (2 * np.pi)
    shown = np.degrees((angles.angle + np.pi / 2) % np.pi - np.pi / 2)
    line = np.array([0.0, frequency.max()])
    names = where[0] if where else "all outputs"
    return Finding(
        "delay", where, sure=sureness(gain, GAIN), size=tau, unit="s", interval=(tau - 1.96 * std, tau + 1.96 * std),
        evidence=f"the phases of the modes at {names} fall in proportion to frequency, as with a delay of {tau:.4g} s "
        f"({np.degrees(tau * angles.omega.max()):.3g} degrees at {frequency.max():.4g} Hz)",
        advice="check filters, sampling clocks and converters of these channels against the force's; a known delay can "
        "be taken out by exp(j 2 pi f tau)",
        picture=Picture(
            [("residues", frequency, shown), ("delay", line, -np.degrees(2 * np.pi * line * tau))],
            "Frequency [Hz]", "Angle off the imaginary axis [deg]", dots=True,
        ),
    )  # fmt: skip
