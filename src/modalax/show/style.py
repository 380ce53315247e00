"""Style of all pictures: colours, units, axes. Figures are made without pyplot, so that no state is kept globally."""

import io
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind readers can tell apart, also in grey print.
BLACK, ORANGE, SKY, GREEN = "#222222", "#d55e00", "#56b4e9", "#009e73"
BLUE, PINK, GOLD, GREY = "#0072b2", "#cc79a7", "#e69f00", "#8c8c8c"
SERIES = (BLUE, ORANGE, GREEN, PINK, GOLD, SKY, BLACK)

UNITS = {"receptance": "m/N", "mobility": "(m/s)/N", "accelerance": "(m/s²)/N"}
FREQUENCY = "Frequency [Hz]"

LOOK: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.3,
    "legend.frameon": True,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "figure.dpi": 120.0,
    "savefig.dpi": 150.0,
}


def look() -> Any:
    """Context in which figures are made, so that the user's own settings stay as they are."""
    return mpl.rc_context(LOOK)


class Picture(Figure):
    """A figure made without pyplot that scripts can show in a window and notebooks as their last value."""

    def show(self, warn: bool = True) -> None:
        """Show the picture in a window; a script waits until it is closed.

        Where the drawing program has no windows, matplotlib warns that it cannot be shown; ``savefig`` writes it then.
        """
        import matplotlib.pyplot as plt
        from matplotlib._pylab_helpers import Gcf

        window = plt.figure()  # of the kind in use
        kind, number = type(window.canvas), window.number
        plt.close(window)
        before = self.canvas
        Gcf._set_new_active_manager(kind.new_manager(self, number))
        if warn or kind.required_interactive_framework:
            plt.show()
        if not plt.isinteractive():
            plt.close(number)
            self.set_canvas(before)

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.savefig(content, format="png")
        return content.getvalue()


def new_figure(width: float = 7.5, height: float = 4.5) -> Figure:
    """Make an empty figure [inches] whose parts do not overlap."""
    return Picture(figsize=(width, height), layout="constrained")


def frf_label(form: str, symbol: str = "|H|") -> str:
    """Axis label of an FRF with its unit."""
    return f"{symbol} [{UNITS[form]}]"


def frequency_axis(ax: Axes, freq: Any) -> None:
    """Label a frequency axis and end it where the data ends."""
    values = np.asarray(freq)
    ax.set_xlabel(FREQUENCY)
    if len(values) > 1:
        ax.set_xlim(float(values[0]), float(values[-1]))


def complex_plane(ax: Axes, form: str) -> None:
    """Label the axes of a Nyquist diagram, of equal scale, in powers of ten so that no labels run into each other."""
    ax.set_aspect("equal", adjustable="datalim")
    ax.ticklabel_format(scilimits=(-2, 3))
    ax.locator_params(nbins=5)
    ax.set_xlabel(frf_label(form, "Re H"))
    ax.set_ylabel(frf_label(form, "Im H"))


def name_text(name: Any) -> str:
    """A channel's name as text that matplotlib draws letter by letter: a dollar sign in it begins no formula."""
    return str(name).replace("$", r"\$")


def short(names: Any, most: int = 40) -> list[str]:
    """Tick labels for channel names: every k-th is kept so that at most ``most`` remain, the others stay empty."""
    names = [name_text(n) for n in names]
    step = max(1, -(-len(names) // most))
    return [n if k % step == 0 else "" for k, n in enumerate(names)]
