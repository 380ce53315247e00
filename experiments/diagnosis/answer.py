"""Diagnose every case of a draw without its truth: ``python experiments/diagnosis/answer.py FOLDER``.

Writes ``FOLDER/answers/NAME.json``: what ``modalax.diagnose(...).to_dict()`` says, and the seconds it took. Answers
that are there already are kept. ``--part 1/2`` and ``--part 2/2`` share a draw between two processes. ``--question
free`` asks what no linear model explains, into ``FOLDER/answers-free``. ``--time`` is the budget of one diagnosis.
"""

import argparse
import json
import os
import time
import warnings
import zlib
from pathlib import Path

import jax
from rich.progress import track


def answer(folder: Path, question: str = "auto", seconds: float = 120.0) -> dict:
    """The diagnosis of one case in a budget of seconds, or the error that it ended in."""
    from modalax.diagnose import diagnose
    from modalax.files import load

    start = time.perf_counter()
    try:
        measured, simulated = load(folder / "measurement.npz"), load(folder / "simulation.npz")
        said = diagnose(measured, simulated, question=question, time=seconds)
        result = said.to_dict()
    except Exception as error:  # one bad case must not end a long draw; it is counted and shown
        result = {"verdict": "error", "causes": [], "alternatives": [], "error": f"{type(error).__name__}: {error}"}
    return {**result, "seconds": time.perf_counter() - start}


def prepare() -> None:
    """Double precision, a compilation cache, and no warnings between the progress bars."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    jax.config.update("jax_enable_x64", True)
    cache = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "modalax"))
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    warnings.simplefilter("ignore")


def answers_to(question: str) -> str:
    """Folder of the answers to a question."""
    return "answers" if question == "auto" else f"answers-{question}"


def run(
    folder: Path,
    part: tuple[int, int] = (1, 1),
    only: str = "",
    redo: bool = False,
    question: str = "auto",
    seconds: float = 120.0,
) -> None:
    prepare()
    cases = [p for p in (folder / "cases").iterdir() if only in p.name]
    # in no order of causes, so that a draw that is stopped early is still a fair sample
    cases = sorted(cases, key=lambda p: zlib.crc32(p.name.encode()))[part[0] - 1 :: part[1]]
    out = folder / answers_to(question)
    out.mkdir(exist_ok=True)
    todo = [c for c in cases if redo or not (out / f"{c.name}.json").exists()]
    for case in track(todo, "diagnosing"):
        (out / f"{case.name}.json").write_text(json.dumps(answer(case, question, seconds), indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--redo", action="store_true")
    parser.add_argument("--question", default="auto", choices=("auto", "fixed", "free"))
    parser.add_argument("--time", type=float, default=120.0, help="seconds that a diagnosis is given")
    args = parser.parse_args()
    first, parts = (int(n) for n in args.part.split("/"))
    run(args.folder, (first, parts), args.only, args.redo, args.question, args.time)


if __name__ == "__main__":
    main()
