"""The same work on every kind of device of this machine: ``python experiments/benchmarks/devices.py``.

Each part runs in processes of its own, one a kind of device (``cpu``, ``cuda``); its first call has nothing compiled
before. Seconds are by the clock, since an accelerator works while the processor waits, so that nothing else should run
beside it; the processor may use all its cores. ``poles``: LSCF to 20 pole pairs of the five-DoF system, 5 FRFs of 501
lines with 2 % noise, for many draws at once. ``balance``: the slipping joint of ``harmonic_balance.py`` at 10 levels
and 50 lines, for as many slip forces at once; ``slope``: the same with the derivatives by them. ``diagram``, ``fit``
and ``diagnose``: single jobs that a user waits for.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from common import THREADS, Table, machine

ORDER, NOISE, LINES = 20, 0.02, 50
REPEATS, ENOUGH = 3, 10.0  # later calls, and seconds of them after which there are no more
PARTS: dict[str, tuple[int, ...]] = {
    "poles": (128, 1_024, 8_192), "balance": (1, 16, 256), "slope": (16,), "diagram": (120,), "fit": (5,),
    "diagnose": (10,),
}  # fmt: skip


def poles(count: int) -> tuple[Callable, Callable]:
    """Diagrams of so many draws, and the median damping of the first mode over them [%]."""
    import numpy as np

    from modalax.identify.many import many_poles
    from modalax.model.examples import five_dof

    structure = five_dof()
    frf = structure.frf(np.arange(501) * 0.14, inputs=["1"])
    rows = np.asarray(frf.H)[:, :, 0].T
    true = np.asarray(structure.modal().poles)
    first = true[np.argmin(np.abs(true))]
    noise = np.random.default_rng(0).normal(size=(count, 2, *rows.shape))
    noise *= NOISE * np.sqrt(np.mean(np.abs(rows) ** 2, axis=1, keepdims=True) / 2)
    noise += np.stack([rows.real, rows.imag])

    def run():
        return many_poles(np.asarray(frf.omega), noise, ORDER)[0]

    def answer(found):
        top = np.asarray(found)[:, -1]
        near = np.take_along_axis(top, np.argmin(np.abs(top - first), axis=1)[:, None], axis=1)[:, 0]
        return float(np.median(-100 * near.real / np.abs(near)))

    return run, answer


def _balance(count: int):
    import jax.numpy as jnp
    import numpy as np
    from harmonic_balance import CASES, HARMONICS, SAMPLES

    from modalax.simulate import harmonic_balance
    from modalax.simulate.joints import ElastoSlip

    structure, place, joint, band, levels = CASES["5 DoFs"]
    freq, name = np.linspace(*band, LINES), structure.dofs[0]

    def respond(slip_force):
        """Response at the first DoF of the structure with one such joint, shape ``(level, f)``."""
        return harmonic_balance(
            structure, [ElastoSlip(joint.k, slip_force, joint.k0)], [list(place)], freq, levels, inputs=[name],
            outputs=[name], harmonics=HARMONICS, samples=SAMPLES,
        ).fundamental[:, :, 0, 0]  # fmt: skip

    return respond, jnp.geomspace(0.5, 2.0, count) * joint.slip_force if count > 1 else jnp.array([joint.slip_force])


def balance(count: int) -> tuple[Callable, Callable]:
    """So many joints by 10 levels by 50 lines, and the largest motion of the last [mm]."""
    import jax
    import numpy as np

    respond, slips = _balance(count)
    program = jax.jit(jax.vmap(respond))
    return lambda: program(slips), lambda found: 1e3 * float(np.abs(np.asarray(found)[-1]).max())


def slope(count: int) -> tuple[Callable, Callable]:
    """The same with derivatives by each joint's slip force, and the last of them [mm/N]."""
    import jax
    import jax.numpy as jnp

    respond, slips = _balance(count)
    program = jax.jit(jax.vmap(jax.grad(lambda slip: jnp.sum(jnp.abs(respond(slip))))))
    return lambda: program(slips), lambda found: 1e3 * float(found[-1])


