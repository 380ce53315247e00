"""Seconds until the command or the package answers: ``python experiments/benchmarks/startup.py``.

The least of several runs in processes of their own, wall-clock and CPU seconds of the whole process.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import THREADS, Table, machine

RUNS = {
    "python": ["-c", "pass"],
    "modalax --help": ["-m", "modalax", "--help"],
    "modalax --version": ["-m", "modalax", "--version"],
    "modalax fit --help": ["-m", "modalax", "fit", "--help"],
    "modalax fit, no such file": ["-m", "modalax", "fit", "missing.uff"],
    "modalax fit, a text file": ["-m", "modalax", "fit", "words.npz"],
    "modalax diagnose, no such file": ["-m", "modalax", "diagnose", "missing.npz", "--simulation", "words.npz"],
    "modalax frf, no such file": ["-m", "modalax", "frf", "missing.npy", "-o", "out.npz"],
    "import jax": ["-c", "import jax"],
    "import modalax": ["-c", "import modalax"],
    "import modalax and its FRF": ["-c", "from modalax import FRF"],
}


def spent(command: list[str], folder: str) -> tuple[float, float, int]:
    """Wall-clock and CPU seconds of a process, and its exit status."""
    before, began = os.times(), time.perf_counter()
    done = subprocess.run([sys.executable, *command], cwd=folder, env={**os.environ, **THREADS}, capture_output=True)
    wall, after = time.perf_counter() - began, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, cpu, done.returncode


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--csv", help="file for the table")
    args = parser.parse_args()
    print(machine() + "\n")
    table = Table(("what", "wall [s]", "CPU [s]", "exit status"), args.csv)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "words.npz").write_text("no archive\n")
        for name, command in RUNS.items():
            runs = [spent(command, folder) for _ in range(args.repeats)]
            table.add(name, f"{min(r[0] for r in runs):.2f}", f"{min(r[1] for r in runs):.2f}", runs[0][2])


if __name__ == "__main__":
    main()
