"""Measured data: FRFs, runs at force levels, time records."""

from modalax.data.bla import BestLinear, DetectionLines, bla_fast, bla_robust
from modalax.data.causality import looks_conjugated
from modalax.data.dofs import Dof, parse_dof
from modalax.data.frf import FRF, Form
from modalax.data.geometry import Geometry
from modalax.data.measurement import Measurement
from modalax.data.multisine import cut_periods, excited_lines, multisine
from modalax.data.recording import Recording, from_sep005
from modalax.data.records import average_frfs, frf_from_blocks, frf_from_hits, frf_from_records
from modalax.data.reduction import Reduction, frf_from_recording

__all__ = [
    "BestLinear",
    "DetectionLines",
    "Dof",
    "FRF",
    "Form",
    "Geometry",
    "Measurement",
    "Recording",
    "Reduction",
    "average_frfs",
    "bla_fast",
    "bla_robust",
    "cut_periods",
    "excited_lines",
    "frf_from_blocks",
    "frf_from_hits",
    "frf_from_recording",
    "frf_from_records",
    "from_sep005",
    "looks_conjugated",
    "multisine",
    "parse_dof",
]
