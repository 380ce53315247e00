"""Pictures of frequencies and damping ratios with error bars, compared with another set of modes."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from modalax.show.style import BLUE, ORANGE, look, new_figure


def plot_modes(
    frequency_hz: Any,
    damping_ratio: Any,
    *,
    frequency_std_hz: Any = None,
    damping_std: Any = None,
    reference: tuple[Any, Any] | None = None,
    reference_name: str = "truth",
    name: str = "estimated",
    intervals: float = 1.96,
) -> Figure:
    """Draw modes with error bars: damping over frequency, and the deviation of each mode from a reference.

    Parameters
    ----------
    frequency_hz, damping_ratio
        Shape ``(n,)`` [Hz], [-].
    frequency_std_hz, damping_std
        Standard deviations of the same shape; NaN or None where there is none.
    reference
        Frequencies [Hz] and damping ratios [-] of the same modes, for the two panels of deviations.
    intervals
        Half length of the bars in standard deviations; 1.96 is 95 %.
    """
    f, zeta = np.asarray(frequency_hz, float), 100 * np.asarray(damping_ratio, float)
    nothing = np.full(f.shape, np.nan)
    df = nothing if frequency_std_hz is None else intervals * np.asarray(frequency_std_hz, float)
    dz = nothing if damping_std is None else 100 * intervals * np.asarray(damping_std, float)
    points: dict[str, Any] = dict(fmt="o", color=BLUE, markersize=4, capsize=3, elinewidth=1.0)
    coverage = f"bars: {intervals:g} standard deviations"
    with look():
        fig = new_figure(9.0, 4.6 if reference is not None else 3.6)
        grid = fig.add_gridspec(2, 2) if reference is not None else fig.add_gridspec(1, 1)
        ax = fig.add_subplot(grid[:, 0])
        ax.errorbar(f, zeta, xerr=df, yerr=dz, label=name, **points)
        ax.set_xlabel("Natural frequency [Hz]")
        ax.set_ylabel("Damping ratio [%]")
        top = float(np.nanmax(zeta + np.nan_to_num(dz)))
        if reference is not None:
            f0, z0 = np.asarray(reference[0], float), 100 * np.asarray(reference[1], float)
            ax.plot(f0, z0, "+", color=ORANGE, markersize=11, markeredgewidth=1.5, label=reference_name, zorder=4)
            top = max(top, float(z0.max()))
            number = np.arange(1, len(f) + 1)
            rows = (
                (100 * (f / f0 - 1), 100 * df / f0, "Frequency deviation [%]"),
                (100 * (zeta / z0 - 1), 100 * dz / z0, "Damping deviation [%]"),
            )
            for k, (value, length, label) in enumerate(rows):
                side = fig.add_subplot(grid[k, 1])
                side.axhline(0, color=ORANGE, linewidth=1.2)
                side.errorbar(number, value, yerr=length, **points)
                side.set_ylabel(label)
                side.set_xticks(number if len(number) <= 20 else number[:: -(-len(number) // 20)])
                side.tick_params(labelbottom=k == 1)
                side.set_xlim(0.5, len(number) + 0.5)
                if k == 1:
                    side.set_xlabel("Mode")
        ax.set_ylim(0, 1.3 * top)
        ax.legend(loc="upper right", title=coverage if np.isfinite(df).any() or np.isfinite(dz).any() else None)
        ax.set_xlim(*_padded(f))
    return fig


def _padded(values: np.ndarray) -> tuple[float, float]:
    """Axis limits that leave a tenth of the range on either side of all values."""
    low, high = float(np.min(values)), float(np.max(values))
    room = 0.1 * (high - low) or 0.02 * high
    return low - room, high + room
