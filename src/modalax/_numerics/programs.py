"""Releasing compiled programs before a process runs out of memory or memory maps."""

import ctypes
import gc
import os
import platform
from pathlib import Path

import jax

MAPS, LIMIT, USED = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count"), Path("/proc/self/statm")
FULL = 0.6  # share of the memory maps a process may have from which on programs are released
GROWN = 0.1  # share of the machine's memory that a process may grow by before they are
_kept = [0]  # pages of memory that the process had when they were last released


def release_programs(maps: Path = MAPS, limit: Path = LIMIT, used: Path = USED) -> bool:
    """Release all compiled programs if the process has become large; True if they were released.

    Every program compiled for the CPU takes some tens of memory maps and a megabyte. Linux allows a process 65,530
    maps, and a process that has used them up ends without an exception. Batches of measurements of many different sizes
    get there after a few dozen, and hold gigabytes long before. A program that is needed again comes from the
    compilation cache on disk, where there is one.
    """
    try:
        with maps.open() as lines:
            many = sum(1 for _ in lines) >= FULL * int(limit.read_text())
        pages = int(used.read_text().split()[1])
    except (OSError, ValueError):  # not Linux
        return False
    if not many and pages - _kept[0] < GROWN * os.sysconf("SC_PHYS_PAGES"):
        return False
    jax.clear_caches()
    gc.collect()
    if platform.libc_ver()[0] == "glibc":  # which keeps what was freed
        ctypes.CDLL(None).malloc_trim(0)
    _kept[0] = int(used.read_text().split()[1])
    return True
