"""Writing files safely: a name always holds a complete file, the old one until the new one is complete."""

import contextlib
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from modalax.files.sniff import is_zarr

_MARK = re.compile(r"\.modalax-(?P<host>.*)-(?P<pid>\d+)-[0-9a-f]{8}")
_ours: set[str] = set()  # folders that this process is writing to now
OLD, NAME, KEEP = "old", "name", "keep"
FORGOTTEN = 86400.0  # age [s] at which what another machine left behind is taken to be left for good


def check_target(
    path: Path, overwrite: bool, advice: str = "pass overwrite=True to replace it", store: bool = False
) -> Path:
    """The place that a file (or a Zarr ``store``) at ``path`` is written to, after links, if writing is allowed.

    A symbolic link leads to the file it points to.

    Raises
    ------
    ValueError
        If the file exists and ``overwrite`` is False, if ``path`` is a folder that is not a Zarr store, a link to a
        folder or to nothing, or something else that is no file; or a file where a store is to be, or the reverse.
    FileNotFoundError
        If there is no folder to write to.
    PermissionError
        If the file is read-only.
    """
    target = path
    if path.is_symlink():
        target = Path(os.path.realpath(path))
        if not target.is_file():
            raise ValueError(f"{path} is a symbolic link to {target}, which is no file; remove the link first")
    if os.path.lexists(target):
        _check_existing(path, target, store, overwrite, advice)
    if not target.absolute().parent.is_dir():
        raise FileNotFoundError(
            f"{path}: there is no folder {target.absolute().parent}: it does not exist, make it first"
        )
    return target


def _check_existing(path: Path, target: Path, store: bool, overwrite: bool, advice: str) -> None:
    if target.is_dir():
        if not store:
            raise ValueError(f"{path} is a folder; a file cannot take its place, choose another name")
        if not is_zarr(target, alone=True):
            raise ValueError(
                f"{path} is a folder that is not a Zarr store, or holds more than one; it is never replaced"
            )
    elif not stat.S_ISREG(target.stat().st_mode):
        raise ValueError(f"{path} is neither a file nor a folder (a device or a pipe); choose another name")
    elif store and overwrite:
        raise ValueError(f"{path} is a file, and a Zarr store is a folder; choose another name")
    if not overwrite:
        raise ValueError(f"{path} exists already; choose another name, or {advice}")
    if not os.access(target, os.W_OK):
        raise PermissionError(f"{path} is read-only; make it writable first, or choose another name")


@contextmanager
def replacing(path: Path, overwrite: bool = True, store: bool = False) -> Iterator[Path]:
    """Give a temporary place beside ``path``; what is written there takes the name once it is complete and on disk.

    A file or Zarr store of that name stays as it is until then, whatever happens: an error, a full disk, a process
    that is killed. What killed processes left behind in the folder is cleaned up first. Where the new file is whole
    but cannot take the name, it is kept, and the error says where.

    Raises
    ------
    ValueError, FileNotFoundError, PermissionError
        As :func:`check_target`.
    OSError
        Naming the file, if the disk is full or the folder cannot be written to.
    """
    target = check_target(path, overwrite, store=store)
    clean(target.absolute().parent)
    folder = target.absolute().parent / f".modalax-{_host()}-{os.getpid()}-{secrets.token_hex(4)}"
    part = folder / f"part{target.suffix.lower()}"
    _ours.add(folder.name)
    try:
        folder.mkdir()
        yield part
        _to_disk(part)
        _put(part, check_target(path, overwrite, store=store), folder)
    except OSError as error:
        if error.errno is None:
            raise
        # The message of the operating system speaks of the temporary file, or of none.
        kept = f"; the new file is whole and stands in {folder}" if (folder / KEEP).exists() else ""
        raise OSError(error.errno, f"{error.strerror} (nothing was replaced{kept})", str(path)) from error
    finally:
        if not (folder / KEEP).exists():
            _remove(folder, store)
        _ours.discard(folder.name)


def _remove(folder: Path, store: bool) -> None:
    """Remove a folder; one of a store again while threads of a writer that failed still put files into it."""
    for wait in (0.0, 0.02, 0.1, 0.5, 1.0) if store else (0.0,):
        time.sleep(wait)
        there = folder.exists()
        shutil.rmtree(folder, ignore_errors=True)
        if wait and not there:
            break


def write_bytes(path: Path, content: bytes, overwrite: bool = True) -> None:
    """Write a complete file, or leave the old one unchanged."""
    with replacing(path, overwrite) as part:
        part.write_bytes(content)


def write_text(path: Path, content: str, overwrite: bool = True) -> None:
    """Write a complete text file (UTF-8), or leave the old one unchanged."""
    write_bytes(path, content.encode("utf-8"), overwrite)


def _put(part: Path, target: Path, folder: Path) -> None:
    """Give a complete file its name."""
    try:
        if target.is_dir():
            _put_store(part, target, folder)
        else:
            if target.exists():
                shutil.copymode(target, part)
            os.replace(part, target)
    except OSError:
        with contextlib.suppress(OSError):
            (folder / KEEP).touch()
        raise
    _sync_folder(target.absolute().parent)


def _put_store(part: Path, target: Path, folder: Path) -> None:
    """Replace a folder by another: in one step where the system can, else through a temporary name."""
    whole = folder / target.name
    os.replace(part, whole)
    if _exchange(whole, target):
        return
    (folder / NAME).write_text(target.name, encoding="utf-8")  # for `clean`, if this process is killed between
    os.replace(target, folder / OLD)
    try:
        os.replace(whole, target)
    except OSError:
        os.replace(folder / OLD, target)
        raise


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two names in one step (renameat2 of Linux); False where that is not possible."""
    if not sys.platform.startswith("linux"):
        return False
    import ctypes

    here, both = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    return rename is not None and rename(here, os.fsencode(a.absolute()), here, os.fsencode(b.absolute()), both) == 0


def clean(folder: Path) -> None:
    """Remove what killed writers left in ``folder``, and put back an old store that one had moved away."""
    try:
        left = [e for e in os.scandir(folder) if _MARK.fullmatch(e.name) and e.is_dir(follow_symlinks=False)]
    except OSError:
        return
    for entry in left:
        place = Path(entry.path)
        if (place / KEEP).exists() or not _is_dead(entry):
            continue
        with contextlib.suppress(OSError):
            old, name = place / OLD, place / NAME
            if old.exists() and name.exists():
                target = folder / Path(name.read_text(encoding="utf-8")).name
                if not os.path.lexists(target):
                    os.replace(old, target)
            shutil.rmtree(place)


def _is_dead(entry: os.DirEntry[str]) -> bool:
    """Whether the process that wrote to that folder has ended."""
    mark = _MARK.fullmatch(entry.name)
    if mark is None or entry.name in _ours:
        return False
    if mark["host"] != _host() or os.name == "nt":  # on Windows asking after a process by signal 0 would end it
        return time.time() - entry.stat().st_mtime > FORGOTTEN
    pid = int(mark["pid"])
    if pid == os.getpid():
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False


def _host() -> str:
    import platform

    return re.sub(r"[^A-Za-z0-9]", "_", platform.node()) or "here"


def _to_disk(path: Path) -> None:
    """Wait until the content of a file, or of all files of a folder, is on the disk."""
    for file in [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]:
        with file.open("rb+") as stream:
            os.fsync(stream.fileno())


def _sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk, where the system can say so."""
    with contextlib.suppress(OSError, AttributeError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
