"""Interactive figures of a report. Names from the data are escaped: plotly reads its texts as a kind of HTML."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from modalax.data.frf import FRF
from modalax.identify.tables import PoleTable
from modalax.model.indicators import cmif, sum_frf
from modalax.show.frf import Predicts, synthesised
from modalax.show.report.page import NEEDS, Plot
from modalax.show.residuals import bin_lines
from modalax.show.stabilization import KINDS, Flags, not_in_diagram, pole_kinds
from modalax.show.style import FREQUENCY, GREEN, GREY, ORANGE, frf_label

BLUE = "#2e8bcc"  # Lighter than in print, so that it is seen on dark ground too.
SYMBOLS = {".": "circle", "x": "x-thin-open", "d": "diamond", "o": "circle"}
BUDGET = 2.5e6  # Bytes for the FRFs of all channels; the whole file has to stay easy to send.
MAC_COLOURS = [[0, "#f3f7fb"], [0.5, "#6baed6"], [1, "#08306b"]]
NUMBERED = 400  # Fields of a matrix up to which each holds its number.
PRINTED = 6  # FRFs that stand on paper unless a reader selects others.
MOST_LINES = 6000  # Frequency lines of a curve; of more the peaks are kept.


def escape(name: str) -> str:
    """Make plotly show a name as it stands (it knows no escaped quotation marks)."""
    return html.escape(name, quote=False)


def graph_objects() -> Any:
    """Give plotly's figure classes.

    Raises
    ------
    ImportError
        If plotly is not installed.
    """
    try:
        import plotly.graph_objects as go
    except ImportError as error:
        raise ImportError(NEEDS) from error
    return go


def base_figure(rows: int = 1, heights: Sequence[float] | None = None, **layout: Any) -> Any:
    """Make an empty figure of rows that share the frequency axis, in the report's look."""
    graph_objects()
    from plotly.subplots import make_subplots

    fig = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=heights)
    fig.update_layout(
        template="none",
        font={"family": "system-ui, sans-serif", "size": 13},
        margin={"l": 80, "r": 30, "t": 50, "b": 55},
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "bgcolor": "rgba(0,0,0,0)"},
        hovermode="closest",
        dragmode="zoom",
        **layout,
    )
    fig.update_xaxes(showline=True, ticks="outside", zeroline=False)
    fig.update_yaxes(showline=True, ticks="outside", zeroline=False, exponentformat="power")
    return fig


def thinned(frf: FRF) -> np.ndarray:
    """Line numbers to draw: all, or of very many the one with the largest sum FRF in each of ``MOST_LINES`` bins."""
    count = len(frf.freq)
    if count <= MOST_LINES:
        return np.arange(count)
    size = np.asarray(sum_frf(frf))
    cuts = np.linspace(0, count, MOST_LINES + 1).round().astype(int)
    return np.array([a + int(np.argmax(size[a:b])) for a, b in zip(cuts[:-1], cuts[1:], strict=True)])


def axis_of(freq: np.ndarray) -> dict[str, Any]:
    """The frequency axis of a trace: start and step where the lines are equispaced, which is short."""
    step = np.diff(freq)
    if len(freq) > 2 and np.allclose(step, step[0], rtol=1e-6, atol=0):
        return {"x0": float(freq[0]), "dx": float((freq[-1] - freq[0]) / (len(freq) - 1))}
    return {"x": freq.astype(np.float32)}


