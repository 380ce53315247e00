"""``modalax view``: modes picked by hand in the browser."""

from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import (
    BandOption,
    DataArgument,
    check_readable,
    note,
    read_measurement,
    require_view,
    start,
    working,
)
from modalax.cli.fit import Method, nodes_beside, one_run, read_geometry
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


def view(
    data: DataArgument,
    band: BandOption = None,
    method: Annotated[
        Method | None, typer.Option(help="Estimator of the poles; chosen automatically if not given.")
    ] = None,
    order: Annotated[int | None, typer.Option(help="Highest order of the first diagram.", show_default=False)] = None,
    run: Annotated[
        int | None, typer.Option(metavar="K", help="Run to show, counted from 1; the first if not given.")
    ] = None,
    selection: Annotated[
        Path | None,
        typer.Option("--selection", metavar="FILE", help="Start from the modes of a saved selection or of fit --json."),
    ] = None,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation", metavar="FILE", help="Matrices, modes or an earlier result to compare with: MAC and shapes."
        ),
    ] = None,
    geometry: Annotated[
        Path | None, typer.Option("--geometry", metavar="FILE", help="Coordinates of the nodes: UFF, CSV or STL.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder to save files in; the current one by default.")
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page, or only print its address.")
    ] = True,
    form: FormOption = None,
    unit: UnitOption = None,
    frequency_unit: FrequencyUnitOption = None,
    outputs: OutputsOption = None,
    inputs: InputsOption = None,
    axes: AxesOption = None,
    complete: CompleteOption = False,
) -> None:
    """Pick modes in the browser, on a page that this machine alone can open."""
    require_view()
    check_readable(data)
    folder = Path.cwd() if out is None else out
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: there is no such folder to save files in; make it first")
    start()
    from modalax.check import check
    from modalax.view import Server, Session
    from modalax.view.answers import Answers
    from modalax.view.beside import read_beside
    from modalax.view.files import read_selection

    picks, seen, highest = ([], None, None) if selection is None else read_selection(selection)
    measured = read_measurement(data, **told(form, unit, frequency_unit, outputs, inputs, axes, complete))
    one = one_run(measured, run, data)
    places = nodes_beside(data) if geometry is None else read_geometry(geometry)
    beside = None if simulation is None else read_beside(simulation)
    doing = "Drawing the stabilization diagram (slower the first time, when programs are compiled)"
    with naming(data), working(doing) as progress:
        session = Session(
            one, band=band or seen, order=order or highest, method=None if method is None else method.value,
            geometry=places, progress=progress,
        )  # fmt: skip
        if selection is not None:
            session.restore(picks)
        if beside is not None:
            beside.near(Answers(session).dofs, session.state.band)  # said before the page opens, if nothing is common
        read = [p for p in (data, selection, simulation, geometry) if p is not None]
        server = Server(
            session, name=data.name, folder=folder, inputs=read, beside=beside, findings=lambda: check(measured)
        )
    typer.echo(server.url)
    note("the page is for this machine alone; Ctrl-C here ends it")
    if browser:
        import webbrowser

        webbrowser.open(server.url)
    wait(server)


def wait(server: Any) -> None:
    """Wait until the user stops the command; then say which picks were not saved."""
    import threading

    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        note("")
    finally:
        server.close()
    picks = server.session.state.picks
    if server.unsaved and picks:
        note(f"not saved: {len(picks)} modes at {', '.join(f'{p.frequency_hz:.6g}' for p in picks)} Hz")
    note("the page is closed")
