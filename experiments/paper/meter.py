"""What a method costs: seconds, and memory where the system tells it."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROCESS = Path("/proc/self")


class Meter:
    """Seconds that each method took in all, and by how much it raised the memory in use at most [MB]."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.megabytes: dict[str, float] = {}

    @contextmanager
    def running(self, name: str) -> Iterator[None]:
        """Count what happens inside for this method."""
        _forget_peak()
        before, tick = _memory("VmRSS"), time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - tick
        self.megabytes[name] = max(self.megabytes.get(name, 0.0), _memory("VmHWM") - before)


def _forget_peak() -> None:
    if PROCESS.exists():
        (PROCESS / "clear_refs").write_text("5")


def _memory(key: str) -> float:
    """A line of the process's own status [MB]; NaN on systems other than Linux."""
    if not PROCESS.exists():
        return float("nan")
    lines = (PROCESS / "status").read_text().splitlines()
    return next(float(line.split()[1]) / 1e3 for line in lines if line.startswith(key + ":"))