def frf_plot(measured: FRF, fitted: Predicts | None, name: str = "fitted", caption: str = "") -> Plot:
    """Plot the FRFs of the channels with the most energy (all that fit the budget), one at a time."""
    which = thinned(measured)
    H, freq = np.asarray(measured.H)[which], np.asarray(measured.freq)[which]
    model = None if fitted is None else synthesised(measured, fitted)[which]
    sigma = None if measured.variance is None else np.sqrt(np.asarray(measured.variance)[which])
    energy = np.sum(np.abs(H) ** 2, axis=0)
    pairs = sorted(np.ndindex(*energy.shape), key=lambda p: -energy[p])
    most = max(2, int(BUDGET / (len(freq) * 6 * 4 * 4 / 3)))
    shown = sorted(pairs[:most], key=lambda p: (p[1], p[0]))
    figures = []
    for o, i in shown:
        curves = (H[:, o, i], None if model is None else model[:, o, i], None if sigma is None else sigma[:, o, i])
        label = f"{measured.outputs[o]} from {measured.inputs[i]}"
        figures.append((label, _frf_figure(freq, curves, measured.form, name)))
    notes = []
    if len(pairs) > len(shown):
        notes.append(f"The {len(shown)} strongest of {len(pairs)} channels.")
    if len(which) < measured.shape[0]:
        notes.append(f"{len(which)} of {measured.shape[0]} lines, peaks kept.")
    return Plot(
        figures,
        caption=" ".join([caption or "Measured FRF, fitted model, and their difference.", *notes]),
        description=f"Magnitude and phase of the measured FRFs with the {name} model over frequency.",
        height=520,
        on_paper=sorted(shown.index(pair) for pair in pairs[:PRINTED] if pair in shown),
    )


def _frf_figure(freq: np.ndarray, curves: tuple[np.ndarray, Any, Any], form: str, name: str) -> Any:
    go = graph_objects()
    fig = base_figure(2, [0.68, 0.32])
    axis, single = axis_of(freq), np.float32
    H, model, sigma = curves

    def add(values: np.ndarray, label: str, row: int, mode: str = "lines", **style: Any) -> None:
        trace = go.Scatter(y=values.astype(single), name=escape(label), mode=mode, **axis, **style)
        fig.add_trace(trace, row=row, col=1)

    add(np.abs(H), "measured", 1, line={"width": 1.4}, meta="ink")
    add(np.degrees(np.angle(H)), "measured", 2, "markers", marker={"size": 3}, meta="ink", showlegend=False)
    if model is not None:
        add(np.abs(model), name, 1, line={"width": 1.8, "color": ORANGE})
        add(np.abs(H - model), f"|measured - {name}|", 1, line={"width": 1, "color": BLUE})
        add(phase_line(model), name, 2, line={"width": 1.4, "color": ORANGE}, showlegend=False)
    if sigma is not None:
        add(sigma, "noise, 1 standard deviation", 1, line={"width": 1, "color": GREY, "dash": "dash"})
    fig.update_yaxes(title=frf_label(form), **decades([np.abs(H)]), row=1, col=1)
    _phase_below(fig, freq)
    return fig


def phase_line(values: np.ndarray) -> np.ndarray:
    """Phase [degrees] for a line, broken where it passes 180 degrees: a jump there would be none of the phase."""
    angle = np.degrees(np.angle(values))
    angle[1:][np.abs(np.diff(angle)) > 180] = np.nan
    return angle


def _phase_below(fig: Any, freq: Any) -> None:
    fig.update_yaxes(title="Phase [°]", tickvals=[-180, -90, 0, 90, 180], range=[-190, 190], row=2, col=1)
    fig.update_xaxes(title=FREQUENCY, row=2, col=1)
    fig.update_xaxes(range=[float(freq[0]), float(freq[-1])])


def decades(curves: Sequence[np.ndarray]) -> dict[str, Any]:
    """A logarithmic axis with ticks at powers of ten, or at 1, 2 and 5 times them where there are few."""
    values = np.concatenate([c[c > 0] for c in curves])
    span = np.log10(values.max() / values.min()) if values.size else 0.0
    return {"type": "log", "exponentformat": "power", "dtick": 1 if span > 1.7 else "D2"}


