"""Identification of a modal model from measured FRFs."""

from modalax.identify.bandwidth import BandwidthTest, bandwidth_test
from modalax.identify.bias import DampingBias, predicted_damping_bias
from modalax.identify.bound import Bound, cramer_rao
from modalax.identify.consistent import compensated, gtls, subspace
from modalax.identify.fdpi import NormalModes, fdpi, fdpi_normal_modes
from modalax.identify.fit import Fit, fit
from modalax.identify.lsce import lsce
from modalax.identify.lscf import lscf
from modalax.identify.over_amplitude import OverAmplitude, over_amplitude
from modalax.identify.plscf import plscf
from modalax.identify.refine import Refined, refine
from modalax.identify.residues import residues
from modalax.identify.reweighted import reweighted
from modalax.identify.search import missing_modes, mode_scores
from modalax.identify.select import Selection, best_order, select, select_near
from modalax.identify.stabilize import Stability, stabilization
from modalax.identify.tables import PoleTable

__all__ = [
    "BandwidthTest",
    "Bound",
    "DampingBias",
    "Fit",
    "NormalModes",
    "OverAmplitude",
    "PoleTable",
    "Refined",
    "Selection",
    "Stability",
    "bandwidth_test",
    "best_order",
    "compensated",
    "cramer_rao",
    "fdpi",
    "fdpi_normal_modes",
    "fit",
    "gtls",
    "lsce",
    "lscf",
    "missing_modes",
    "mode_scores",
    "over_amplitude",
    "plscf",
    "predicted_damping_bias",
    "refine",
    "residues",
    "reweighted",
    "select",
    "select_near",
    "stabilization",
    "subspace",
]
