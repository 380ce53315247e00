"""Writers under faults: a full disk, a read-only folder, processes killed at random times.

Every kind of file that the package writes is replaced by another version while the fault strikes. What stands under
the name afterwards must be one of the two versions, whole, and a further write must leave no temporary folder behind.

usage: python experiments/files/faults.py [--kills 100] [--seed 0] [KIND ...]
"""

import argparse
import contextlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np

# Nothing in this process itself may compute with JAX or open a Zarr store: it forks, and both start threads.
import modalax.files
import modalax.files.labelled  # noqa: F401
import modalax.files.mat  # noqa: F401
import modalax.files.uff  # noqa: F401
from modalax.cli.common import write_json
from modalax.data import Measurement
from modalax.files.modes import save_modes
from modalax.files.write import write_text

jax.config.update("jax_enable_x64", True)
LINES, OUTPUTS = 400, 3
FORMATS = ("npz", "uff", "mat", "nc", "zarr")
KINDS = (*FORMATS, "json", "html", "csv", "png", "gif")
SECONDS = 60  # after which a process is taken to hang


def measurement(version: int) -> Measurement:
    """FRFs that say which version they are of: their level is 1 or 2 N."""
    rng = np.random.default_rng(version)
    freq = np.linspace(1.0, 100.0, LINES)
    H = (1 + rng.normal(size=(1, LINES, OUTPUTS, 1))) / (400 - freq[None, :, None, None] ** 2 + 4j * freq[0])
    return Measurement(freq, H, level=[version + 1.0], outputs=["1", "2", "3"], inputs=["1"])


def writer(kind: str, version: int) -> Callable[[Path], None]:
    """Make all that one version of a file holds; what is given writes it."""
    if kind in FORMATS:
        data = measurement(version)
        return lambda path: modalax.files.save(data, path, overwrite=True)
    if kind == "json":
        value = {"version": version, "values": list(range(20000))}
        return lambda path: write_json(path, value)
    if kind == "html":
        text = f"<html><!-- {version} -->{'<p>' * 100000}</html>"
        return lambda path: write_text(path, text)
    if kind == "csv":
        modes = _Modes(version)
        return lambda path: save_modes(modes, path, overwrite=True)  # pyright: ignore
    if kind == "gif":
        from modalax.show.shapes import animate_shape

        places = _Places(version)
        return lambda path: animate_shape(places, ["1:+Z", "2:+Z"], [1.0, -1.0], path, frames=2 + version)  # pyright: ignore
    from matplotlib.figure import Figure

    from modalax.show.fit import save_pictures

    figure = Figure(figsize=(3, 3), dpi=100 * (1 + version))
    figure.add_subplot().plot(np.random.default_rng(0).normal(size=300))
    return lambda path: save_pictures({path.stem: figure}, path.parent)  # pyright: ignore


class _Modes:
    """Modes with what is written of them, without JAX."""

    def __init__(self, version: int):
        count = 200
        self.outputs, self.inputs = [str(k) for k in range(60)], ["1"]
        self.poles = self.damping_ratio = np.full(count, 0.01)
        self.frequency_hz = np.arange(count) + 1.0 + version
        self.shapes = np.ones((count, 60)) + 0.5j

    def normalised(self) -> "_Modes":
        return self


class _Places:
    """Two nodes and the line between them, without JAX."""

    def __init__(self, version: int):
        self.nodes, self.lines = ("1", "2"), (("1", "2"),)
        self.xyz = np.array([[0.0, 0.0, 0.0], [1.0 + version, 0.0, 0.0]])
        self.segments = np.array([[0, 1]])

    def displacements(self, dofs: list[str], values: object) -> tuple[np.ndarray, np.ndarray]:
        motion = np.zeros((2, 3), complex)
        motion[:, 2] = np.asarray(values)
        return motion, np.ones((2, 3), bool)


def version_of(path: Path) -> int:
    """Which version a file is of, after all of it was read."""
    kind = path.suffix[1:]
    if kind in FORMATS:
        found = modalax.files.load(path, conjugate=False)
        version = int(found.level[0]) - 1
        np.testing.assert_allclose(found.H, measurement(version).H, rtol=1e-12)
        return version
    if kind == "json":
        value = json.loads(path.read_text())
        assert value["values"] == list(range(20000))
        return value["version"]
    if kind == "html":
        text = path.read_text()
        assert text.endswith("</html>")
        return int(text[11])
    if kind == "csv":
        rows = path.read_text().splitlines()
        assert len(rows) == 201 and all(row.count(",") == 124 for row in rows)
        return int(float(rows[1].split(",")[1])) - 1
    from PIL import Image

    with Image.open(path) as picture:
        if kind == "gif":
            frames = picture.n_frames
            picture.seek(frames - 1)
            return frames - 2
        picture.load()
        return int(picture.width > 450)  # 3 inches of 100 or 200 dots


