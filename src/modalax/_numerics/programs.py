"""Compiled programs that a process no longer has room for."""

from pathlib import Path

import jax

MAPS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.6  # share of the memory maps that a process may have


def release_programs(maps: Path = MAPS, limit: Path = LIMIT) -> bool:
    """Let compiled programs go where the next few hundred might not fit; True if they went.

    Every program compiled for the CPU takes some tens of memory maps. Linux allows a process 65,530 of them, and one
    that has used them up ends without an exception. Batches over data of many sizes get there after a few dozen. The
    compilation cache on disk, where there is one, gives the programs back.
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
