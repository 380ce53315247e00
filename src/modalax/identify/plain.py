"""FRFs and modal models as plain arrays, and shapes at given poles from these without compiling anything."""

from collections.abc import Callable
from typing import Any

import numpy as np

from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.maximum import Modal, Samples, linear_fit
from modalax.identify.sample_weights import check_size, sigma_of
from modalax.model.modal import ModalModel


def samples_of(frf: FRF, residuals: str = "complex", real_modes: bool = False) -> Samples:
    """The FRF as plain arrays."""
    s = float(frf.added_decay) + 1j * np.asarray(frf.omega)
    return Samples(s, np.asarray(frf.H), DERIVATIVES[frf.form], residuals, real_modes)


def modal_of(model: ModalModel) -> Modal:
    """The model as plain arrays."""
    return Modal(*(np.asarray(a) for a in (model.poles, model.shapes, model.participation, model.upper, model.lower)))


def model_of(modal: Modal, frf: FRF) -> ModalModel:
    """The modal model of plain arrays, with the names of an FRF."""
    still = np.zeros(len(modal.poles))
    return ModalModel(
        modal.poles, modal.shapes, modal.participation, outputs=frf.outputs, inputs=frf.inputs, upper=modal.upper,
        lower=modal.lower, frequency_std=still, damping_std=still,
    )  # fmt: skip


def shorter_side(model: Modal, samples: Samples) -> np.ndarray:
    """Participation along the shorter of outputs and inputs, which is what a search starts from."""
    return model.shapes if samples.turned else model.participation


def residue_fits(
    frf: FRF, *, residuals: str = "complex", real_modes: bool = False, weights: Any = "auto"
) -> Callable[..., ModalModel]:
    """:func:`modalax.identify.residues` for some sets of poles, one after the other: the FRFs are weighed once.

    With participation, ``(n, i)``, of FRFs with no more inputs than outputs.
    """
    samples = samples_of(frf, residuals, real_modes)
    projection = samples.projection(np.asarray(sigma_of(frf, weights)))

    def fitted(poles: Any, participation: np.ndarray | None = None) -> ModalModel:
        check_size(frf, len(poles), residuals)
        return model_of(linear_fit(samples, projection, np.asarray(poles), participation)[0], frf)

    return fitted
