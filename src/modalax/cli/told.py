"""Options by which a user tells what a plain file of FRFs does not say itself."""

from typing import Annotated, Any

import typer

FormOption = Annotated[
    str | None,
    typer.Option("--form", metavar="FORM", help="Form of FRFs whose file does not tell it (receptance, ...)."),
]
UnitOption = Annotated[str | None, typer.Option("--unit", help="Unit of FRFs whose file does not tell it: g/N, mm/N.")]
FrequencyUnitOption = Annotated[
    str | None, typer.Option("--frequency-unit", metavar="UNIT", help="Unit of its frequencies: Hz, kHz, rad/s.")
]
OutputsOption = Annotated[
    str | None, typer.Option("--outputs", metavar="NAMES", help="Names of its outputs: 1:+Z,2:+Z,...")
]
InputsOption = Annotated[str | None, typer.Option("--inputs", metavar="NAMES", help="Names of its inputs.")]
AxesOption = Annotated[
    str | None, typer.Option("--axes", help="Order of the axes of its H out of run, f, o, i: 'f o i', 'f o'.")
]


def told(
    form: str | None,
    unit: str | None,
    frequency_unit: str | None,
    outputs: str | None,
    inputs: str | None,
    axes: str | None,
) -> dict[str, Any]:
    """Options of :func:`modalax.load` that were given."""
    given = {
        "form": form, "unit": unit, "frequency_unit": frequency_unit, "outputs": names(outputs),
        "inputs": names(inputs), "axes": axes,
    }  # fmt: skip
    return {name: value for name, value in given.items() if value is not None}


def names(text: str | None) -> list[str] | None:
    """Names out of a list with commas; None where there is none."""
    return None if text is None else [name.strip() for name in text.split(",")]
