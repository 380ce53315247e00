"""Pictures of matrices that compare two sets of modes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modalax.show.style import look, new_figure


def mode_names(frequency_hz: Any) -> list[str]:
    """Tick labels of modes: number and frequency [Hz]."""
    return [f"{k + 1}: {float(f):.4g} Hz" for k, f in enumerate(np.asarray(frequency_hz))]


def plot_mac(
    matrix: Any,
    *,
    rows: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    row_title: str = "Mode",
    column_title: str = "Mode",
    title: str = "MAC",
) -> Figure:
    """Draw a matrix of modal assurance criteria as squares, with their values in percent where they fit.

    Parameters
    ----------
    matrix
        Values from 0 to 1, shape ``(row, column)``.
    rows, columns
        Names of the modes, for example from :func:`mode_names`; numbers from 1 by default.
    """
    values = np.asarray(matrix, float)
    n_rows, n_columns = values.shape
    rows = [str(k + 1) for k in range(n_rows)] if rows is None else rows
    columns = [str(k + 1) for k in range(n_columns)] if columns is None else columns
    with look():
        cell = float(np.clip(7.0 / max(n_rows, n_columns), 0.16, 0.62))
        fig = new_figure(cell * n_columns + 2.6, cell * n_rows + 1.7)
        ax = fig.add_subplot()
        ax.grid(False)
        picture = ax.imshow(values, vmin=0, vmax=1, cmap="Blues", aspect="equal")
        turned = max(map(len, columns)) > 3
        ax.set_xticks(range(n_columns), columns, rotation=90 if turned else 0)
        ax.set_yticks(range(n_rows), rows)
        if cell < 0.25:
            ax.tick_params(labelsize=6)
        ax.set_xlabel(column_title)
        ax.set_ylabel(row_title)
        ax.set_title(title)
        if cell >= 0.35:
            for (i, j), v in np.ndenumerate(values):
                ax.text(j, i, f"{100 * v:.0f}", ha="center", va="center", fontsize=7, color="w" if v > 0.55 else "k")
        fig.colorbar(picture, ax=ax, shrink=0.8, label="MAC [-]" + (", in the squares [%]" if cell >= 0.35 else ""))
    return fig
