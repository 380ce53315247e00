"""FRFs of a recording with hits, periodic, stepped, sweep, burst or random excitation."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float

from modalax.data.bla import bla_robust
from modalax.data.choices import Reduction, tell_unused
from modalax.data.excitation import KINDS, Excitation, excitation_of, excited
from modalax.data.frf import FRF
from modalax.data.hits import Hits, clipped_records, contacts, find_hits, good_hits
from modalax.data.multisine import cut_periods
from modalax.data.recording import Channels, Recording, channels_of
from modalax.data.records import frf_from_blocks, frf_from_records, pooled_frfs
from modalax.data.stepped import frf_from_steps
from modalax.data.streaming import HEAD, Streamed, frfs_of_stream
from modalax.data.windows import decay_to, force_window

MOST = 2**16  # samples of a block of records that are streamed, where none is given
RINGING = 0.02  # share of its largest value above which a response at the end of a block has not died away


def frf_from_recording(
    recording: Recording,
    *,
    force: Sequence[str | int] = (),
    response: Sequence[str | int] = (),
    unit: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    how: Reduction | None = None,
    **choices: object,
) -> FRF:
    """FRF of a recording with any kind of excitation; warnings say what was assumed.

    Parameters
    ----------
    recording
        Time records, from :func:`modalax.files.load_records` or :func:`modalax.data.from_sep005`.
    force, response
        Channels by name or number; see :func:`modalax.data.recording.channels_of`.
    unit
        Unit of responses that have none in the recording.
    inputs, outputs
        Names of the DoFs; those of the channels by default. With a roving hammer ``inputs`` names the points.
    how
        A :class:`Reduction`; its entries can be given by name as well.

    Raises
    ------
    ValueError
        If no force channel is found, a roving hammer is asked for without hits, no hit or period can be used, or the
        numbers of names and channels differ.
    """
    how = replace(how or Reduction(), **choices)
    if isinstance(recording, Streamed):
        found = _of_stream(recording, (force, response, unit), outputs, inputs, how)
        if found is not None:
            return found
        recording = recording.whole()
    channels = channels_of(recording, force, response, unit)
    if how.kind not in (None, *KINDS):
        raise ValueError(f"kind is {how.kind!r}; it must be one of {', '.join(KINDS)}")
    channels = _renamed(channels, outputs, None if how.roving else inputs)
    if how.roving:
        how = replace(how, kind=how.kind or "hits")
    found = excitation_of(channels.force[:, :, 0]) if how.kind is None else Excitation(how.kind, "", 0)
    if how.kind is None:
        warnings.warn(f"taken as {found.kind}: {found.why}", stacklevel=2)
    tell_unused(how, found.kind)
    if found.kind == "hits":
        return _from_hits(channels, recording.fs, how, inputs)
    if found.kind == "multisine":
        return _from_periods(channels, recording.fs, how, found)
    if found.kind == "stepped":
        return frf_from_steps(channels, recording.fs, how.estimator, how.band)
    if found.kind == "random":
        return _from_random(channels, recording.fs, how)
    return _from_blocks(channels, recording.fs, how, found.kind)


def common_lines(frfs: Sequence[FRF]) -> list[FRF]:
    """FRFs at the frequency lines that all of them have; a warning says how many are left out.

    Raises
    ------
    ValueError
        If they have none in common.
    """
    axes = [np.asarray(f.freq) for f in frfs]
    spacing = min(float(np.diff(a).min(initial=np.inf)) for a in axes)
    tiny = 1e-6 * spacing

    def among(few: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Index of each line of ``few`` on the axis; -1 where the axis lacks it."""
        at = np.clip(np.searchsorted(axis, few - tiny), 0, len(axis) - 1)
        return np.where(np.abs(axis[at] - few) < tiny, at, -1)

    shared = axes[0]
    for axis in axes[1:]:
        shared = shared[among(shared, axis) >= 0]
    if len(shared) == 0:
        raise ValueError("the runs have no frequency line in common; records of the same rate and length do")
    if any(len(a) != len(shared) for a in axes):
        warnings.warn(
            f"the runs have {min(map(len, axes))} to {max(map(len, axes))} lines; the {len(shared)} of all are kept",
            stacklevel=2,
        )
    return [f.lines(among(shared, a)).replace(freq=shared) for f, a in zip(frfs, axes, strict=True)]


