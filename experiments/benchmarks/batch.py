"""Fits of 10,000 draws of the noise beside sdypy-EMA: ``python experiments/benchmarks/batch.py``.

The five-degree-of-freedom system, five FRFs of 501 lines from 0 to 70 Hz, 2 % noise: LSCF with up to 20 pole pairs at
each of 19 or 20 orders, and the selection of the five modes from the diagram near their true frequencies, for each
draw. On our side that is a study, with its noise, its rows and their files; the peer is handed its noise. One core and
one thread a side, CPU seconds. The peer chooses with a search window of 50 Hz, its default, which runs together modes
that lie 6 Hz apart, and with one of 8 Hz, which keeps them apart. Below it the same study with refinement by maximum
likelihood and standard deviations, which the peer has none of.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from common import SDYPY, Table, call, machine, one_core, python_of

ORDER, NOISE = 20, 0.02
TOP, LINES = 70.0, 501
WINDOWS = (50, 8)

PEER = """
import json, sys, time
import numpy as np
from sdypy import EMA
given, draws, order, window = np.load(sys.argv[1]), *map(int, sys.argv[2:])
rng, poles, selection, zeta = np.random.default_rng(0), 0.0, 0.0, []
for k in range(draws + 1):
    e = rng.normal(size=(2, *given["H"].shape)) * given["sigma"] / np.sqrt(2)
    H = given["H"] + e[0] + 1j * e[1]
    began = time.process_time()
    model = EMA.Model(H, given["freq"], lower=float(given["freq"][1]), upper=float(given["freq"][-1]),
                      pol_order_high=order, frf_form="receptance")
    model.get_poles(method="lscf", show_progress=False)
    middle = time.process_time()
    model.select_closest_poles(list(given["true"]), f_window=window)
    if k:  # the first one warms up
        poles, selection = poles + middle - began, selection + time.process_time() - middle
        right = np.abs(model.nat_freq / given["true"] - 1) < 0.02
        zeta.append(np.where(right, model.nat_xi, np.nan))
zeta = np.array(zeta)
print(json.dumps({"poles": poles / draws, "selection": selection / draws, "found": float(np.mean(np.isfinite(zeta))),
                  "error": [float(100 * e) for e in np.nanmedian(zeta, axis=0) / 0.02 - 1]}))
"""


def settings(draws: int, order: int, refine: bool) -> dict:
    """Our study."""
    system = {"simulation": "five_dof", "band": [0.0, TOP], "step": TOP / (LINES - 1), "inputs": ["1"], "noise": NOISE}
    fit = {"refine": refine} | ({} if refine else {"method": "lscf", "order": order})
    return {"kind": "noise", "draws": draws, "system": system, "fit": fit}


def write_case(path: Path) -> None:
    """FRFs and noise for the peer."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.model.examples import five_dof

    structure = five_dof()
    clean = structure.frf(np.arange(LINES) * TOP / (LINES - 1), inputs=["1"])
    sigma = np.sqrt(np.asarray(clean.add_noise(jax.random.key(0), NOISE).variance))[:, :, 0].T
    true = np.sort(np.abs(np.asarray(structure.modal().poles))) / (2 * np.pi)
    np.savez(path, H=np.asarray(clean.H)[:, :, 0].T, sigma=sigma, freq=np.asarray(clean.freq), true=true)


def own(draws: int, order: int, refine: bool) -> dict:
    """A study in this process: once small, so that all is compiled, then whole."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.study import study

    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        few = {**settings(1 if refine else 512, order, refine), **({} if refine else {"chunk": 512})}
        study(few, Path(folder) / "few", workers=0)
        first = time.process_time() - began
        began = time.process_time()
        columns = study({**few, "draws": draws, "seed": 1}, Path(folder) / "all", workers=0).columns
        seconds = time.process_time() - began
    zeta = np.array([columns[f"damping_ratio_{r}"] for r in range(1, 6)])
    return {
        "first": first, "draw": seconds / draws, "found": float(np.mean(np.isfinite(zeta))),
        "error": [float(100 * e) for e in np.nanmedian(zeta, axis=1) / 0.02 - 1],
    }  # fmt: skip


def errors(values: list[float]) -> str:
    """Median errors of the five dampings [%]."""
    return ", ".join("none" if v != v else f"{v:+.1f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--peer-draws", type=int, default=200)
    parser.add_argument("--refined-draws", type=int, default=20)
    parser.add_argument("--order", type=int, default=ORDER, help="pole pairs of the highest order")
    parser.add_argument("--csv", help="file for the table")
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part:
        print(json.dumps(own(int(args.part[1]), args.order, args.part[0] == "refined")))
        return
    python = python_of("sdypy", [SDYPY])
    one_core()
    print(machine() + "\n")
    head = ("side", "draws", "poles [ms a draw]", "selection [ms]", "all [ms]", "draws a second", "modes found [%]")
    table = Table((*head, "median error of damping [%]", "times the peer's rate"), args.csv)
    me = [sys.executable, __file__, "--order", args.order, "--part"]
    with tempfile.TemporaryDirectory() as folder:
        path, script = Path(folder) / "case.npz", Path(folder) / "peer.py"
        write_case(path)
        script.write_text(PEER, encoding="utf-8")
        slow = {}
        for window in WINDOWS:
            r = call([python, script, path, args.peer_draws, args.order, window])
            slow[window] = r["poles"] + r["selection"]
            table.add(
                f"sdypy-EMA, window {window} Hz", args.peer_draws, f"{1e3 * r['poles']:.2f}",
                f"{1e3 * r['selection']:.2f}", f"{1e3 * slow[window]:.2f}", f"{1 / slow[window]:.0f}",
                f"{100 * r['found']:.0f}", errors(r["error"]), "",
            )  # fmt: skip
    for name, draws in (("diagrams", args.draws), ("refined", args.refined_draws)):
        r = call([*me, name, draws])
        times = ", ".join(f"{seconds / r['draw']:.2g} (window {window} Hz)" for window, seconds in slow.items())
        table.add(
            f"modalax, {name}; compiled and first draws in {r['first']:.0f} s", draws, "", "", f"{1e3 * r['draw']:.2f}",
            f"{1 / r['draw']:.0f}", f"{100 * r['found']:.0f}", errors(r["error"]), times,
        )  # fmt: skip


if __name__ == "__main__":
    main()
