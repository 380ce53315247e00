"""``modalax fit``: modes of measured FRFs, with standard deviations."""

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


class ResidualTerms(StrEnum):
    """Terms that stand for the modes outside the band."""

    complex = "complex"
    real = "real"
    none = "none"


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
        Method | None, typer.Option(help="Estimator of the poles; chosen automatically if not given.")
    ] = None,
    order: Annotated[int | None, typer.Option(help="Largest model order; chosen automatically if not given.")] = None,
    refine: Annotated[
        bool,
        typer.Option(
            "--refine/--no-refine", help="Refine the modes by maximum likelihood, which gives standard deviations."
        ),
    ] = True,
    run: Annotated[
        int | None, typer.Option(metavar="K", help="Run to fit, counted from 1; the first if not given.")
    ] = None,
    pick: Annotated[
        list[float] | None,
        typer.Option("--pick", metavar="HZ", help="Fit only the mode nearest to this frequency; repeat for several."),
    ] = None,
    drop: Annotated[
        list[float] | None,
        typer.Option("--drop", metavar="HZ", help="Leave out the mode nearest to this frequency; repeat for several."),
    ] = None,
    add: Annotated[
        list[float] | None,
        typer.Option("--add", metavar="HZ", help="Add a mode at this frequency; repeat for several."),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="NAME", help="Leave out this output or input; repeat for several."),
    ] = None,
    real_modes: Annotated[
        bool, typer.Option("--real-modes", help="Fit real (normal) mode shapes instead of complex ones.")
    ] = False,
    residuals: Annotated[
        ResidualTerms, typer.Option("--residuals", help="Residual terms for the modes outside the band.")
    ] = ResidualTerms.complex,
    json: JsonOption = None,
    report: ReportOption = None,
    out: PicturesOption = None,
    modes: Annotated[
        Path | None, typer.Option("--modes", metavar="FILE", help="Write the modes to .csv, .uff (55) or .npz.")
    ] = None,
    geometry: Annotated[
        Path | None, typer.Option("--geometry", metavar="FILE", help="Coordinates of the nodes: UFF, CSV or STL.")
    ] = None,
    form: FormOption = None,
    unit: UnitOption = None,
    frequency_unit: FrequencyUnitOption = None,
    outputs: OutputsOption = None,
    inputs: InputsOption = None,
    axes: AxesOption = None,
    complete: CompleteOption = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Identify the modes of measured FRFs: frequency, damping and shape, with standard deviations."""
    check_free(json, report, modes, overwrite=overwrite, inputs=[data, geometry])
    require_report(report)
    check_folder(out, overwrite, inputs=[data, geometry])
    check_readable(data)
    start()
    if modes is not None:
        check_modes(modes)
    measured = read_measurement(data, **told(form, unit, frequency_unit, outputs, inputs, axes, complete))
    places = None if geometry is None else read_geometry(geometry)
    frf = one_run(measured, run, data)
    from rich.console import Console

    from modalax.cli.tables import mode_table, print_remarks, print_uncut
    from modalax.identify import fit as identify

    name = None if method is None else method.value
    with naming(data), working("Identifying the modes (slower the first time, when programs are compiled)") as progress:
        result = identify(
            frf, name, order, refine, band, residuals=residuals.value, real_modes=real_modes, pick=pick or None,
            drop=drop, add=add, without=without or None, progress=progress,
        )  # fmt: skip
    answer = result.to_dict()
    console = Console()
    print_uncut(console, mode_table(answer["modes"]))
    print_remarks(console, answer)
    if not refine:
        note(
            "not refined, so there are no standard deviations; the scatter over the model orders shows how far a "
            "damping ratio can be trusted"
        )
    if result.refined is not None and not bool(result.refined.success):
        note(f"the refinement did not converge: {result.refined.reason}")
    places = nodes_beside(data) if places is None and (report or out or modes) else places
    if modes is not None:
        write_modes(result, modes, places, overwrite)
    write_outputs(result, answer, json, report, out, f"Modes of {data.name}", places)


def check_modes(path: Path) -> None:
    """Refuse a file for the modes if its ending is not known."""
    from modalax.files.modes import check_modes_file

    check_modes_file(path)


def read_geometry(path: Path) -> Any:
    """Coordinates of the nodes; a note says how the corners of an STL file, which have no names, are numbered."""
    from modalax.files import load_geometry

    if path.suffix.lower() == ".stl":
        note(f"{path}: its corners are taken to be in metres, and are numbered 1, 2, ... in the order of the file")
    return load_geometry(path)


def write_modes(result: Any, path: Path, geometry: Any, overwrite: bool) -> None:
    """Write the modes inside the band to a file."""
    import numpy as np

    from modalax._numerics.cuts import cut
    from modalax.files import save_modes

    inside, model, refined = np.asarray(result.inside), result.model, result.refined
    kept = model.replace(
        **{name: cut(getattr(model, name), inside) for name in (
            "poles", "shapes", "participation", "frequency_std", "damping_std")},
    )  # fmt: skip
    std = (None, None) if refined is None else (cut(refined.frequency_std_hz, inside), cut(refined.damping_std, inside))
    save_modes(kept, path, frequency_std_hz=std[0], damping_std=std[1], geometry=geometry, overwrite=overwrite)
    note(f"modes: {path}")


def one_run(measurement: Any, run: int | None, path: Path) -> Any:
    """Pick the run to fit; where none is asked for, the first, and a note says so if there are several.

    Raises
    ------
    ValueError
        If there is no such run.
    """
    if run is not None and not 1 <= run <= measurement.runs:
        raise ValueError(f"{path}: there is no run {run}; the runs are 1 to {measurement.runs}")
    if run is None and measurement.runs > 1:
        note(f"{path} holds {measurement.runs} runs; fitting run 1, choose another with --run")
    return measurement.run(0 if run is None else run - 1)


def nodes_beside(path: Path) -> Any:
    """The geometry (nodes and lines) that a universal file holds beside its FRFs, or that of a published measurement.

    None where there is none.
    """
    from modalax.data.datasets import known_geometry
    from modalax.files import load_geometry
    from modalax.files.sniff import sniff

    if sniff(path) != "uff":
        return known_geometry(path)
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
    """Write the JSON file, the report and the pictures of a fit, those that were asked for."""
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
