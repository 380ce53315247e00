"""Results as tables on the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from modalax._numerics.text import with_error

UNBOUNDED = 10_000  # columns of a line that any table fits


def new_table(title: str) -> Table:
    """Make an empty table in the style of all tables on the terminal."""
    return Table(title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD, pad_edge=False)


def print_uncut(console: Console, table: Table) -> None:
    """Print a table of which no number is cut: with closer columns, then longer lines, where the console is narrow."""
    unbounded = console.options.update(width=UNBOUNDED)
    if Measurement.get(console, unbounded, table).maximum > console.width:
        table.padding = (0, 1, 0, 0)
        table.width = Measurement.get(console, unbounded, table).maximum
    console.print(table, crop=False)


def mode_table(modes: Sequence[Mapping[str, Any]], truth: tuple[Any, Any] | None = None) -> Table:
    """Make a table of the modes of ``Fit.to_dict()``, beside true frequencies and damping ratios where known."""
    from modalax.identify.summary import BIAS, GRADE

    refined = any(mode["frequency_std_hz"] is not None for mode in modes)
    scattered = not refined and any(mode.get("frequency_scatter_hz") is not None for mode in modes)
    table = new_table("Modes, ± one standard deviation" if refined else "Modes of the diagram, not refined")
    table.caption = BIAS
    true = ["true"] if truth is not None else []
    grade = ["Grade"] if truth is None else []  # 80 columns do not hold both
    spread = ["Scatter [%]"] if scattered else []
    if grade:
        table.caption = f"{GRADE} {table.caption}"
    if spread:
        table.caption = f"Scatter: by how much the damping changes over the orders of the diagram. {table.caption}"
    for name in ("Mode", "Frequency [Hz]", *true, "Damping [%]", *true, *spread, "MPC", *grade, "Bias [%]"):
        table.add_column(name, justify="right", no_wrap=True, style="dim" if name == "true" else None)
    for k, mode in enumerate(modes):
        bias = mode.get("predicted_damping_bias")
        row = [
            str(k + 1),
            with_error(mode["frequency_hz"], mode["frequency_std_hz"]),
            with_error(mode["damping_ratio"], mode["damping_ratio_std"], 100.0),
            *(_scatter(mode) for _ in spread),
            f"{mode['mpc']:.3f}",
            *(f"{mode['grade']:.2f}" for _ in grade),
            "" if bias is None else f"{100 * bias / mode['damping_ratio']:+.2g}",
        ]
        if truth is not None:
            row.insert(3, f"{100 * float(truth[1][k]):.4g}")
            row.insert(2, f"{float(truth[0][k]):.5g}")
        table.add_row(*row)
    return table


def _scatter(mode: Mapping[str, Any]) -> str:
    scatter = mode.get("damping_scatter")
    return "" if scatter is None else f"{100 * scatter / mode['damping_ratio']:.2g}"


def print_remarks(console: Console, answer: Mapping[str, Any]) -> None:
    """Print the remarks of ``Fit.to_dict()`` on single modes and the measurement, and the unexplained part."""
    for k, mode in enumerate(answer["modes"]):
        if mode["flags"]:
            text = f"mode {k + 1}, {mode['frequency_hz']:.5g} Hz: {'; '.join(mode['flags'])}"
            console.print(text, highlight=False, markup=False)
    for note in answer["notes"]:
        console.print(note, highlight=False, markup=False)
    console.print(
        f"unexplained part of the measured energy: {100 * answer['unexplained']:.3g} % "
        f"({100 * answer['unexplained_noise']:.2g} % noise, {100 * answer['unexplained_misfit']:.2g} % misfit)",
        highlight=False,
    )


def cause_table(causes: Sequence[Any]) -> Table:
    """Make a table of causes, with what an answer tells of each; forms of a cause that share a name share a row."""
    from modalax.diagnose.causes.listing import listing

    table = new_table("Causes that a diagnosis can name")
    table.add_column("Cause", no_wrap=True)
    table.add_column("Parameters")
    table.add_column("The simulation lacks")
    for row in listing(causes):
        words = ", ".join(f"{name} [{unit}]" for name, unit in row.units.items())
        table.add_row(row.slug, escape(words), escape("; ".join(row.summaries)))
    return table


def print_diagnosis(console: Console, answer: Mapping[str, Any]) -> None:
    """Print ``Diagnosis.to_dict()``: verdict, causes, rivals, reasons, advice and gain."""
    from modalax.diagnose.summary import CAUSE_COLUMNS, cause_rows, explanation_lines, meaning

    verdict = answer["verdict"]
    console.print(f"[bold]{verdict}[/bold]: {meaning(answer)}", highlight=False)
    if answer["causes"]:
        table = new_table("Best attempt" if verdict == "unknown" else "Causes in the extended simulation")
        for name in CAUSE_COLUMNS:
            table.add_column(name, justify="right" if name == "Probability" else "left")
        for row in cause_rows(answer):
            table.add_row(*map(escape, row))
        console.print(table)
    for line in explanation_lines(answer):
        console.print(line, highlight=False, markup=False)