def diagram(order: int) -> tuple[Callable, Callable]:
    """Poles of 458 FRFs of 3,000 lines up to an order, and the error of the worst of 40 modes [Hz]."""
    import numpy as np

    from modalax.identify import lscf
    from modalax.model import ModalModel

    rng = np.random.default_rng(1)
    hz = np.linspace(5.0, 85.0, 40)
    model = ModalModel.from_real_modes(
        hz, rng.uniform(0.003, 0.01, 40), rng.normal(size=(40, 458)), np.ones(40), [str(k) for k in range(458)]
    )
    frf = model.frf(np.linspace(0.03, 90.0, 3000), inputs=["0"])

    def answer(found):
        top = np.abs(np.asarray(found.poles)[-1]) / (2 * np.pi)
        return float(np.max(np.min(np.abs(top[:, None] - hz), axis=0)))

    return lambda: lscf(frf, tuple(range(2, order // 2 + 1))), answer


def fit(count: int) -> tuple[Callable, Callable]:
    """A whole fit with error bars, and the number of modes."""
    import numpy as np
    from fit_speed import frf_of

    from modalax.identify import fit

    del count
    frf, _ = frf_of("five")
    return lambda: fit(frf), lambda found: float(np.sum(np.asarray(found.inside)))


def diagnose(count: int) -> tuple[Callable, Callable]:
    """A whole diagnosis of a simulation that is off everywhere, and whether the cause is named with its place."""
    from diagnosis import off_everywhere

    from modalax.diagnose import diagnose

    measured, simulation = off_everywhere(count, count, 1, 400, 3)
    return lambda: diagnose(measured, simulation), lambda found: float(found.verdict == "named")


def part(name: str, count: int) -> dict:
    """Seconds of the first call and the least of later ones in this process, and the answer."""
    import jax

    jax.config.update("jax_enable_x64", True)
    run, answer = globals()[name](count)
    took, found = [], None
    for turn in range(1 + REPEATS):
        if turn > 1 and sum(took[1:]) > ENOUGH:
            break
        began = time.perf_counter()
        found = jax.block_until_ready(run())
        took.append(time.perf_counter() - began)
    device = jax.devices()[0]
    return {"device": device.device_kind, "first": took[0], "warm": min(took[1:]), "answer": answer(found)}


def side(name: str, count: int, kind: str, limit: float) -> dict:
    """A part on a kind of device, in a process of its own; why there is no answer where there is none."""
    platforms = kind if kind == "cpu" else f"{kind},cpu"
    kept = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment = {**THREADS, **kept, "JAX_PLATFORMS": platforms, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    command = [sys.executable, __file__, "--part", name, str(count)]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return {"failed": f"no answer in {limit:.0f} s"}
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1][:200]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def kinds_here() -> list[str]:
    """The kinds of device that JAX finds, the processor first."""
    command = [sys.executable, "-c", "import jax; print(jax.default_backend())"]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip().splitlines()[-1]
    return ["cpu"] if found == "cpu" else ["cpu", "cuda" if found == "gpu" else found]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all if none is given")
    parser.add_argument("--limit", type=float, default=150.0, help="seconds after which a part is ended")
    parser.add_argument("--csv", type=Path, help="file for the table")
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part:
        print(json.dumps(part(args.part[0], int(args.part[1]))))
        return
    print(machine() + "\n")
    kinds = kinds_here()
    table = Table(("part", "size", "device", "first [s]", "warm [s]", "times the processor", "answer"), args.csv)
    for name in args.parts or PARTS:
        for count in PARTS[name]:
            found = {kind: side(name, count, kind, args.limit) for kind in kinds}
            for kind, r in found.items():
                if "failed" in r:
                    table.add(name, count, kind, "", "", "", r["failed"])
                    continue
                faster = found["cpu"].get("warm", float("nan")) / r["warm"]
                device = f"{kind} ({r['device']})"
                told = f"{r['answer']:.6g}"
                table.add(name, count, device, f"{r['first']:.2f}", f"{r['warm']:.4f}", f"{faster:.2g}", told)


if __name__ == "__main__":
    main()
