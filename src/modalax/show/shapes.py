"""Pictures and animations of mode shapes on the geometry."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from modalax.data.dofs import parse_dof
from modalax.data.geometry import Geometry
from modalax.files.write import replacing
from modalax.model.indicators import mean_phase
from modalax.model.modal import ModalModel
from modalax.show.style import GREY, Picture, look

VIEW = (28.0, -58.0)
LARGEST = 0.15  # Largest displacement drawn, as a part of the structure's size.
NEIGHBOURS = 3


def plot_shape(
    geometry: Geometry,
    dofs: Sequence[str],
    shape: Any,
    *,
    title: str = "",
    phase: float = 0.0,
    view: tuple[float, float] = VIEW,
) -> Figure:
    r"""Draw a mode shape over the undeformed structure, :math:`\mathrm{Re}(\psi e^{j\varphi})` scaled to be seen.

    Nodes that were not measured follow their nearest measured neighbours, so that outlines move along.

    Parameters
    ----------
    geometry
        Nodes [m] and lines.
    dofs, shape
        DoF names and the complex or real component at each, shape ``(dof,)``.
    phase
        Instant of the cycle [rad], counted from the one of largest displacement.
    view
        Elevation and azimuth of the eye [degrees].
    """
    return plot_shapes(geometry, dofs, np.asarray(shape)[None], titles=[title], phase=phase, view=view, width=6.8)


def plot_shapes(
    geometry: Geometry,
    dofs: Sequence[str],
    shapes: Any,
    *,
    titles: Sequence[str] | None = None,
    phase: float = 0.0,
    view: tuple[float, float] = VIEW,
    width: float = 3.2,
) -> Figure:
    """Draw several mode shapes, ``(mode, dof)``, beside one another; parameters as :func:`plot_shape`."""
    vectors = [moving(geometry, dofs, shape) for shape in np.asarray(shapes)]
    columns = min(4, len(vectors))
    rows = -(-len(vectors) // columns)
    with look():
        fig = Picture(figsize=(width * columns, (0.75 if rows * columns == 1 else 0.62) * width * rows))
        fig.subplots_adjust(0.0, 0.0, 0.86 if len(vectors) == 1 else 1.0 - 0.9 / (width * columns), 0.96, 0.0, 0.0)
        for k, vector in enumerate(vectors):
            ax = fig.add_subplot(rows, columns, k + 1, projection="3d")
            _draw(ax, geometry, np.real(vector * np.exp(1j * phase)), np.abs(vector).max(), view, len(vectors) == 1)
            ax.set_title("" if titles is None else titles[k], y=1.0 if len(vectors) == 1 else 0.95)
        _scale(fig)
    return fig


def animate_shape(
    geometry: Geometry,
    dofs: Sequence[str],
    shape: Any,
    path: Path | str,
    *,
    title: str = "",
    frames: int = 24,
    seconds: float = 1.2,
    view: tuple[float, float] = VIEW,
) -> Path:
    """Write one cycle of a mode shape as an endless GIF animation, and return its path.

    Raises
    ------
    ValueError
        If the file is not to be a GIF, or has fewer than 2 frames.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path.name}: animations are written as .gif")
    if frames < 2:
        raise ValueError(f"{frames} frames asked for; a cycle needs at least 2")
    vector = moving(geometry, dofs, shape)
    writer = PillowWriter(fps=max(1, round(frames / seconds)))
    with look():
        fig = Figure(figsize=(5.8, 4.4))
        fig.subplots_adjust(0.0, 0.0, 0.92, 0.92)
        ax = fig.add_subplot(projection="3d")
        with replacing(path) as part, writer.saving(fig, str(part), dpi=80):
            for phase in 2 * np.pi * np.arange(frames) / frames:
                ax.clear()
                _draw(ax, geometry, np.real(vector * np.exp(1j * phase)), np.abs(vector).max(), view, True)
                ax.set_title(title)
                writer.grab_frame()
    return path


