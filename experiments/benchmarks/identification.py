"""Poles beside four peers in one run: ``python experiments/benchmarks/identification.py``.

LSCF with real coefficients, every even degree up to the highest, on 5 outputs x 1 input x 501 lines (5 modes, to degree
60) and on 458 x 1 x 3000 (42 modes, to degrees 120 and 200), without noise. Each peer runs in a virtual environment
that this script makes. All sides run in processes of their own on one core, cold once (nothing compiled before) and
then warm; the least warm time counts. Beside them the floor: the matrix products and eigenvalues without which no LSCF
does, timed with NumPy. Seconds are wall-clock; the CPU seconds next to them show how much other work was in the way.
The peers' cold times hold what they import.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import SDYPY, Table, call, machine, one_core, peak, python_of

CASES = {"5 x 1 x 501": (5, 5, 501, 70.0, 60), "458 x 1 x 3000": (458, 42, 3000, 300.0, 120)}
CASES["458 x 1 x 3000 "] = (458, 42, 3000, 300.0, 200)

PEERS = {
    "sdypy": ("sdypy-EMA 0.31", [SDYPY]),
    "sdynpy": ("SDynPy 0.23", ["sdynpy==0.23.0"]),
    "pyfbs": ("pyFBS 1.0.7", ["pyFBS==1.0.7"]),
    "pyoma2": ("pyOMA2 1.4.3, its function for spectra", ["pyOMA-2==1.4.3"]),
}


def write_case(name: str, path: Path) -> None:
    """Modes spread over the band, FRFs from 0 Hz."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.model import ModalModel

    outputs, modes, lines, top, _ = CASES[name]
    rng = np.random.default_rng(1)
    f = np.linspace(0.06, 0.94, modes) * top * (1 + 0.004 * rng.uniform(-1, 1, modes))
    zeta = rng.uniform(0.003, 0.01, modes)
    shapes = rng.normal(size=(modes, outputs))
    model = ModalModel.from_real_modes(f, zeta, shapes, np.ones(modes), [str(k) for k in range(outputs)])
    freq = np.linspace(0, top, lines)
    H = np.asarray(model.frf(freq, inputs=["0"]).H)[:, :, 0].T
    np.savez(path, H=H, freq=freq, true=f, zeta=zeta)


def own(path: str, degree: int, repeats: int, real: bool) -> dict:
    """Our side, in a process of its own."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.data.frf import FRF
    from modalax.identify import lscf

    given = np.load(path)
    frf = FRF(given["freq"], given["H"].T[:, :, None])
    orders = range(2, degree + 1, 2) if real else range(1, degree // 2 + 1)
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter(), time.process_time()
        table = jax.block_until_ready(lscf(frf, orders, real=real))
        times.append((time.perf_counter() - began[0], time.process_time() - began[1]))
    poles = np.asarray(table.poles[-1])[np.asarray(table.valid[-1])]
    f, z = np.abs(poles) / 2 / np.pi, -poles.real / np.abs(poles)
    near = [int(np.argmin(abs(f - t))) for t in given["true"]]
    return {
        "times": times,
        "peak": peak(),
        "frequency": max(abs(f[k] / t - 1) for k, t in zip(near, given["true"], strict=True)),
        "damping": max(abs(z[k] / t - 1) for k, t in zip(near, given["zeta"], strict=True)),
    }


def floor(path: str, degree: int) -> dict:
    """Moments of all FRFs by FFT, one pair of products an output, and every order's eigenvalues."""
    import numpy as np

    H = np.load(path)["H"]
    rng = np.random.default_rng(0)
    began = time.process_time()
    np.fft.irfft(H, axis=1)
    np.fft.irfft(np.sum(np.abs(H) ** 2, axis=0))
    moments = time.process_time() - began
    W, S = rng.normal(size=(2, degree + 1, degree + 1))
    began = time.process_time()
    for _ in range(len(H)):
        T = W @ S
        T.T @ T
    products = time.process_time() - began
    began = time.process_time()
    for n in range(2, degree + 1, 2):
        np.linalg.eigvals(np.diag(np.ones(n - 1), 1) + np.outer(np.eye(n)[-1], rng.normal(size=n)))
    return {"moments": moments, "products": products, "eigenvalues": time.process_time() - began}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=PEERS)
    parser.add_argument("--limit", type=float, default=900.0, help="seconds after which a side is given up")
    parser.add_argument("--csv", help="file for the table")
    parser.add_argument("--part", nargs=4, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part:
        what, path, degree, repeats = args.part
        sides = {"floor": lambda: floor(path, int(degree))}
        sides |= {w: lambda w=w: own(path, int(degree), int(repeats), w == "real") for w in ("real", "complex")}
        print(json.dumps(sides[what]()))
        return
    pythons = {peer: python_of(peer, PEERS[peer][1]) for peer in args.peers}
    one_core()
    print(machine() + "\n")
    head = ("case", "degree", "side", "cold [s]", "compile [s]", "warm [s]", "warm CPU [s]", "memory [MB]")
    table = Table((*head, "frequency", "damping"), args.csv)
    me, script = [sys.executable, __file__, "--part"], Path(__file__).with_name("identification_peer.py")
    with tempfile.TemporaryDirectory() as folder:
        for name, (*_, degree) in CASES.items():
            path = Path(folder) / "case.npz"
            write_case(name, path)
            given = [path, degree, args.repeats]
            sides = {PEERS[peer][0]: [python, script, peer, *given] for peer, python in pythons.items()}
            sides |= {f"modalax, {w}": [*me, w, *given] for w in ("real", "complex")}
            for side, command in sides.items():
                case = name.strip(), degree, side
                try:
                    r = call(command, args.limit)
                except subprocess.TimeoutExpired:
                    table.add(*case, f"not done in {args.limit:.0f}", *[""] * 6)
                    continue
                except RuntimeError as error:
                    table.add(*case, f"fails: {error}", *[""] * 6)
                    continue
                warm = r["times"][1:] or r["times"]
                cold, least = r["times"][0][0], min(t[0] for t in warm)
                compiled = f"{cold - least:.2f}" if side.startswith("modalax") else ""
                table.add(
                    *case, f"{cold:.2f}", compiled, f"{least:.3f}", f"{min(t[1] for t in warm):.3f}",
                    f"{r['peak']:.0f}", f"{r['frequency']:.0e}", f"{r['damping']:.0e}",
                )  # fmt: skip
            low = call([*me, "floor", path, degree, 0])
            parts = ", ".join(f"{k} {v:.3f}" for k, v in low.items())
            table.add(name.strip(), degree, f"floor: {parts}", "", "", "", f"{sum(low.values()):.3f}", "", "", "")


if __name__ == "__main__":
    sys.exit(main())