def stabilization_plot(table: PoleTable, stability: Flags | None, frf: FRF, selected_hz: Any) -> Plot:
    """Stabilization diagram over the sum FRF."""
    go = graph_objects()
    fig = base_figure(1)
    poles, kinds = np.asarray(table.poles), pole_kinds(table, stability)
    freq = np.abs(poles) / (2 * np.pi)
    orders = np.broadcast_to(np.asarray(table.orders)[:, None], poles.shape)
    lines = thinned(frf)
    axis = np.asarray(frf.freq)[lines]
    inside = (freq >= axis[0]) & (freq <= axis[-1])
    curves = [("sum FRF", np.asarray(sum_frf(frf))[lines], GREY)]
    singular = np.sqrt(np.asarray(cmif(frf)))[lines]
    if singular.shape[1] > 1:
        curves += [("√CMIF", singular[:, k], "#b89b4a") for k in range(min(3, singular.shape[1]))]
    for k, (name, values, colour) in enumerate(curves):
        fig.add_trace(
            go.Scatter(
                y=values.astype(np.float32), name=name, mode="lines", line={"width": 1.2, "color": colour}, yaxis="y2",
                hoverinfo="skip", showlegend=k < 2, legendgroup=name, **axis_of(axis),
            )
        )  # fmt: skip
    zeta = -np.real(poles) / np.maximum(np.abs(poles), 1e-300)
    for kind, (marker, printed, _, name) in enumerate(KINDS):
        which, colour = (kinds == kind) & inside, BLUE if marker == "x" else printed
        if which.any():
            fig.add_trace(
                go.Scatter(
                    x=freq[which], y=orders[which], name=name, mode="markers", customdata=100 * zeta[which],
                    marker={"symbol": SYMBOLS[marker], "color": colour, "size": 3 if kind == 0 else 6,
                            "line": {"color": colour, "width": 1 if marker == "x" else 0}},
                    hovertemplate="%{x:.4f} Hz, %{customdata:.3f} %<br>order %{y}<extra>" + name + "</extra>",
                )
            )  # fmt: skip
    selected = np.atleast_1d(np.asarray(selected_hz, float))
    absent = not_in_diagram(table, selected)
    for f, dash in zip(selected, np.where(absent, "dot", "dash"), strict=True):
        fig.add_vline(x=float(f), line={"color": ORANGE, "width": 1, "dash": str(dash)}, layer="below")
    fig.update_layout(
        yaxis={
            "title": {"text": "Model order"}, "tickformat": "d",
            "range": [min(table.orders) - 1.5, max(table.orders) + 1.5],
        },
        yaxis2={
            "title": {"text": frf_label(frf.form, "Sum FRF, √CMIF" if len(curves) > 1 else "Sum FRF")},
            "overlaying": "y", "side": "right", "showgrid": False, "zeroline": False, "showline": True,
            "ticks": "outside", **decades([values for _, values, _ in curves]),
        },
    )  # fmt: skip
    fig.update_layout(margin={"r": 80})
    fig.update_xaxes(title=FREQUENCY, range=[float(axis[0]), float(axis[-1])])
    return Plot(
        [("", fig)],
        caption="Poles of every model order; dashed lines are the selected modes. Hover for frequency and damping."
        + _absent_words(selected[absent]),
        description="Stabilization diagram: poles over frequency and model order, over the sum of the FRFs.",
        height=520,
    )


def _absent_words(frequency_hz: np.ndarray) -> str:
    """Why modes stand in the diagram without a pole."""
    if not len(frequency_hz):
        return ""
    one = len(frequency_hz) == 1
    which = "mode at" if one else "modes at"
    return (
        f" The {which} {', '.join(f'{f:.5g}' for f in frequency_hz)} Hz (dotted) {'has' if one else 'have'} no pole in "
        f"this diagram: {'it was' if one else 'they were'} found in what the other modes leave of the FRFs, or chosen "
        "by hand."
    )


def modes_plot(modes: Sequence[Mapping[str, Any]], truth: tuple[Any, Any] | None = None) -> Plot:
    """Damping over frequency with 95 % bars, from the modes of ``Fit.to_dict()``."""
    go = graph_objects()
    fig = base_figure(1)
    bars = lambda key, unit: [1.96 * unit * (m[key] or 0.0) for m in modes]
    fig.add_trace(
        go.Scatter(
            x=[m["frequency_hz"] for m in modes], y=[100 * m["damping_ratio"] for m in modes], mode="markers",
            name="estimated, bars hold 95 %", marker={"color": BLUE, "size": 8},
            error_x={"array": bars("frequency_std_hz", 1), "color": BLUE, "thickness": 1.4},
            error_y={"array": bars("damping_ratio_std", 100), "color": BLUE, "thickness": 1.4},
            text=[f"mode {k + 1}" for k in range(len(modes))],
            hovertemplate="%{text}: %{x:.4f} Hz, %{y:.4f} %<extra></extra>",
        )
    )  # fmt: skip
    if truth is not None:
        marker = {"symbol": "cross-thin-open", "size": 13, "color": ORANGE, "line": {"width": 2, "color": ORANGE}}
        x, y = np.asarray(truth[0]), 100 * np.asarray(truth[1])
        fig.add_trace(go.Scatter(x=x, y=y, mode="markers", name="truth", marker=marker))
    fig.update_xaxes(title="Natural frequency [Hz]")
    fig.update_yaxes(title="Damping ratio [%]", rangemode="tozero")
    return Plot(
        [("", fig)], "Natural frequencies and damping ratios.", "Damping ratio of each mode over its frequency."
    )


