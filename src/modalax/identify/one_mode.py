r"""Whether one mode is enough about a resonance, and which two would take its place.

Two close modes, written about a pole :math:`\lambda` between them, are

.. math:: \sum_j \frac{R_j}{s-\lambda_j} = \sum_{k\ge 0} \frac{\sum_j R_j(\lambda_j-\lambda)^k}{(s-\lambda)^{k+1}}.

One mode at its best place holds the first term, and of the second what goes with its own residues. So what more than
one mode leaves shows first in the terms :math:`1/(s-\lambda)^2` and :math:`1/(s-\lambda)^3`, free in every channel, and
the third tells how far the two are apart: its part along the residues is the mean of :math:`(\lambda_j-\lambda)^2`.
"""

from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Complex

from modalax.data.frf import FRF
from modalax.identify.best_poles import best_poles
from modalax.identify.close_modes import CHANCE, MISFIT, told_apart
from modalax.identify.neighbourhood import Neighbourhood, around
from modalax.model.modal import ModalModel

PART = 0.003  # size of what one mode leaves, over its own response, from which on it is told
TIMES = 10.0  # by how much less likely than by chance a mode must be enough before two are looked for


class Rest(NamedTuple):
    r"""What one mode leaves of the lines about it, in the terms that a second close mode would make.

    Attributes
    ----------
    chance
        Chance that noise alone leaves as much.
    part
        Size of it over that of the mode's own response, both as roots of sums of squares.
    level
        Power of what is left beside it, in units of the noise.
    spread
        Mean of :math:`(\lambda_j-\lambda)^2` over two modes, weighed by their parts of the residues [rad^2/s^2].
    """

    chance: float
    part: float
    level: float
    spread: complex

    @property
    def plain(self) -> bool:
        """Whether one mode is not enough, beyond chance and by a part of its response that counts."""
        return self.chance < CHANCE and self.part > PART


NOTHING_LEFT = Rest(1.0, 0.0, 1.0, 0j)


def rest_of(hood: Neighbourhood) -> Rest:
    """What one mode leaves of the lines around it (a score test of the two further terms)."""
    pole = complex(hood.poles[0])
    width, channels = -pole.real, hood.data.shape[1]
    Q = np.linalg.qr(hood.columns([pole]))[0]
    own = hood.pole_kernel(hood.s, pole) * hood.weight
    terms = np.stack([own * width / (hood.s - pole), own * (width / (hood.s - pole)) ** 2], axis=1)
    terms = terms - Q @ (Q.conj().T @ terms)
    left = hood.data - Q @ (Q.conj().T @ hood.data)
    columns, triangle = np.linalg.qr(terms)
    seen = columns.conj().T @ left
    gain = 2 * float(np.sum(np.abs(seen) ** 2))
    unknowns = 4 * channels - 2  # the change of the pole is no freedom any more
    samples = max(2 * left.size - 2 * channels * Q.shape[1] - unknowns, 1)
    level = max(2 * float(np.vdot(left, left).real) - gain, 0.0) / samples
    R = hood.residues[0]
    size = max(float(np.sum(np.abs(R) ** 2)), 1e-300)
    third = np.linalg.pinv(triangle, rcond=1e-9)[1] @ seen
    response = max(float(np.sum(np.abs(own) ** 2)) * size, 1e-300)
    return Rest(
        chance=float(scipy.special.chdtrc(unknowns, gain / max(level, 1.0))),
        part=float(np.sqrt(0.5 * gain / response)),
        level=level,
        spread=complex(np.sum(R.conj() * third) / size) * width**2,
    )


def second_mode(
    frf: FRF, model: ModalModel, residual: Complex[np.ndarray, "f o i"], which: int
) -> Complex[np.ndarray, " 2"] | None:
    """Two poles that take the place of one mode, where the lines around it tell two modes from anything else.

    Parameters
    ----------
    frf, model
        The FRF and a modal model of it.
    residual
        The FRF less what the model makes.
    which
        Index of the mode.

    Returns
    -------
    Array or None
        None where one mode is enough, or where something else than a second mode explains as much
        (:func:`modalax.identify.close_modes.told_apart`).
    """
    hood = around(frf, model, residual, [which], smooth=True)
    rest = rest_of(hood)
    if not rest.plain or rest.chance > CHANCE / TIMES or rest.level > MISFIT:
        return None
    pole, width = complex(hood.poles[0]), -float(hood.poles[0].real)
    leading = hood.leading()
    steps = [np.sqrt(rest.spread), 0.5j * width, 0.5 * width]
    starts = [_stable(np.array([pole - step, pole + step]), width) for step in steps]
    poles = min((best_poles(hood, start, leading) for start in starts), key=lambda found: found[1])[0]
    if np.ptp(poles.imag) == 0 or not _about(poles, pole, width):
        return None
    columns = np.array([hood.pole_kernel(hood.s, p) * hood.weight for p in poles]).T
    residues = np.linalg.lstsq(np.concatenate([columns, hood.fixed], axis=1), hood.data, rcond=None)[0][:2]
    pair = hood._replace(poles=poles, residues=residues)
    return poles if told_apart(frf, pair) else None


def _stable(poles: np.ndarray, width: float) -> np.ndarray:
    """Poles with at least a tenth of a half-bandwidth of damping."""
    return np.minimum(poles.real, -0.1 * width) + 1j * poles.imag


def _about(poles: np.ndarray, pole: complex, width: float) -> bool:
    """Whether both poles are parts of the resonance: near it, and neither background nor a single line."""
    broad = -poles.real
    return bool((np.abs(poles.imag - pole.imag) < 4 * (width + broad)).all() and broad.max() < 20 * width)
