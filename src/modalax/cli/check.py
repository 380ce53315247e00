"""``modalax check``: faults of a measurement, found without a model of the structure."""

from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import (
    JsonOption,
    OverwriteOption,
    ReportOption,
    check_free,
    note,
    require_report,
    start,
    working,
    write_json,
)
from modalax.cli.told import (
    AxesOption,
    CompleteOption,
    FormOption,
    FrequencyUnitOption,
    InputsOption,
    OutputsOption,
    UnitOption,
    told,
)
from modalax.files.messages import naming


def check(
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA", help="Measured FRFs or time records (UFF, npz, npy, mat, NetCDF, Zarr or CSV)."),
    ],
    json: JsonOption = None,
    report: ReportOption = None,
    form: FormOption = None,
    unit: UnitOption = None,
    frequency_unit: FrequencyUnitOption = None,
    outputs: OutputsOption = None,
    inputs: InputsOption = None,
    axes: AxesOption = None,
    complete: CompleteOption = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Find what is wrong with a measurement: channels, hits, records, noise, reciprocity and form."""
    check_free(json, report, overwrite=overwrite, inputs=[data])
    require_report(report)
    if not data.exists():
        raise FileNotFoundError(f"{data}: no such file")
    start()
    from rich.console import Console

    from modalax.check import check as look

    with naming(data), working("Checking the measurement"):
        result = look(data, **told(form, unit, frequency_unit, outputs, inputs, axes, complete))
    print_findings(Console(), result)
    if json is not None:
        write_json(json, result.to_dict())
        note(f"result: {json}")
    if report is not None:
        from modalax.files.write import write_text
        from modalax.show.report import check_report

        with working("Writing the report"):
            write_text(report, check_report(result, title=f"Check of {data.name}"))
        note(f"report: {report}")


def print_findings(console: Any, result: Any) -> None:
    """Print a table of the findings, and below it the evidence and the advice of each."""
    from rich.markup import escape

    from modalax.check.overview import COLUMNS, SOUND, of_finding, row
    from modalax.cli.tables import new_table

    for line in result.about:
        console.print(line, highlight=False, markup=False)
    if not len(result):
        console.print(SOUND)
        return
    table = new_table("Findings")
    for name, justify in zip(COLUMNS, ("left", "left", "right", "right"), strict=True):
        table.add_column(name, justify=justify)
    for f in result:
        table.add_row(*map(escape, row(f)))
    console.print(table)
    for f in result:
        console.print(of_finding(f), highlight=False, markup=False)
