"""Continuous records cut into blocks: one a hit, one a period, or overlapping ones of random excitation."""

from dataclasses import replace

import numpy as np

from modalax.check.records import Records
from modalax.data.excitation import excitation_of
from modalax.data.hits import find_hits

# A block of a hit begins this share of itself before the hit; gaps shorter than this share of the middle are rebounds.
BEFORE, REBOUND = 0.02, 0.2
# A hit is found above this share of the largest force.
TRIGGER = 0.2
# Blocks that random records are cut into, each half over the next.
RANDOM = 16


def cut(records: Records) -> Records:
    """Blocks of a record that is one piece; records that are blocks already stay, with their kind told."""
    kind = excitation_of(records.force)
    if len(records.force) > 1:
        return replace(records, kind="hits" if kind.kind == "hits" else "blocks")
    if kind.kind == "hits":
        return _hits(records)
    if kind.kind == "multisine":
        count = records.force.shape[1] // kind.period
        return _parts(records, [k * kind.period for k in range(count)], kind.period, "periods")
    if kind.kind in ("sweep", "stepped"):
        return replace(records, kind="blocks")
    length = 2 * records.force.shape[1] // (RANDOM + 1)
    starts = [k * (length // 2) for k in range(RANDOM) if k * (length // 2) + length <= records.force.shape[1]]
    return _parts(records, starts, length, "random")


def _parts(records: Records, starts: list[int], length: int, kind: str) -> Records:
    force = np.stack([records.force[0, a : a + length] for a in starts])
    response = np.stack([records.response[0, a : a + length] for a in starts])
    return replace(records, force=force, response=response, kind=kind)


def _hits(records: Records) -> Records:
    force, samples = records.force[0], records.force.shape[1]
    size = np.abs(force - np.median(force))
    rises = np.flatnonzero(np.diff((size > TRIGGER * size.max()).astype(int)) == 1) + 1
    gaps = np.diff(rises)
    wide = gaps[gaps > max(REBOUND * np.median(gaps), 0.02 * samples)] if len(gaps) else gaps
    if not len(wide):
        return replace(records, kind="hits")
    length = int(min(0.98 * wide.min(), max(samples - rises[-1], 0.7 * wide.min())))
    before = min(int(BEFORE * length), int(rises[0]))
    hits = find_hits(
        force - np.median(force), records.response[0], records.fs, block=length / records.fs, trigger=TRIGGER,
        pretrigger=before / records.fs,
    )  # fmt: skip
    return _parts(records, hits.start.tolist(), hits.samples, "hits")
