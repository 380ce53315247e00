"""Pictures of FRFs and a fit: magnitude, phase, Nyquist, coherence and residual."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modalax.data.frf import FRF
from modalax.model.modal import ModalModel
from modalax.model.structure import Structure
from modalax.show.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SERIES,
    complex_plane,
    frequency_axis,
    frf_label,
    look,
    name_text,
    new_figure,
)

Predicts = FRF | ModalModel | Structure
FINE = {ModalModel: 32, Structure: 8}  # Points of a fitted Nyquist circle for each line measured.


def synthesised(measured: FRF, fitted: Predicts) -> np.ndarray:
    """FRF values of ``fitted`` at the lines, channels and form of ``measured``, shape ``(f, o, i)``.

    Raises
    ------
    ValueError
        If ``fitted`` is an FRF on other lines.
    """
    if not isinstance(fitted, FRF):
        return np.asarray(
            fitted.frf(measured.freq, form=measured.form, outputs=measured.outputs, inputs=measured.inputs).H
        )
    same = fitted.to_form(measured.form).pick(measured.outputs, measured.inputs)
    if same.shape[0] != measured.shape[0] or not np.allclose(same.freq, measured.freq, rtol=1e-9, atol=0):
        raise ValueError(
            f"the fit has {same.shape[0]} lines and the measurement {measured.shape[0]}; they need the same frequencies"
        )
    return np.asarray(same.H)


def strongest(frf: FRF) -> tuple[str, str]:
    """Name the output and input with the most energy over the lines."""
    energy = np.sum(np.abs(np.asarray(frf.H)) ** 2, axis=0)
    o, i = np.unravel_index(int(np.argmax(energy)), energy.shape)
    return frf.outputs[int(o)], frf.inputs[int(i)]


def plot_frf(
    measured: FRF,
    fitted: Predicts | None = None,
    *,
    output: str | None = None,
    input: str | None = None,
    label: str = "fitted",
) -> Figure:
    """Draw one FRF in every view: magnitude with the residual, phase, coherence where known, Nyquist.

    Parameters
    ----------
    measured
        The measured FRF.
    fitted
        An FRF on the same lines, or a model, drawn over it; its difference from ``measured`` is drawn too.
    output, input
        The channel by name; the one with the most energy by default.
    label
        Name of ``fitted`` in the legend.
    """
    if output is None and input is None:
        output, input = strongest(measured)
    one = measured.pick(
        [measured.outputs[0] if output is None else output], [measured.inputs[0] if input is None else input]
    )
    H, freq = np.asarray(one.H)[:, 0, 0], np.asarray(one.freq)
    model = None if fitted is None else synthesised(one, fitted)[:, 0, 0]
    with look():
        rows = 2 + (one.coherence is not None)
        fig = new_figure(9.5, 4.4 + 0.9 * (rows - 2))
        grid = fig.add_gridspec(rows, 2, width_ratios=(1.75, 1), height_ratios=(2.4, 1, 0.8)[:rows])
        top = fig.add_subplot(grid[0, 0])
        _magnitude(top, one, model, label)
        phase = fig.add_subplot(grid[1, 0], sharex=top)
        _phase(phase, freq, H, model)
        last = phase
        if one.coherence is not None:
            last = fig.add_subplot(grid[2, 0], sharex=top)
            last.plot(freq, np.asarray(one.coherence)[:, 0, 0], color=GREY)
            last.set_ylim(-0.02, 1.05)
            last.set_ylabel("Coherence [-]")
            phase.tick_params(labelbottom=False)
        top.tick_params(labelbottom=False)
        frequency_axis(last, freq)
        _nyquist(fig.add_subplot(grid[:, 1]), one, None if fitted is None else _fine(one, fitted), label)
        fig.suptitle(f"FRF from {name_text(one.inputs[0])} to {name_text(one.outputs[0])}")
    return fig


def plot_frf_grid(
    measured: FRF,
    fitted: Predicts | None = None,
    *,
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    most: int = 12,
    label: str = "fitted",
) -> Figure:
    """Draw the magnitudes of several FRFs, a small picture for each channel; at most ``most``, the strongest."""
    some = measured.pick(outputs, inputs)
    H = np.asarray(some.H)
    model = None if fitted is None else synthesised(some, fitted)
    pairs = [(o, i) for i in range(H.shape[2]) for o in range(H.shape[1])]
    if len(pairs) > most:
        energy = np.sum(np.abs(H) ** 2, axis=0)
        pairs = sorted(sorted(pairs, key=lambda p: -energy[p])[:most], key=lambda p: (p[1], p[0]))
    columns = min(4, int(np.ceil(np.sqrt(len(pairs)))))
    rows = -(-len(pairs) // columns)
    with look():
        fig = new_figure(2.7 * columns + 0.8, 1.75 * rows + 0.9)
        axes = fig.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for ax, (o, i) in zip(axes.flat, pairs, strict=False):
            ax.semilogy(some.freq, np.abs(H[:, o, i]), color=BLACK, linewidth=0.9, label="measured")
            if model is not None:
                ax.semilogy(some.freq, np.abs(model[:, o, i]), color=ORANGE, linewidth=1.1, label=label)
            ax.set_title(f"{name_text(some.outputs[o])} from {name_text(some.inputs[i])}", fontsize=8)
        for k, ax in enumerate(axes.flat):
            ax.set_visible(k < len(pairs))
            ax.tick_params(labelbottom=k + columns >= len(pairs))
        frequency_axis(axes[0, 0], some.freq)
        axes[0, 0].set_xlabel("")
        _log_limits(axes[0, 0], np.abs(H[:, [o for o, _ in pairs], [i for _, i in pairs]]))
        fig.supxlabel("Frequency [Hz]", fontsize=9)
        fig.supylabel(frf_label(some.form), fontsize=9)
        handles, names = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, names, loc="outside upper right", ncols=2)
    return fig


def plot_levels(freq: Any, H: Any, level: Any, form: str = "receptance", title: str = "") -> Figure:
    """Draw one FRF at several force levels; curves that differ show a non-linear structure.

    Parameters
    ----------
    freq, H, level
        Shapes ``(f,)`` [Hz], ``(run, f)`` and ``(run,)`` [N].
    """
    with look():
        fig = new_figure(7.0, 3.8)
        ax = fig.add_subplot()
        for k, (row, force) in enumerate(zip(np.asarray(H), np.asarray(level), strict=True)):
            name = f"run {k + 1}" if np.isnan(force) else f"{force:g} N"
            ax.semilogy(freq, np.abs(row), color=SERIES[k % len(SERIES)], label=name)
        frequency_axis(ax, freq)
        ax.set_ylabel(frf_label(form))
        ax.set_title(title)
        ax.legend(title="Force")
    return fig


def _log_limits(ax: Axes, *curves: np.ndarray) -> None:
    """Limits that hold the curves but not single near-zeros, at least one decade high."""
    values = np.concatenate([c[c > 0].ravel() for c in curves])
    if values.size:
        top = float(values.max()) * 2
        ax.set_ylim(min(float(np.quantile(values, 0.005)) / 2, top / 10), top)


def _magnitude(ax: Axes, one: FRF, model: np.ndarray | None, label: str) -> None:
    H, freq = np.asarray(one.H)[:, 0, 0], np.asarray(one.freq)
    ax.semilogy(freq, np.abs(H), color=BLACK, linewidth=1.0, label="measured")
    curves = [np.abs(H)]
    if model is not None:
        ax.semilogy(freq, np.abs(model), color=ORANGE, label=label)
        left = np.abs(H - model)
        curves += [np.abs(model), left]
        part = float(np.sum(left**2) / np.sum(np.abs(H) ** 2))
        ax.semilogy(freq, left, color=BLUE, linewidth=0.7, label=f"|measured - {label}|, {100 * part:.2g} % of energy")
    if one.variance is not None:
        sigma = np.sqrt(np.asarray(one.variance)[:, 0, 0])
        ax.semilogy(freq, sigma, color=GREY, linestyle="--", linewidth=1.0, label="noise, 1 standard deviation")
    _log_limits(ax, *curves)
    ax.set_ylabel(frf_label(one.form))
    # Room above the curves, so that the legend hides no peak.
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.28)
    ax.legend(ncols=2, loc="upper center")


def _phase(ax: Axes, freq: np.ndarray, H: np.ndarray, model: np.ndarray | None) -> None:
    draw_phase(ax, freq, H, color=BLACK, marker=".", markersize=2, linestyle="none")
    if model is not None:
        draw_phase(ax, freq, model, color=ORANGE)
    ax.set_ylabel("Phase [°]")


def draw_phase(ax: Axes, freq: Any, values: Any, **style: Any) -> None:
    """Phase of complex values in degrees, as points or as a line that is broken where it passes 180 degrees."""
    angle = np.degrees(np.angle(np.asarray(values)))
    # A line from -180 to 180 degrees is the same angle; drawn, it would look like a jump.
    if style.get("linestyle") != "none":
        angle[1:][np.abs(np.diff(angle)) > 180] = np.nan
    ax.plot(freq, angle, **style)
    ax.set_yticks([-180, -90, 0, 90, 180])
    ax.set_ylim(-200, 200)


def _fine(one: FRF, fitted: Predicts) -> np.ndarray:
    """Values of a model for a smooth circle: at several lines for each one measured; an FRF has those it has."""
    if isinstance(fitted, FRF):
        return synthesised(one, fitted)[:, 0, 0]
    freq, fine = np.asarray(one.freq), next(n for kind, n in FINE.items() if isinstance(fitted, kind))
    between = np.interp(np.arange(fine * (len(freq) - 1) + 1) / fine, np.arange(len(freq)), freq)
    predicted = fitted.frf(between, form=one.form, outputs=one.outputs, inputs=one.inputs)
    return np.asarray(predicted.H)[:, 0, 0]


def _nyquist(ax: Axes, one: FRF, model: np.ndarray | None, label: str) -> None:
    H = np.asarray(one.H)[:, 0, 0]
    ax.plot(np.real(H), np.imag(H), ".", color=BLACK, markersize=2.5, label="measured")
    if model is not None:
        ax.plot(np.real(model), np.imag(model), color=ORANGE, linewidth=1.0, label=label)
    complex_plane(ax, one.form)
    ax.set_title("Nyquist")
