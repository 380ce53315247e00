"""Phases of residues: what the wrong form, or a record cut short, does to all modes alike.

For modes that are nearly real the residues of the receptance lie on the imaginary axis. One derivative too few or too
many turns all of them by 90 degrees, two of them turn all by 180, which only a drive point can show.
"""

from typing import NamedTuple

import numpy as np

from modalax.check.study import CLEAR, Study

# Angle by which the residues of complex modes may scatter [rad].
SCATTER = 0.10
# The same where nothing tells it, and the error of an angle that no standard deviation knows [rad].
UNKNOWN, ANGLE = 0.05, 0.003


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


def misfit(angles: Angles, turn: float = 0.0) -> float:
    """Squares of scatter that a turn [rad] leaves; elsewhere than at drive points signs are free."""
    rest = angles.angle - turn
    free = np.where(angles.drive, 0.5 * (1 - np.cos(rest)) * 4, 0.5 * (1 - np.cos(2 * rest)))
    return float(np.sum(angles.weight * free))


def complexity(study: Study) -> tuple[float, float]:
    """Scatter of phases [rad] of a channel that takes full part in a mode, and how many angles tell it.

    Told by how the channels of each mode lie about their middle; the median of all does not see a channel at fault. A
    channel that takes little part in a mode scatters more in proportion.
    """
    _, residues, std = study.summed
    scores, count = [], 0
    for r in range(len(residues)):
        size = np.abs(residues[r])
        seen = size > CLEAR * std[r]
        if seen.sum() < 3:
            continue
        typical = np.sqrt(np.mean(size**2))
        angle, part = np.angle(1j * residues[r][seen]), np.maximum(typical / size[seen], 1.0)
        noise = std[r][seen] / size[seen]
        weight = 1 / (noise**2 + (0.05 * part) ** 2)
        gaps = np.abs(undirected(angle[:, None] - angle[None, :]))
        off = undirected(angle - angle[np.argmin(gaps @ weight)])
        scores.append(np.stack([off, noise, part]))
        count += len(off) - 1
    if not scores:
        return UNKNOWN, 0.0
    off, noise, part = np.concatenate(scores, axis=1)
    low, high = 1e-3, 1.0
    # The middle of squares of scatter is 0.455 of their mean; of three angles the middle one adds nothing.
    half = 0.455 * count / len(off)
    for _ in range(30):
        middle = np.sqrt(low * high)
        above = np.median(off**2 / (noise**2 + ANGLE**2 + (middle * part) ** 2)) > half
        low, high = (middle, high) if above else (low, middle)
    return float(high), 0.5 * count


def undirected(angle: np.ndarray) -> np.ndarray:
    """Angles of undirected lines, from -pi/2 to pi/2."""
    return (angle + np.pi / 2) % np.pi - np.pi / 2
