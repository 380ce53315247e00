"""Picture of the stabilization diagram: poles of rising order over the sum of the FRFs."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from modalax.data.frf import FRF
from modalax.identify.tables import PoleTable
from modalax.model.indicators import cmif, sum_frf
from modalax.show.style import BLUE, GREEN, GREY, ORANGE, PINK, frequency_axis, frf_label, look, new_figure

# Marker, colour, size and legend of each kind of pole, from unstable to stable in everything.
KINDS = (
    (".", GREY, 22, "new"),
    ("x", BLUE, 14, "frequency stable"),
    ("d", PINK, 14, "frequency and damping stable"),
    ("o", GREEN, 16, "all stable"),
)


NEAR = 0.005  # Distance, relative to its frequency, up to which a pole of the diagram belongs to a selected mode.


@runtime_checkable
class Flags(Protocol):
    """Stability of the poles as it is drawn: boolean arrays ``(order, pole)``."""

    @property
    def frequency(self) -> Any: ...  # noqa: D102

    @property
    def damping(self) -> Any: ...  # noqa: D102

    @property
    def shape(self) -> Any: ...  # noqa: D102


def pole_kinds(table: PoleTable, stability: Flags | None) -> np.ndarray:
    """Kind of each pole, shape ``(order, pole)``: -1 no pole, 0 new, 1 frequency, 2 and damping, 3 and shape stable."""
    poles, valid = np.asarray(table.poles), np.asarray(table.valid)
    here = valid & (np.imag(poles) > 0) & (np.real(poles) < 0)
    kinds = np.where(here, 0, -1)
    if stability is not None:
        steps = [np.asarray(f) for f in (stability.frequency, stability.damping, stability.shape)]
        kinds = kinds + here * (steps[0].astype(int) + (steps[0] & steps[1]) + (steps[0] & steps[1] & steps[2]))
    return kinds


def not_in_diagram(table: PoleTable, selected_hz: Any) -> np.ndarray:
    """Which selected frequencies [Hz] have no pole of any order within ``NEAR`` of them: booleans, one for each."""
    found = np.sort((np.abs(np.asarray(table.poles)) / (2 * np.pi))[pole_kinds(table, None) >= 0])
    wanted = np.atleast_1d(np.asarray(selected_hz, float))
    if not len(found):
        return np.ones(len(wanted), bool)
    after = np.searchsorted(found, wanted).clip(1, len(found) - 1) if len(found) > 1 else np.zeros(len(wanted), int)
    distance = np.minimum(np.abs(found[after] - wanted), np.abs(found[after - 1] - wanted))
    return distance > NEAR * wanted


def plot_stabilization(
    table: PoleTable,
    stability: Flags | None = None,
    frf: FRF | None = None,
    *,
    selected_hz: Any = None,
    title: str = "",
) -> Figure:
    """Draw poles of every order against frequency, with the sum FRF and the CMIF behind them.

    Parameters
    ----------
    table
        Poles of all orders.
    stability
        Which of them are stable in frequency, damping and shape; all are drawn as new without it.
    frf
        The FRFs they came from.
    selected_hz
        Frequencies of the selected modes [Hz], drawn as dashed lines; dotted ones where no pole is near, as of a mode
        that was found in the residual of the others.
    """
    poles = np.asarray(table.poles)
    freq = np.abs(poles) / (2 * np.pi)
    kinds = pole_kinds(table, stability)
    orders = np.broadcast_to(np.asarray(table.orders)[:, None], poles.shape)
    with look():
        fig = new_figure(9.0, 5.2)
        ax = fig.add_subplot()
        if frf is not None:
            _background(ax, frf)
            frequency_axis(ax, frf.freq)
        else:
            frequency_axis(ax, np.sort(freq[kinds >= 0]))
        lower, upper = ax.get_xlim()
        inside = (freq >= lower) & (freq <= upper)
        for kind, (marker, colour, size, name) in enumerate(KINDS):
            which = (kinds == kind) & inside
            if which.any():
                width = 0.8 if marker == "x" else 0.0
                ax.scatter(
                    freq[which],
                    orders[which],
                    s=size,
                    marker=marker,
                    color=colour,
                    label=name,
                    zorder=3,
                    linewidths=width,
                )
        selected = np.atleast_1d(np.asarray([] if selected_hz is None else selected_hz, float))
        absent = not_in_diagram(table, selected)
        for which, style, label in (
            (~absent, "--", "selected mode"), (absent, ":", "selected mode without a pole here"),
        ):  # fmt: skip
            for k, f in enumerate(selected[which]):
                ax.axvline(f, color=ORANGE, linewidth=0.8, linestyle=style, zorder=2, label=None if k else label)
        ax.set_ylabel("Model order")
        ax.yaxis.set_major_locator(MaxNLocator("auto", integer=True))
        ax.set_ylim(min(table.orders) - 1.5, max(table.orders) + 1.5)
        ax.set_title(title)
        fig.legend(loc="outside lower center", ncols=4)
    return fig


def _background(ax: Axes, frf: FRF) -> None:
    """Sum FRF and the first singular values of the FRF matrix, on an axis of their own to the right."""
    twin = ax.twinx()
    twin.grid(False)
    twin.spines["right"].set_visible(True)
    twin.semilogy(frf.freq, np.asarray(sum_frf(frf)), color="#999999", linewidth=1.0, label="sum FRF")
    # The CMIF is squared singular values; its root has the unit of the FRF and shares the axis.
    singular = np.sqrt(np.asarray(cmif(frf)))
    for k in range(min(singular.shape[1], 3)):
        if singular.shape[1] == 1:  # With one input the CMIF is the sum of squares again.
            break
        twin.semilogy(frf.freq, singular[:, k], color="#d9c58a", linewidth=0.9, label="√CMIF" if k == 0 else None)
    twin.set_ylabel(frf_label(frf.form, "Sum FRF, √CMIF" if singular.shape[1] > 1 else "Sum FRF"))
    ax.set_zorder(twin.get_zorder() + 1)
    ax.patch.set_visible(False)
