"""Releasing compiled programs before a process runs out of memory maps."""

from pathlib import Path

import jax

MAPS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.6  # share of the memory maps a process may have from which on programs are released


def release_programs(maps: Path = MAPS, limit: Path = LIMIT) -> bool:
    """Release all compiled programs if most of the memory maps of the process are in use; True if they were released.

    Every program compiled for the CPU takes some tens of memory maps. Linux allows a process 65,530 of them, and a
    process that has used them up ends without an exception. Batches of measurements of many different sizes get there
    after a few dozen. A program that is needed again comes from the compilation cache on disk, where there is one.
    """
    try:
        with maps.open() as lines:
            used = sum(1 for _ in lines)
        allowed = int(limit.read_text())
    except (OSError, ValueError):  # not Linux
        return False
    if used < FULL * allowed:
        return False
    jax.clear_caches()
    return True
