"""Measured shapes drawn over those of a model."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from modalax.data.geometry import Geometry
from modalax.model.indicators import msf
from modalax.show.shapes import VIEW, moving
from modalax.show.style import BLUE, GREY, ORANGE, Picture, look

LARGEST = 0.15  # displacement drawn, over the size of the structure


def plot_shape_pairs(
    geometry: Geometry,
    dofs: Sequence[str],
    measured: Any,
    model: Any,
    *,
    titles: Sequence[str] | None = None,
    view: tuple[float, float] = VIEW,
) -> Figure:
    """Draw each measured shape (dots) over that of the model (lines), which is scaled and turned to lie closest to it.

    Parameters
    ----------
    geometry
        Nodes of the measured points [m] and lines between them.
    dofs
        Measured DoF names.
    measured, model
        Paired shapes at these DoFs, shape ``(n, dof)``.
    titles
        One for each pair.
    """
    a, b = np.atleast_2d(np.asarray(measured, complex)), np.atleast_2d(np.asarray(model, complex))
    b = b * np.asarray(msf(a, b))[:, None]
    columns = min(4, len(a))
    rows = -(-len(a) // columns)
    xyz = np.asarray(geometry.xyz)
    size = float(np.ptp(xyz, axis=0).max()) or 1.0
    with look():
        fig = Picture(figsize=(3.2 * columns, 2.4 * rows))
        fig.subplots_adjust(0.0, 0.0, 1.0, 0.95)
        for k in range(len(a)):
            ax: Any = fig.add_subplot(rows, columns, k + 1, projection="3d")
            top = float(np.abs(a[k]).max()) or 1.0
            dots, line = (xyz + LARGEST * size / top * np.real(moving(geometry, dofs, s)) for s in (a[k], b[k]))
            if len(geometry.segments):
                ax.add_collection3d(Line3DCollection(list(xyz[geometry.segments]), colors=GREY, linewidths=0.5))
                ax.add_collection3d(Line3DCollection(list(line[geometry.segments]), colors=BLUE, linewidths=1.4))
            else:
                ax.scatter(*line.T, s=8, color=BLUE, depthshade=False)
            ax.scatter(*dots.T, s=10, color=ORANGE, depthshade=False)
            room = LARGEST * size
            low, high = xyz.min(axis=0) - room, xyz.max(axis=0) + room
            ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
            ax.set_box_aspect(high - low, zoom=1.7)
            ax.view_init(*view)
            ax.set_axis_off()
            ax.set_title("" if titles is None else titles[k], y=0.95)
    return fig
