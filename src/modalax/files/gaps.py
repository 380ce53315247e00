"""Lines of a file in any order, and numbers that are missing in it: what is mended is said."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

SHOWN = 6  # names or frequencies that a sentence lists
MOST = 0.5  # part of the lines that may be left out because samples are missing


class LeftOut(UserWarning):
    """What of a file was left out, as it holds no finite number: ``channels`` are the outputs and inputs."""

    def __init__(self, text: str, channels: Sequence[str] = ()):
        super().__init__(text)
        self.channels = tuple(channels)


Arrays = tuple[np.ndarray, np.ndarray, list[str], list[str], dict[str, Any]]


def mended(
    freq: np.ndarray, H: np.ndarray, outputs: Sequence[str], inputs: Sequence[str], beside: dict[str, Any],
    stacklevel: int,
) -> Arrays:  # fmt: skip
    """The arrays of a measurement with rising frequencies and without missing numbers; a warning says what was done.

    Lines are sorted, and of a frequency that stands several times the mean is taken. Channels and lines without any
    finite number are left out: a sensor that failed, and the line at 0 Hz of a force without mean, are often written
    as NaN throughout. A line at which some samples are missing is left out for all channels: no number is made up.

    Parameters
    ----------
    freq, H, outputs, inputs
        Lines ``(f,)``, FRFs ``(run, f, o, i)`` and names.
    beside
        Arrays of the axes of H (``variance``, ``coherence``) or ``(run, f)`` (``force``); others are kept as they are.
    stacklevel
        Of the warnings.

    Raises
    ------
    ValueError
        If samples are missing at more than ``MOST`` of the lines (the channel with the most of them is named), or so
        many frequencies stand several times with different values.
    """
    if H.ndim != 4 or H.shape != (len(H), len(freq), len(outputs), len(inputs)) or not np.isfinite(freq).all():
        return freq, H, list(outputs), list(inputs), beside
    freq, H, beside = _rising(freq, H, beside, stacklevel + 1)
    arrays = _without_empty(freq, H, outputs, inputs, beside, stacklevel + 1)
    return _without_missing(*arrays, stacklevel + 1)


def _rising(
    freq: np.ndarray, H: np.ndarray, beside: dict[str, Any], stacklevel: int
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """The lines in rising order, each frequency once."""
    if (np.diff(freq) > 0).all():
        return freq, H, beside
    if (np.diff(freq) < 0).any():
        warnings.warn("its lines do not stand in rising order and were sorted", UserWarning, stacklevel=stacklevel)
        order = np.argsort(freq, kind="stable")
        freq, H, beside = freq[order], H[:, order], _along_lines(beside, H.shape, lambda name, v: v[:, order])
    lines, first, times = np.unique(freq, return_index=True, return_counts=True)
    if (times == 1).all():
        return lines, H, beside
    shape = H.shape
    each = [H, *(v for name, v in beside.items() if np.shape(v) == shape or name == "force")]
    alike = all(_same(v, first, times) for v in each if np.shape(v)[:2] == shape[:2])
    told = _listed("line", [f"{x:g} Hz" for x in lines[times > 1]])
    if not alike and (times > 1).mean() > MOST:
        raise ValueError(
            f"freq must increase: {told} stand several times, with different values; sweeps up and down, or several "
            "tests, are runs of their own"
        )
    stand = "stands" if (times > 1).sum() == 1 else "stand"
    what = "alike each time, and is kept once" if alike else "and the mean of the values is taken"
    warnings.warn(f"{told} {stand} several times, {what}", UserWarning, stacklevel=stacklevel)
    if alike:
        return lines, H[:, first], _along_lines(beside, shape, lambda name, v: v[:, first])
    # A line of which one measurement misses a number keeps that of the other.
    mean = lambda v: _sums(v, first) / np.maximum(_sums(np.isfinite(v), first), 1)
    missing = lambda v, m: np.where(_sums(np.isfinite(v), first) > 0, m, np.nan)
    several = {"variance": lambda v: mean(v) / np.maximum(_sums(np.isfinite(v), first), 1)}
    taken = lambda name, v: missing(v, several.get(name, mean)(v))
    return lines, missing(H, mean(H)), _along_lines(beside, shape, taken)


def _sums(values: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Sums over the lines of each frequency; what is missing adds nothing."""
    return np.add.reduceat(np.where(np.isfinite(values), values, 0), first, axis=1)


