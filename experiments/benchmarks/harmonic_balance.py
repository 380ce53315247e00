"""Harmonic balance beside its peers in one run: ``python experiments/benchmarks/harmonic_balance.py``.

1,000 lines, 10 levels, 5 harmonics (1, 3, 5, 7, 9), one slipping joint on 5 and on 300 DoFs. Each peer runs in a
virtual environment that this script makes (pyHarm from PyPI, tmdsimpy from its repository), on as many lines of one
level as ``--peer-lines`` says, about the largest response, where the joint slips; its time a line is what is compared,
and its answers are checked against ours. Times are CPU seconds, the least of the repeats, so that other work on the
machine disturbs them less.

Last, the same joint at the end of chains of rising length: what the balance costs beyond the receptance.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax  # noqa: E402
import numpy as np  # noqa: E402

from modalax.model import Structure  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402
from modalax.model.receptance import directions  # noqa: E402
from modalax.simulate import harmonic_balance  # noqa: E402
from modalax.simulate.harmonic import receptances  # noqa: E402
from modalax.simulate.joints import ElastoSlip  # noqa: E402

jax.config.update("jax_enable_x64", True)
SOURCE = "https://github.com/tmd-lab/tmdsimpy"
NEEDS = {"tmdsimpy": ["numpy", "scipy", "jax[cpu]"], "pyharm": ["pyHarm-os==1.2.2"]}
HARMONICS, SAMPLES, LEVEL = (1, 3, 5, 7, 9), 128, 7


def chain(n: int) -> Structure:
    """Masses in a row between two walls, lightly damped."""
    K = 1e7 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return Structure(np.eye(n), 2e-4 * K, K)


SLIDER, PUSHES = ElastoSlip(2e6, 2.0, -2e6), np.geomspace(20.0, 1000.0, 10)
CASES = {
    "5 DoFs": (five_dof(), ("3", "5"), ElastoSlip(9.8e3, 2.4, -9.8e3), (20.0, 70.0), np.geomspace(0.5, 20.0, 10)),
    "300 DoFs": (chain(300), ("1", "2"), SLIDER, (5.0, 60.0), PUSHES),
}


def least(run: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """CPU seconds of the first call and of the quickest later one, and what it gave."""
    took, made = [], None
    for _ in range(repeats + 1):
        began = time.process_time()
        made = jax.block_until_ready(run())
        took.append(time.process_time() - began)
    return took[0], min(took[1:]), made


def ours(case: tuple, lines: int, repeats: int) -> tuple[float, float, float, Any]:
    """CPU seconds of the first and of later calls, those of the receptances alone, and the response."""
    structure, place, joint, band, levels = case
    freq, name = np.linspace(*band, lines), structure.dofs[0]
    b, ends = directions(structure, [list(place)]), directions(structure, [[name]])
    alone = partial(receptances, structure, b, 2 * np.pi * freq, ends, ends, HARMONICS)
    whole = partial(
        harmonic_balance, structure, [joint], [list(place)], freq, levels, inputs=[name], outputs=[name],
        harmonics=HARMONICS, samples=SAMPLES,
    )  # fmt: skip
    cold, warm, response = least(whole, repeats)
    return cold, warm, least(alone, repeats)[1], response


def environment(name: str, source: str) -> tuple[Path, Path | None]:
    """A virtual environment with a peer, and its sources where it is not installed; both kept for the next run."""
    home = Path(tempfile.gettempdir()) / f"modalax-benchmark-{name}"
    python = home / "venv" / "bin" / "python"
    if not python.exists():
        venv.create(home / "venv", with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", *NEEDS[name]], check=True)
    if name != "tmdsimpy" or Path(source).is_dir():
        return python, Path(source) if name == "tmdsimpy" else None
    if not (home / name).exists():
        subprocess.run(["git", "clone", "--depth", "1", source, home / name], check=True)
    return python, home / name


def peer(name: str, case: tuple, where: tuple[Path, Path | None], lines: np.ndarray, repeats: int) -> Any:
    """CPU seconds of a peer's first sweep and of its quickest, and its motion at the force."""
    structure, place, joint, _, levels = case
    b = np.zeros(len(structure.dofs))
    b[structure.index(place[0])], b[structure.index(place[1])] = 1.0, -1.0
    K = np.asarray(structure.K) + float(joint.k0) * np.outer(b, b)
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "case.npz", Path(folder) / "answer.npz"
        np.savez(
            given, M=structure.M, C=structure.C, K=K, b=b, k=float(joint.k), slip=float(joint.slip_force),
            harmonics=HARMONICS, samples=SAMPLES, freq=lines, level=levels[LEVEL], repeats=repeats,
        )  # fmt: skip
        script, (python, source) = Path(__file__).with_name("harmonic_balance_peer.py"), where
        more = [] if source is None else [source]
        # Compiler flags of this JAX end a process with another that does not know them.
        kept = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
        subprocess.run([python, script, name, given, made, *more], env=kept, check=True, stdout=subprocess.DEVNULL)
        answer = np.load(made)
        return float(answer["first"]), float(answer["cpu"]), answer["motion"]


