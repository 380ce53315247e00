"""Measured modes beside those of a model: which belongs to which, how alike, and where they differ."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
from jaxtyping import Float, Int

from modalax.model.indicators import comac, ecomac, mac
from modalax.model.mode_table import ModeTable
from modalax.model.overview import of_correlation

LEAST = 0.3  # MAC below which two modes are not called a pair


@dataclass(frozen=True)
class Correlation:
    """Pairs of modes.

    Attributes
    ----------
    mac
        Between measured modes and those of the model, shape ``(n, m)``.
    pairs
        Mode of the model for each measured one, -1 where none is like it, shape ``(n,)``.
    frequency_hz, model_frequency_hz
        Of measured modes, and of their partners (NaN where there is none), shape ``(n,)`` [Hz].
    comac, ecomac
        Of the pairs, at each measured DoF, shape ``(dof,)``: :func:`modalax.model.comac` and ``ecomac``.
    """

    mac: Float[np.ndarray, "n m"]
    pairs: Int[np.ndarray, " n"]
    frequency_hz: Float[np.ndarray, " n"]
    model_frequency_hz: Float[np.ndarray, " n"]
    comac: Float[np.ndarray, " dof"]
    ecomac: Float[np.ndarray, " dof"]

    def __str__(self) -> str:
        """A table of the pairs."""
        return of_correlation(self)

    @property
    def change(self) -> Float[np.ndarray, " n"]:
        """Frequency of the model over the measured one, less 1."""
        return self.model_frequency_hz / self.frequency_hz - 1

    @property
    def pair_mac(self) -> Float[np.ndarray, " n"]:
        """MAC of each pair; NaN where there is none."""
        return np.where(self.pairs >= 0, self.mac[np.arange(len(self.pairs)), self.pairs], np.nan)


def correlate(table: ModeTable, model_frequency_hz: Any, model_shapes: Any, least: float = LEAST) -> Correlation:
    """Pair measured modes with those of a model so that the sum of their MAC is largest.

    Parameters
    ----------
    table
        Measured modes.
    model_frequency_hz, model_shapes
        Of the model, shapes ``(m,)`` and ``(m, dof)`` at the measured DoFs (:func:`modalax.model.matching.match`).
    least
        MAC below which two modes are no pair.

    Raises
    ------
    ValueError
        If the shapes are not at the measured DoFs.
    """
    frequency, shapes = np.asarray(model_frequency_hz, float), np.atleast_2d(np.asarray(model_shapes))
    if shapes.shape != (len(frequency), len(table.dofs)):
        raise ValueError(
            f"shapes of the model have shape {shapes.shape}; {len(frequency)} modes at the {len(table.dofs)} measured "
            f"DoFs need ({len(frequency)}, {len(table.dofs)})"
        )
    alike = np.asarray(mac(table.shapes, shapes))
    rows, columns = scipy.optimize.linear_sum_assignment(-alike)
    pairs = np.full(len(table.frequency_hz), -1)
    good = alike[rows, columns] >= least
    pairs[rows[good]] = columns[good]
    paired = np.flatnonzero(pairs >= 0)
    none = np.full(len(table.dofs), np.nan)
    both = (table.shapes[paired], shapes[pairs[paired]])
    places = (np.asarray(comac(*both)), np.asarray(ecomac(*both))) if len(paired) else (none, none)
    partner = np.where(pairs >= 0, frequency[pairs], np.nan)
    return Correlation(alike, pairs, table.frequency_hz, partner, *places)
