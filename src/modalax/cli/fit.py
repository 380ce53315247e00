"""``modalax fit``: measured FRFs to modes with error bars."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import (
    BandOption,
    DataArgument,
    JsonOption,
    OverwriteOption,
    PicturesOption,
    ReportOption,
    check_folder,
    check_free,
    check_readable,
    note,
    read_measurement,
    start,
    working,
    write_json,
)


class Method(StrEnum):
    """Estimators of poles."""

    lscf = "lscf"
    plscf = "plscf"
    lsce = "lsce"
    fdpi = "fdpi"


def fit(
    data: DataArgument,
    band: BandOption = None,
    method: Annotated[
        Method | None, typer.Option(help="Estimator of the poles; chosen by itself if not given.")
    ] = None,
    order: Annotated[int | None, typer.Option(help="Largest model order; chosen by itself if not given.")] = None,
    refine: Annotated[bool, typer.Option("--refine/--no-refine", help="Refine by maximum likelihood.")] = True,
    run: Annotated[int | None, typer.Option(help="Which run of several, counted from 1.", show_default=False)] = None,
    json: JsonOption = None,
    report: ReportOption = None,
    out: PicturesOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Identify the modes of measured FRFs: frequency, damping and shape with standard deviations."""
    check_free(json, report, overwrite=overwrite, inputs=[data])
    check_folder(out, overwrite, inputs=[data])
    check_readable(data)
    start()
    frf = one_run(read_measurement(data), run, data)
    from rich.console import Console

    from modalax.cli.tables import mode_table, print_remarks
    from modalax.identify import fit as identify

    name = None if method is None else method.value
    with working("Identifying the modes (the first time on a machine also compiles)") as progress:
        result = identify(frf, method=name, order=order, refine=refine, band=band, progress=progress)
    answer = result.to_dict()
    console = Console()
    console.print(mode_table(answer["modes"]))
    print_remarks(console, answer)
    if not refine:
        note("not refined: no standard deviations; the scatter over the orders tells how far to trust a damping ratio")
    if result.refined is not None and not bool(result.refined.success):
        note(f"the refinement did not converge: {result.refined.reason}")
    geometry = nodes_beside(data) if report or out else None
    write_outputs(result, answer, json, report, out, f"Modes of {data.name}", geometry)


def one_run(measurement: Any, run: int | None, path: Path) -> Any:
    """Pick the run to fit; of several runs the first, and that is said.

    Raises
    ------
    ValueError
        If there is no such run.
    """
    if run is not None and not 1 <= run <= measurement.runs:
        raise ValueError(f"{path}: run {run} asked for, but there are {measurement.runs} runs, counted from 1")
    if run is None and measurement.runs > 1:
        note(f"{path} holds {measurement.runs} runs; fitting run 1, choose another with --run")
    return measurement.run(0 if run is None else run - 1)


def nodes_beside(path: Path) -> Any:
    """The nodes and lines that a universal file holds beside its FRFs; None where there are none."""
    from modalax.files import load_geometry
    from modalax.files.sniff import sniff

    if sniff(path) != "uff":
        return None
    try:
        return load_geometry(path)
    except ValueError:
        return None


def write_outputs(
    result: Any,
    answer: dict[str, Any],
    json: Path | None,
    report: Path | None,
    out: Path | None,
    title: str,
    geometry: Any,
) -> None:
    """Write what was asked for of a fit."""
    if json is not None:
        write_json(json, answer)
        note(f"result: {json}")
    if report is not None:
        from modalax.files.write import write_text
        from modalax.show.report import fit_report

        with working("Writing the report"):
            write_text(report, fit_report(result, title=title, geometry=geometry))
        note(f"report: {report}")
    if out is not None:
        from modalax.show import save_fit_pictures

        with working("Drawing"):
            written = save_fit_pictures(result, out, geometry=geometry)
        note(f"pictures: {', '.join(str(p) for p in written)}")
