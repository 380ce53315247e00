"""All pictures of a fit."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from modalax.data.geometry import Geometry
from modalax.files.write import write_bytes
from modalax.identify.fit import Fit
from modalax.model.indicators import auto_mac
from modalax.show.frf import plot_frf, plot_frf_grid
from modalax.show.matrices import mode_names, plot_mac
from modalax.show.modes import plot_modes
from modalax.show.shapes import along, plot_shapes
from modalax.show.stabilization import plot_stabilization

Truth = tuple[np.ndarray, np.ndarray]


def fit_pictures(fit: Fit, truth: Truth | None = None, geometry: Geometry | None = None) -> dict[str, Figure]:
    """Draw a fit: stabilization, modes with error bars, FRFs over the measurement, auto-MAC, shapes on the geometry.

    Parameters
    ----------
    fit
        A :class:`modalax.identify.Fit`.
    truth
        True frequencies [Hz] and damping ratios of the modes in the band, where known.
    geometry
        Positions of the DoFs, where known.
    """
    model, refined = fit.model, fit.refined
    inside = np.asarray(fit.inside)
    frequency = np.asarray(model.frequency_hz)[inside]
    pictures = {
        "stabilization": plot_stabilization(
            fit.table, fit.stability, fit.frf, selected_hz=frequency, title=f"Stabilization diagram, {fit.table.method}"
        ),
        "modes": plot_modes(
            frequency,
            np.asarray(model.damping_ratio)[inside],
            frequency_std_hz=None if refined is None else np.asarray(refined.frequency_std_hz)[inside],
            damping_std=None if refined is None else np.asarray(refined.damping_std)[inside],
            reference=truth,
        ),
        "frf": plot_frf(fit.frf, model),
    }
    if len(fit.frf.outputs) * len(fit.frf.inputs) > 1:
        pictures["frfs"] = plot_frf_grid(fit.frf, model)
    names = mode_names(frequency)
    dofs, shapes = ([], np.zeros((0, 0))) if geometry is None else along(geometry, model)
    if geometry is not None and dofs:
        pictures["shapes"] = plot_shapes(geometry, dofs, shapes[inside], titles=names)
    seen = model.along_longer_side()
    if len(seen.outputs) > 1 and len(frequency) > 1:
        pictures["auto_mac"] = plot_mac(auto_mac(seen.shapes[inside]), rows=names, columns=names, title="Auto-MAC")
    return pictures


def save_fit_pictures(
    fit: Fit, folder: Path, truth: Truth | None = None, geometry: Geometry | None = None
) -> list[Path]:
    """Write the pictures of a fit as PNG files into a folder, made if it does not exist, and return their paths."""
    return save_pictures(fit_pictures(fit, truth, geometry), folder)


def save_pictures(pictures: dict[str, Figure], folder: Path) -> list[Path]:
    """Write figures as PNG files named by their keys, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in pictures.items():
        paths.append(folder / f"{name}.png")
        content = io.BytesIO()
        figure.savefig(content, format="png")
        write_bytes(paths[-1], content.getvalue())
    return paths
