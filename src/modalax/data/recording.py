"""A time recording of several channels: which of them is the force, and in which units they are."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Real

from modalax.data.checks import require_samples
from modalax.data.labels import FORCE, KNOWN, SI, Unit, kind_by_name, unit_of
from modalax.data.overview import of_recording

EVEN = 0.1  # largest error of an instant, relative to the time step
SAME_CLOCK = 1e-9  # relative error of a rate that sums of many time steps make
ONE_RATE = 1e-5  # rates that differ by less, relatively, are one that was rounded differently


@dataclass(frozen=True)
class Recording:
    """Time records of some channels, in one piece or in several of equal length.

    Attributes
    ----------
    data
        Samples, shape ``(segment, t, channel)``.
    fs
        Sampling rate [Hz].
    channels
        Name of each channel.
    units
        Unit of each channel as it was written; empty where the file says nothing.
    numbers
        Number of each channel in its file, from 1; time columns count, so these may begin at 2.
    """

    data: Real[np.ndarray, "segment t channel"]
    fs: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    numbers: tuple[int, ...]

    def __post_init__(self) -> None:
        count = len(self.channels)
        if self.data.ndim != 3 or self.data.shape[2] != count or {len(self.units), len(self.numbers)} != {count}:
            raise ValueError(
                f"data of shape {self.data.shape} for {count} channels, {len(self.units)} units; it needs "
                "(segment, t, channel), a name and a unit for each channel"
            )
        if not (np.isfinite(self.fs) and self.fs > 0):
            raise ValueError(f"the sampling rate is {self.fs:g} Hz; it must be positive")
        require_samples(self.data, self.fs, self.channels)

    def __str__(self) -> str:
        """Duration, rate and channels."""
        return of_recording(self)

    def whole(self) -> "Recording":
        """The recording with all samples in memory."""
        return self

    def listed(self) -> str:
        """The channels in words: number, name, unit."""
        named = zip(self.numbers, self.channels, self.units, strict=True)
        return ", ".join(f"{k} {name}" + (f" [{unit}]" if unit else "") for k, name, unit in named)

    def is_force(self, k: int) -> bool:
        """Whether the unit of a channel is one of force."""
        unit = unit_of(self.units[k])
        return unit is not None and unit.kind == FORCE

    def index(self, wanted: str | int, force: bool | None = None) -> int:
        """Place of a channel given by its name, or by its number in the file.

        At a drive point a force and a response may have one name: ``force`` says which of them is meant.

        Raises
        ------
        ValueError
            If there is no such channel, or several; the message lists those that are there.
        """
        text = str(wanted).strip()
        named = [k for k, name in enumerate(self.channels) if name == text]
        if len(named) > 1 and force is not None:
            named = [k for k in named if self.is_force(k) == force]
        if len(named) > 1:
            raise ValueError(f"{len(named)} channels are named {text}: choose by number; there are {self.listed()}")
        if named:
            return named[0]
        if text.isdigit() and int(text) in self.numbers:
            return self.numbers.index(int(text))
        raise ValueError(f"no channel {text!r}; there are {self.listed()}")

    def with_units(self, units: Mapping[str | int, str]) -> "Recording":
        """The recording with the units of some channels set.

        Raises
        ------
        ValueError
            If a channel is not there.
        """
        given = {self.index(name): unit for name, unit in units.items()}
        return replace(self, units=tuple(given.get(k, unit) for k, unit in enumerate(self.units)))

    def between(self, start: float, stop: float) -> "Recording":
        """The part of every segment from ``start`` to ``stop`` [s from its beginning].

        Raises
        ------
        ValueError
            If the records do not hold it.
        """
        length = self.data.shape[1] / self.fs
        first, last = round(start * self.fs), round(stop * self.fs)
        if not 0 <= first < last <= self.data.shape[1]:
            raise ValueError(f"{start:g} to {stop:g} s of records of {length:g} s; it needs 0 <= start < stop <= end")
        return replace(self, data=self.data[:, first:last])

    def renamed(self, names: Mapping[str | int, str]) -> "Recording":
        """The recording with some channels renamed, for example to their DoF.

        Raises
        ------
        ValueError
            If a channel is not there, or two would have one name.
        """
        given = {self.index(old): new for old, new in names.items()}
        channels = tuple(given.get(k, name) for k, name in enumerate(self.channels))
        if given and len(set(channels)) < len(channels):
            raise ValueError(f"two channels would have one name: {', '.join(channels)}")
        return replace(self, channels=channels)

    def scaled(self, factors: Mapping[str | int, float]) -> "Recording":
        """The recording with some channels multiplied by a factor, for example newtons per volt.

        Raises
        ------
        ValueError
            If a channel is not there.
        """
        gain = np.ones(len(self.channels))
        for name, factor in factors.items():
            gain[self.index(name)] = factor
        return replace(self, data=self.data * gain)


def joined(recordings: Sequence[Recording]) -> Recording:
    """Several recordings of the same channels as the segments of one; longer ones are cut, with a warning.

    Raises
    ------
    ValueError
        If rates, channels or units differ.
    """
    recordings = [r.whole() for r in recordings]
    first = recordings[0]
    for k, other in enumerate(recordings[1:], start=2):
        same = (other.channels, other.units) == (first.channels, first.units)
        if not same or abs(other.fs - first.fs) > ONE_RATE * first.fs:
            raise ValueError(
                f"recording {k} has {other.listed()} at {other.fs:g} Hz, the first {first.listed()} at {first.fs:g} "
                "Hz; records taken together need the same channels, units and rate"
            )
    return replace(first, data=np.concatenate([r.data for r in of_one_length(recordings)]))


def of_one_length(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings cut to the shortest, with a warning where that leaves something out.

    Rates that are one but for their rounding become that of the first.
    """
    fs = recordings[0].fs
    recordings = [replace(r, fs=fs) if abs(r.fs - fs) < ONE_RATE * fs else r for r in recordings]
    lengths = [r.data.shape[1] for r in recordings]
    if len(set(lengths)) > 1:
        warnings.warn(
            f"the records have {min(lengths)} to {max(lengths)} samples; all are cut to the first {min(lengths)}",
            stacklevel=3,
        )
    return [replace(r, data=r.data[:, : min(lengths)]) for r in recordings]