def _of_stream(
    recording: Streamed, asked: tuple, outputs: Sequence[str] | None, inputs: Sequence[str] | None, how: Reduction
) -> FRF | None:
    """The FRF of records that stay in their file if their excitation is random, which can be read piece by piece."""
    if how.roving or how.kind not in (None, "random"):
        return None
    head = channels_of(recording.piece(0, min(HEAD, recording.data.shape[1])), *asked)
    found = excitation_of(head.force[:, :, 0])
    if how.kind is None and found.kind != "random":
        return None
    if how.kind is None:
        warnings.warn(f"taken as random: {found.why}", stacklevel=3)
    tell_unused(how, "random")
    block = how.block or _block_of(recording.data.shape[1], recording.fs, MOST)
    parts = frfs_of_stream(
        recording, asked, _renamed(head, outputs, inputs), block=block, overlap=how.overlap, window=how.window,
        estimator=how.estimator, band=how.band,
    )  # fmt: skip
    return pooled_frfs(parts)


def _renamed(channels: Channels, outputs: Sequence[str] | None, inputs: Sequence[str] | None) -> Channels:
    return channels._replace(
        outputs=_named(outputs, channels.outputs, "outputs"), inputs=_named(inputs, channels.inputs, "inputs")
    )


def _named(given: Sequence[str] | None, own: list[str], what: str) -> list[str]:
    if given is None:
        return own
    if len(given) != len(own):
        raise ValueError(f"{len(given)} names of {what} for {len(own)} channels ({', '.join(own)}); give as many")
    return list(given)


# hits -----------------------------------------------------------------------------------------------------------------


def _from_hits(channels: Channels, fs: float, how: Reduction, points: Sequence[str] | None) -> FRF:
    if channels.force.shape[2] != 1:
        raise ValueError(f"{channels.force.shape[2]} forces; a hammer test has one, that of the hammer: choose it")
    force, response, before = _hit_blocks(channels, fs, how)
    samples = force.shape[1]
    still = (before + 1) // 2  # the second half holds the rise of the hit
    if still:
        force, response = (b - b[:, :still].mean(axis=1, keepdims=True) for b in (force, response))
    if how.contact is not None:
        start = max(0.0, before / fs - how.contact)
        keep = force_window(samples, fs, before / fs + how.contact, start, ramp=how.contact / 2)
        force = force * np.asarray(keep)[:, None]
    decay = 0.0 if how.remainder is None else decay_to(how.remainder, samples / fs)
    _tell_ringing(response, how)
    options = {
        "unit": channels.unit, "estimator": how.estimator, "decay": decay, "band": how.band,
        "outputs": channels.outputs,
    }  # fmt: skip
    if not how.roving:
        if len(force) == 1:
            warnings.warn("only one hit, so neither coherence nor variance is known", stacklevel=4)
        return frf_from_blocks(force, response, fs, inputs=channels.inputs, **options)
    if len(force) % how.roving:
        raise ValueError(f"{len(force)} hits; with {how.roving} at each point a multiple of {how.roving} is needed")
    count = len(force) // how.roving
    names = _named(points, [f"{channels.inputs[0]} {k + 1}" for k in range(count)], "points")
    groups = [slice(k * how.roving, (k + 1) * how.roving) for k in range(count)]
    parts = [
        frf_from_blocks(force[g], response[g], fs, inputs=[n], **options) for g, n in zip(groups, names, strict=True)
    ]
    first = parts[0]
    beside = lambda name: (
        None if getattr(first, name) is None else np.concatenate([getattr(p, name) for p in parts], axis=2)
    )
    return FRF(
        first.freq, beside("H"), form=first.form, variance=beside("variance"), coherence=beside("coherence"),
        outputs=channels.outputs, inputs=names, averages=first.averages, added_decay=first.added_decay,
    )  # fmt: skip


