"""A long study killed every minute: ``python experiments/study/kill.py --draws 20000 --every 60``.

A noise study of the five-degree-of-freedom system, each draw refined by maximum likelihood, runs as a user runs it, on
two processes of this machine. Again and again something is killed without warning, in turn: everything at once, as
when the machine fails; the client alone; one worker. After the first two the study is started again. A process needs
some 10 s until its first fit, more on a busy machine, so that kills every few seconds would leave no time for work.

At the end

- every chunk that stood when something was killed is still the same file: nothing was lost, nothing done twice;
- some chunks, drawn by chance, are computed anew in this process and agree bit for bit (``--whole``: all of them);
- no process of the study is left.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

SETTINGS = """
kind = "noise"
draws = {draws}
seed = 5
chunk = {chunk}
[system]
simulation = "five_dof"
band = [20.0, 70.0]
step = {step}
noise = 0.02
[fit]
refine = true
"""
GONE = 30.0  # seconds within which the workers of a client that was killed must end by themselves


def begin(path: Path, workers: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "modalax", "study", str(path), "--workers", str(workers)]
    with path.with_suffix(".log").open("ab") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)


def chunks(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Every stored chunk: which file it is, when it was written, and its size."""
    rows = folder / "rows"
    found = [e for e in os.scandir(rows) if not e.name.startswith(".")] if rows.is_dir() else []
    return {e.name: (e.stat().st_ino, e.stat().st_mtime_ns, e.stat().st_size) for e in found}


def kill(process: subprocess.Popen[bytes], what: str) -> list[psutil.Process]:
    """Kill everything, the client, or one worker; the processes that must end by themselves then."""
    children = psutil.Process(process.pid).children(recursive=True)
    busy = [p for p in children if p.is_running() and p.cpu_times().user > 0.5]
    if what == "worker":
        if busy:
            random.choice(busy).kill()
        return []
    if what == "everything":
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    return children


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=20000)
    parser.add_argument("--chunk", type=int, default=16)
    parser.add_argument("--step", type=float, default=0.1, help="distance of the frequency lines [Hz]")
    parser.add_argument("--every", type=float, default=60.0, help="seconds between kills")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--check", type=int, default=10, help="chunks that are computed anew")
    parser.add_argument("--whole", action="store_true", help="compute all chunks anew")
    parser.add_argument("--folder", type=Path, help="where to work, and to go on; a temporary folder if not given")
    args = parser.parse_args()
    home = args.folder or Path(tempfile.mkdtemp(prefix="modalax-kill-"))
    home.mkdir(exist_ok=True)
    path, out = home / "study.toml", home / "study-results"
    path.write_text(SETTINGS.format(draws=args.draws, chunk=args.chunk, step=args.step))
    total = -(-args.draws // args.chunk)
    kinds, killed, stood = ["everything", "client", "worker"], 0, {}
    start, process = time.monotonic(), begin(path, args.workers)
    while True:
        try:
            process.wait(args.every)
        except subprocess.TimeoutExpired:
            pass
        else:
            if process.returncode:
                sys.exit(f"the study ended with {process.returncode}; see {path.with_suffix('.log')}")
            break
        what = kinds[killed % len(kinds)]
        orphans = kill(process, what)
        killed += 1
        _, alive = psutil.wait_procs(orphans, timeout=GONE)
        if alive:
            sys.exit(f"{len(alive)} processes were still at work {GONE:g} s after {what} was killed")
        now = chunks(out)
        changed = [name for name, mark in stood.items() if now.get(name) != mark]
        if changed:
            sys.exit(f"chunks were lost or done twice: {', '.join(changed)}")
        stood = now
        print(f"{time.monotonic() - start:6.0f} s: {what} killed, {len(now)} of {total} chunks stored", flush=True)
        if what != "worker":
            process = begin(path, args.workers)
    now = chunks(out)
    changed = [name for name, mark in stood.items() if now.get(name) != mark]
    checked = total if args.whole else min(args.check, total)
    different = anew(path, out, checked)
    print(
        f"{killed} kills in {time.monotonic() - start:.0f} s, {len(now)} of {total} chunks stored, {len(changed)} of "
        f"those that stood at a kill lost or done twice, {different} of {checked} computed anew differ; {home}"
    )
    sys.exit(bool(changed or different or len(now) != total))


def anew(path: Path, out: Path, count: int) -> int:
    """How many of some chunks differ, in any bit, from what this process computes for them."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from modalax.study.engine import rows_of
    from modalax.study.run import prepared
    from modalax.study.settings import read_settings
    from modalax.study.store import Store, columns_of, write_rows

    work, store, different = prepared(read_settings(path), path.parent), Store(out), 0
    for k in sorted(random.sample(range(work.chunks), count)):
        again = path.parent / f"again{store.file(k).suffix}"
        write_rows(again, columns_of(rows_of(work, k)))
        different += again.read_bytes() != store.file(k).read_bytes()
    return different


if __name__ == "__main__":
    main()