class Channels(NamedTuple):
    """Forces and responses in SI: shapes ``(segment, t, i)`` [N] and ``(segment, t, o)`` [``unit``]."""

    force: Float[np.ndarray, "segment t i"]
    response: Float[np.ndarray, "segment t o"]
    unit: str
    inputs: list[str]
    outputs: list[str]


def channels_of(
    recording: Recording, force: Sequence[str | int] = (), response: Sequence[str | int] = (), unit: str | None = None
) -> Channels:
    """Find out which channels are forces and bring all to SI units; a warning says what was assumed.

    Parameters
    ----------
    recording
        The records.
    force
        Channels that are forces, by name or number. If none is given: those in a unit of force, or else those named
        force, hammer or load cell.
    response
        Channels that are responses; if none is given, all others that can be.
    unit
        Unit of responses that have none in the recording.

    Raises
    ------
    ValueError
        If no force is found, a label cannot be read as a unit, a response has no known unit, or the
        responses are not of one form.
    """
    forces = [recording.index(c, force=True) for c in force] or _forces(recording)
    by_name: dict[str, list[str]] = {}
    asked = None if unit is None else unit_of(unit)
    if unit is not None and (asked is None or asked.kind == FORCE):
        raise ValueError(f"unit is {unit!r}; a response is in {KNOWN} and the like")
    responses = [recording.index(c, force=False) for c in response]
    both = set(forces) & set(responses)
    if both:
        raise ValueError(f"channel {recording.channels[both.pop()]} is asked for as force and as response")
    others = [k for k in range(len(recording.channels)) if k not in forces]
    units = {k: _response_unit(recording, k, unit, by_name) for k in responses or others}
    for label, named in by_name.items():
        warnings.warn(f"{', '.join(named)} without a unit: taken as {label} by name", stacklevel=2)
    if not responses:
        responses = [k for k in units if units[k] is not None]
        left = [recording.channels[k] for k in units if k not in responses]
        if left and responses:
            warnings.warn(f"neither force nor response, left out: {', '.join(left)}", stacklevel=2)
    unknown = [k for k in responses or others if units[k] is None]
    if unknown or not responses:
        raise ValueError(_unknown_units(recording, unknown, bool(responses)))
    found = {k: u for k in responses if (u := units[k]) is not None}
    forms = sorted({u.kind for u in found.values()})
    if len(forms) > 1 or FORCE in forms:
        raise ValueError(f"the responses are of {' and '.join(forms)}; choose channels of one kind of motion")
    factors = [_force_factor(recording, k) for k in forces]
    return Channels(
        recording.data[:, :, forces] * factors, recording.data[:, :, responses] * [u.factor for u in found.values()],
        SI[forms[0]], [recording.channels[k] for k in forces], [recording.channels[k] for k in responses],
    )  # fmt: skip


def _forces(recording: Recording) -> list[int]:
    known = [unit_of(u) for u in recording.units]
    by_unit = [k for k, u in enumerate(known) if u is not None and u.kind == FORCE]
    by_name = [k for k, u in enumerate(known) if u is None and kind_by_name(recording.channels[k]) == FORCE]
    if not by_unit and not by_name:
        raise ValueError(f"which channel is the force is not known: name it (--force); there are {recording.listed()}")
    chosen, why = (by_unit, "unit") if by_unit else (by_name, "name")
    named = ", ".join(recording.channels[k] for k in chosen)
    warnings.warn(f"force by its {why}: {named}", stacklevel=3)
    return chosen


def _unknown_units(recording: Recording, unknown: Sequence[int], asked: bool) -> str:
    """What to say of responses whose unit is not known, with the labels that could not be read."""
    which = recording.channels[unknown[0]] if asked else "the responses"
    unread = [f"{recording.units[k]!r} of {recording.channels[k]}" for k in unknown if recording.units[k]]
    why = f" ({', '.join(unread)} cannot be read)" if unread else ""
    return f"the unit of {which} is not known{why}: give it (--unit: {KNOWN}); there are {recording.listed()}"


