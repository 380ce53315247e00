"""The folder of a study: its settings, one file for each chunk of rows, and a lock.

A chunk is done when its file exists; the file takes its name only when it is complete and on disk. So a study can be
stopped in any way at any time: what is done stays, and what was under way is computed again.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from modalax.files.write import replacing, write_text
from modalax.study.work import Row

SETTINGS, ROWS, ALL, LOCK = "study.json", "rows", "results", "lock"
PACKAGES = ("modalax", "numpy", "scipy", "jax", "jaxlib")  # whose versions decide the last digits


class Store:
    """The folder of a study.

    Parameters
    ----------
    folder
        Made if it does not exist.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.kind = "parquet" if find_spec("pyarrow") else "npz"

    def open(self, settings: Mapping[str, Any], inputs: Mapping[str, str], chunk: int, count: int) -> list[str]:
        """Begin a study here, or go on with the same one.

        Parameters
        ----------
        settings
            What decides the rows, as plain data.
        inputs
            Digest of each file that they depend on.
        chunk, count
            Rows in a chunk, and in all.

        Returns
        -------
        list of str
            Remarks: packages whose versions have changed since.

        Raises
        ------
        ValueError
            If the folder holds another study, or files of another kind; the message names the first difference.
        """
        now = {
            "settings": json.loads(json.dumps(settings)), "inputs": dict(inputs), "chunk": chunk, "count": count,
            "rows": self.kind, "versions": _versions(),
        }  # fmt: skip
        path = self.folder / SETTINGS
        if not path.exists():
            self.check_own(locked=True)
            (self.folder / ROWS).mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(now, indent=1) + "\n", overwrite=False)
            return []
        old = _read(path)
        for part in ("settings", "inputs", "chunk", "count"):
            if difference := _difference(old.get(part), now[part]):
                raise ValueError(
                    f"{self.folder} holds the results of another study: {'' if part == 'settings' else part + ' '}"
                    f"{difference}. Take the change back to go on with it, or choose another folder with --out"
                )
        if old["rows"] != self.kind:
            if old["rows"] == "parquet":
                raise ValueError(
                    f"{self.folder} was begun in Parquet, which needs pyarrow: pip install 'modalax[study]'"
                )
            self.kind = old["rows"]
        (self.folder / ROWS).mkdir(exist_ok=True)
        return [
            f"{name} is {now['versions'].get(name)}, the study was begun with {was}; the last digits may differ"
            for name, was in old["versions"].items()
            if now["versions"].get(name) != was
        ]

    def check_own(self, locked: bool = False) -> None:
        """Refuse a folder that holds other files, and no study, before anything is put there.

        Where a lock lies in it that is not our own (``locked``), another process may be about to begin the study.

        Raises
        ------
        ValueError
            Naming the folder.
        """
        if (self.folder / SETTINGS).exists() or not self.folder.is_dir():
            return
        there = set(os.listdir(self.folder))
        if there - {LOCK} and (locked or LOCK not in there):
            raise ValueError(f"{self.folder} holds other files, and no study; choose another folder with --out")

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from working on the same folder; a process that is killed lets go.

        Raises
        ------
        ValueError
            If another process is at work on it.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            import fcntl
        except ImportError:  # no such locks on Windows
            yield
            return
        with (self.folder / LOCK).open("w") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise ValueError(f"{self.folder}: another process is at work on this study") from error
            yield

    def file(self, k: int) -> Path:
        """File of chunk ``k``."""
        return self.folder / ROWS / f"{k:06d}.{self.kind}"

    def missing(self, chunks: int) -> list[int]:
        """Chunks that are not done yet."""
        there = set(os.listdir(self.folder / ROWS))
        return [k for k in range(chunks) if self.file(k).name not in there]

    def put(self, k: int, rows: Sequence[Row]) -> None:
        """Store chunk ``k``."""
        write_rows(self.file(k), columns_of(rows))

    def read(self, chunks: int) -> dict[str, np.ndarray]:
        """All rows of the chunks that are done, by column."""
        done = set(range(chunks)) - set(self.missing(chunks))
        return joined([read_rows(self.file(k)) for k in sorted(done)])

    def finish(self, columns: Mapping[str, np.ndarray]) -> Path:
        """Write all rows into one file beside those of the chunks."""
        path = self.folder / f"{ALL}.{self.kind}"
        write_rows(path, columns)
        return path


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return found if {"settings", "versions", "rows"} <= set(found) else {}["settings"]
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path} is damaged: it does not tell which study the folder holds") from error


def _difference(old: Any, new: Any, name: str = "") -> str:
    """The first difference of two settings in words; empty if there is none."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*new, *(k for k in old if k not in new)]:
            if found := _difference(old.get(key), new.get(key), f"{name}.{key}" if name else str(key)):
                return found
        return ""
    return "" if old == new else f"{name} was {json.dumps(old)} and is now {json.dumps(new)}"


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def digest(path: Path) -> str:
    """Digest of a file, or of all files of a folder."""
    total = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            total.update(hashlib.file_digest(stream, "sha256").digest())
    return total.hexdigest()


def columns_of(rows: Sequence[Row]) -> dict[str, np.ndarray]:
    """Rows as columns; numbers that a row lacks are NaN, texts empty."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: Sequence[Any]) -> np.ndarray:
    if any(isinstance(v, str) for v in values):
        return np.array(["" if v is None else str(v) for v in values], dtype=np.str_)
    if any(v is None for v in values):
        return np.array([np.nan if v is None else float(v) for v in values])
    return np.array(values)


def joined(tables: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Tables of rows put under each other."""
    names = dict.fromkeys(name for table in tables for name in table)
    found = {}
    for name in names:
        text = any(t[name].dtype.kind == "U" for t in tables if name in t)
        empty = "" if text else np.nan
        parts = [t[name] if name in t else np.full(len(t["item"]), empty) for t in tables]
        found[name] = np.concatenate([p.astype(np.str_) for p in parts] if text else parts)
    return found


def write_rows(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns to a Parquet or NumPy file, complete or not at all."""
    with replacing(path) as part:
        if path.suffix == ".npz":
            np.savez(part, **{name: np.asarray(values) for name, values in columns.items()})
            return
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.table({name: pyarrow.array(values) for name, values in columns.items()})
        pyarrow.parquet.write_table(table, part)


def read_rows(path: Path) -> dict[str, np.ndarray]:
    """The columns of such a file.

    Raises
    ------
    ValueError
        If the file is damaged.
    """
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as found:
                return {name: found[name] for name in found.files}
        import pyarrow.parquet

        table = pyarrow.parquet.read_table(path)
    except (ValueError, KeyError, EOFError, OSError) as error:
        raise ValueError(
            f"{path} is damaged: {error}; remove it and start the study again to compute it anew"
        ) from error
    return {name: _plain(table[name]) for name in table.column_names}


def _plain(column: Any) -> np.ndarray:
    values = column.to_numpy()
    return values.astype(np.str_) if values.dtype.kind == "O" else values
