"""Measurements, structures, modal models and geometry from files and into files."""

from modalax.files.load import load, save
from modalax.files.uff import load_geometry, load_modes

__all__ = ["load", "load_geometry", "load_modes", "save"]
