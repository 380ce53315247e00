"""Diagnose every case of a draw without its truth: ``python experiments/diagnosis/answer.py FOLDER [--workers 2]``.

Writes ``FOLDER/answers/NAME.json``: what ``modalax.diagnose(...).to_dict()`` says, and the seconds it took. Answers
that are there already are kept, so that a run can be stopped and taken up again; a ``modalax.study`` shares the others
out to workers, here or, with ``--scheduler ADDRESS``, wherever the folder can be reached. ``--time`` is the budget of
one diagnosis; one that takes more than ``--limit`` seconds counts as ``no answer``. ``--question free`` asks what no
linear model explains, into ``FOLDER/answers-free``. ``--keep FILE`` writes all answers into one file, one a line.
"""

import argparse
import json
import os
import tempfile
import time
import warnings
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax


def diagnosed(folder: Path, question: str = "auto", seconds: float = 120.0, limit: float = float("inf")) -> dict:
    """The diagnosis of the case in a folder, in a budget of seconds, or the error that it ended in."""
    from modalax.diagnose import diagnose
    from modalax.files import load

    start, cpu = time.perf_counter(), time.process_time()
    try:
        measured, simulated = load(folder / "measurement.npz"), load(folder / "simulation.npz")
        said = diagnose(measured, simulated, question=question, time=seconds).to_dict()
    except Exception as error:  # one bad case must not end a long draw; it is counted and shown
        said = {"verdict": "error", "causes": [], "alternatives": [], "error": f"{type(error).__name__}: {error}"}
    took = time.perf_counter() - start
    if took > limit:
        said = {"verdict": "no answer", "causes": [], "alternatives": [], "error": f"more than {limit:g} s"}
    return {**said, "seconds": took, "cpu_seconds": time.process_time() - cpu}


def prepare() -> None:
    """Double precision, a compilation cache, and no warnings between the lines of progress."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    jax.config.update("jax_enable_x64", True)
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "modalax"))
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    warnings.simplefilter("ignore")


def one(seed: int, number: int, cases: Sequence[str], out: str, options: dict[str, Any]) -> dict[str, Any]:
    """One draw of the study: answer a case and write the answer down."""
    del seed  # the cases are drawn already
    prepare()
    case = Path(cases[number])
    said = diagnosed(case, **options)
    write(Path(out) / f"{case.name}.json", said)
    return {"name": case.name, "verdict": said["verdict"], "seconds": said["seconds"]}


def write(file: Path, content: dict) -> None:
    """Write a file whole or not at all, whenever the process is ended."""
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1))
    part.replace(file)


def shared_out(
    function: Callable, count: int, parameters: dict[str, Any], workers: int = 1, scheduler: str | None = None
) -> None:
    """Call ``function(seed, number=..., **parameters)`` for every number, a task each, by workers."""
    from modalax.study import study

    if not count:
        return
    name = (
        f"{Path(function.__code__.co_filename).stem}:{function.__name__}"  # by name, for a script is __main__ to itself
    )
    settings = {"kind": "function", "draws": count, "chunk": 1, "function": name, "parameters": parameters}
    with tempfile.TemporaryDirectory() as folder:
        found = study(settings, folder, scheduler=scheduler, workers=workers if workers > 1 else 0, progress=print)
    for reason in sorted({str(r) for r in found.columns["reason"] if str(r)}):
        print(f"failed: {reason}")


def answers_to(question: str) -> str:
    """Folder of the answers to a question."""
    return "answers" if question == "auto" else f"answers-{question}"


def answered(folder: Path) -> list[dict]:
    """Answers that a folder holds, one a file, or a file, one a line."""
    if folder.is_file():
        return [json.loads(line) for line in folder.read_text().splitlines()]
    return [{"name": file.stem, **json.loads(file.read_text())} for file in sorted(folder.glob("*.json"))]


def keep(folder: Path, file: Path) -> None:
    """Write the answers of a folder into one file, one a line."""
    file.write_text("".join(json.dumps(said) + "\n" for said in answered(folder)))


def run(
    folder: Path, only: str = "", question: str = "auto", most: int | None = None, workers: int = 1,
    scheduler: str | None = None, **options: Any,
) -> None:  # fmt: skip
    """Answer what has no answer yet."""
    out = (folder / answers_to(question)).resolve()
    out.mkdir(exist_ok=True)
    # In no order of causes, so that a draw that is stopped early is still a fair sample; one test measured in several
    # ways comes at once, so that it can be compared.
    order = lambda case: (zlib.crc32(case.name.split("-l")[0].encode()), case.name)
    cases = sorted((p for p in (folder / "cases").resolve().iterdir() if only in p.name), key=order)
    todo = [str(c) for c in cases if not (out / f"{c.name}.json").exists()][:most]
    given = {"cases": todo, "out": str(out), "options": {"question": question, **options}}
    shared_out(one, len(todo), given, workers, scheduler)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--question", default="auto", choices=("auto", "fixed", "free"))
    parser.add_argument("--time", type=float, default=120.0, help="seconds that a diagnosis is given")
    parser.add_argument("--limit", type=float, default=400.0, help="seconds after which an answer does not count")
    parser.add_argument("--most", type=int, help="stop after so many")
    parser.add_argument("--workers", type=int, default=1, help="processes on this machine")
    parser.add_argument("--scheduler", help="address of a Dask scheduler")
    parser.add_argument("--keep", type=Path, help="file for all answers")
    args = parser.parse_args()
    run(
        args.folder, args.only, args.question, args.most, args.workers, args.scheduler, seconds=args.time,
        limit=args.limit,
    )  # fmt: skip
    if args.keep:
        keep(args.folder / answers_to(args.question), args.keep)


if __name__ == "__main__":
    main()
