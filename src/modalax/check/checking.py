"""The check of a measurement: every detector is run in turn."""

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from modalax.check.channels import conjugated, dead, duplicated, without_numbers
from modalax.check.excitation import excitation
from modalax.check.finding import Finding, Findings
from modalax.check.form import FORMS, wrong_form
from modalax.check.hum import hum
from modalax.check.late import delay
from modalax.check.leakage import record_too_short
from modalax.check.levels import clipped
from modalax.check.places import misplaced
from modalax.check.reciprocity import reciprocity
from modalax.check.record_faults import record_findings
from modalax.check.record_files import read_records
from modalax.check.records import Records
from modalax.check.resolution import resolution
from modalax.check.shifts import frequency_shift
from modalax.check.slow import drift
from modalax.check.study import Study, study_of
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.files import load
from modalax.files.gaps import LeftOut
from modalax.files.messages import about
from modalax.model.entry import check_frf

Detector = Callable[[Study], Iterator[Finding]]
# The order matters: what a detector finds is corrected or left out before the later ones run.
DETECTORS: tuple[Detector, ...] = (
    conjugated, dead, duplicated, wrong_form, hum, drift, clipped, excitation, record_too_short, resolution,
    frequency_shift, delay, misplaced, reciprocity,
)  # fmt: skip


def check(data: FRF | Measurement | Records | str | os.PathLike[str], **told: Any) -> Findings:
    """Find what is wrong with a measurement, without a model of the structure.

    The check looks for faults of channels (reversed, swapped, dead, duplicated, delayed, wrong calibration), of the
    excitation and of the records, and for a structure that changed during the test. A fault that the data cannot
    show, such as a reversed sensor at a place that was never driven, is not reported.

    Parameters
    ----------
    data
        FRFs of one run or several, time records (:class:`modalax.check.Records`), or a file that holds either.
    **told
        What a plain file of FRFs does not say itself, as for :func:`modalax.load`: ``form``, ``unit``, ``outputs``, ...

    Returns
    -------
    Findings
        Empty for a sound measurement.

    Raises
    ------
    ValueError
        If the file holds no measurement, or fewer than 8 lines above 0 Hz, or something is told of data that are none.
    """
    empty: tuple[str, ...] = ()
    if isinstance(data, str | os.PathLike):
        data, empty = _read(Path(data), told)
    elif told:
        raise ValueError(f"option {', '.join(told)} is for files of FRFs; this is a {type(data).__name__}")
    if isinstance(data, Records):
        return _check_records(data)
    check_frf(data, "check", several=True)
    found = [without_numbers(name) for name in empty]
    return Findings(_ordered(found + _findings(study_of(_measurement(data)), DETECTORS)))


def _check_records(records: Records) -> Findings:
    """Findings from the blocks of time records, then from their FRFs."""
    found = list(record_findings(records))
    told = {f.what for f in found}
    # What blocks show directly needs no second telling from their spectra, nor do these say more of a bad channel.
    later = tuple(d for d in DETECTORS if d not in (excitation, drift, hum, resolution, record_too_short))
    bad = {name for f in found if f.what in ("dead", "clipped", "drift", "hum") for name in f.where}
    if records.input not in bad and set(records.outputs) - bad:
        left_out = [name for name in bad if name in records.outputs]
        found += _findings(without(study_of(records.measurement()), left_out), later)
        if records.hits and len(records.force) > 1 and not told & {"double_hit", "clipped"}:
            found += _findings(without(study_of(records.measurement(each=True)), left_out), (frequency_shift,))
    return Findings(_ordered(found))


def _ordered(found: list[Finding]) -> tuple[Finding, ...]:
    """Report each fault once, the surest first."""
    once = {(f.what, f.where): f for f in sorted(found, key=lambda f: f.sure)}
    return tuple(sorted(once.values(), key=lambda f: -f.sure))


def _findings(study: Study, detectors: Sequence[Detector]) -> list[Finding]:
    found: list[Finding] = []
    for detector in detectors:
        new = [f for f in detector(study) if not _explained(f, found)]
        upside_down = [f for f in new if f.what == "wrong_form" and f.size is None]
        if upside_down:  # what was found before is a consequence
            return upside_down
        found += new
        mended_study = mended(study, new)
        if mended_study is None:
            break
        study = mended_study
    return found


def _explained(finding: Finding, found: Sequence[Finding]) -> bool:
    """Whether an earlier finding explains this one too."""
    told = {f.what for f in found}
    # Columns of different structures cannot be compared.
    apart = "frequency_shift" in told and finding.what in ("delay", "calibration", "not_reciprocal")
    return apart or finding.what == "too_few_lines" and "record_too_short" in told


