"""Seconds of a whole fit, before and now: ``python experiments/benchmarks/fit_speed.py --before COMMIT``.

Every case runs in a process of its own with one thread of linear algebra and an empty compilation cache: the first fit
is cold, the second warm. CPU seconds, for other work does not count in them; largest memory; modes in the band. With
``--before`` the same with the package as it was at a commit, checked out into a temporary folder, and the ratios.
``--profile`` says which functions the last fit spends most in.
"""

import argparse
import cProfile
import json
import os
import pstats
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import Table, machine

CASES = {
    "five": "five DoFs, 5 x 5 x 701",
    "small": "3 x 1 x 1,000, noise unknown",
    "aeroplane": "laboratory aeroplane, 12-180 Hz",
    "large": "458 x 4 x 3,000, 112 modes",
    "diagram": "the same, its diagram alone",
}
THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def frf_of(case: str):
    """The FRFs of a case, and the band [Hz]."""
    import jax
    import numpy as np

    from modalax.data import FRF
    from modalax.model import ModalModel

    if case == "aeroplane":
        from modalax.data.datasets import uliege_plane

        return uliege_plane().frf, (12.0, 180.0)
    if case == "five":
        from modalax.model.examples import five_dof

        return five_dof().modal().frf(np.arange(701) * 0.1).add_noise(jax.random.key(0), 0.02), None
    rng = np.random.default_rng(1)
    outputs, inputs, lines, modes, top = (3, 1, 1000, 6, 200.0) if case == "small" else (458, 4, 3000, 112, 90.0)
    f = np.linspace(0.06, 0.94, modes) * top * (1 + 0.2 / modes * rng.uniform(-1, 1, modes))
    zeta, shapes = rng.uniform(0.003, 0.01, modes), rng.normal(size=(modes, outputs))
    model = ModalModel.from_real_modes(f, zeta, shapes, np.ones(modes), [str(k) for k in range(outputs)])
    freq = np.linspace(top / lines, top, lines)
    clean = model.frf(freq, form="accelerance", inputs=[str(k) for k in range(inputs)])
    size = 0.02 * np.sqrt(np.mean(np.abs(np.asarray(clean.H)) ** 2, axis=0))
    noise = rng.normal(size=(2, *clean.H.shape)) * size / np.sqrt(2)
    H = np.asarray(clean.H) + noise[0] + 1j * noise[1]
    return FRF(freq, H, form="accelerance", outputs=clean.outputs, inputs=clean.inputs), None


def run(case: str, profile: bool) -> dict:
    """Cold and warm, in this process."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.identify import fit

    frf, band = frf_of(case)
    seconds, found = [], None
    watch = cProfile.Profile()
    turns = 1 if case == "large" else 2
    for turn in range(turns):
        began = time.process_time()
        if profile and turn == turns - 1:
            watch.enable()
        found = fit(frf, band=band, refine=case != "diagram")
        watch.disable()
        seconds.append(time.process_time() - began)
    if profile:
        pstats.Stats(watch, stream=sys.stderr).sort_stats("tottime").print_stats(20)
    assert found is not None
    peak = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    assert peak is not None
    error = None if found.refined is None else np.asarray(found.refined.frequency_std_hz)
    whole = error is not None and bool(np.isfinite(error[np.asarray(found.inside)]).all())
    modes = int(np.sum(np.asarray(found.inside)))
    return {"seconds": seconds, "peak": int(peak[1]) / 1024**2, "modes": modes, "deviations": whole}


def side(case: str, source: Path, profile: bool) -> dict:
    """A case with the package in some folder, in a process of its own with an empty compilation cache."""
    with tempfile.TemporaryDirectory() as cache:
        kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
        environment = {**kept, **THREADS, "PYTHONPATH": str(source), "JAX_COMPILATION_CACHE_DIR": cache}
        command = [sys.executable, __file__, "--part", case, *(["--profile"] if profile else [])]
        done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.strip().splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", help="commit to compare with")
    parser.add_argument("--cases", nargs="+", default=["five", "small", "aeroplane"], choices=CASES)
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--part", choices=CASES, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part:
        print(json.dumps(run(args.part, args.profile)))
        return
    print(machine() + "\n")
    root = Path(__file__).parents[2]
    with tempfile.TemporaryDirectory() as old:
        sides = {"now": root / "src"}
        if args.before:
            tree = subprocess.run(
                ["git", "-C", root, "archive", args.before, "src"], check=True, stdout=subprocess.PIPE
            )
            subprocess.run(["tar", "-x", "-C", old], input=tree.stdout, check=True)
            sides = {"before": Path(old) / "src", **sides}
        head = ("FRFs", "package", "cold CPU [s]", "warm CPU [s]", "memory [GB]", "modes", "all with deviations")
        table = Table(head)
        for case in args.cases:
            found = {name: side(case, source, args.profile) for name, source in sides.items()}
            for name, r in found.items():
                times = r["seconds"]
                warm = f"{times[-1]:.2f}" if len(times) > 1 else ""
                table.add(CASES[case], name, f"{times[0]:.1f}", warm, f"{r['peak']:.2f}", r["modes"], r["deviations"])
            if args.before:
                one, two = found["before"]["seconds"], found["now"]["seconds"]
                table.add(
                    CASES[case], "times as fast", f"{one[0] / two[0]:.1f}", f"{one[-1] / two[-1]:.1f}", "", "", ""
                )


if __name__ == "__main__":
    main()
