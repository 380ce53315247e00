r"""Whether the residues of a fit are those of hits whose records end before the structure has come to rest.

The transform of :math:`e^{\lambda_r t}` over a record of length :math:`T`, at the lines :math:`k/T` of its discrete
Fourier transform, is :math:`(1 - e^{\lambda_r T})/(j\omega - \lambda_r)`: the poles stay as they are, and each residue
is multiplied by a number that is 1 only where the mode has decayed. Modes of light damping are all but real, and their
residues of receptances all but imaginary; cut off, they are turned by the angle that the pole itself predicts.
"""

import numpy as np
from jaxtyping import Complex, Float

from modalax.data.frf import FRF
from modalax.model.modal import ModalModel

SURE = 0.5  # grade from which on a mode is asked
LEFT = 0.05  # share of a mode's motion at the end of the record from which on it matters
ON_GRID = 0.02  # distance from a multiple of the spacing, in spacings, up to which lines are those of a transform
SCATTER = 0.1  # angle by which the residues of a complex mode lie off the imaginary axis, typically [rad]
GAIN, PART = 9.0, 0.4  # squares of scatter that the angles must explain, and the part of them that may be left
ALONE = 3.0  # how much more is asked of one mode alone, which much else may turn


def cut_notes(frf: FRF, model: ModalModel, sure: Float[np.ndarray, " n"]) -> list[str]:
    """A sentence on records that end before the modes have decayed; none where nothing speaks for it.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it.
    sure
        Grade of each mode, 0 for modes outside the band, shape ``(n,)``.
    """
    length = record_length(np.asarray(frf.freq))
    if length is None or float(frf.added_decay):
        return []
    poles = np.asarray(model.poles)
    which = np.flatnonzero((sure >= SURE) & (np.exp(poles.real * length) > LEFT))
    factor = 1 - np.exp(poles[which] * length)
    if not is_cut(np.asarray(model.residues)[which], factor):
        return []
    slowest = float(np.exp(poles[which].real.max() * length))
    return [
        f"The residues are turned as those of hits are whose records of {length:.4g} s end too early: of the slowest "
        f"mode {100 * slowest:.2g} % is left then. Frequencies and damping ratios hold, residues and modal masses do "
        "not: multiply the modal mass of each mode by 1 - exp(pole x length of the record), or record longer."
    ]


def record_length(freq: Float[np.ndarray, " f"]) -> float | None:
    """Length of the records [s] whose discrete Fourier transform has such lines [Hz]; None if there is none."""
    steps = np.diff(freq)
    if len(steps) < 2 or np.ptp(steps) > 0.01 * steps.mean():
        return None
    places = freq / steps.mean()
    return None if np.abs(places - np.round(places)).max() > ON_GRID else 1 / float(steps.mean())


def is_cut(residues: Complex[np.ndarray, "n o i"], factor: Complex[np.ndarray, " n"]) -> bool:
    """Whether residues of receptances lie by the angles of these factors off the imaginary axis, not by others."""
    if not len(residues):
        return False
    before, after = _off_axis(residues), _off_axis(residues / factor[:, None, None])
    more = ALONE if len(residues) == 1 else 1.0
    return before - after > more * GAIN and after < PART / more * before


def _off_axis(residues: np.ndarray) -> float:
    """Sum of squares of the angles off the imaginary axis over their scatter, within a mode too; signs are free."""
    squares = -np.sum(residues**2, axis=(1, 2)) / np.sum(np.abs(residues) ** 2, axis=(1, 2))
    within = 0.5 * (1 - np.abs(squares))  # variance of the angles about their mean, where it is small
    return float(np.sum(0.5 * (1 - np.cos(np.angle(squares))) / (SCATTER**2 + within)))
