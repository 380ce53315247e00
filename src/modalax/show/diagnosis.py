"""Pictures of a diagnosis: the errors of the simulation and of the extended simulation."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from modalax.data import Measurement
from modalax.diagnose.result import Diagnosis
from modalax.show.fit import save_pictures
from modalax.show.frf import draw_phase
from modalax.show.residuals import plot_residual_map
from modalax.show.style import (
    BLACK,
    BLUE,
    ORANGE,
    complex_plane,
    frequency_axis,
    frf_label,
    look,
    name_text,
    new_figure,
)

MOST_ROWS = 60


def run_names(level: np.ndarray) -> list[str]:
    """Name of each run: its force [N] where it is known."""
    return [f"run {k + 1}" if np.isnan(force) else f"{force:.4g} N" for k, force in enumerate(np.asarray(level))]


def residual_rows(data: Measurement, before: Any, after: Any) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names of the rows of a map (channel and run), and two residuals ``(run, f, o, i)`` as ``(row, f)``.

    Of very many rows those with the largest first residual are kept.
    """
    before, after = np.asarray(before), np.asarray(after)
    runs, _, outputs, inputs = before.shape
    index = [(r, o, i) for i in range(inputs) for o in range(outputs) for r in range(runs)]
    energy = np.sum(np.abs(before) ** 2, axis=1)
    if len(index) > MOST_ROWS:
        index = sorted(sorted(index, key=lambda k: -energy[k])[:MOST_ROWS], key=lambda k: (k[2], k[1], k[0]))
    force = [""] if runs == 1 else [f", {name}" for name in run_names(np.asarray(data.level))]
    names = [f"{data.outputs[o]} from {data.inputs[i]}{force[r]}" for r, o, i in index]
    return (
        names,
        np.stack([before[r, :, o, i] for r, o, i in index]),
        np.stack([after[r, :, o, i] for r, o, i in index]),
    )


def worst_channel(diagnosis: Diagnosis) -> tuple[int, int]:
    """Output and input of the FRF with the largest error of the simulation."""
    energy = np.sum(np.abs(np.asarray(diagnosis.residual_before)) ** 2, axis=(0, 1))
    o, i = np.unravel_index(int(np.argmax(energy)), energy.shape)
    return int(o), int(i)


