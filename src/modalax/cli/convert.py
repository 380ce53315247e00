"""``modalax convert``: rewrite FRFs or a model in another file format."""

from pathlib import Path
from typing import Annotated

import typer

from modalax.cli.common import OverwriteOption, check_free, check_readable, note, start
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


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="File to read; its format is detected.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; its ending gives the format.")],
    form: FormOption = None,
    unit: UnitOption = None,
    frequency_unit: FrequencyUnitOption = None,
    outputs: OutputsOption = None,
    inputs: InputsOption = None,
    axes: AxesOption = None,
    complete: CompleteOption = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Read FRFs or a model from a file and write them in another format."""
    check_free(target, overwrite=overwrite, inputs=[source], data=True)
    check_readable(source)
    start()
    from modalax.files import load, save

    save(load(source, **told(form, unit, frequency_unit, outputs, inputs, axes, complete)), target, overwrite=overwrite)
    note(f"{target} written")
