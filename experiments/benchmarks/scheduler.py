"""What the scheduler of a study costs a task: ``python experiments/benchmarks/scheduler.py``.

Tasks that compute nothing go through Dask distributed to one worker process, ten at a time, and bring back rows as a
study of five modes has them. CPU seconds of the process with client and scheduler, which is what saturates when workers
are added. Beside them what a whole study spends there on a chunk: a noise study of five modes, its rows stored and
summed up, from the difference of a long one and a short one on two worker processes.
"""

import tempfile
import time
from pathlib import Path

from common import Table, machine


def rows_of(k: int, count: int) -> list[dict]:
    """The rows of a chunk, of made-up numbers."""
    names = [f"{what}_{mode}" for mode in range(1, 6) for what in ("frequency_hz", "damping_ratio", "stability")]
    return [{"item": i, **{n: 1e-3 * (i + k) for n in names}, "failed": False, "reason": ""} for i in range(count)]


def of_study(draws: int, chunk: int) -> float:
    """CPU seconds of this process, which is client and scheduler, for a study without refinement."""
    from modalax.study import study

    settings = {
        "kind": "noise", "draws": draws, "chunk": chunk, "fit": {"refine": False, "method": "lscf", "order": 20},
        "system": {"simulation": "five_dof", "band": [0.0, 70.0], "step": 0.14, "inputs": ["1"], "noise": 0.02},
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        study(settings, Path(folder) / "study", workers=2)
        return time.process_time() - began


def main() -> None:
    import jax
    from distributed import Client, LocalCluster

    print(machine() + "\n")
    table = Table(("rows a task", "tasks", "CPU of client and scheduler [ms a task]"))
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:
        for rows, tasks in ((0, 1000), (16, 300), (512, 40)):
            client.gather([client.submit(rows_of, k, rows, pure=False) for k in range(10)])
            began = time.process_time()
            for k in range(0, tasks, 10):
                client.gather([client.submit(rows_of, k + j, rows, pure=False) for j in range(10)])
            table.add(rows, tasks, f"{1e3 * (time.process_time() - began) / tasks:.1f}")
    jax.config.update("jax_enable_x64", True)
    for chunk, few, many in ((16, 10, 210), (512, 4, 24)):
        of_study(few * chunk, chunk)
        seconds = of_study(many * chunk, chunk) - of_study(few * chunk, chunk)
        table.add(f"{chunk}, of a study, stored", many - few, f"{1e3 * seconds / (many - few):.1f}")


if __name__ == "__main__":
    main()