def moving(geometry: Geometry, dofs: Sequence[str], shape: Any) -> np.ndarray:
    """Displacement of every node, complex ``(node, 3)``, turned so that most of it is real.

    Raises
    ------
    ValueError
        If no DoF of the shape has a direction of translation.
    """
    psi = np.asarray(shape, complex)
    psi = psi * np.exp(-1j * float(np.asarray(mean_phase(psi[None]))[0]))
    vectors, known = geometry.displacements(dofs, psi)
    measured = known.any(axis=1)
    if not measured.any():
        raise ValueError(
            f"none of the DoFs {', '.join(list(dofs)[:4])} has a direction such as ':+Z'; nothing can move"
        )
    xyz = np.asarray(geometry.xyz)
    for k in np.flatnonzero(~measured):
        distance = np.linalg.norm(xyz[measured] - xyz[k], axis=1)
        near = np.argsort(distance)[:NEIGHBOURS]
        weight = 1 / np.maximum(distance[near], 1e-9 * (distance.max() or 1.0)) ** 2
        vectors[k] = weight @ vectors[measured][near] / weight.sum()
    return vectors


def along(geometry: Geometry, model: ModalModel) -> tuple[list[str], np.ndarray]:
    """DoFs that move nodes of the geometry, and the shapes at them, shape ``(mode, dof)``.

    They are the outputs, or the inputs where there are more of them (a roving hammer).
    """
    model = model.along_longer_side()
    dofs = [parse_dof(name) for name in model.outputs]
    keep = [k for k, d in enumerate(dofs) if d.node in geometry.nodes and d.direction in ("X", "Y", "Z")]
    return [model.outputs[k] for k in keep], np.asarray(model.shapes)[:, keep]


def _scale(fig: Figure) -> None:
    """What the colours mean, at the right edge of a figure."""
    across, up = fig.get_size_inches()
    tall = min(0.6, 1.8 / up)
    bar = fig.add_axes((1 - 0.62 / across, 0.5 - tall / 2, 0.1 / across, tall), label="scale")
    colours = ScalarMappable(Normalize(0, 1), "viridis")
    fig.colorbar(colours, cax=bar, label="Displacement [-]", ticks=[0, 0.5, 1])


def _draw(ax: Any, geometry: Geometry, u: np.ndarray, top: float, view: tuple[float, float], labels: bool) -> None:
    """Draw one instant: the structure at rest in grey, the displaced one coloured by how far it moved."""
    xyz = np.asarray(geometry.xyz)
    size = float(np.ptp(xyz, axis=0).max()) or 1.0
    moved = xyz + u * (LARGEST * size / (top or 1.0))
    amount = np.linalg.norm(u, axis=1) / (top or 1.0)
    segments = geometry.segments
    if len(segments):
        ax.add_collection3d(Line3DCollection(list(xyz[segments]), colors=GREY, linewidths=0.6, alpha=0.5))
        lines = Line3DCollection(list(moved[segments]), cmap="viridis", linewidths=1.8)
        lines.set_array(amount[segments].mean(axis=1))
        lines.set_clim(0, 1)
        ax.add_collection3d(lines)
    else:
        ax.scatter(*xyz.T, s=3, color=GREY, alpha=0.5, depthshade=False)
    ax.scatter(*moved.T, c=amount, cmap="viridis", vmin=0, vmax=1, s=9, depthshade=False)
    room = LARGEST * size
    low, high = xyz.min(axis=0) - room, xyz.max(axis=0) + room
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    # Equal scales on the three axes, and less of the empty margin that is meant for labels.
    ax.set_box_aspect(high - low, zoom=1.0 if labels else 1.9)
    for artist in ax.collections:
        artist.set_clip_on(False)
    ax.view_init(*view)
    ax.locator_params(nbins=4)
    if labels:
        ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    else:
        ax.set_axis_off()