def _hit_blocks(channels: Channels, fs: float, how: Reduction):
    """Blocks ``(hit, t, 1)`` and ``(hit, t, o)``, and the samples before each trigger."""
    records = channels.force[:, :, 0]
    rises = [_rises(f, how.trigger) for f in records]
    one_each = len(records) > 1 and how.block is None
    clipped = clipped_records(channels.force, channels.response)
    if one_each:
        length = records.shape[1]
        before = min(int(np.argmax(np.abs(f) > how.trigger * np.abs(f).max())) for f in records)
        hits = Hits(
            start=np.zeros(len(records), int), peak=np.abs(records).max(axis=1), samples=length,
            double=np.array([contacts(f) > 1 for f in records]), overload=clipped.any(axis=1),
        )  # fmt: skip
        keep = _kept(hits, how)
        return channels.force[keep], channels.response[keep], max(0, before - 2)
    gaps = np.concatenate([np.diff(r) for r in rises]) / fs
    block = how.block
    if block is None:
        block = _room(records, rises, gaps, fs)
    pretrigger = _rise(records, rises, fs, block) if how.pretrigger is None else how.pretrigger
    if how.block is None:
        warnings.warn(
            f"{block:g} s are kept of each hit, which the time between hits allows, {pretrigger:.3g} s of it before",
            stacklevel=5,
        )
    found = []
    for f, x, c in zip(records, channels.response, clipped, strict=True):
        hits = find_hits(f, x, fs, block=block, trigger=how.trigger, pretrigger=pretrigger)
        found.append(eqx.tree_at(lambda h: h.overload, hits, hits.cut(c[:, None]).any(axis=(1, 2))))
    parts = [(h.cut(f), h.cut(x)) for h, f, x in zip(found, channels.force, channels.response, strict=True)]
    every = Hits(
        *(np.concatenate([getattr(h, name) for h in found]) for name in ("start", "peak", "double", "overload")),
        samples=found[0].samples,
    )
    keep = _kept(every, how)
    force, response = (np.concatenate([p[c] for p in parts])[keep] for c in (0, 1))
    return force, response, round(pretrigger * fs)


def _rises(force: Float[np.ndarray, " t"], trigger: float) -> np.ndarray:
    size = np.abs(force)
    return np.flatnonzero(np.diff((size > trigger * size.max()).astype(int)) == 1) + 1


def _room(records: np.ndarray, rises: list[np.ndarray], gaps: np.ndarray, fs: float) -> float:
    """Shortest time between two hits [s], or from a hit to the end of the record where that is not much less."""
    wide = gaps[gaps > 0.2 * np.median(gaps)] if len(gaps) else gaps  # closer ones are double hits
    ends = [(len(f) - r[-1]) / fs for f, r in zip(records, rises, strict=True) if len(r)]
    if not len(wide):
        return float(np.floor(min(ends, default=1.0) * fs) / fs)
    shortest = 0.98 * float(wide.min())
    return float(np.floor(min([shortest, *(e for e in ends if e > 0.7 * shortest)]) * fs) / fs)


def _rise(records: np.ndarray, rises: list[np.ndarray], fs: float, block: float) -> float:
    """Time before the trigger in which a hit rises [s]: four times that from the trigger to its peak."""
    after = round(0.05 * block * fs) + 1
    climbs = [int(np.abs(f[k : k + after]).argmax()) for f, r in zip(records, rises, strict=True) for k in r]
    room = min((int(r[0]) for r in rises if len(r)), default=0)
    return min(4 * max(climbs, default=0) + 4, round(0.05 * block * fs), room) / fs


def _kept(hits: Hits, how: Reduction) -> np.ndarray:
    """The hits to use; with a roving hammer these are all hits, because otherwise a point would be missing."""
    every = np.ones(len(hits.start), bool)
    if how.keep_all:
        return every
    if how.roving and not hits.good.all():
        for which, what in ((hits.double, "double"), (hits.overload, "overloaded")):
            if which.any():
                numbers = ", ".join(str(k + 1) for k in np.flatnonzero(which))
                warnings.warn(
                    f"hits {numbers} of {len(which)} are {what}; they are kept, as otherwise a point would be missing",
                    stacklevel=6,
                )
        return every
    if not hits.good.all():
        good_hits(hits)  # tells what is left out, or that nothing is left
    return hits.good