def forked(work: Callable[[], object]) -> str:
    """Do something in a process of its own and say how it ended: nothing if well, else the error or the signal."""
    read, write = os.pipe()
    child = _fork()
    if child == 0:
        signal.alarm(SECONDS)
        text = ""
        try:
            work()
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(write, text.encode()[:4000])
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    status = os.waitpid(child, 0)[1]
    return f"ended by signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else text


def _fork() -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return os.fork()


def killed(kind: str, folder: Path, delay: float) -> bool:
    """Kill a process that replaces a file over and over; say whether that was in the middle of it."""
    read, write = os.pipe()
    child = _fork()
    if child == 0:
        signal.alarm(SECONDS)
        path, writers = folder / f"data.{kind}", [writer(kind, version) for version in (0, 1)]
        writers[0](path)
        os.write(write, b"x")
        while True:
            for version in (1, 0):
                writers[version](path)
    os.read(read, 1)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(read)
    os.close(write)
    return len(os.listdir(folder)) > 1


def whole_after(kind: str, folders: list[Path]) -> None:
    """Check every file that a killed process left, and that the next write cleans up."""
    last = writer(kind, 1)
    for folder in folders:
        path = folder / f"data.{kind}"
        assert version_of(path) in (0, 1)
        last(path)
        assert version_of(path) == 1
        assert os.listdir(folder) == [path.name], os.listdir(folder)


def kills(kind: str, count: int, rng: random.Random, root: Path) -> str:
    """Kill writers of one kind at random times; say how many left a whole file."""
    folders, inside = [], 0
    for k in range(count):
        folders.append(root / f"{kind}{k}")
        folders[-1].mkdir()
        inside += killed(kind, folders[-1], rng.uniform(0.0, 0.08))
    problem = forked(lambda: whole_after(kind, folders))
    return f"{kind}: killed {count} times, {inside} of them while writing; " + (
        f"FAILED: {problem}" if problem else f"{count} of {count} whole"
    )


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """A disk of its own in memory, if this user may make one.

    Raises
    ------
    PermissionError
        If not.
    """
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise PermissionError(done.stderr.strip() or "mount failed")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def replaced_in(folder: Path, kind: str, prepare: Callable[[], object]) -> None:
    """Write version 0, prepare the fault, and require that version 1 fails in one clear way and 0 stays."""
    path, new = folder / f"data.{kind}", writer(kind, 1)
    writer(kind, 0)(path)
    version_of(path)
    prepare()
    try:
        new(path)
    except OSError as error:
        assert str(path) in str(error), f"the message does not name the file: {error}"
    else:
        raise AssertionError("the fault went unnoticed")
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    left = [name for name in os.listdir(folder) if name not in (path.name, "filler")]
    assert not left, f"left behind: {left}"
    assert version_of(path) == 0


def fill(folder: Path) -> None:
    """Leave no room on the disk."""
    with contextlib.suppress(OSError), (folder / "filler").open("wb", buffering=0) as file:
        while True:
            file.write(b"x" * 4096)


def read_only(folder: Path) -> None:
    """Let nothing be written to a disk."""
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)


def limit_sizes() -> None:
    """Let no file grow beyond two kilobytes: what a full disk is where none can be made."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, resource.RLIM_INFINITY))


def faults(kind: str, root: Path) -> Iterator[str]:
    """Every fault but the kill, on one kind of file."""
    own = root / f"limit-{kind}"
    own.mkdir()
    yield _told(kind, "a limit on file sizes", forked(lambda: replaced_in(own, kind, limit_sizes)))
    for name, prepare in (("a full disk", fill), ("a read-only folder", read_only)):
        try:
            with small_disk(root / f"{prepare.__name__}-{kind}", 8192) as disk:
                end = forked(lambda d=disk, p=prepare: replaced_in(d, kind, lambda: p(d)))
                yield _told(kind, name, end)
        except PermissionError as error:
            yield f"{kind}: {name}: not tried, no disk of its own can be made here ({error})"


def _told(kind: str, fault: str, problem: str) -> str:
    return f"{kind}: {fault}: " + (f"FAILED: {problem}" if problem else "said so, old file whole, nothing left behind")


def main(argv: list[str] | None = None) -> int:
    """Run the faults that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS), metavar="KIND")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng, failed = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory() as name:
        for kind in options.kinds:
            for line in (*faults(kind, Path(name)), kills(kind, options.kills, rng, Path(name))):
                print(line, flush=True)
                failed += "FAILED" in line
    print(f"{failed} failures")
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
