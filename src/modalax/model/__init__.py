"""Models of a structure: modal models, matrices, receptance, local changes, indicators of mode shapes."""

from modalax.model.assembly import (
    add_damper,
    add_mass,
    add_spring,
    add_tuned_mass,
    modal_damping,
    proportional_damping,
    reduce_to_modes,
    structural_damping,
)
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
from modalax.model.modal import ModalModel, poles_from
from modalax.model.receptance import Damper, Mass, Modified, Spring, TunedMass, change
from modalax.model.structure import Structure

__all__ = [
    "Damper",
    "Mass",
    "ModalModel",
    "Modified",
    "Spring",
    "Structure",
    "TunedMass",
    "add_damper",
    "add_mass",
    "add_spring",
    "add_tuned_mass",
    "auto_mac",
    "change",
    "cmif",
    "comac",
    "ecomac",
    "fdac",
    "frac",
    "mac",
    "mean_phase",
    "modal_damping",
    "mpc",
    "mpd",
    "msf",
    "mvmif",
    "poles_from",
    "proportional_damping",
    "reduce_to_modes",
    "structural_damping",
    "sum_frf",
]
