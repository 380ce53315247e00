"""Code that all commands share: double precision, the compilation cache, output files and messages."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.files.json_text import json_text
from modalax.files.sniff import kind_to_write, sniff

DataArgument = Annotated[
    Path, typer.Argument(metavar="DATA", help="Measured FRFs (UFF, npz, mat, NetCDF, Zarr or CSV).")
]
BandOption = Annotated[
    tuple[float, float] | None, typer.Option("--band", metavar="LO HI", help="Frequency band [Hz].", show_default=False)
]
JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the result to this JSON file.")]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE", help="Write a report as one HTML file that opens in any browser."),
]
PicturesOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write pictures (PNG) into this folder.")
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace output files that exist already.")]


def start() -> None:
    """Set up JAX before its first use: double precision, threads, and the folder that keeps compiled programs."""
    import jax
    import threadpoolctl

    if not {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"} & set(os.environ):
        # The matrices are small, so that threads of the linear algebra library would only wait for each other.
        threadpoolctl.threadpool_limits(1, "blas")
    jax.config.update("jax_enable_x64", True)
    if "JAX_LOGGING_LEVEL" not in os.environ:
        # Otherwise each program taken from the cache logs two screens of text about processor features as an error.
        jax.config.update("jax_logging_level", "CRITICAL")
    if jax.config.jax_compilation_cache_dir is None and "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = cache_folder()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return  # Without a writable home folder every process compiles again, which costs time only.
        # By the environment too, so that the worker processes of a study share it.
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def cache_folder() -> Path:
    """Folder of the compiled programs that are kept: that of ``JAX_COMPILATION_CACHE_DIR``, or one of our own."""
    import platformdirs

    own = Path(platformdirs.user_cache_dir("modalax", appauthor=False)) / "compiled"
    return Path(os.environ.get("JAX_COMPILATION_CACHE_DIR") or own)


def check_readable(*paths: Path) -> None:
    """Refuse files that are missing, empty or of no known kind, before anything slow is imported.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a file is empty or of a kind that cannot be read.
    """
    for path in paths:
        sniff(path)


def check_free(*paths: Path | None, overwrite: bool, inputs: Sequence[Path | None] = (), data: bool = False) -> None:
    """Refuse outputs that would replace an existing file, an input or each other, before any work is done.

    With ``data``, the outputs hold FRFs or models: their endings are those that can be written, and one whose name ends
    in ``.zarr`` may replace a Zarr store.

    Raises
    ------
    ValueError
        If an output exists and ``overwrite`` is not set, is among the inputs, is asked for twice, is a folder, or has
        an ending that cannot be written.
    OSError
        If the folder of an output does not exist, or the file is read-only.
    """
    from modalax.files.write import check_target

    outputs = [p for p in paths if p is not None]
    read = [p for p in inputs if p is not None]
    for k, path in enumerate(outputs):
        _check_apart(path, read)
        twice = [other for other in outputs[:k] if _same(path, other)]
        if twice:
            raise ValueError(f"{path} is asked for twice as an output; give each output its own name")
        check_target(path, overwrite, "add --overwrite", store=data and path.suffix.lower() == ".zarr")
        if data:
            kind_to_write(path)


def check_ending(path: Path | None, endings: Sequence[str], what: str) -> None:
    """Refuse an output whose name has not one of the endings of ``what`` it is to hold.

    Raises
    ------
    ValueError
        Naming the output and the endings.
    """
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"{path}: the ending must be {' or '.join(endings)} for {what}")


def check_folder(folder: Path | None, overwrite: bool, inputs: Sequence[Path | None] = ()) -> None:
    """Refuse to write pictures into a folder that holds files already.

    Raises
    ------
    ValueError
        If the folder is not empty and ``overwrite`` is not set, or if it is a file or an input.
    """
    if folder is None or not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; --out needs a folder")
    _check_apart(folder, [p for p in inputs if p is not None])
    if any(folder.iterdir()) and not overwrite:
        raise ValueError(f"{folder} is not empty; choose another folder or add --overwrite")


def _check_apart(path: Path, inputs: Sequence[Path]) -> None:
    """Refuse an output that is an input, or that lies within an input that is a folder (a Zarr store)."""
    for read in inputs:
        if _same(path, read) or Path(os.path.realpath(read)) in Path(os.path.realpath(path)).parents:
            raise ValueError(f"{path} is read as input ({read}), so nothing is written to it; choose another name")


def _same(a: Path, b: Path) -> bool:
    """Whether two paths are of the same file: through links, another spelling, or upper and lower case."""
    if a.exists() and b.exists():
        return os.path.samefile(a, b)
    return os.path.normcase(os.path.realpath(a)) == os.path.normcase(os.path.realpath(b))


def free_folder(folder: Path) -> Path:
    """Return ``folder``, or the first of ``folder-2``, ``folder-3``, ... that does not exist."""
    choice, k = folder, 1
    while choice.exists():
        k += 1
        choice = folder.with_name(f"{folder.name}-{k}")
    return choice


def write_json(path: Path, value: Any) -> None:
    """Write a result as standard JSON, without NaN or infinity."""
    from modalax.files.write import write_text

    write_text(path, json_text(value))


def require_report(report: Path | None) -> None:
    """Refuse a report before any work is done if plotly or jinja2, which write it, are not installed.

    Raises
    ------
    ImportError
        Naming what to install.
    """
    if report is not None and not can_report():
        raise ImportError(
            f"{report} cannot be written: a report needs plotly and jinja2; install them by: "
            "pip install 'modalax[report]'"
        )


def require_view() -> None:
    """Refuse a view before any work is done if what draws it is not installed.

    Raises
    ------
    ImportError
        Naming what to install.
    """
    if not can_report():
        raise ImportError("a view needs plotly and jinja2; install them by: pip install 'modalax[view]'")


def can_report() -> bool:
    """Whether the packages that write a report are installed."""
    from importlib.util import find_spec

    return all(find_spec(name) is not None for name in ("plotly", "jinja2"))


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show progress on stderr: a spinner on a terminal, lines elsewhere.

    The context gives a function, which is called with the description of each step.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(f"{what} ...") as status:
            yield lambda step: status.update(f"{what}: {step} ...")
    else:
        console.print(f"{what} ...", highlight=False, markup=False, soft_wrap=True)
        yield lambda step: console.print(f"  {step}", highlight=False, markup=False, soft_wrap=True)


def note(text: str) -> None:
    """Print a remark on stderr, apart from the result on stdout."""
    typer.echo(text, err=True)


def read_measurement(path: Path, **told: Any) -> Any:
    """Read FRFs; the keywords say what the file itself does not (form, unit, names, ...).

    Raises
    ------
    ValueError
        If the file holds something else than measured FRFs; the message names it.
    """
    from modalax.data import Measurement
    from modalax.files import load

    found = load(path, **told)
    if not isinstance(found, Measurement):
        raise ValueError(f"{path} holds a {type(found).__name__}; measured FRFs are needed here")
    return found


def read_simulation(path: Path, extended: bool = False) -> Any:
    """Read matrices, a modal model or, if ``extended`` is set, an extended simulation.

    Raises
    ------
    ValueError
        If the file holds something else; the message names it.
    """
    from modalax.diagnose.extend import ExtendedSimulation
    from modalax.files import load
    from modalax.model import ModalModel, Structure

    found = load(path)
    if not isinstance(found, Structure | ModalModel) and not (extended and isinstance(found, ExtendedSimulation)):
        raise ValueError(
            f"{path} holds a {type(found).__name__}; a simulation (M, C, K or a modal model) is needed here"
        )
    return found
