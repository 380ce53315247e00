"""``modalax diagnose``: what a simulation gets wrong; ``modalax causes``: the list of causes that can be named."""

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
    check_ending,
    check_folder,
    check_free,
    check_readable,
    note,
    read_measurement,
    read_simulation,
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


def diagnose(
    data: DataArgument,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation",
            metavar="SIM",
            help="Simulation: matrices M, C, K or a modal model (required).",
        ),
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
    complete: CompleteOption = False,
    question: Annotated[
        str,
        typer.Option(
            "--question",
            help="fixed: does the data agree with this simulation? free: with any linear modal model? "
            "auto: free for a modal model that was fitted to data, else fixed.",
        ),
    ] = "auto",
    band: BandOption = None,
    run: Annotated[
        list[int] | None,
        typer.Option("--run", metavar="K", help="Use only this run, counted from 1; repeat the option for several."),
    ] = None,
    causes: Annotated[
        str | None,
        typer.Option("--causes", metavar="SLUG,...", help="Look for these causes only; 'modalax causes' lists them."),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            metavar="SLUG=F,...",
            help="Factor on the prior odds of a cause, such as joint_stiffness=10.",
        ),
    ] = None,
    time: Annotated[
        float,
        typer.Option(
            "--time",
            metavar="SECONDS",
            help="Time limit in seconds; after it no new step begins, and the best answer so far is given.",
        ),
    ] = 120.0,
    modal_std: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            "--modal-std",
            metavar="F Z S",
            show_default=False,
            help="Of modes alone: relative deviations of frequency, damping and shape; default 0.002 0.1 0.03.",
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="EXTENDED", help="Write the extended simulation to this file (npz)."),
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Find what a simulation gets wrong about measured FRFs, and how much better it predicts once extended.

    DATA may also hold modes alone: a modal model, shapes of a universal file, or a CSV table as fit --modes writes it.
    """
    if simulation is None:
        raise ValueError("diagnose needs --simulation SIM, the model to compare with")
    if time <= 0:
        raise ValueError(f"--time is {time:g} s; it must be above zero")
    check_free(json, report, save, overwrite=overwrite, inputs=[data, simulation])
    check_ending(save, (".npz",), "an extended simulation")
    require_report(report)
    check_folder(out, overwrite, inputs=[data, simulation])
    check_readable(data, simulation)
    start()
    measurement = read_measured(data, **told(form, unit, frequency_unit, outputs, inputs, axes, complete))
    modes_alone = not hasattr(measurement, "H")
    if modes_alone and (report or out or band or run):
        raise ValueError(f"{data} holds modes alone: --report, --out, --band and --run are for FRFs; --json tells all")
    if modal_std and not modes_alone:
        raise ValueError(f"{data} holds FRFs: --modal-std is for modes alone")
    model = read_simulation(simulation, extended=True)
    from rich.console import Console

    from modalax.cli.tables import print_diagnosis
    from modalax.diagnose import diagnose as answered
    from modalax.files import save as write_model

    wanted, held = _named_causes(causes), _factors(prior)
    with naming(data):
        measurement = measurement if modes_alone else _selected(measurement, band, run)
    doing = "Diagnosing (slower the first time, when programs are compiled)"
    with naming(data, simulation), working(doing) as tell:
        result = answered(
            measurement, model, question=question, causes=wanted, time=time, modal_std=modal_std, prior=held,
            progress=tell,
        )  # fmt: skip
    answer = result.to_dict()
    print_diagnosis(Console(), answer)
    if json is not None:
        write_json(json, answer)
        note(f"result: {json}")
    if save is not None:
        if result.extended is None:
            note(f"nothing to save in {save}: the simulation needs no extension")
        else:
            write_model(result.extended, save, overwrite)
            note(f"extended simulation: {save}")
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


def read_measured(path: Path, **told: Any) -> Any:
    """Read FRFs or, where a file holds modes alone, these."""
    from modalax.files import load_mode_table
    from modalax.files.mode_files import holds_modes_alone

    return load_mode_table(path) if holds_modes_alone(path) else read_measurement(path, **told)


def _selected(measurement: Any, band: tuple[float, float] | None, runs: list[int] | None) -> Any:
    """The part of a measurement with the runs (counted from 1) and the band that were asked for."""
    if runs:
        wrong = [k for k in runs if not 1 <= k <= measurement.runs]
        if wrong:
            raise ValueError(f"--run {wrong[0]}: the measurement has runs 1 to {measurement.runs}")
        import numpy as np

        keep = np.array([k - 1 for k in runs])
        take = lambda a: None if a is None else a[keep]
        measurement = measurement.replace(
            H=take(measurement.H), variance=take(measurement.variance), coherence=take(measurement.coherence),
            level=take(measurement.level), force=take(measurement.force),
        )  # fmt: skip
    return measurement if band is None else measurement.band(*band)


def _factors(text: str | None) -> dict[str, float]:
    """Factors by cause as ``SLUG=FACTOR,...``."""
    found: dict[str, float] = {}
    for item in (part.strip() for part in (text or "").split(",") if part.strip()):
        name, _, number = (part.strip() for part in item.partition("="))
        try:
            found[name] = float(number)
        except ValueError:
            raise ValueError(f"--prior {item}: it needs SLUG=FACTOR, for example joint_stiffness=10") from None
    return found


def _named_causes(slugs: str | None) -> list[Any] | None:
    """Causes of the catalogue whose names were given, separated by commas; None where no name was given."""
    if slugs is None:
        return None
    from modalax.diagnose.causes import as_causes

    names = [s.strip() for s in slugs.split(",") if s.strip()]
    if not names:
        raise ValueError("--causes needs at least one name, for example --causes added_mass,joint_stiffness")
    return as_causes(names)


def causes() -> None:
    """List the causes that a diagnosis can name, with their parameters."""
    start()
    from rich.console import Console

    from modalax.cli.tables import cause_table
    from modalax.diagnose.causes import catalogue

    Console().print(cause_table(catalogue()))