def _force_factor(recording: Recording, k: int) -> float:
    """Newtons in the unit of a force; a warning tells that one without a unit is taken as N.

    Raises
    ------
    ValueError
        If its label cannot be read as a unit of force.
    """
    label, name = recording.units[k], recording.channels[k]
    known = unit_of(label)
    if known is not None and known.kind == FORCE:
        return known.factor
    if label:
        raise ValueError(
            f"the unit {label!r} of force {name} is none of force that can be read; give it with --units {name}=N "
            "(or mN, kN, lbf, kgf)"
        )
    warnings.warn(f"force {name} is without a unit: taken as N", stacklevel=3)
    return 1.0


def _response_unit(recording: Recording, k: int, unit: str | None, by_name: dict[str, list[str]]) -> Unit | None:
    """Unit of a response; if it follows from the channel's name alone, the channel is added to ``by_name``."""
    label, name = recording.units[k], recording.channels[k]
    known = unit_of(label)
    if known is not None or (label and unit is None):
        return known
    if label:
        raise ValueError(
            f"the unit {label!r} of channel {name} cannot be read, and --unit is for channels without one; give "
            f"its own with --units {name}={unit}, or name the channels to use (--response)"
        )
    if unit is not None:
        return unit_of(unit)
    kind = kind_by_name(recording.channels[k])
    if kind in (None, FORCE):
        return None
    by_name.setdefault(SI[kind], []).append(recording.channels[k])
    return Unit(kind, 1.0)


def from_sep005(series: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> Recording:
    """A recording from the time series dictionaries of SDyPy (SEP 005).

    Each holds ``data`` (t,), ``name``, ``unit_str``, and the rate as ``fs`` or the instants as ``time``.

    Parameters
    ----------
    series
        One dictionary or a list of them.

    Raises
    ------
    ValueError
        If one lacks an entry, or their rates or lengths differ.

    References
    ----------
    SDyPy enhancement proposal 5, time series data format.
    """
    every = [series] if isinstance(series, Mapping) else list(series)
    if not every:
        raise ValueError("no time series given; at least a force and a response are needed")
    rows, rates = [], []
    for k, one in enumerate(every, start=1):
        lacking = [key for key in ("data", "name", "unit_str") if key not in one]
        lacking += ["fs or time"] if "fs" not in one and "time" not in one else []
        if lacking:
            raise ValueError(f"time series {k} has no {', '.join(lacking)}; SEP 005 needs data, name, unit_str and fs")
        rows.append(np.asarray(one["data"], float).ravel())
        rates.append(float(one["fs"]) if "fs" in one else rate_of(np.asarray(one["time"], float)))
    if len({len(r) for r in rows}) > 1 or not np.allclose(rates, rates[0], rtol=1e-6):
        sizes = ", ".join(f"{len(r)} at {fs:g} Hz" for r, fs in zip(rows, rates, strict=True))
        raise ValueError(f"the time series have {sizes} samples; they need one length and one rate")
    count = len(every)
    return Recording(
        np.stack(rows, axis=-1)[None], rates[0], tuple(str(o["name"]) for o in every),
        tuple(str(o["unit_str"] or "") for o in every), tuple(range(1, count + 1)),
    )  # fmt: skip


def rate_of(time: Float[np.ndarray, " t"]) -> float:
    """Sampling rate [Hz] of evenly spaced instants; a whole number where the digits of the instants allow it.

    Raises
    ------
    ValueError
        If they are not finite, evenly spaced and rising.
    """
    if not np.isfinite(time).all():
        k = int(np.argmin(np.isfinite(time)))
        raise ValueError(f"instant {k + 1} of {len(time)} is {time[k]:g}; each needs to be a number of seconds")
    count = len(time) - 1
    step = float(time[-1] - time[0]) / count if count > 0 else 0.0
    # Rounding to a few digits moves an instant by a part of the step; a missing sample moves it by a whole step.
    if not step > 0 or np.abs(time - time[0] - step * np.arange(count + 1)).max() > EVEN * step:
        steps = np.diff(time) if count > 0 else np.zeros(1)
        raise ValueError(
            f"the instants are not evenly spaced: steps of {steps.min():g} to {steps.max():g} s; resample the records "
            "to one rate"
        )
    rate = 1 / step
    error = max(1.1 * _last_digit(time) / (count * step), SAME_CLOCK)  # the first and the last are off by half of it
    return float(np.round(rate)) if abs(rate - np.round(rate)) < error * rate and rate > 10 else rate


def _last_digit(time: Float[np.ndarray, " t"]) -> float:
    """To how much the last of some instants are rounded [s]: to a decimal place, or to single precision."""
    last = np.asarray(time, float)[-10:]  # earlier ones may have more decimals
    if np.array_equal(last, last.astype(np.float32)):
        return float(np.spacing(np.abs(last).max().astype(np.float32)))
    tiny = 4 * np.spacing(np.abs(last).max())
    places = (10.0**-k for k in range(16) if np.abs(last - np.round(last, k)).max() <= tiny)
    return next(places, float(tiny))