def plot_comparison(diagnosis: Diagnosis, output: str | None = None, input: str | None = None, most: int = 6) -> Figure:
    """Draw one FRF at each force level, magnitude and phase: measured, simulated, and by the extended simulation.

    Parameters
    ----------
    output, input
        The channel by name; by default the one with the largest error of the simulation.
    most
        At most this many runs are drawn, spread over all.
    """
    data = diagnosis.comparison.measurement
    o, i = worst_channel(diagnosis)
    o = o if output is None else data.outputs.index(output)
    i = i if input is None else data.inputs.index(input)
    runs = np.unique(np.linspace(0, data.runs - 1, min(most, data.runs)).round().astype(int))
    names = run_names(np.asarray(data.level))
    with look():
        columns = min(3, len(runs))
        rows = -(-len(runs) // columns)
        fig = new_figure(3.3 * columns + 1.2, 3.9 * rows + 0.7)
        axes = fig.subplots(2 * rows, columns, sharex=True, sharey="row", squeeze=False, height_ratios=[2.4, 1] * rows)
        for k in range(rows * columns):
            top, under = axes[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
            if k >= len(runs):
                top.set_visible(False)
                under.set_visible(False)
                continue
            _compared(top, under, diagnosis, (int(runs[k]), o, i))
            top.set_title(names[runs[k]])
            top.set_xlabel("")
            last = k + columns >= len(runs)
            under.tick_params(labelbottom=last)
            under.set_xlabel("Frequency [Hz]" if last else "")
            top.set_ylabel(frf_label(data.form) if k % columns == 0 else "")
            under.set_ylabel("Phase [°]" if k % columns == 0 else "")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=3)
        fig.suptitle(f"FRF from {name_text(data.inputs[i])} to {name_text(data.outputs[o])}")
    return fig


def worst_mode(diagnosis: Diagnosis) -> float | None:
    """Frequency [Hz] of the mode with the largest error of the simulation; None where no mode was seen."""
    modes = (diagnosis.evidence or {"by_mode": []})["by_mode"]
    seen = [m for m in modes if m["chi2_before"] is not None]
    return max(seen, key=lambda m: m["chi2_before"])["frequency_hz"] if seen else None


def plot_nyquist(diagnosis: Diagnosis, widths: float = 8.0) -> Figure | None:
    """Draw the mode with the largest error in the complex plane: measured, simulated, and by the extended simulation.

    Parameters
    ----------
    widths
        Half-bandwidths on either side of the mode, and of the simulation's own, that are drawn.

    Returns
    -------
    matplotlib.figure.Figure or None
        Of the last run, in the channel with the largest error; None where no mode was seen.
    """
    at = worst_mode(diagnosis)
    if at is None or diagnosis.evidence is None:
        return None
    row = next(m for m in diagnosis.evidence["by_mode"] if m["frequency_hz"] == at)
    data, (o, i) = diagnosis.comparison.measurement, worst_channel(diagnosis)
    moved = at * (1 + (row["frequency_error_before"] or 0.0))
    reach = max(widths * row["damping_ratio"] * at, 2.5 * float(np.diff(diagnosis.freq).mean()))
    near = (diagnosis.freq > min(at, moved) - reach) & (diagnosis.freq < max(at, moved) + reach)
    with look():
        fig = new_figure(5.6, 5.2)
        ax = fig.subplots()
        for every, style, label in _curves(diagnosis):
            values = np.asarray(every)[-1, near, o, i]
            ax.plot(values.real, values.imag, label=label, **style)
        complex_plane(ax, data.form)
        ax.set_title(f"{at:.5g} Hz, from {name_text(data.inputs[i])} to {name_text(data.outputs[o])}")
        ax.legend()
    return fig


def _curves(diagnosis: Diagnosis) -> list[tuple[Any, dict[str, Any], str]]:
    """FRFs, how each is drawn, and what it is."""
    return [
        (diagnosis.comparison.measurement.H, {"color": BLACK, "marker": ".", "markersize": 3, "linestyle": "none"},
         "measured"),
        (diagnosis.predicted_before, {"color": BLUE, "linestyle": "--"}, "simulation"),
        (diagnosis.predicted_after, {"color": ORANGE}, "extended simulation"),
    ]  # fmt: skip


def _compared(top: Axes, under: Axes, diagnosis: Diagnosis, channel: tuple[int, int, int]) -> None:
    r, o, i = channel
    for every, style, label in _curves(diagnosis):
        values = np.asarray(every)[r, :, o, i]
        top.semilogy(diagnosis.freq, np.abs(values), label=label, **style)
        draw_phase(under, diagnosis.freq, values, **style)
    for ax in (top, under):
        frequency_axis(ax, diagnosis.freq)


def diagnosis_pictures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Draw a diagnosis: residuals, the FRF with the largest error at each level, and its worst mode's circle."""
    names, before, after = residual_rows(
        diagnosis.comparison.measurement, diagnosis.residual_before, diagnosis.residual_after
    )
    residuals, panels = (
        (before, None) if diagnosis.extended is None else (np.stack([before, after]), ["before", "after"])
    )
    circle = plot_nyquist(diagnosis)
    return {
        "residuals": plot_residual_map(diagnosis.freq, residuals, names, panels=panels),
        "comparison": plot_comparison(diagnosis),
        **({} if circle is None else {"nyquist": circle}),
    }


def save_diagnosis_pictures(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    """Write the pictures of a diagnosis as PNG files into a folder and return their paths."""
    return save_pictures(diagnosis_pictures(diagnosis), folder)
