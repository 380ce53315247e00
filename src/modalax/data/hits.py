"""Hammer hits in a time record: found, cut out and checked."""

import warnings
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

# A force counts as in contact from where it exceeds CONTACT of its peak until it falls below RELEASE of it. What an
# anti-alias filter rings after a sharp hit stays below 10 % of the peak.
CONTACT, RELEASE = 0.15, 0.05
# So many equal samples in a row at the largest value of a channel are a clipped peak, not a rounded one.
CLIPPED = 3


class Hits(eqx.Module):
    """Hits found in a force record.

    Attributes
    ----------
    start
        First sample of each block, shape ``(m,)``.
    samples
        Length of a block.
    peak
        Largest force of each hit, shape ``(m,)`` [N].
    double
        Whether the hammer touched more than once within the block, shape ``(m,)``.
    overload
        Whether a channel was clipped within the block, shape ``(m,)``.
    """

    start: Int[np.ndarray, " m"]
    peak: Float[np.ndarray, " m"]
    double: Bool[np.ndarray, " m"]
    overload: Bool[np.ndarray, " m"]
    samples: int = eqx.field(static=True)

    @property
    def good(self) -> Bool[np.ndarray, " m"]:
        """Hits that are neither double nor clipped."""
        return ~(self.double | self.overload)

    def cut(self, record: Float[np.ndarray, "t c"]) -> Float[np.ndarray, "m block c"]:
        """Blocks of a record, one for each hit, good or not."""
        return np.stack([record[k : k + self.samples] for k in self.start])


def find_hits(
    force: Any,
    response: Any,
    fs: float,
    *,
    block: float,
    trigger: float = 0.2,
    pretrigger: float = 0.0,
    full_scale: Any = None,
) -> Hits:
    """Find hammer hits by a force threshold, and flag double hits and overloads.

    Parameters
    ----------
    force
        Force record, shape ``(t,)`` [N]; hits may point either way.
    response
        Response records, shape ``(t, o)``.
    fs
        Sampling rate [Hz].
    block
        Length of the block kept of each hit [s]. A hit within the block of another counts as its double.
    trigger
        Threshold, as a share of the largest force of the record.
    pretrigger
        How long before the threshold a block starts [s].
    full_scale
        Largest value that the channels can hold: one number, or one for each channel, the force first. If None,
        clipping is found from runs of equal samples at a channel's largest value alone.

    Raises
    ------
    ValueError
        If no hit with a whole block around it is found.
    """
    force, response = np.asarray(force, float), np.asarray(response, float)
    if force.ndim != 1 or response.ndim != 2 or len(force) != len(response):
        raise ValueError(
            f"force has shape {force.shape} and response {response.shape}; they need (t,) and (t, o) with one t"
        )
    samples, before = round(block * fs), round(pretrigger * fs)
    size = np.abs(force)
    rising = np.flatnonzero(np.diff((size > trigger * size.max()).astype(int)) == 1) + 1
    starts, cut_off, end = [], 0, 0
    for k in rising:
        if k < end:
            continue
        start = int(k) - before
        end = start + samples
        if start < 0 or end > len(force):
            cut_off += 1
        else:
            starts.append(start)
    if cut_off:
        warnings.warn(
            f"{cut_off} hits left out: the record of {len(force) / fs:g} s does not hold their whole block of "
            f"{block:g} s with {pretrigger:g} s before the trigger",
            stacklevel=2,
        )
    if not starts:
        raise ValueError(
            f"no whole hit in {len(force) / fs:g} s: the force rises {len(rising)} times above the trigger of "
            f"{trigger * size.max():g} N; at least one hit with a block of {block:g} s is needed"
        )
    clipped = np.any(clipped_samples(np.column_stack([force, response]), full_scale), axis=1)
    blocks = [slice(k, k + samples) for k in starts]
    return Hits(
        start=np.array(starts),
        peak=np.array([size[b].max() for b in blocks]),
        double=np.array([contacts(force[b]) > 1 for b in blocks]),
        overload=np.array([bool(np.any(clipped[b])) for b in blocks]),
        samples=samples,
    )


def contacts(force: Float[np.ndarray, " t"]) -> int:
    """How often the force rises above ``CONTACT`` of its peak after having fallen below ``RELEASE`` of it."""
    size = np.abs(force) / max(np.abs(force).max(), np.finfo(float).tiny)
    events = np.where(size > CONTACT, 1, np.where(size < RELEASE, -1, 0))
    events = events[events != 0]
    return int(np.sum(np.diff(np.concatenate([[-1], events])) == 2))


def clipped_samples(channels: Float[np.ndarray, "t c"], full_scale: Any = None) -> Bool[np.ndarray, "t c"]:
    """Samples at the full scale, or at the largest or smallest value of a channel that stays there.

    A channel clips at its extreme if ``CLIPPED`` or more samples in a row are there; then each sample there is clipped.
    """
    flags = np.zeros(channels.shape, bool)
    if full_scale is not None:
        flags |= np.abs(channels) >= np.broadcast_to(np.asarray(full_scale, float), channels.shape[1:])
    for extreme in (channels.max(axis=0), channels.min(axis=0)):
        at = (channels == extreme) & (extreme != 0)
        flags |= at & _stays(at)
    return flags


def _stays(at: Bool[np.ndarray, "t c"]) -> Bool[np.ndarray, " c"]:
    """Whether a channel is there for ``CLIPPED`` or more samples in a row."""
    ends = len(at) - CLIPPED + 1
    return np.all([at[k : k + ends] for k in range(CLIPPED)], axis=0).any(axis=0) if ends > 0 else at[0] & False


def clipped_records(force: Float[np.ndarray, "m t i"], response: Float[np.ndarray, "m t o"]) -> Bool[np.ndarray, "m t"]:
    """Samples of several records at which a channel is clipped.

    A level at which one record clips holds in all of them; a record may also clip at a lower level of its own.
    """
    records = np.concatenate([force, response], axis=2)
    together = clipped_samples(records.reshape(-1, records.shape[2])).reshape(records.shape)
    return np.any([together[k] | clipped_samples(record) for k, record in enumerate(records)], axis=2)


def good_hits(hits: Hits) -> Hits:
    """The good hits only, with a warning that names those left out.

    Raises
    ------
    ValueError
        If none is good.
    """
    for which, what in ((hits.double, "double hits"), (hits.overload, "overloaded")):
        if which.any():
            numbers = ", ".join(str(k + 1) for k in np.flatnonzero(which))
            warnings.warn(f"hits {numbers} of {len(which)} left out: {what}", stacklevel=3)
    if not hits.good.any():
        raise ValueError(f"none of the {len(hits.start)} hits is usable: all are double or overloaded")
    keep = hits.good
    return Hits(hits.start[keep], hits.peak[keep], hits.double[keep], hits.overload[keep], hits.samples)
