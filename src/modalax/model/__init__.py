"""What a structure is: modal models, matrices, receptance, indicators."""

from modalax.model.indicators import (
    auto_mac,
    cmif,
    comac,
    ecomac,
    fdac,
    frac,
    mac,
    mean_phase,
    mpc,
    mpd,
    msf,
    mvmif,
    sum_frf,
)
from modalax.model.modal import ModalModel
from modalax.model.structure import Structure

__all__ = [
    "ModalModel",
    "Structure",
    "auto_mac",
    "cmif",
    "comac",
    "ecomac",
    "fdac",
    "frac",
    "mac",
    "mean_phase",
    "mpc",
    "mpd",
    "msf",
    "mvmif",
    "sum_frf",
]
