"""What the scheduler of a study costs a task: ``python experiments/benchmarks/scheduler.py``.

Tasks that compute nothing go through Dask distributed to one worker process, ten at a time, and bring back rows as a
study of five modes has them. CPU seconds of the process with client and scheduler, which is what saturates when workers
are added.
"""

import time

from common import Table, machine


def rows_of(k: int, count: int) -> list[dict]:
    """The rows of a chunk, of made-up numbers."""
    names = [f"{what}_{mode}" for mode in range(1, 6) for what in ("frequency_hz", "damping_ratio", "stability")]
    return [{"item": i, **{n: 1e-3 * (i + k) for n in names}, "failed": False, "reason": ""} for i in range(count)]


def main() -> None:
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


if __name__ == "__main__":
    main()
