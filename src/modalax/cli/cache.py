"""``modalax cache``: the compiled programs that are kept from run to run."""

from pathlib import Path
from typing import Annotated

import typer

from modalax.cli.common import cache_folder


def cache(
    clear: Annotated[
        bool, typer.Option("--clear", help="Remove the compiled programs; they are made anew when needed.")
    ] = False,
) -> None:
    """Show the folder that keeps compiled programs, its size and their number; a second run compiles nothing."""
    folder = cache_folder()
    files = programs(folder)
    size = sum(file.stat().st_size for file in files)
    count = sum(not file.name.endswith("-atime") for file in files)
    if clear:
        for file in files:
            file.unlink(missing_ok=True)
    verb = "removed " if clear else ""
    typer.echo(f"{folder}: {verb}{count} compiled programs, {size / 1e6:.1f} MB")


def programs(folder: Path) -> list[Path]:
    """Files that JAX keeps of compiled programs; other files in the folder are not touched."""
    endings = ("-cache", "-atime")
    return [p for p in folder.iterdir() if p.is_file() and p.name.endswith(endings)] if folder.is_dir() else []