def head(*names: str) -> None:
    print("\n| " + " | ".join(names) + " |\n" + "| --- " * len(names) + "|", flush=True)


def beside_peers(args: argparse.Namespace) -> None:
    where = {name: environment(name, args.tmdsimpy) for name in args.peers}
    head(
        "case", "compile [s]", "warm [s]", "a solve [us]", "unsolved", "peer", "lines", "its first sweep [s]",
        "a solve [ms]", "times slower", "largest difference over the peak",
    )  # fmt: skip
    for (name, case), count in zip(CASES.items(), args.peer_lines, strict=True):
        cold, warm, _, r = ours(case, args.lines, args.repeats)
        solve, unsolved = warm / (args.lines * len(r.level)), int((~np.asarray(r.converged)).sum())
        size = np.abs(np.asarray(r.fundamental)[LEVEL, :, 0, 0])
        some = max(int(np.argmax(size)) - 3 * count // 4, 0) + np.arange(count)  # up to the peak and past it
        own = np.asarray(r.fundamental)[LEVEL, some, 0, 0]
        for one, place in where.items():
            repeats = args.repeats if len(case[0].dofs) < 100 else 1
            first, seconds, motion = peer(one, case, place, np.asarray(r.freq)[some], repeats)
            apart, theirs = np.max(np.abs(own - motion)) / np.max(np.abs(motion)), seconds / count
            print(
                f"| {name} | {cold - warm:.1f} | {warm:.2f} | {1e6 * solve:.1f} | {unsolved} | {one} | {count} | "
                f"{first:.1f} | {1e3 * theirs:.1f} | {theirs / solve:.0f} | {apart:.1e} |",
                flush=True,
            )


def by_size(sizes: list[int], args: argparse.Namespace) -> None:
    head("DoFs", "warm [s]", "of it the receptances [s]", "the rest [s]", "unsolved")
    for n in sizes:
        case = (chain(n), ("1", "2"), SLIDER, (5.0, 60.0), PUSHES)
        _, warm, alone, r = ours(case, args.lines, args.repeats)
        unsolved = int((~np.asarray(r.converged)).sum())
        print(f"| {n} | {warm:.2f} | {alone:.2f} | {warm - alone:.2f} | {unsolved} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, default=1000)
    parser.add_argument("--peers", nargs="*", default=list(NEEDS), choices=list(NEEDS))
    parser.add_argument("--peer-lines", type=int, nargs=2, default=(100, 2), help="lines for 5 and for 300 DoFs")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--sizes", type=int, nargs="*", default=[10, 30, 100, 300, 600])
    parser.add_argument("--tmdsimpy", default=SOURCE, help="an address to clone, or a folder")
    args = parser.parse_args()
    beside_peers(args)
    by_size(args.sizes, args)


if __name__ == "__main__":
    sys.exit(main())