def shape_plot(shapes: Any, dofs: Sequence[str], frequency_hz: Any, at: str = "", paper: bool = True) -> Plot:
    """Components of each mode shape as bars, scaled to its largest, one mode at a time.

    ``at`` says where they were measured, and ``paper`` whether all of them are to stand on paper.
    """
    go = graph_objects()
    figures = []
    for k, (shape, f) in enumerate(zip(np.asarray(shapes), np.asarray(frequency_hz), strict=True)):
        scaled = shape / shape[np.argmax(np.abs(shape))]
        fig = base_figure(1, barmode="group", bargap=0.25)
        for part, name, colour in ((scaled.real, "real", BLUE), (scaled.imag, "imaginary", ORANGE)):
            fig.add_trace(go.Bar(x=[escape(n) for n in dofs], y=part.round(5), name=name, marker={"color": colour}))
        fig.update_xaxes(title="Degree of freedom", type="category", automargin=True)
        fig.update_yaxes(title="Shape [-]", range=[-1.1, 1.1])
        figures.append((f"{k + 1}: {f:.5g} Hz", fig))
    caption = f"Mode shapes{at}, each scaled to its largest component."
    every, across = range(len(figures)) if paper else (), 2 if len(dofs) <= 40 else 1
    return Plot(figures, caption, "Bars of the shape components.", "Mode", 360, every, across)


def mac_plot(matrix: Any, rows: Sequence[str], columns: Sequence[str], caption: str) -> Plot:
    """A matrix of modal assurance criteria."""
    go = graph_objects()
    fig = base_figure(1)
    fig.add_trace(
        go.Heatmap(
            z=np.asarray(matrix, np.float32), x=[escape(c) for c in columns], y=[escape(r) for r in rows], zmin=0,
            zmax=1, colorscale=MAC_COLOURS, colorbar={"title": {"text": "MAC [-]"}}, xgap=1, ygap=1,
            texttemplate="%{z:.2f}" if len(rows) * len(columns) <= NUMBERED else "", textfont={"size": 11},
            hovertemplate="%{y} and %{x}: %{z:.3f}<extra></extra>",
        )
    )  # fmt: skip
    fig.update_yaxes(autorange="reversed", type="category", automargin=True, showgrid=False)
    fig.update_xaxes(type="category", automargin=True, showgrid=False)
    height = int(np.clip(150 + 30 * len(rows), 320, 800))
    return Plot([("", fig)], caption, "Matrix of the modal assurance criterion.", height=height)


def residual_plot(freq: Any, maps: Sequence[tuple[str, Any]], rows: Sequence[str], bands: int = 200) -> Plot:
    r"""Maps of the energy of whitened residuals, each (label, complex ``(row, f)``), chosen from a list.

    All share one colour scale, so that before and after compare.
    """
    go = graph_objects()
    binned = [(label, *bin_lines(freq, np.abs(np.asarray(r)) ** 2 / 2, bands)) for label, r in maps]
    top = max(1.0, float(np.log10(max(mean.max() for _, mean, _ in binned))))
    ticks = np.arange(-int(top), int(top) + 1)
    figures = []
    for label, mean, edges in binned:
        fig = base_figure(1)
        fig.add_trace(
            go.Heatmap(
                z=np.log10(np.maximum(mean, 10**-top)).astype(np.float32), x=edges.astype(np.float32),
                y=[escape(r) for r in rows], zmin=-top, zmax=top, colorscale="RdBu", reversescale=True,
                customdata=mean.astype(np.float32),
                colorbar={"title": {"text": "energy<br>per sample"}, "tickvals": ticks,
                          "ticktext": [f"{10.0**t:g}" for t in ticks]},
                hovertemplate="%{y}, %{x:.2f} Hz: %{customdata:.3g} times the noise<extra></extra>",
            )
        )  # fmt: skip
        fig.update_yaxes(autorange="reversed", type="category", automargin=True, showgrid=False)
        fig.update_xaxes(title=FREQUENCY, showgrid=False)
        figures.append((label, fig))
    return Plot(
        figures,
        "Energy of the whitened residual: 1 (white) is noise alone, red is an error of the prediction.",
        "Map of the residual energy over frequency and channel.",
        "Prediction",
        height=int(np.clip(170 + 22 * len(rows), 320, 760)),
        on_paper=range(len(figures)),
    )


