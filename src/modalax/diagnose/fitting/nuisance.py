r"""Modal parameters that may adapt while causes are fitted.

A nuisance :math:`\theta` (relative changes of the modal frequencies and damping ratios) has the spread that the author
of the simulation claims as its prior; the FREE question gives it a wide one and projects the modes' residues and the
residual terms of every channel out as well.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from modalax.diagnose.fitting.residual import modal_directions
from modalax.diagnose.prediction.frf import NOWHERE, predicted
from modalax.diagnose.setup.problem import Problem, bucket

WIDE = 0.2  # prior spread of log frequency and log damping when the modes are free
NEGLIGIBLE = 3e-4  # squared length of a modal parameter's effect, in standard deviations, below which it is left out


@dataclass(frozen=True)
class Nuisance:
    """Spread of the modal parameters, shape ``(2, n)``, and directions of each channel that do not count.

    Attributes
    ----------
    spread
        Standard deviations of log frequency and log damping; 0 where they are exact.
    basis
        Orthonormal whitened directions, shape ``(o, i, run f 2, k)``, or None.
    live
        Which modal parameters can show in the data within their spread, as numbers in the flat order of ``spread``.
    """

    spread: np.ndarray
    basis: Any
    live: np.ndarray

    @property
    def active(self) -> bool:
        """Whether there is any modal parameter to adapt."""
        return len(self.live) > 0

    @property
    def chooser(self) -> np.ndarray:
        """A row for each parameter that may adapt, and empty rows up to a common size, shape ``(k, 2 n)``."""
        rows = np.zeros((bucket(len(self.live)) if self.active else 0, self.spread.size))
        rows[np.arange(len(self.live)), self.live] = 1.0
        return rows


def make_nuisance(spread: np.ndarray, basis: Any, problem: Problem) -> Nuisance:
    """Find the modal parameters whose change within their spread would show in the data.

    Parameters
    ----------
    spread
        Standard deviations of log frequency and log damping, shape ``(2, n)``.
    basis
        Whitened directions of each channel that do not count, or None.
    problem
        The data and the simulation.
    """
    if not (spread > 0).any():
        return Nuisance(spread, basis, np.zeros(0, np.int64))
    G = np.asarray(modal_directions(np.zeros(spread.shape), spread, basis, problem))
    # data far larger than was expected (wrong units) shows a modal parameter by as much more
    H, weight = predicted((), NOWHERE, (), (), np.zeros(spread.shape), problem), np.asarray(problem.weight)
    measured, expected = (float(np.sum(np.abs(weight * x) ** 2)) for x in (np.asarray(problem.data), H))
    larger = max(1.0, measured / max(expected, 1e-300))
    return Nuisance(spread, basis, np.flatnonzero((G.reshape(len(G), -1) ** 2).sum(axis=1) * larger > NEGLIGIBLE))
