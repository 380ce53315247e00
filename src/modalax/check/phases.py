r"""Phases of residues: what a delay, or the wrong form, does to all modes alike.

For modes that are nearly real the residues of the receptance lie on the imaginary axis. A delay :math:`\tau` turns
them by :math:`-\omega_r\tau`; one derivative too few or too many turns all of them by 90 degrees, two of them turn all
by 180, which only a drive point can show.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.study import CLEAR, Study

# Angle by which complex modes may scatter [rad].
SCATTER = 0.10
# No angle is known better than this [rad].
FLOOR = 0.03
# A delay is told from this angle at the highest mode on [rad], and from this gain in squares of scatter on.
SMALLEST_ANGLE, GAIN = 0.2, 30.0
# Squares of scatter a residue that a good explanation may leave, and modes it takes.
LEFT, FEWEST_MODES = 3.0, 3


class Angles(NamedTuple):
    """Angles off the imaginary axis, one an entry: mode, output, input.

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
        """Some of the entries."""
        return Angles(*(a[which] for a in self))


def angles_of(study: Study) -> Angles:
    """Angles of all residues that stand clear of their noise."""
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
    """Squares of scatter that a delay [s] and a turn [rad] leave; elsewhere than at drive points signs are free."""
    rest = angles.angle + angles.omega * tau - turn
    free = np.where(angles.drive, 0.5 * (1 - np.cos(rest)) * 4, 0.5 * (1 - np.cos(2 * rest)))
    return float(np.sum(angles.weight * free))


def best_delay(angles: Angles, turn: float = 0.0) -> tuple[float, float, float]:
    """Delay [s] that leaves least, what it leaves, and its standard deviation."""
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
    """Outputs, or the force, that come late or early by a constant time."""
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
    """The middle angle of each mode over all channels, as one entry a mode."""
    entries = []
    for r in np.unique(angles.mode):
        own = angles.take(angles.mode == r)
        middle = _middle(own)
        scatter = np.sum(_apart(own.angle - middle) ** 2) + 2 * SCATTER**2
        # Complex modes turn many channels the same way: many channels are no better than a few.
        weight = 1 / (scatter / (len(own.angle) + 1) / min(len(own.angle), 3) + FLOOR**2)
        entries.append((r, 0, 0, own.omega[0], middle, weight, False))
    return Angles(*(np.array(column) for column in zip(*entries, strict=True)))


def _beside(own: Angles, others: Angles) -> Angles:
    """Angles of one channel off the middle of the other channels, weighted by how these scatter in each mode."""
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
    """Delay, its standard deviation and its gain, where a delay explains the angles and nothing does not."""
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
        evidence=f"the phases of the modes at {names} fall in proportion to frequency, as a delay of {tau:.4g} s makes "
        f"them ({np.degrees(tau * angles.omega.max()):.3g} degrees at {frequency.max():.4g} Hz)",
        advice="check filters, sampling clocks and converters of these channels against the force's; a known delay can "
        "be taken out by exp(j 2 pi f tau)",
        picture=Picture(
            [("residues", frequency, shown), ("delay", line, -np.degrees(2 * np.pi * line * tau))],
            "Frequency [Hz]", "Angle off the imaginary axis [deg]", dots=True,
        ),
    )  # fmt: skip
