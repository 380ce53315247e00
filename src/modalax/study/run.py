"""A study from its settings to its results."""

import importlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.write import write_text
from modalax.study import engine
from modalax.study.overview import of_summary
from modalax.study.settings import checked, read_settings
from modalax.study.statistics import summary
from modalax.study.store import Store, digest
from modalax.study.work import Row, Work

MODULES = {
    "noise": "modalax.study.noise", "bootstrap": "modalax.study.bootstrap", "parameter": "modalax.study.parameter",
    "diagnosis": "modalax.study.power", "function": "modalax.study.function",
}  # fmt: skip
PART = 0.05  # part of the draws after which progress is told again


@dataclass(frozen=True)
class Results:
    """What a study found.

    Attributes
    ----------
    folder
        Where the rows lie, a file for each chunk under ``rows``.
    file
        File of all rows, Parquet or NumPy.
    columns
        All rows by column: ``item`` (number of the draw), the values, ``failed``, ``reason``.
    summary
        Statistics, as of :func:`modalax.study.statistics.summary`.
    """

    folder: Path
    file: Path
    columns: dict[str, np.ndarray]
    summary: dict[str, Any]

    def __str__(self) -> str:
        """The statistics, as ``modalax study`` prints them, and where all rows are."""
        return f"{of_summary(self.summary)}\nall rows: {self.file}"


def study(
    settings: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str] | None = None,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Results:
    """Run a study, or go on with one that was stopped; what is done already is not done again.

    Rows depend on the settings, the seed and the number of the draw alone: not on the number of workers, their order,
    or how often the study was stopped. On processors of another make the last digits may differ.

    Parameters
    ----------
    settings
        A TOML file, or its content as a dictionary; ``modalax study --example KIND`` prints one of each kind. For the
        kind ``function`` the function may also be given as itself.
    out
        Folder of the results; the name of the file with ``-results`` in place of its ending if None.
    scheduler
        Address of a Dask scheduler. Its workers need modalax installed; files and functions travel with the work.
    workers
        Processes on this machine, as many as it has cores if None; 0 computes in this process. A script that uses them
        needs ``if __name__ == "__main__":`` around what it runs.
    progress
        Called with how far the study is, in words.

    Returns
    -------
    Results
        All rows, and the statistics over them.

    Raises
    ------
    ValueError
        If a setting is unknown, missing or impossible; if ``out`` holds another study or is worked on by another
        process; or if the scheduler cannot be reached.
    FileNotFoundError
        If a file of the settings does not exist.
    """
    tell = progress or (lambda text: None)
    given, path = (checked(settings), None) if isinstance(settings, Mapping) else _of_file(Path(settings))
    if out is None and path is None:
        raise ValueError("a study that is not read from a file needs out, a folder for its results")
    folder = Path(out) if out is not None else path.with_name(f"{path.stem}-results")
    home = Path.cwd() if path is None else path.parent
    store = Store(folder)
    store.check_own()
    tell("preparing")
    with _naming(path):
        inputs = inputs_of(given, home)
        work = prepared(given, home)
    with store.locked():
        for remark in store.open(_plain(given), inputs, work.chunk, work.count):
            tell(f"note: {remark}")
        todo = store.missing(work.chunks)
        if todo:
            compute(work, todo, store, scheduler, workers, tell, _own_modules(given))
        columns = store.read(work.chunks)
        found = summary(columns, work)
        import json

        file = store.finish(columns)
        write_text(folder / "summary.json", json.dumps(found, indent=1) + "\n")
    return Results(folder, file, columns, found)


@contextmanager
def _naming(path: Path | None) -> Iterator[None]:
    """Put the name of the study's file, where there is one, before the messages of what its settings lead to."""
    try:
        yield
    except (ValueError, FileNotFoundError) as error:
        named_by_system = isinstance(error, OSError) and error.errno is not None
        if path is None or named_by_system or str(error).startswith(str(path)):
            raise
        kind = FileNotFoundError if isinstance(error, OSError) else ValueError
        raise kind(f"{path}: {error}") from error


def _of_file(path: Path) -> tuple[dict[str, Any], Path]:
    return read_settings(path), path


