"""Chunks computed here, or as tasks of Dask distributed, and stored as they come."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from typing import Any

from modalax.study.work import Row, Work

AHEAD = 3  # tasks handed out ahead for each worker, so that none waits
RETRIES = 3  # how often a task is tried again whose worker failed
DEATHS = 10  # workers that may end during one task before the task is given up

Stored = Callable[[int, Sequence[Row]], None]


def here(work: Work, chunks: Sequence[int], stored: Stored) -> None:
    """Compute chunks in this process, one after the other."""
    for k in chunks:
        stored(k, rows_of(work, k))


def rows_of(work: Work, k: int) -> list[Row]:
    """The rows of one chunk; one thread for the linear algebra library, so that they do not depend on its threads."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        return work.rows(k)


def task(blob: bytes, k: int, double: bool) -> list[Row]:
    """What a worker does: one chunk of the work that ``blob`` holds."""
    if double:
        import jax

        jax.config.update("jax_enable_x64", True)
    return rows_of(_restored(blob), k)


_latest: list[Any] = [b"", None]


def _restored(blob: bytes) -> Work:
    """The work, unpacked once for all chunks that this process computes."""
    if _latest[0] != blob:
        _latest[:] = [blob, pickle.loads(blob)]
    return _latest[1]


def has_dask() -> bool:
    """Whether Dask distributed is installed."""
    return find_spec("distributed") is not None


def on_dask(
    work: Work, chunks: Sequence[int], stored: Stored, scheduler: str | None, workers: int, modules: Sequence[Any]
) -> None:
    """Compute chunks on Dask, a few ahead for each worker.

    Parameters
    ----------
    scheduler
        Address of a scheduler; a cluster of processes on this machine if None.
    workers
        Number of those processes.
    modules
        Modules that the workers may not have, sent along.

    Raises
    ------
    ValueError
        If the scheduler cannot be reached or was lost, or workers end on a chunk again and again.
    """
    from distributed import KilledWorker, as_completed
    from distributed.comm.core import CommClosedError

    with client_of(scheduler, workers) as client:
        blob = packed(work, modules)
        shared = client.submit(bytes, blob, pure=False)  # a task, so that it can be made again if its worker ends
        hand = lambda k: client.submit(task, shared, k, double(), pure=False, retries=RETRIES)
        waiting = iter(chunks)
        ahead = AHEAD * max(1, sum(client.ncores().values()))
        numbers = {hand(k): k for k in islice(waiting, ahead)}
        running = as_completed(list(numbers), loop=client.loop)
        k = 0
        try:
            for future in running:
                k = numbers.pop(future)
                stored(k, future.result())
                future.release()
                for more in islice(waiting, 1):
                    numbers[new := hand(more)] = more
                    running.add(new)
        except KilledWorker as error:
            raise ValueError(
                f"workers ended {DEATHS} times while computing chunk {k}: out of memory, or killed. What is done is "
                "kept; start again with a smaller memory_mb or chunk"
            ) from error
        except (CommClosedError, TimeoutError) as error:
            raise ValueError(f"the scheduler was lost ({error}); what is done is kept, start again to go on") from error


@contextmanager
def client_of(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of a scheduler, or of a cluster of processes of its own.

    Raises
    ------
    ValueError
        If there is no scheduler at the address.
    """
    import logging

    from dask.config import set as configured
    from distributed import Client, LocalCluster

    with configured({"distributed.scheduler.allowed-failures": DEATHS}):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="20s", set_as_default=False)
            except (OSError, ValueError) as error:
                raise ValueError(f"no Dask scheduler answers at {scheduler}: {error}") from error
            with client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None,
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):  # fmt: skip
            yield client


def packed(work: Work, modules: Sequence[Any] = ()) -> bytes:
    """The work as bytes, with the code of ``modules`` where the workers may not have them."""
    import cloudpickle

    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        return cloudpickle.dumps(work)
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def double() -> bool:
    """Whether this process computes in double precision; jax is not loaded to find out."""
    import sys

    jax = sys.modules.get("jax")
    return jax is not None and bool(jax.config.jax_enable_x64)