def _tell_ringing(response: np.ndarray, how: Reduction) -> None:
    if how.remainder is not None:
        return
    tail = response[:, -max(8, response.shape[1] // 20) :]
    still = tail - tail.mean(axis=1, keepdims=True)
    left = float((np.abs(still).max(axis=1) / np.abs(response).max(axis=1)).max())
    if left > RINGING:
        warnings.warn(
            f"the responses are still at {100 * left:.2g} % of their peak at the end of the block: longer blocks or an "
            "exponential window avoid leakage",
            stacklevel=5,
        )


# periods, blocks, random ----------------------------------------------------------------------------------------------


def _from_periods(channels: Channels, fs: float, how: Reduction, found: Excitation) -> FRF:
    period = how.period or found.period or excitation_of(channels.force[:, :, 0]).period
    if not period:
        raise ValueError("the force does not repeat within the record; give its period in samples")
    count = channels.force.shape[1] // period
    skip = how.skip if how.skip is not None else (1 if count >= 3 else 0)
    if how.skip is None:
        warnings.warn(f"{count} periods of {period} samples, the first {skip} left out to settle", stacklevel=4)
    force = np.stack([np.asarray(cut_periods(f, period, skip)) for f in channels.force])  # (r, p, t, i)
    response = np.stack([np.asarray(cut_periods(x, period, skip)) for x in channels.response])
    lines = excited(force.mean(axis=(0, 1)) if len(force) == 1 else force[0].mean(axis=0))
    freq = lines * fs / period
    warnings.warn(f"{len(lines)} excited lines from {freq[0]:g} to {freq[-1]:g} Hz", stacklevel=4)
    rest = {"unit": channels.unit, "outputs": channels.outputs, "inputs": channels.inputs}
    draws = len(force) // force.shape[3]
    if draws >= 2 and len(force) % force.shape[3] == 0:
        frf = bla_robust(force, response, fs, lines, **rest).frf
    else:
        force, response = (a.reshape(-1, *a.shape[2:]) for a in (force, response))
        frf = frf_from_blocks(force, response, fs, estimator=how.estimator, **rest).lines(lines - 1)
    return frf if how.band is None else frf.band(*how.band)


def _from_blocks(channels: Channels, fs: float, how: Reduction, kind: str) -> FRF:
    """Each record one block: bursts, or sweeps from rest to rest; lines of a sweep end where its force does."""
    how_band = how.band
    if kind == "sweep" and how.band is None:
        power = np.abs(np.fft.rfft(channels.force[0, :, 0]))
        width = max(3, len(power) // 500)
        smooth = np.convolve(power, np.ones(width) / width, "same")
        held = np.flatnonzero(smooth > 0.2 * np.quantile(smooth, 0.98))
        freq = np.fft.rfftfreq(channels.force.shape[1], 1 / fs)
        how_band = float(freq[max(held[0], 1)]), float(freq[held[-1]])
        warnings.warn(f"band of the sweep: {how_band[0]:.4g} to {how_band[1]:.4g} Hz", stacklevel=4)
    middle = channels.force[:, channels.force.shape[1] // 5 : -(channels.force.shape[1] // 5)]
    frf = frf_from_blocks(
        channels.force, channels.response, fs, unit=channels.unit, estimator=how.estimator, band=how_band,
        outputs=channels.outputs, inputs=channels.inputs,
        level=float(np.sqrt(2) * middle.std()) if kind == "sweep" else np.nan,
    )  # fmt: skip
    if frf.variance is None:
        warnings.warn("no more records than forces, so neither coherence nor variance is known", stacklevel=4)
    return frf


def _from_random(channels: Channels, fs: float, how: Reduction) -> FRF:
    block = how.block or _block_of(channels.force.shape[1], fs)
    parts = [
        frf_from_records(
            f, x, fs, unit=channels.unit, block=block, overlap=how.overlap, window=how.window,
            estimator=how.estimator, band=how.band, outputs=channels.outputs, inputs=channels.inputs,
        )
        for f, x in zip(channels.force, channels.response, strict=True)
    ]  # fmt: skip
    return pooled_frfs(parts)


def _block_of(length: int, fs: float, most: int | None = None) -> float:
    """Length of a block [s] where none is given: a twelfth of the record."""
    samples = max(16, min(length, most or length, 2 ** int(np.log2(max(length / 12, 16)))))
    block = samples / fs
    warnings.warn(f"blocks of {block:g} s ({1 / block:.3g} Hz between lines)", stacklevel=4)
    return block
