"""Damaged and hostile files of every kind that is read: each is refused in one line, or what it holds is sound.

A sound file is damaged (bytes flipped, cut out, put in, repeated, taken from another file; numbers in text replaced by
extreme ones; arrays of a wrong shape, type or value), then read. Failures are: an error that is neither a ValueError
nor one of the operating system or that does not name the file in one line; over ten seconds; over twice the file's
size and 1 GB of memory; anything executed; anything accepted that the file contract refuses.

A file is damaged as its number and the seed say, so a part of the files is the same however many are tried.

usage: python experiments/files/fuzz.py [--files 10000] [--seed 0] [--part 1/4 --tally FILE] [--keep FOLDER] [KIND ...]
"""

import argparse
import contextlib
import json
import random
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from fuzz_damage import make  # noqa: E402
from fuzz_kinds import KINDS, unsound  # noqa: E402

sys.path.remove(str(Path(__file__).parent))

SECONDS, BYTES = 10, 1e9
EXECUTION = (
    "pickle.find_class", "os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "socket.connect",
)  # fmt: skip
executed: list[str] = []


def sound_files(folder: Path, kinds: list[str]) -> dict[str, Path]:
    """One sound file of each of these kinds."""
    paths = {name: folder / f"{name}.{KINDS[name].ending}" for name in kinds}
    for name, path in paths.items():
        KINDS[name].write(path)
    return paths


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Stop what takes too long."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"over {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


class Peak:
    """Memory that this process takes at most from now on, beyond what it has [bytes]; of Linux only."""

    def __init__(self) -> None:
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
        self.begin = self._told("VmRSS")

    def grown(self) -> int:
        """Bytes beyond those at the beginning, at the highest."""
        return self._told("VmHWM") - self.begin

    @staticmethod
    def _told(name: str) -> int:
        with contextlib.suppress(OSError):
            for line in Path("/proc/self/status").read_text().splitlines():
                if line.startswith(name):
                    return 1024 * int(line.split()[1])
        return 0


def tried(name: str, path: Path, sound: Path) -> tuple[str, str]:
    """Read a file: how it ended (``refused``, ``sound`` or a failure), and the words."""
    count, peak = len(executed), Peak()
    outcome, words = _read(name, path, sound)
    grown, size = peak.grown(), sum(p.stat().st_size for p in [path, *path.rglob("*")] if p.is_file())
    if len(executed) > count:
        return "executed", str(executed[count:])
    if grown > 2 * size + BYTES:
        return "memory", f"{grown / 1e6:.0f} MB for a file of {size / 1e6:.3g} MB; {words}"
    return outcome, words


def _read(name: str, path: Path, sound: Path) -> tuple[str, str]:
    try:
        with warnings.catch_warnings(), limited(SECONDS):
            warnings.simplefilter("ignore")
            problem = unsound(KINDS[name].read(path, sound))
        return ("accepted", problem) if problem else ("sound", "")
    except TimeoutError as error:
        return "hang", str(error)
    except (ValueError, OSError) as error:
        words = str(error)
        good = str(path) in words and "\n" not in words and "cannot be used: unexpected" not in words
        return ("refused" if good else "unclear"), words
    except BaseException as error:
        return "foreign", f"{type(error).__name__}: {error}"


def watch() -> None:
    """Take down everything that would execute something."""
    sys.addaudithook(lambda event, args: executed.append(event) if event.startswith(EXECUTION) else None)


def run(numbers: range, seed: int, kinds: list[str], keep: Path | None = None) -> Iterator[tuple[str, str, str]]:
    """Try the files of these numbers, in turn over the kinds; each as kind, end and words."""
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "sound").mkdir()
        sound = sound_files(Path(name) / "sound", kinds)
        for which in kinds:
            end = _read(which, sound[which], sound[which])
            assert end[0] == "sound", (which, end)
        for k in numbers:
            which = kinds[k % len(kinds)]
            path = make(which, sound, Path(name), random.Random(f"{seed} {k}"))
            end, words = tried(which, path, sound[which])
            if keep is not None and end not in ("refused", "sound"):
                keep.mkdir(exist_ok=True)
                (shutil.copytree if path.is_dir() else shutil.copy)(path, keep / f"{k}-{end}-{path.name}")
            yield which, end, words


def main(argv: list[str] | None = None) -> int:
    """Try as many files as the command line asks for, and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS), metavar="KIND")
    parser.add_argument("--files", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--part", default="1/1", metavar="K/N", help="the K-th of N equal parts of the files")
    parser.add_argument("--tally", type=Path, help="JSON file of counts, to which those of this part are added")
    parser.add_argument("--keep", type=Path, help="folder to keep the files that failed")
    options = parser.parse_args(argv)
    part, parts = (int(v) for v in options.part.split("/"))
    numbers = range(options.files * (part - 1) // parts, options.files * part // parts)
    watch()
    begin = time.process_time()
    told = json.loads(options.tally.read_text()) if options.tally and options.tally.exists() else {}
    ends = {name: Counter(told.get(name, {})) for name in options.kinds}
    for which, end, words in run(numbers, options.seed, options.kinds, options.keep):
        ends[which][end] += 1
        if end not in ("refused", "sound"):
            print(f"{which}: {end}: {words[:300]}", flush=True)
    seconds = time.process_time() - begin + told.get("seconds", 0.0)
    if options.tally:
        options.tally.write_text(json.dumps({**ends, "seconds": seconds}))
    for name, counted in ends.items():
        print(f"{name}: " + ", ".join(f"{n} {end}" for end, n in counted.most_common()))
    total: Counter[str] = sum(ends.values(), Counter())
    failures = total.total() - total["refused"] - total["sound"]
    print(
        f"{total.total()} files: {total['refused']} refused in one line, {total['sound']} read and sound, "
        f"{failures} failures; {seconds:.0f} s of processor time"
    )
    return min(failures, 1)


if __name__ == "__main__":
    sys.exit(main())
