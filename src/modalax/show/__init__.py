"""Pictures and reports; no other package draws."""

from modalax.show.diagnosis import diagnosis_pictures, plot_comparison, save_diagnosis_pictures
from modalax.show.fit import fit_pictures, save_fit_pictures
from modalax.show.frf import plot_frf, plot_frf_grid, plot_levels
from modalax.show.matrices import mode_names, plot_mac
from modalax.show.modes import plot_modes
from modalax.show.residuals import plot_residual_map
from modalax.show.shapes import animate_shape, plot_shape, plot_shapes
from modalax.show.stabilization import plot_stabilization

__all__ = [
    "animate_shape",
    "diagnosis_pictures",
    "fit_pictures",
    "mode_names",
    "plot_comparison",
    "plot_frf",
    "plot_frf_grid",
    "plot_levels",
    "plot_mac",
    "plot_modes",
    "plot_residual_map",
    "plot_shape",
    "plot_shapes",
    "plot_stabilization",
    "save_diagnosis_pictures",
    "save_fit_pictures",
]