def bar_plot(names: Sequence[str], values: Sequence[float], axis: str, caption: str) -> Plot:
    """Horizontal bars, the first on top, for example probabilities of causes."""
    go = graph_objects()
    fig = base_figure(1)
    fig.add_trace(go.Bar(x=list(values), y=[escape(n) for n in names], orientation="h", marker={"color": GREEN}))
    fig.update_yaxes(autorange="reversed", type="category", automargin=True)
    fig.update_xaxes(title=axis, rangemode="tozero")
    return Plot([("", fig)], caption, f"Bars: {axis}.", height=140 + 34 * len(names))


def comparison_plot(
    freq: Any, measured: Any, simulated: Any, extended: Any, form: str, outputs: Sequence[str], inputs: Sequence[str],
    runs: Sequence[str],
) -> Plot:  # fmt: skip
    """Plot measured FRFs with a simulation and its extension, ``(run, f, o, i)``, one channel and run at a time.

    The first is the one with the largest error of the simulation, relative to its size.
    """
    go = graph_objects()
    size = np.abs(np.asarray(measured))
    energy = np.sum(np.abs(np.asarray(measured) - np.asarray(simulated)) ** 2, axis=1) / np.sum(size**2, axis=1)
    order = sorted(np.ndindex(*energy.shape), key=lambda k: -energy[k])
    most = max(2, int(BUDGET / (size.shape[1] * 6 * 4 * 4 / 3)))
    worst, shown = order[0], order[:most]
    shown = sorted(shown, key=lambda k: (k != worst, k[2], k[1], k[0]))  # the first is seen without choosing
    axis, figures = axis_of(np.asarray(freq)), []
    for r, o, i in shown:
        fig = base_figure(2, [0.7, 0.3])
        curves = [
            ("measured", measured, {"mode": "markers", "marker": {"size": 4}, "meta": "ink"}),
            ("simulation", simulated, {"mode": "lines", "line": {"color": BLUE, "dash": "dash", "width": 1.6}}),
        ]
        if extended is not None:
            curves.append(("extended simulation", extended, {"mode": "lines", "line": {"color": ORANGE, "width": 1.6}}))
        for name, values, style in curves:
            value = np.asarray(values)[r, :, o, i]
            phase = phase_line(value) if style["mode"] == "lines" else np.degrees(np.angle(value))
            for row, y in ((1, np.abs(value)), (2, phase)):
                trace = go.Scatter(y=y.astype(np.float32), name=name, showlegend=row == 1, **axis, **style)
                fig.add_trace(trace, row=row, col=1)
        fig.update_yaxes(title=frf_label(form), **decades([size[r, :, o, i]]), row=1, col=1)
        _phase_below(fig, freq)
        figures.append((f"{outputs[o]} from {inputs[i]}" + (f", {runs[r]}" if len(runs) > 1 else ""), fig))
    caption = "Measured FRF, the simulation, and the extended simulation where there is one."
    if len(order) > len(shown):
        caption += f" The {len(shown)} of {len(order)} channels and runs with the largest errors of the simulation."
    said = "Magnitude and phase of the measured and simulated FRFs over frequency."
    return Plot(figures, caption, said, height=520, on_paper=sorted(shown.index(k) for k in order[:PRINTED]))
