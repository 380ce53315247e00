"""Reading time records: arrays of force and response (.npy, .npz, .mat, .csv), time histories of universal files."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from modalax.check.records import Records

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
# Kinds of functions and of units in universal files: a time response, and a force.
TIME_RESPONSE, EXCITATION_FORCE = 1, 13
# Steps of a time axis may differ by this share.
EVEN = 1e-3


def read_records(path: str | os.PathLike[str]) -> Records | None:
    """Read the time records of a file; None where it holds none.

    Raises
    ------
    ValueError
        If it holds records that cannot be used; the message says what is missing.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".npy":
        return _table(path, np.load(path, allow_pickle=False))
    if ending == ".csv":
        try:
            return _table(path, np.genfromtxt(path, delimiter=",", skip_header=_header(path)))
        except ValueError:
            return None
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
    if ending in (".uff", ".unv", ".uf"):
        return _universal(path)
    return None


_KNOWN = {*FORCE, *RESPONSE, *TIME, *RATE, "dt"}


def _header(path: Path) -> int:
    with path.open(encoding="utf-8", errors="replace") as file:
        for k, line in enumerate(file):
            try:
                [float(word) for word in line.strip().split(",") if word]
                return k
            except ValueError:
                continue
    return 0


def _rate(path: Path, time: np.ndarray) -> float:
    steps = np.diff(time)
    step = float(np.median(steps))
    if step <= 0 or np.ptp(steps) > max(EVEN * step, 1e-6 * abs(time[-1])):
        raise ValueError(f"{path}: its time axis is not evenly spaced ({steps.min():g} to {steps.max():g} s)")
    return 1 / step


def _table(path: Path, values: np.ndarray) -> Records | None:
    """Records from a table with the columns time, force, then responses."""
    values = np.asarray(values)
    if values.ndim != 2 or min(values.shape) < 3 or np.iscomplexobj(values):
        raise ValueError(
            f"{path}: an array of shape {values.shape}; records need three channels or more: time, force, responses"
        )
    if values.shape[0] > values.shape[1]:
        values = values.T
    if not np.all(np.diff(values[0]) > 0):
        raise ValueError(f"{path}: the first channel must be the time, increasing; then force, then responses")
    fs = _rate(path, values[0])
    names = tuple(f"response{k + 1}" for k in range(len(values) - 2))
    return Records(values[1][None], values[2:].T[None], fs, names)


def _arrays(path: Path, found: Mapping[str, Any]) -> Records | None:
    """Records from arrays named force and response, with a sampling rate or a time axis."""
    lower = {name.lower(): np.asarray(a, float) for name, a in found.items() if np.isrealobj(a)}
    pick = lambda names: next((lower[n] for n in names if n in lower and lower[n].size > 1), None)  # noqa: E731
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


def _universal(path: Path) -> Records | None:
    """Time responses of a universal file: one force, and the responses of the same length."""
    from modalax.files.uff import read_sets

    sets = [s for s in read_sets(path) if s.get("type") == 58 and s.get("func_type") == TIME_RESPONSE]
    forces = [s for s in sets if s.get("ordinate_spec_data_type") == EXCITATION_FORCE]
    others = [s for s in sets if s.get("ordinate_spec_data_type") != EXCITATION_FORCE]
    if not forces or not others:
        return None
    time = np.asarray(forces[0]["x"], float)
    blocks = [np.asarray(s["data"], float) for s in forces]
    names = list(dict.fromkeys(_name(s) for s in others))
    table = {name: [np.asarray(s["data"], float) for s in others if _name(s) == name] for name in names}
    names = [n for n in names if len(table[n]) == len(blocks) and all(len(a) == len(time) for a in table[n])]
    if not names or any(len(b) != len(time) for b in blocks):
        return None
    response = np.stack([np.stack(table[n]) for n in names], axis=-1)
    kind = others[0].get("ordinate_spec_data_type")
    form = "receptance" if kind == 8 else "mobility" if kind == 11 else "accelerance"
    return Records(np.stack(blocks), response, _rate(path, time), tuple(names), input=_name(forces[0]), form=form)


def _name(found: Mapping[str, Any]) -> str:
    node, code = found["rsp_node"], found["rsp_dir"]
    return f"{node}:{'-' if code < 0 else '+'}{'XYZ'[abs(code) - 1]}" if 1 <= abs(code) <= 3 else str(node)
