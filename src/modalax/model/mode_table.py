"""Measured modes alone, as test reports give them: frequencies, damping ratios and shapes without scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float

from modalax.data.frf import check_names
from modalax.model.modal import ModalModel

# Relative standard deviations of frequency and damping ratio, and that of a shape's components relative to the largest,
# where nobody states them: what careful modal tests repeat to.
USUAL = (0.002, 0.1, 0.03)
UNTOLD = 0.01  # damping ratio that stands for one that nobody has measured; nothing is compared with it


@dataclass(frozen=True)
class ModeTable:
    """Measured modes without FRFs.

    Attributes
    ----------
    frequency_hz
        Rising, shape ``(n,)`` [Hz].
    damping_ratio
        Shape ``(n,)`` [-]; NaN where it was not measured.
    shapes
        Up to any factor a mode, shape ``(n, dof)``.
    dofs
        DoF names.
    frequency_std, damping_std
        Relative standard deviations, shape ``(n,)``; NaN where nobody states them.
    """

    frequency_hz: Float[np.ndarray, " n"]
    damping_ratio: Float[np.ndarray, " n"]
    shapes: Complex[np.ndarray, "n dof"]
    dofs: tuple[str, ...]
    frequency_std: Float[np.ndarray, " n"]
    damping_std: Float[np.ndarray, " n"]

    @classmethod
    def of(
        cls, frequency_hz: Any, damping_ratio: Any, shapes: Any, dofs: Sequence[str], frequency_std: Any = np.nan,
        damping_std: Any = np.nan,
    ) -> "ModeTable":  # fmt: skip
        """A table, its modes put in the order of rising frequency.

        Raises
        ------
        ValueError
            If lengths do not fit, a frequency is not positive, a shape is zero or not finite, or a name stands twice.
        """
        f, shapes = np.atleast_1d(np.asarray(frequency_hz, float)), np.atleast_2d(np.asarray(shapes, complex))
        n = len(f)
        zeta, *stds = (np.broadcast_to(np.asarray(v, float), (n,)) for v in (damping_ratio, frequency_std, damping_std))
        if shapes.shape != (n, len(dofs)) or not n:
            raise ValueError(f"shapes has shape {shapes.shape}; {n} modes at {len(dofs)} DoFs need ({n}, {len(dofs)})")
        if not (np.isfinite(f) & (f > 0)).all():
            raise ValueError(f"frequencies are {f.tolist()[:4]} Hz; they must be positive")
        if not (np.isnan(zeta) | (zeta >= 0) & (zeta < 1)).all():
            raise ValueError(f"damping ratios are {zeta.tolist()[:4]}; they lie between 0 and 1")
        if not np.isfinite(shapes).all() or not np.abs(shapes).max(axis=1).all():
            raise ValueError("a shape is zero or holds numbers that are not finite")
        if any(not (np.isnan(s) | (s > 0) & np.isfinite(s)).all() for s in stds):
            raise ValueError("standard deviations of measured modes must be positive")
        order = np.argsort(f)
        names = check_names(dofs, len(dofs), "dofs")
        return cls(f[order], zeta[order], shapes[order], names, stds[0][order], stds[1][order])

    @classmethod
    def of_model(cls, model: ModalModel) -> "ModeTable":
        """The modes of a modal model; what it claims of their errors counts as measured."""
        along = model if len(model.outputs) >= len(model.inputs) else model.transpose()
        stds = [np.where(s > 0, s, np.nan) for s in (np.asarray(model.frequency_std), np.asarray(model.damping_std))]
        return cls.of(along.frequency_hz, along.damping_ratio, along.shapes, along.outputs, *stds)
