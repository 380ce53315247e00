"""The ``modalax`` command, which turns arguments into calls of the package; slow imports wait until a command runs."""

import sys
import warnings
from collections.abc import Sequence
from typing import Any

import typer

from modalax import __version__
from modalax.cli.cache import cache
from modalax.cli.check import check
from modalax.cli.convert import convert
from modalax.cli.demo import demo
from modalax.cli.diagnose import causes, diagnose
from modalax.cli.fit import fit
from modalax.cli.frf import frf
from modalax.cli.import_fe import import_fe
from modalax.cli.simulate import simulate
from modalax.cli.study import HELP as STUDY_HELP
from modalax.cli.study import study
from modalax.cli.view import view

# The base class of typer's usage errors; its module differs from version to version of typer.
USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
UNUSABLE = 2  # exit status where the input cannot be used
HELP = (
    "Experimental modal analysis: FRFs from time records, modes with standard deviations, predictions with non-linear "
    "joints, and what a simulation gets wrong."
)

app = typer.Typer(
    name="modalax",
    help=HELP,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def show_version(wanted: bool) -> bool:
    """Print the version and stop if the option was given."""
    if wanted:
        typer.echo(f"modalax {__version__}")
        raise typer.Exit
    return wanted


@app.callback(help=HELP)
def options(
    debug: bool = typer.Option(False, "--debug", help="Show the whole traceback of an error."),
    version: bool = typer.Option(
        False, "--version", help="Show the version and stop.", is_eager=True, callback=show_version
    ),
) -> None:
    """Options that come before the name of a command."""


for command in (demo, frf, check, fit, view, simulate, diagnose, causes, convert, import_fe, cache):
    app.command()(command)
app.command(help=STUDY_HELP)(study)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    The status is 0 where the command is done, 2 where its input cannot be used (one line on stderr says why), and 130
    where the user stopped it.
    """
    arguments = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    # The option may stand anywhere, so that a user can append it to a line that has just failed.
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default", UserWarning)
            # JAX reads a program that a killed process left half written, or another is writing: it compiles it again.
            warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")
            warnings.showwarning = show_note
            return typer.main.get_command(app).main(arguments, prog_name="modalax", standalone_mode=False) or 0
    except (ValueError, OSError, ImportError, USAGE_ERROR) as error:
        if debug:
            raise
        print(f"modalax: {one_line(error)}", file=sys.stderr)
        return UNUSABLE
    except (KeyboardInterrupt, typer.Abort):
        print("modalax: stopped", file=sys.stderr)
        return 130


def show_note(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning about the data in one line; warnings that are meant for programmers are left out."""
    if issubclass(category, UserWarning):
        print(f"note: {' '.join(str(message).split())}", file=sys.stderr)


def one_line(error: BaseException) -> str:
    """One line that says what was wrong with which file."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror}"
    elif isinstance(error, USAGE_ERROR):
        text = f"{error.format_message()} (modalax --help lists the commands and options)"
    else:
        text = str(error) or type(error).__name__
    return " ".join(text.split())