def _same(values: np.ndarray, first: np.ndarray, times: np.ndarray) -> bool:
    return bool(np.array_equal(values, np.repeat(values[:, first], times, axis=1), equal_nan=True))


def _along_lines(beside: dict[str, Any], shape: tuple[int, ...], change: Any) -> dict[str, Any]:
    """Arrays that have a value a line, changed; the others as they are."""
    has = lambda name, v: np.shape(v) == shape or name == "force" and np.shape(v) == shape[:2]
    return {name: change(name, v) if has(name, v) else v for name, v in beside.items()}


def _without_empty(
    freq: np.ndarray, H: np.ndarray, outputs: Sequence[str], inputs: Sequence[str], beside: dict[str, Any],
    stacklevel: int,
) -> Arrays:  # fmt: skip
    """The arrays without channels and lines at which no sample is finite."""
    sound = np.isfinite(H)
    if sound.all() or not sound.any():
        return freq, H, list(outputs), list(inputs), beside
    f, o, i = (sound.any(axis=axes) for axes in ((0, 2, 3), (0, 1, 3), (0, 1, 2)))
    told = [
        _listed(kind, [name for name, keep in zip(names, kept, strict=True) if not keep])
        for kind, names, kept in (
            ("output", outputs, o), ("input", inputs, i), ("line", [f"{x:g} Hz" for x in freq], f),
        ) if not kept.all()
    ]  # fmt: skip
    if told:
        empty = [name for names, kept in ((outputs, o), (inputs, i)) for name in np.array(names)[~kept].tolist()]
        said = f"no finite number at {' and at '.join(told)}; left out"
        warnings.warn(LeftOut(said, empty), stacklevel=stacklevel)
    take = lambda name, v: v[:, f] if np.ndim(v) == 2 else v[:, f][:, :, o][..., i]
    named = lambda names, kept: [name for name, keep in zip(names, kept, strict=True) if keep]
    beside = _along_lines(beside, H.shape, take)
    return freq[f], take("H", H), named(outputs, o), named(inputs, i), beside


def _without_missing(
    freq: np.ndarray, H: np.ndarray, outputs: list[str], inputs: list[str], beside: dict[str, Any], stacklevel: int
) -> Arrays:
    """The arrays without lines at which some samples are not finite."""
    missing = ~np.isfinite(H)
    for name, v in beside.items():
        if name in ("variance", "coherence") and np.shape(v) == H.shape:
            missing |= ~np.isfinite(v)
    if not missing.any():
        return freq, H, outputs, inputs, beside
    gone = missing.any(axis=(0, 2, 3))
    counts = missing.sum(axis=(0, 1))
    o, i = np.unravel_index(int(np.argmax(counts)), counts.shape)
    size = int(missing.sum())
    where = f"{size} of {missing.size} samples"
    alone = np.count_nonzero(counts) == 1
    most = f"{'all' if alone else 'most'} of output {outputs[o]} to input {inputs[i]}"
    most = most if alone else f"{most} ({counts[o, i]} of {missing[..., 0, 0].size})"
    if gone.mean() > MOST:
        raise ValueError(
            f"{where} hold no finite number, {most}, at {gone.sum()} of {len(freq)} lines; at most half of the lines "
            "can be left out: take out the channel, or the lines where it failed"
        )
    told = _listed("line", [f"{x:g} Hz" for x in freq[gone]])
    warnings.warn(
        f"{where} {'hold' if size > 1 else 'holds'} no finite number, {most}; {told} left out for all channels",
        UserWarning, stacklevel=stacklevel,
    )  # fmt: skip
    kept = _along_lines(beside, H.shape, lambda name, v: v[:, ~gone])
    return freq[~gone], H[:, ~gone], outputs, inputs, kept


def _listed(kind: str, names: Sequence[str]) -> str:
    shown = ", ".join(names[:SHOWN]) + (f", ... ({len(names)} in all)" if len(names) > SHOWN else "")
    return f"{kind}{'s' * (len(names) > 1)} {shown}"
