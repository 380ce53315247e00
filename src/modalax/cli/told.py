"""Options that say what a plain file of FRFs does not: form, units, names, axes; or that a file is incomplete."""

from typing import Annotated, Any

import typer

FormOption = Annotated[
    str | None,
    typer.Option(
        "--form",
        metavar="FORM",
        help="Form of the FRFs if the file has none (or a universal file a wrong one): receptance, mobility or "
        "accelerance.",
    ),
]
UnitOption = Annotated[
    str | None, typer.Option("--unit", metavar="UNIT", help="Unit of the FRFs if the file has none, such as g/N.")
]
FrequencyUnitOption = Annotated[
    str | None,
    typer.Option(
        "--frequency-unit", metavar="UNIT", help="Unit of the frequencies if the file has none: Hz, kHz, rad/s, rpm."
    ),
]
OutputsOption = Annotated[
    str | None, typer.Option("--outputs", metavar="NAMES", help="Names of the outputs in order, such as 1:+Z,2:+Z.")
]
InputsOption = Annotated[str | None, typer.Option("--inputs", metavar="NAMES", help="Names of the inputs in order.")]
AxesOption = Annotated[
    str | None,
    typer.Option("--axes", help="Order of the axes of a plain FRF array (run, f, o, i): 'f o i', 'f o', ..."),
]

CompleteOption = Annotated[
    bool,
    typer.Option("--complete", help="Leave out the channels of which a universal file lacks some FRFs, and list them."),
]


def told(
    form: str | None,
    unit: str | None,
    frequency_unit: str | None,
    outputs: str | None,
    inputs: str | None,
    axes: str | None,
    complete: bool,
) -> dict[str, Any]:
    """Collect the options that were given, as keywords of :func:`modalax.load`."""
    given = {
        "form": form, "unit": unit, "frequency_unit": frequency_unit, "outputs": names(outputs),
        "inputs": names(inputs), "axes": axes, "complete": complete or None,
    }  # fmt: skip
    return {name: value for name, value in given.items() if value is not None}


def names(text: str | None) -> list[str] | None:
    """Split a list of names at its commas; None where there is no list."""
    return None if text is None else [name.strip() for name in text.split(",")]
