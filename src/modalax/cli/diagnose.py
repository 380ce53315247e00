"""``modalax diagnose`` and ``modalax causes``: what a simulation gets wrong, and what can be named."""

from pathlib import Path
from typing import Annotated

import typer

from modalax.cli.common import (
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
    read_simulation,
    start,
    working,
    write_json,
)
from modalax.cli.told import (
    AxesOption,
    FormOption,
    FrequencyUnitOption,
    InputsOption,
    OutputsOption,
    UnitOption,
    told,
)


def diagnose(
    data: DataArgument,
    simulation: Annotated[
        Path | None, typer.Option("--simulation", metavar="SIM", help="Matrices M, C, K or a modal model (npz).")
    ] = None,
    json: JsonOption = None,
    report: ReportOption = None,
    out: PicturesOption = None,
    form: FormOption = None,
    unit: UnitOption = None,
    frequency_unit: FrequencyUnitOption = None,
    outputs: OutputsOption = None,
    inputs: InputsOption = None,
    axes: AxesOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare measured FRFs with a simulation: where it fails, why, and how much better it predicts once extended."""
    if simulation is None:
        raise ValueError("diagnose needs --simulation SIM, the model to compare with")
    check_free(json, report, overwrite=overwrite, inputs=[data, simulation])
    check_folder(out, overwrite, inputs=[data, simulation])
    check_readable(data, simulation)
    start()
    measurement = read_measurement(data, **told(form, unit, frequency_unit, outputs, inputs, axes))
    model = read_simulation(simulation, extended=True)
    from rich.console import Console

    from modalax.cli.tables import print_diagnosis
    from modalax.diagnose import diagnose as run

    with working("Comparing, screening the causes, refitting (the first time on a machine also compiles)"):
        result = run(measurement, model)
    answer = result.to_dict()
    print_diagnosis(Console(), answer)
    if json is not None:
        write_json(json, answer)
        note(f"result: {json}")
    if report is not None:
        from modalax.files.write import write_text
        from modalax.show.report import diagnosis_report

        with working("Writing the report"):
            write_text(report, diagnosis_report(result, title=f"{data.name} against {simulation.name}"))
        note(f"report: {report}")
    if out is not None:
        from modalax.show import save_diagnosis_pictures

        with working("Drawing"):
            written = save_diagnosis_pictures(result, out)
        note(f"pictures: {', '.join(str(p) for p in written)}")


def causes() -> None:
    """List the causes that a diagnosis can name, with their parameters and places."""
    start()
    from rich.console import Console

    from modalax.cli.tables import cause_table
    from modalax.diagnose.causes import catalogue

    Console().print(cause_table(catalogue()))
