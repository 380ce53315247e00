"""Harmonic balance beside tmdsimpy in one run: ``python experiments/benchmarks/harmonic_balance.py``.

1,000 lines, 10 levels, 5 harmonics (1, 3, 5, 7, 9), one slipping joint on 5 and on 300 DoFs. The peer runs in a virtual
environment that this script makes, on as many lines of one level as ``--peer-lines`` says; its time a line is what is
compared, and its answers are checked against ours. Times are CPU seconds, so that other work on the machine disturbs
them less.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import jax  # noqa: E402
import numpy as np  # noqa: E402

from modalax.model import Structure  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402
from modalax.simulate import harmonic_balance  # noqa: E402
from modalax.simulate.joints import ElastoSlip  # noqa: E402

jax.config.update("jax_enable_x64", True)
SOURCE = "https://github.com/tmd-lab/tmdsimpy"
HARMONICS, SAMPLES = (1, 3, 5, 7, 9), 128


def chain(n: int) -> Structure:
    """Masses in a row between two walls, lightly damped."""
    K = 1e7 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return Structure(np.eye(n), 2e-4 * K, K)


CASES = {
    "5 DoFs": (five_dof(), ("3", "5"), ElastoSlip(9.8e3, 2.4, -9.8e3), (20.0, 70.0), np.geomspace(0.5, 20.0, 10)),
    "300 DoFs": (chain(300), ("1", "2"), ElastoSlip(2e6, 2.0, -2e6), (5.0, 60.0), np.geomspace(2.0, 100.0, 10)),
}


def ours(case: tuple, lines: int) -> tuple[float, float, object]:
    structure, place, joint, band, levels = case

    def run() -> tuple[float, object]:
        began = time.process_time()
        r = harmonic_balance(
            structure, [joint], [list(place)], np.linspace(*band, lines), levels, inputs=[structure.dofs[0]],
            outputs=[structure.dofs[0]], harmonics=HARMONICS, samples=SAMPLES,
        )  # fmt: skip
        jax.block_until_ready(r.X)
        return time.process_time() - began, r

    cold, _ = run()
    warm, r = run()
    return cold, warm, r


def peer_environment(source: str) -> tuple[Path, Path]:
    """A virtual environment with the peer's needs, and its sources; both kept for the next run."""
    home = Path(tempfile.gettempdir()) / "modalax-benchmark-peer"
    python = home / "venv" / "bin" / "python"
    if not python.exists():
        venv.create(home / "venv", with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "numpy", "scipy", "jax[cpu]"], check=True)
    if Path(source).is_dir():
        return python, Path(source)
    if not (home / "tmdsimpy").exists():
        subprocess.run(["git", "clone", "--depth", "1", source, home / "tmdsimpy"], check=True)
    return python, home / "tmdsimpy"


def peer(case: tuple, python: Path, source: Path, lines: np.ndarray, level: float) -> tuple[float, np.ndarray]:
    structure, place, joint, _, _ = case
    b = np.zeros(len(structure.dofs))
    b[structure.index(place[0])], b[structure.index(place[1])] = 1.0, -1.0
    K = np.asarray(structure.K) + float(joint.k0) * np.outer(b, b)
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "case.npz", Path(folder) / "answer.npz"
        np.savez(
            given, M=structure.M, C=structure.C, K=K, b=b, k=float(joint.k), slip=float(joint.slip_force),
            harmonics=HARMONICS, samples=SAMPLES, freq=lines, level=level,
        )  # fmt: skip
        script = Path(__file__).with_name("harmonic_balance_peer.py")
        subprocess.run([python, script, source, given, made], check=True, stdout=subprocess.DEVNULL)
        answer = np.load(made)
        return float(answer["cpu"]), answer["motion"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, default=1000)
    parser.add_argument("--peer-lines", type=int, nargs=2, default=(100, 2), help="lines for 5 and for 300 DoFs")
    parser.add_argument("--peer", default=SOURCE, help="tmdsimpy: an address to clone, or a folder")
    args = parser.parse_args()
    python, source = peer_environment(args.peer)
    head = ("case", "cold [s]", "warm [s]", "a solve [us]", "tmdsimpy a solve [ms]", "ratio", "difference", "unsolved")
    print("| " + " | ".join(head) + " |\n" + "| --- " * len(head) + "|", flush=True)
    for (name, case), count in zip(CASES.items(), args.peer_lines, strict=True):
        cold, warm, r = ours(case, args.lines)
        some = np.unique(np.linspace(args.lines // 4, args.lines // 3, count).astype(int))
        level = 7
        seconds, motion = peer(case, python, source, np.asarray(r.freq)[some], float(r.level[level]))
        own = np.asarray(r.fundamental)[level, some, 0, 0]
        apart = np.max(np.abs(own - motion)) / np.max(np.abs(motion))
        solve, theirs = warm / (args.lines * len(r.level)), seconds / len(some)
        unsolved = int((~np.asarray(r.converged)).sum())
        print(
            f"| {name} | {cold:.1f} | {warm:.2f} | {1e6 * solve:.1f} | {1e3 * theirs:.1f} | {theirs / solve:.0f} | "
            f"{apart:.1e} | {unsolved} |",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
