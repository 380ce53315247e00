"""``modalax import-fe``: make a simulation from the files of a finite-element program."""

from pathlib import Path
from typing import Annotated

import typer

from modalax.cli.common import OverwriteOption, check_ending, check_free, note, start


def import_fe(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Nastran punch (DMIG, eigenvectors), Ansys .full, or a stiffness matrix (Abaqus, Matrix Market, "
            "Harwell-Boeing).",
        ),
    ],
    target: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="Simulation to write (.npz or .mat).")],
    mass: Annotated[Path | None, typer.Option("--mass", help="Mass matrix, if it has a file of its own.")] = None,
    damping_matrix: Annotated[Path | None, typer.Option("--damping-matrix", help="Viscous damping matrix.")] = None,
    grids: Annotated[
        Path | None,
        typer.Option("--grids", help="Nastran deck with grid points and local axes, to check rigid-body modes."),
    ] = None,
    units: Annotated[
        str,
        typer.Option(
            "--units", help="Units of the model, length-force: m-N, mm-N, in-lbf, ft-lbf, mm-kgf, ...; time in seconds."
        ),
    ] = "m-N",
    damping: Annotated[
        float | None,
        typer.Option("--damping", help="Damping ratio of all modes as a fraction, such as 0.01; 0 if not given."),
    ] = None,
    up_to: Annotated[
        float | None,
        typer.Option(
            "--up-to",
            metavar="HZ",
            help="Highest frequency of interest; the condensed model is accurate up to it.",
            show_default=False,
        ),
    ] = None,
    keep: Annotated[
        str, typer.Option("--keep", metavar="DOF,...", help="DoFs to keep, such as '101:+Z' or '*:+Z'.")
    ] = "",
    matrices: Annotated[
        tuple[str, str] | None,
        typer.Option("--matrices", metavar="K M", help="Names of the stiffness and mass matrices in the file."),
    ] = None,
    groups: Annotated[
        bool,
        typer.Option("--groups", help="Make groups of the elements of each property and material in the deck."),
    ] = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Read matrices or modes of a finite-element model and write them as a simulation."""
    check_free(target, overwrite=overwrite, inputs=[source, mass, damping_matrix, grids])
    check_ending(target, (".npz", ".mat"), "a simulation")
    for path in (source, mass, damping_matrix, grids):
        if path is not None and not path.is_file():
            raise FileNotFoundError(f"{path}: no such file")
    start()
    from modalax.files import save
    from modalax.files.finite_elements import import_finite_elements
    from modalax.files.messages import about

    with about(source):
        found = import_finite_elements(
            source, mass=mass, damping=damping_matrix, grids=grids, units=units, damping_ratio=damping, up_to_hz=up_to,
            keep=[name.strip() for name in keep.split(",") if name.strip()], matrices=matrices, groups=groups,
        )  # fmt: skip
    for sentence in found.notes:
        note(sentence)
    save(found.simulation, target, overwrite=overwrite)
    note(f"{target} written")
