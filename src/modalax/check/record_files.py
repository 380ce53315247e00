"""Time records in files: arrays named force and response, or channels of any file that holds time records."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modalax.check.blocks import cut
from modalax.check.records import Records
from modalax.data.recording import channels_of
from modalax.files.record_kinds import kind_of
from modalax.files.records import load_records
from modalax.files.records_uff import holds_records_alone

FORCE = ("force", "f", "u", "input", "hammer", "excitation")
RESPONSE = (
    "response",
    "x",
    "y",
    "a",
    "acc",
    "acceleration",
    "accelerations",
    "output",
    "v",
    "velocity",
    "displacement",
)
TIME, RATE = ("time", "t"), ("fs", "rate", "sampling_rate", "samplerate", "sample_rate")
FORMS = {"v": "mobility", "velocity": "mobility", "x": "receptance", "displacement": "receptance"}
FORM_OF_UNIT = {"m": "receptance", "m/s": "mobility"}
# Steps of a time axis may differ by this share.
EVEN = 1e-3


def read_records(path: str | os.PathLike[str]) -> Records | None:
    """Read the time records of a file, cut into hits, periods or blocks; None where it holds none.

    Raises
    ------
    ValueError
        If it holds records that cannot be used; the message says what is missing.
    """
    path = Path(path)
    found = _by_name(path) or _by_channels(path)
    return None if found is None else cut(found)


def _by_name(path: Path) -> Records | None:
    """Arrays whose names say which is the force; None where there are none."""
    ending = path.suffix.lower()
    if ending == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            return _arrays(path, {name: archive[name] for name in archive.files if name.lower() in _KNOWN})
    if ending == ".mat":
        import scipy.io

        try:
            found = scipy.io.loadmat(path, squeeze_me=True)
        except (NotImplementedError, ValueError):
            return None
        return _arrays(path, {name: a for name, a in found.items() if name.lower() in _KNOWN})
    return None


def _by_channels(path: Path) -> Records | None:
    """Any file of records: the force by its unit or name, or else the first channel."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            recording = load_records(path)
        except ValueError:
            if _holds_records(path):
                raise
            return None
        if len(recording.channels) < 2:
            return None
        try:
            found = channels_of(recording)
        except ValueError:
            try:
                found = channels_of(recording, unit="m/s^2")
            except ValueError:
                found = channels_of(recording, force=[recording.channels[0]], unit="m/s^2")
    form = FORM_OF_UNIT.get(found.unit, "accelerance")
    return Records(
        np.asarray(found.force)[:, :, 0], np.asarray(found.response), recording.fs, tuple(found.outputs),
        input=found.inputs[0], form=form,
    )  # fmt: skip


def _holds_records(path: Path) -> bool:
    """Whether a file that could not be read holds time records for sure, so that the reason is told."""
    kind = kind_of(path)
    return kind == "wav" or kind == "uff" and holds_records_alone(path)


_KNOWN = {*FORCE, *RESPONSE, *TIME, *RATE, "dt"}


def _rate(path: Path, time: np.ndarray) -> float:
    steps = np.diff(time)
    step = float(np.median(steps))
    if step <= 0 or np.ptp(steps) > max(EVEN * step, 1e-6 * abs(time[-1])):
        raise ValueError(f"{path}: its time axis is not evenly spaced ({steps.min():g} to {steps.max():g} s)")
    return 1 / step


def _arrays(path: Path, found: Mapping[str, Any]) -> Records | None:
    """Records from arrays named force and response, with a sampling rate or a time axis."""
    lower = {name.lower(): np.asarray(a, float) for name, a in found.items() if np.isrealobj(a)}
    pick = lambda names: next((lower[n] for n in names if n in lower and lower[n].size > 1), None)
    force, response = pick(FORCE), pick(RESPONSE)
    if force is None or response is None:
        return None
    rate = next((float(lower[n]) for n in RATE if n in lower and lower[n].size == 1), None)
    if rate is None and "dt" in lower:
        rate = 1 / float(lower["dt"])
    time = pick(TIME)
    if rate is None and time is not None:
        rate = _rate(path, np.ravel(time))
    if rate is None:
        raise ValueError(f"{path}: holds force and response, but neither fs nor time; one of them is needed")
    samples = max(force.shape)
    force = np.atleast_2d(force)
    if force.shape[-1] != samples:
        force = force.T
    response = _as_blocks(path, response, force.shape)
    word = next(n for n in RESPONSE if n in lower)
    names = tuple(f"{word}{k + 1}" for k in range(response.shape[2]))
    return Records(force, response, rate, names, form=FORMS.get(word, "accelerance"))


def _as_blocks(path: Path, response: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Responses as ``(block, t, o)``."""
    blocks, samples = shape
    if response.ndim == 1:
        response = response[None, :, None]
    elif response.ndim == 2 and blocks == 1:
        response = (response if response.shape[0] == samples else response.T)[None]
    elif response.ndim == 2:
        response = response[:, :, None] if response.shape == shape else response.T[:, :, None]
    if response.ndim == 3 and response.shape[1] != samples:
        response = np.swapaxes(response, 1, 2)
    if response.shape[:2] != (blocks, samples):
        raise ValueError(f"{path}: force has shape {shape} and response {response.shape}; they need the same samples")
    return response
