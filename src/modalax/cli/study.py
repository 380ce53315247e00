"""``modalax study``: thousands of fits or diagnoses, resumable, on one machine or many."""

from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import note, start, working
from modalax.study.examples import EXAMPLES
from modalax.study.settings import KINDS

# A square bracket begins markup on a terminal, unless a backslash stands before it.
COMPLETE = EXAMPLES["noise"].replace("[", r"\[")
HELP = f"""Run a study described by a TOML file: thousands of fits or diagnoses over draws of the noise.

Kinds: noise, bootstrap, parameter, diagnosis, function. Each draw is a row; one that failed tells why. A study that was
stopped in any way goes on when it is started again, and gives the same rows. A complete file:

\b
{COMPLETE}
"""


def study(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE.toml", help="Description of the study.", show_default=False)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler to run on, such as tcp://host:8786."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", min=0, help="Processes on this machine; as many as cores if not given, 0: this process alone."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder of the results; FILE-results beside the file if not given."),
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            "--example", metavar="KIND", help=f"Print a complete file of a kind ({', '.join(KINDS)}) and stop."
        ),
    ] = None,
) -> None:
    """Run the study."""
    if example is not None:
        if example not in EXAMPLES:
            raise ValueError(f"--example {example}: there is no such kind; there are {', '.join(EXAMPLES)}")
        typer.echo(EXAMPLES[example], nl=False)
        return
    if file is None:
        raise ValueError(
            "study needs FILE.toml, the description of the study; --example noise prints one to start from"
        )
    from modalax.study.settings import read_settings

    settings = read_settings(file)  # mistakes are told before anything slow is imported
    if settings["kind"] != "function" or settings["vmap"]:
        start()
    from rich.console import Console

    from modalax.study.run import study as run

    with working(f"Study {file.name}") as progress:
        results = run(file, out, scheduler=scheduler, workers=workers, progress=progress)
    console = Console()
    print_summary(console if console.is_terminal else Console(width=WIDTH), results.summary)
    note(f"results: {results.file} ({results.summary['draws']} rows), summary: {results.folder / 'summary.json'}")


WIDTH = 110  # characters in a line of the table where it is no terminal


def print_summary(console: Any, told: dict[str, Any]) -> None:
    """Print a table of the statistics for each group of draws, and why draws failed."""
    from modalax.cli.tables import new_table
    from modalax.study.overview import caption, table, title
    from modalax.study.statistics import reason_lines

    for group in told["groups"]:
        printed = new_table(title(group))
        printed.caption = caption(group)
        header, rows = table(group)
        printed.add_column(header[0], no_wrap=True)
        for name in header[1:]:
            printed.add_column(name, justify="right", no_wrap=True)
        for row in rows:
            printed.add_row(*row)
        console.print(printed)
    for line in reason_lines(told):
        console.print(line, highlight=False, markup=False)
