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
from modalax.show.style import BLACK, BLUE, ORANGE, frequency_axis, frf_label, look, name_text, new_figure

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


def _compared(top: Axes, under: Axes, diagnosis: Diagnosis, channel: tuple[int, int, int]) -> None:
    r, o, i = channel
    curves = (
        (diagnosis.comparison.measurement.H, {"color": BLACK, "marker": ".", "markersize": 3, "linestyle": "none"}),
        (diagnosis.predicted_before, {"color": BLUE, "linestyle": "--"}),
        (diagnosis.predicted_after, {"color": ORANGE}),
    )
    for (every, style), label in zip(curves, ("measured", "simulation", "extended simulation"), strict=True):
        values = np.asarray(every)[r, :, o, i]
        top.semilogy(diagnosis.freq, np.abs(values), label=label, **style)
        draw_phase(under, diagnosis.freq, values, **style)
    for ax in (top, under):
        frequency_axis(ax, diagnosis.freq)


def diagnosis_pictures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Draw a diagnosis: maps of the residual before and after, and the FRF with the largest error at each level."""
    names, before, after = residual_rows(
        diagnosis.comparison.measurement, diagnosis.residual_before, diagnosis.residual_after
    )
    residuals, panels = (
        (before, None) if diagnosis.extended is None else (np.stack([before, after]), ["before", "after"])
    )
    return {
        "residuals": plot_residual_map(diagnosis.freq, residuals, names, panels=panels),
        "comparison": plot_comparison(diagnosis),
    }


def save_diagnosis_pictures(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    """Write the pictures of a diagnosis as PNG files into a folder and return their paths."""
    return save_pictures(diagnosis_pictures(diagnosis), folder)
