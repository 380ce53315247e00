"""Cost against size: ``python experiments/benchmarks/curves.py`` (``--out FOLDER`` for the picture, ``--csv FILE``).

One size at a time grows, the others stay: outputs, lines and the highest order of a stabilization diagram (LSCF, every
order), modes of a refinement by maximum likelihood (one step), draws of a study without refinement, and workers of a
study of a function that waits, where only the scheduler costs anything. CPU seconds of the second call, wall-clock for
workers. The exponent is that of the upper half of the sizes; beside it stands what the arithmetic leads to expect.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
os.environ.setdefault("JAX_ENABLE_X64", "1")

import jax
import numpy as np
from common import Table, machine

from modalax.data import FRF
from modalax.identify import lscf
from modalax.identify.host import refine_on_host
from modalax.identify.residues import residues
from modalax.model import ModalModel
from modalax.study import study

TOP = 200.0


def system(modes: int, outputs: int, lines: int) -> tuple[ModalModel, FRF]:
    """Modes spread over the band, and their FRFs with 1 % noise."""
    rng = np.random.default_rng(modes)
    f = np.linspace(0.06, 0.94, modes) * TOP
    names = [str(k) for k in range(outputs)]
    model = ModalModel.from_real_modes(
        f, np.full(modes, 0.005), rng.normal(size=(modes, outputs)), np.ones(modes), names
    )
    frf = model.frf(np.linspace(TOP / lines, TOP, lines), inputs=["0"])
    return model, frf.add_noise(jax.random.key(0), 0.01)


def seconds(call: Callable[[], object], repeats: int = 2) -> float:
    """Least CPU seconds of a call after the first."""
    call()
    least = np.inf
    for _ in range(repeats):
        began = time.process_time()
        call()
        least = min(least, time.process_time() - began)
    return least


def diagram(outputs: int = 100, lines: int = 2000, order: int = 40) -> float:
    """A diagram of every order by moments."""
    frf = system(10, outputs, lines)[1]
    return seconds(lambda: jax.block_until_ready(lscf(frf, range(1, order + 1), solver="moments")))


def refinement(modes: int) -> float:
    """One step of maximum likelihood: the difference of four steps and one."""
    model, frf = system(modes, 20, 2000)
    moved = residues(frf, np.asarray(model.poles) * (1 + 2e-3j))
    few, more = refine_on_host(frf, moved, max_steps=1), refine_on_host(frf, moved, max_steps=4)
    steps = int(more.steps) - int(few.steps)
    return (
        seconds(lambda: refine_on_host(frf, moved, max_steps=4))
        - seconds(lambda: refine_on_host(frf, moved, max_steps=1))
    ) / steps


def draws(count: int) -> float:
    """A study of the five-DoF system, without what is compiled."""
    system = {"simulation": "five_dof", "band": [0.0, 70.0], "step": 0.14, "inputs": ["1"], "noise": 0.02}
    settings = {
        "kind": "noise",
        "system": system,
        "fit": {"refine": False, "method": "lscf", "order": 12},
        "chunk": 128,
    }

    def run() -> None:
        with tempfile.TemporaryDirectory() as folder:
            study({**settings, "draws": count}, Path(folder) / "out", workers=0)

    return seconds(run, 1)


def wait(seed: int) -> dict[str, float]:
    """A draw that waits for a twentieth of a second."""
    time.sleep(0.05)
    return {"value": float(seed % 7)}


def workers(count: int) -> float:
    """Wall-clock seconds of 240 draws that wait, on local processes, from the first rows that come to the last."""
    came: list[tuple[float, int]] = []

    def told(text: str) -> None:
        if " draws" in text:
            came.append((time.perf_counter(), int(text.split()[0])))

    with tempfile.TemporaryDirectory() as folder:
        settings = {"kind": "function", "function": wait, "draws": 240, "chunk": 1}
        study(settings, Path(folder) / "out", workers=count, progress=told)
    (began, first), (ended, last) = came[0], came[-1]
    return (ended - began) * 240 / (last - first)


CURVES = {
    "outputs": (lambda n: diagram(outputs=n), (25, 50, 100, 200, 400), "1 (moments and products)"),
    "lines": (lambda n: diagram(lines=n), (1000, 2000, 4000, 8000, 16000), "1 (moments)"),
    "order": (lambda n: diagram(order=n), (20, 40, 80, 120, 160), "3 (products) to 4 (roots of every order)"),
    "modes": (refinement, (4, 8, 16, 32), "1 (kernels) to 2 (their products)"),
    "draws": (draws, (256, 512, 1024, 2048), "1"),
    "workers": (workers, (1, 2, 4), "-1"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--curves", nargs="*", default=list(CURVES), choices=CURVES)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    parser.add_argument("--csv", help="file for the table")
    args = parser.parse_args()
    print(machine() + "\n")
    table = Table(("against", "sizes", "seconds", "exponent", "expected"), args.csv)
    found = {}
    for name in args.curves:
        measure, sizes, expected = CURVES[name]
        times = [measure(n) for n in sizes]
        half = len(sizes) // 2
        exponent = np.polyfit(np.log(sizes[half:]), np.log(times[half:]), 1)[0]
        found[name] = (sizes, times, exponent, expected)
        table.add(name, ", ".join(map(str, sizes)), ", ".join(f"{t:.3g}" for t in times), f"{exponent:.2f}", expected)
    if args.out:
        draw(found, args.out)


def draw(found: dict, folder: Path) -> None:
    """All curves in one picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(10, 6), layout="constrained")
    for ax, (name, (sizes, times, exponent, expected)) in zip(axes.flat, found.items(), strict=False):
        ax.loglog(sizes, times, "o-")
        ax.set(xlabel=name, ylabel="seconds", title=f"exponent {exponent:.2f}; expected {expected}")
        ax.title.set_fontsize(8)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "curves.png", dpi=150)


if __name__ == "__main__":
    main()
