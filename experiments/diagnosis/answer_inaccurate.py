"""Diagnose every case of a draw within a budget: ``python experiments/diagnosis/answer_inaccurate.py FOLDER``.

Appends to ``FOLDER/answers.jsonl``, one line a case: its name, what ``modalax.diagnose(...).to_dict()`` says, and the
seconds it took. Cases that have a line are left alone, so a run can be stopped and taken up again. A case that has no
answer after ``--limit`` seconds is stopped and counted as ``no answer``. ``--time`` is the budget that the diagnosis
itself is given, where it takes one.
"""

import argparse
import json
import multiprocessing
import time
import zlib
from pathlib import Path

from rich.progress import track


def serve(pipe, budget: float | None) -> None:
    """Answer folder after folder in one process, which keeps what it has compiled."""
    import inspect

    from answer import prepare

    prepare()
    from modalax.diagnose import diagnose
    from modalax.files import load

    options = {"time": budget} if budget and "time" in inspect.signature(diagnose).parameters else {}
    while True:
        folder = Path(pipe.recv())
        start, cpu = time.perf_counter(), time.process_time()
        try:
            said = diagnose(load(folder / "measurement.npz"), load(folder / "simulation.npz"), **options).to_dict()
        except Exception as error:  # one bad case must not end a long draw; it is counted and shown
            said = {"verdict": "error", "causes": [], "error": f"{type(error).__name__}: {error}"}
        pipe.send({**said, "seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu})


class Worker:
    """A process that answers, started afresh after a case that took too long."""

    def __init__(self, budget: float | None):
        self.budget, self.process = budget, None

    def ask(self, folder: Path, limit: float) -> dict:
        """What is said of one case; ``no answer`` after ``limit`` seconds."""
        start = time.perf_counter()
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.pipe, other = context.Pipe()
            self.process = context.Process(target=serve, args=(other, self.budget), daemon=True)
            self.process.start()
            other.close()  # so that the end of the process ends the waiting for it
        try:
            self.pipe.send(str(folder))
            if self.pipe.poll(limit):
                return self.pipe.recv()
            reason = f"stopped after {limit:g} s"
        except (EOFError, OSError):
            self.process.join()
            reason = f"the process ended with status {self.process.exitcode}"
        self.process.kill()
        self.process.join()
        self.process = None
        return {"verdict": "no answer", "causes": [], "error": reason, "seconds": time.perf_counter() - start}


def answered(folder: Path) -> dict[str, dict]:
    """Answers that are there, by name."""
    file = folder / "answers.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    return {said["name"]: said for said in map(json.loads, lines)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--time", type=float, default=60.0, help="seconds that a diagnosis is given")
    parser.add_argument("--limit", type=float, default=180.0, help="seconds after which a case is stopped")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--most", type=int, help="stop after so many")
    args = parser.parse_args()
    done = answered(args.folder)
    # in no order of kinds, so that a run that is stopped early is still a fair sample; one test measured in several
    # ways comes at once, so that it can be compared
    order = lambda n: (zlib.crc32(n.split("-l")[0].encode()), n)
    names = sorted((p.name for p in (args.folder / "cases").iterdir()), key=order)
    todo = [n for n in names if args.only in n and n not in done][: args.most]
    worker = Worker(args.time)
    with (args.folder / "answers.jsonl").open("a") as file:
        for name in track(todo, "diagnosing"):
            said = worker.ask(args.folder / "cases" / name, args.limit)
            file.write(json.dumps({"name": name, **said}) + "\n")
            file.flush()


if __name__ == "__main__":
    main()