def _measurement(data: FRF | Measurement) -> Measurement:
    return Measurement.from_frfs([data]) if isinstance(data, FRF) else data


def _read(path: Path, told: dict[str, Any]) -> tuple[Measurement | Records, tuple[str, ...]]:
    """FRFs in the time convention of their file, or else time records; channels of FRFs that hold no number."""
    try:
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            found = load(path, conjugate=False, **told)
    except ValueError as error:
        if told:
            raise
        with about(path):
            records = read_records(path) if path.is_file() else None
        if records is None:
            raise error
        return records, ()
    if not isinstance(found, Measurement):
        raise ValueError(f"{path} holds a {type(found).__name__}; measured FRFs or time records are needed here")
    for warning in heard:
        warnings.warn(warning.message, warning.category, stacklevel=3)
    left_out = [w.message.channels for w in heard if isinstance(w.message, LeftOut)]
    return found, tuple(name for names in left_out for name in names)


def mended(study: Study, found: Sequence[Finding]) -> Study | None:
    """The measurement with a fault corrected or left out, as far as possible; None if too little is left."""
    for f in found:
        if f.what in ("dead", "duplicated"):
            # Of two equal channels which one is right is unknown, so both are left out of what compares channels.
            study = without(study, f.where)
        elif f.what == "wrong_form":
            study = _in_true_form(study, f)
        elif f.what == "delay" and f.size is not None:
            late = [o for o, name in enumerate(study.outputs) if name in f.where or not f.where]
            H = study.H.copy()
            H[:, :, late] *= np.exp(2j * np.pi * study.freq * f.size)[:, None, None]
            study = replace(study, H=H)
        elif f.what == "swapped":
            study = exchanged(study, f.where)
        elif f.what == "hum":
            study = bridged(study, f.bands)
        elif f.what == "drift":
            study = within(study, study.freq > max(end for _, end in f.bands))
        elif f.what == "force_rolloff" and f.size is not None:
            study = within(study, study.freq < f.size)
        if 0 in study.H.shape:
            return None
    return study


def _in_true_form(study: Study, f: Finding) -> Study:
    """The measurement in its own form, without outputs of another one."""
    power = study.power + round(f.size or 0)
    return without(study, f.where) if f.where else replace(study, power=power, form=FORMS[power])


def bridged(study: Study, bands: Sequence[tuple[float, float]]) -> Study:
    """The measurement with straight lines over some bands: lines of a record must stay as far apart as they are."""
    gone = np.any([(study.freq > low) & (study.freq < high) for low, high in bands], axis=0)
    if gone.all() or not gone.any():
        return study
    runs, lines = study.H.shape[:2]
    flat = study.H.transpose(1, 0, 2, 3).reshape(lines, -1)
    over = [np.interp(study.freq[gone], study.freq[~gone], column[~gone]) for column in flat.T]
    H = study.H.copy()
    H[:, gone] = np.array(over).T.reshape(-1, runs, *study.H.shape[2:]).transpose(1, 0, 2, 3)
    return replace(study, H=H)


def within(study: Study, keep: np.ndarray) -> Study:
    """The measurement at some of its lines only, unless next to none would be left."""
    if keep.sum() < len(keep) / 2:
        return study
    variance = None if study.variance is None else study.variance[:, keep]
    return replace(study, freq=study.freq[keep], H=study.H[:, keep], variance=variance)


def exchanged(study: Study, where: Sequence[str]) -> Study:
    """The measurement with two channels exchanged."""
    axis, names = (2, study.outputs) if set(where) <= set(study.outputs) else (3, study.inputs)
    order = list(range(len(names)))
    a, b = (names.index(name) for name in where)
    order[a], order[b] = b, a
    take = lambda x: None if x is None else np.take(x, order, axis=axis)
    return replace(study, H=take(study.H), variance=take(study.variance))


def without(study: Study, names: Sequence[str]) -> Study:
    """The measurement without some outputs and inputs."""
    o = [k for k, name in enumerate(study.outputs) if name not in names]
    i = [k for k, name in enumerate(study.inputs) if name not in names]
    # A dead output need not be a dead input: where the names differ, only the named side is left out.
    take = lambda a: None if a is None else a[:, :, o][..., i]
    return replace(
        study, H=take(study.H), variance=take(study.variance),
        outputs=tuple(study.outputs[k] for k in o), inputs=tuple(study.inputs[k] for k in i),
    )  # fmt: skip
