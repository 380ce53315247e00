"""What the benchmarks share: environments of other packages, processes of their own, and tables."""

import csv
import json
import os
import platform
import re
import subprocess
import tempfile
import venv
from collections.abc import Sequence
from pathlib import Path

THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
SDYPY = "sdypy-EMA==0.31.0"


def python_of(name: str, packages: Sequence[str]) -> Path:
    """The interpreter of a virtual environment with some packages, made once and kept in the temporary folder."""
    home = Path(tempfile.gettempdir()) / f"modalax-benchmark-{name}"
    python, done = home / "bin" / "python", home / "installed"
    if not done.exists():
        venv.create(home, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", *packages], check=True)
        done.touch()
    return python


def one_core() -> None:
    """Keep this process and what it starts on one core, whatever pools the libraries keep."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def call(command: Sequence[object], limit: float | None = None) -> dict:
    """Run a process with nothing compiled before, and read the last line of its output as JSON.

    Raises
    ------
    RuntimeError
        With the last line of its errors, if it fails.
    """
    kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    done = subprocess.run(
        [str(c) for c in command], env={**kept, **THREADS}, capture_output=True, text=True, timeout=limit, check=False
    )
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return json.loads(done.stdout.strip().splitlines()[-1])


def peak() -> float:
    """Largest memory of this process so far [MB], which Linux counts from its own start, not from its parent's."""
    found = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    return int(found[1]) / 1024 if found else float("nan")


def forget_peak() -> None:
    """Let :func:`peak` count from the memory that this process holds now."""
    Path("/proc/self/clear_refs").write_text("5")


def machine() -> str:
    """Processor, cores, load and versions, for the head of a table."""
    from importlib.metadata import version

    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = re.search(r"model name\s*:\s*(.+)", text)
    versions = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "scipy"))
    return (
        f"{model[1] if model else platform.processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; "
        f"Python {platform.python_version()}, {versions}"
    )


class Table:
    """Rows printed as Markdown as they come, and kept in a CSV file where one is asked for."""

    def __init__(self, head: Sequence[str], path: str | None = None):
        self.path, self.rows = path, [list(head)]
        print("| " + " | ".join(head) + " |\n" + "| --- " * len(head) + "|", flush=True)

    def add(self, *cells: object) -> None:
        """One more row."""
        self.rows.append([str(c) for c in cells])
        print("| " + " | ".join(self.rows[-1]) + " |", flush=True)
        if self.path:
            with open(self.path, "w", newline="", encoding="utf-8") as f:
                csv.writer(f).writerows(self.rows)
