"""Maps of the whitened residual, which show where a prediction is wrong."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modalax.show.style import frequency_axis, look, new_figure, short


def bin_lines(freq: Any, energy: Any, bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of ``energy`` (row, f) over at most ``bands`` runs of neighbouring lines, and their edges [Hz].

    A dense axis has more lines than a picture has columns; averaging keeps a narrow peak visible, picking does not.
    """
    freq, energy = np.asarray(freq, float), np.asarray(energy, float)
    count = min(bands, len(freq))
    cuts = np.linspace(0, len(freq), count + 1).round().astype(int)
    mean = np.add.reduceat(energy, cuts[:-1], axis=1) / np.diff(cuts)
    half = np.diff(freq) / 2 if len(freq) > 1 else np.array([0.5])
    edges = (
        np.concatenate([[freq[0] - half[0]], freq[:-1] + half, [freq[-1] + half[-1]]])
        if len(freq) > 1
        else (np.array([freq[0] - 0.5, freq[0] + 0.5]))
    )
    return mean, edges[cuts]


def plot_residual_map(
    freq: Any,
    residual: Any,
    rows: Sequence[str],
    *,
    panels: Sequence[str] | None = None,
    title: str = "Whitened residual",
    bands: int = 160,
) -> Figure:
    r"""Draw the energy of a whitened residual over frequency and channel: 1 is noise alone, more is an error.

    Parameters
    ----------
    freq
        Shape ``(f,)`` [Hz].
    residual
        Complex, each real and imaginary part of unit variance under noise alone, :math:`\sqrt2(H-\hat H)/\sigma`,
        shape ``(row, f)``, or ``(panel, row, f)`` for several pictures, for example before and after.
    rows, panels
        Names of the rows (channels or force levels) and of the panels.
    """
    r = np.asarray(residual)
    r = r[None] if r.ndim == 2 else r
    names = [""] * len(r) if panels is None else list(panels)
    binned = [bin_lines(freq, np.abs(part) ** 2 / 2, bands) for part in r]
    # White at 1, which is noise alone. Ten-fold either way is the least range, so that noise does not look like error.
    top = max(1.0, float(np.log10(max(m.max() for m, _ in binned))))
    with look():
        fig = new_figure(8.5, (0.9 + float(np.clip(0.22 * len(rows), 0.7, 4.5))) * len(r) + 0.6)
        axes = fig.subplots(len(r), 1, sharex=True, squeeze=False)[:, 0]
        picture = None
        for ax, (mean, edges), name in zip(axes, binned, names, strict=True):
            ax.grid(False)
            values = np.log10(np.maximum(mean, 10**-top))
            picture = ax.pcolormesh(edges, np.arange(len(rows) + 1) - 0.5, values, cmap="RdBu_r", vmin=-top, vmax=top)
            ax.set_yticks(range(len(rows)), short(rows, 20))
            ax.invert_yaxis()
            ax.set_title(f"{title}, {name}" if name else title)
        frequency_axis(axes[-1], binned[0][1])
        if picture is not None:
            bar = fig.colorbar(picture, ax=list(axes), label="Energy per sample, 1 = noise alone")
            right = np.arange(0, int(top) + 1, max(1, int(top) // 2))
            ticks = [*-right[:0:-1], *right]
            bar.set_ticks(ticks, labels=[f"{10.0**t:g}" for t in ticks])
    return fig