def prepared(settings: Mapping[str, Any], home: Path) -> Work:
    """The work of a study: everything that its draws have in common, computed once.

    Raises
    ------
    ValueError
        If double precision is needed and off, or the settings are impossible.
    """
    if settings["kind"] != "function":
        from modalax._numerics.checks import require_double

        require_double("study")
    return importlib.import_module(MODULES[settings["kind"]]).prepare(dict(settings), home)


def inputs_of(settings: Mapping[str, Any], home: Path) -> dict[str, str]:
    """Digests of the files that the rows depend on.

    Raises
    ------
    FileNotFoundError
        If one does not exist.
    """
    found = {}
    for table, key in (("system", "simulation"), ("data", "file")):
        name = settings.get(table, {}).get(key)
        path = home / (name or "")
        if name and path.exists():
            found[name] = digest(path)
        elif name and name != "five_dof":
            raise FileNotFoundError(f"[{table}] {key}: {path}: no such file")
    function = settings.get("function")
    if function is not None:
        module = sys.modules.get(getattr(function, "__module__", ""), None) if callable(function) else None
        place = getattr(module, "__file__", None) if module else home / f"{str(function).partition(':')[0]}.py"
        if place is not None and Path(place).is_file():
            found[Path(place).name] = digest(Path(place))
    return found


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as plain data: a function by its name."""
    found = dict(settings)
    if callable(found.get("function")):
        found["function"] = f"{found['function'].__module__}:{getattr(found['function'], '__qualname__', '')}"
    return found


def _own_modules(settings: Mapping[str, Any]) -> list[Any]:
    """The module of the user's function, which the workers may not have."""
    function = settings.get("function")
    if function is None:
        return []
    name = function.__module__ if callable(function) else str(function).partition(":")[0]
    return [sys.modules[name]] if name in sys.modules and name != "__main__" else []


def compute(
    work: Work, todo: Sequence[int], store: Store, scheduler: str | None, workers: int | None,
    tell: Callable[[str], None], modules: Sequence[Any],
) -> None:  # fmt: skip
    """Compute the chunks that are missing, and store each as it comes.

    Raises
    ------
    ValueError
        If a scheduler is asked for and Dask is not installed, or the scheduler fails.
    """
    if scheduler is not None and not engine.has_dask():
        raise ValueError("--scheduler needs Dask distributed; install it: pip install 'modalax[study]'")
    count = min(len(todo), workers if workers is not None else os.cpu_count() or 1)
    before = work.count - sum(len(work.items(k)) for k in todo)
    if before:
        tell(f"{before} of {work.count} draws were done before")
    said = Progress(work.count, before, tell)

    def stored(k: int, rows: Sequence[Row]) -> None:
        store.put(k, rows)
        said.add(rows)

    if scheduler is not None or (count > 1 and engine.has_dask()):
        tell(f"on the scheduler {scheduler}" if scheduler else f"on {count} processes of this machine")
        engine.on_dask(work, todo, stored, scheduler, count, modules)
        return
    if count > 1:
        tell("Dask distributed is not installed, so this process does it alone; pip install 'modalax[study]'")
    engine.here(work, todo, stored)


class Progress:
    """How far a study is, told after every twentieth part, or every ten seconds."""

    def __init__(self, count: int, before: int, tell: Callable[[str], None]):
        self.count, self.done, self.failed, self.new = count, before, 0, 0
        self.tell, self.start, self.told = tell, time.monotonic(), (before, time.monotonic())

    def add(self, rows: Sequence[Row]) -> None:
        """Count the rows of a chunk."""
        self.done += len(rows)
        self.new += len(rows)
        self.failed += sum(bool(row["failed"]) for row in rows)
        now = time.monotonic()
        if self.done < self.count and self.done - self.told[0] < PART * self.count and now - self.told[1] < 10:
            return
        self.told = (self.done, now)
        left = (now - self.start) / self.new * (self.count - self.done)
        failed = f", {self.failed} failed" if self.failed else ""
        self.tell(f"{self.done} of {self.count} draws{failed}" + (f", about {left:.0f} s left" if left >= 1 else ""))
