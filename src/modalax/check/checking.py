"""The check of a measurement: every detector asked in turn."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from modalax.check.channels import conjugated, dead, duplicated
from modalax.check.finding import TOLD, Finding, Findings
from modalax.check.form import FORMS, wrong_form
from modalax.check.hum import hum
from modalax.check.phases import delay
from modalax.check.places import misplaced
from modalax.check.reciprocity import reciprocity
from modalax.check.resolution import resolution
from modalax.check.shifts import frequency_shift
from modalax.check.study import Study, study_of
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.files import load

Detector = Callable[[Study], Iterator[Finding]]
# In this order: what an earlier one finds is mended, or left out, before the later ones look.
DETECTORS: tuple[Detector, ...] = (
    conjugated, dead, duplicated, hum, resolution, wrong_form, frequency_shift, delay, misplaced, reciprocity,
)  # fmt: skip


def check(data: FRF | Measurement | str | os.PathLike[str]) -> Findings:
    """Find what is wrong with a measurement, before any model.

    What is looked for are faults of channels (reversed, swapped, dead, duplicated, delayed, wrong calibration), of the
    excitation, of the record, and of the structure's rest during the test. A fault that the data cannot show, such as
    a reversed sensor at a place that was never driven, is not told.

    Parameters
    ----------
    data
        FRFs of one run or several, or a file that :func:`modalax.load` reads.

    Returns
    -------
    Findings
        Empty for a sound measurement.

    Raises
    ------
    ValueError
        If the file holds no measurement, or fewer than 8 lines above 0 Hz.
    """
    study = study_of(_measurement(data))
    found: list[Finding] = []
    for detector in DETECTORS:
        new = [f for f in detector(study) if f.sure >= TOLD]
        found += new
        study = mended(study, new)
        if study is None:
            break
    return Findings(tuple(sorted(found, key=lambda f: -f.sure)))


def _measurement(data: FRF | Measurement | str | os.PathLike[str]) -> Measurement:
    """What was measured, in the time convention of its file."""
    if isinstance(data, FRF):
        return Measurement.from_frfs([data])
    if isinstance(data, Measurement):
        return data
    found = load(data, conjugate=False)
    if not isinstance(found, Measurement):
        raise ValueError(f"{data} holds a {type(found).__name__}; a measurement is needed here")
    return found


def mended(study: Study, found: Sequence[Finding]) -> Study | None:
    """The measurement without what was found, as far as that can be taken out; None if too little is left."""
    for f in found:
        if f.what in ("dead", "duplicated"):
            # Of two equal channels which one is right is unknown, so both are left out of what compares channels.
            study = without(study, f.where)
        elif f.what == "wrong_form":
            study = replace(study, power=study.power + round(f.size or 0), form=FORMS[study.power + round(f.size or 0)])
        elif f.what == "delay" and f.size is not None:
            late = [o for o, name in enumerate(study.outputs) if name in f.where or not f.where]
            H = study.H.copy()
            H[:, :, late] *= np.exp(2j * np.pi * study.freq * f.size)[:, None, None]
            study = replace(study, H=H)
        elif f.what == "swapped":
            study = exchanged(study, f.where)
        elif f.what == "frequency_shift":
            return None  # Columns of different structures cannot be compared.
        if 0 in study.H.shape:
            return None
    return study


def exchanged(study: Study, where: Sequence[str]) -> Study:
    """The measurement with two channels exchanged."""
    axis, names = (2, study.outputs) if set(where) <= set(study.outputs) else (3, study.inputs)
    order = list(range(len(names)))
    a, b = (names.index(name) for name in where)
    order[a], order[b] = b, a
    take = lambda x: None if x is None else np.take(x, order, axis=axis)  # noqa: E731
    return replace(study, H=take(study.H), variance=take(study.variance))


def without(study: Study, names: Sequence[str]) -> Study:
    """The measurement without some outputs and inputs."""
    o = [k for k, name in enumerate(study.outputs) if name not in names]
    i = [k for k, name in enumerate(study.inputs) if name not in names]
    # A dead output need not be a dead input: only the side that was named goes, where the names differ.
    take = lambda a: None if a is None else a[:, :, o][..., i]  # noqa: E731
    return replace(
        study, H=take(study.H), variance=take(study.variance),
        outputs=tuple(study.outputs[k] for k in o), inputs=tuple(study.inputs[k] for k in i),
    )  # fmt: skip
