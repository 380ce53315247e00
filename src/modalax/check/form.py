r"""Wrong form: FRFs called receptance that are mobility or accelerance, and so on.

One derivative turns the residues of all modes by 90 degrees. Two turn them by 180, and what tells that from a reversed
sensor is the rest: below the first mode a structure is a spring or a mass, and at a drive point every part of the
receptance, :math:`\sum_r a_r/(\omega_r^2-\omega^2) - b/\omega^2 + u`, has a positive constant.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from modalax.check.finding import Finding, Picture
from modalax.check.late import delay
from modalax.check.passive import passive_misfit
from modalax.check.phases import angles_of, misfit
from modalax.check.study import DrivePoint, Study
from modalax.data.frf import DERIVATIVES

FORMS = tuple(DERIVATIVES)
# Share of the sum of squares that a turn by 90 degrees may leave, and sum of squares below which it is not tried.
QUARTER, ASKED = 0.15, 40.0
# Angles, or FRFs, from which on one output is judged by itself, or an inverse is tried.
FEWEST = 3
# Factor by which another form must explain the drive points better.
BETTER = 2.0
# Lines below this share of the first mode's frequency show the spring or the mass line; this many lines are needed,
# over this ratio of frequencies.
BELOW, LINES, RANGE = 0.55, 6, 1.8
# Slopes of |H| over frequency there, in powers: receptance is a spring (0) or a mass (-2).
STEP_SLOPE = 0.35


def wrong_form(study: Study) -> Iterator[Finding]:
    """Find FRFs whose phases or slopes contradict their form."""
    if not study.followed and _upside_down(study):
        yield _inverse(study)
        return
    turn = _turn(study) if study.followed else 0
    slope = _slope(study)
    drive = _drive_form(study) if study.followed else None
    label = study.power
    if abs(turn) == 1:
        if drive is not None and drive[0] != label:
            yield _finding(study, drive[0], "the residues of all modes are turned by 90 degrees", 0.99)
        else:
            options = [p for p in (label - 1, label + 1) if 0 <= p <= 2]
            power = min(options, key=lambda p: 0.0 if slope is None else _off(slope, p))
            yield _finding(study, power, "the residues of all modes are turned by 90 degrees", 0.98)
        return
    if study.followed and (turned := _turned_outputs(study)):
        yield from (_one_output(study, o) for o in turned)
    elif drive is not None and drive[0] != label and not any(not f.where for f in delay(study)):
        text = f"as {FORMS[drive[0]]} the drive points are {drive[1]:.3g} times closer to those of a passive structure"
        yield _finding(study, drive[0], text, 0.97)
    elif slope is not None and _off(slope, label) > 1 - STEP_SLOPE and turn == 0:
        fits = [p for p in range(3) if _off(slope, p) < STEP_SLOPE and (p - label) % 2 == 0]
        if len(fits) == 1:
            text = f"below the first mode |H| goes with f^{slope:.2f}, {study.form} with f^{label} (a spring) "
            yield _finding(study, fits[0], text + f"or f^{label - 2} (a mass)", 0.95)


def _off(slope: float, power: int) -> float:
    return min(abs(slope - power), abs(slope - power + 2))


def _turn(study: Study) -> int:
    """1 if all residues are turned by 90 degrees, 2 if all drive points are turned by 180, else 0."""
    angles = angles_of(study)
    if not len(angles.angle):
        return 0
    undirected = angles._replace(drive=np.zeros_like(angles.drive))
    at_rest, quarter = misfit(undirected), misfit(undirected, np.pi / 2)
    count = len(angles.angle)
    if at_rest > ASKED and quarter < QUARTER * at_rest and quarter < 4 * count:
        return 1
    return 0


def _turned_outputs(study: Study) -> list[int]:
    """Outputs whose residues are turned by 90 degrees, in a file where others are not: sensors of different kinds."""
    angles = angles_of(study)
    angles = angles._replace(drive=np.zeros_like(angles.drive))
    found = []
    for o in range(len(study.outputs)):
        own = angles.take(angles.o == o)
        count, quarter = len(own.angle), misfit(own, np.pi / 2)
        if count >= FEWEST and misfit(own) > ASKED and quarter < QUARTER * misfit(own) and quarter < 4 * count:
            found.append(o)
    return found if len(found) < len(study.outputs) else []


def _one_output(study: Study, o: int) -> Finding:
    name = study.outputs[o]
    H = study.H[0, :, o, 0]
    return Finding(
        "wrong_form", (name,), sure=0.96, size=1.0, unit="time derivatives",
        evidence=f"the residues of all modes at {name} are turned by 90 degrees beside those of the other outputs: "
        f"it is one time derivative off {study.form}",
        advice=f"turn {name} to {study.form} before it is put into one file with the others",
        picture=Picture(
            [("real part", study.freq, H.real), ("imaginary part", study.freq, H.imag)], "Frequency [Hz]",
            f"H({name}, {study.inputs[0]})",
        ),
    )  # fmt: skip


def _upside_down(study: Study) -> bool:
    """Whether no modes follow the FRFs and the same modes follow the inverse of all of them."""
    H = study.H
    if not np.abs(H).all() or H.shape[2] * H.shape[3] < FEWEST:
        return False  # the inverse of a drive point alone is passive too
    variance = (study.sigma / np.abs(H) ** 2) ** 2
    return replace(study, H=1 / H, variance=variance).followed


def _inverse(study: Study) -> Finding:
    size = np.abs(study.H[0, :, 0, 0])
    return Finding(
        "wrong_form", (), sure=0.97, size=None, unit="",
        evidence="no common modes follow these FRFs, and the same modes follow the inverse of all: they are force over "
        f"motion, not {study.form}",
        advice="invert each FRF: one of motion over force is needed",
        picture=Picture(
            [("as it is", study.freq, size), ("inverse", study.freq, 1 / size)], "Frequency [Hz]", "[-]", True
        ),
    )  # fmt: skip


def _slope(study: Study) -> float | None:
    """Power of frequency that |H| follows below the first mode; None where the data do not show it."""
    if not len(study.modes.poles):
        return None
    first = study.modes.frequency.min()
    below = np.flatnonzero(study.freq < BELOW * first)
    if len(below) < LINES or study.freq[below[-1]] < RANGE * study.freq[below[0]]:
        return None
    f = study.freq[below]
    # Springs and masses in parallel bend the line by 1 - (f/f1)^2; the first mode's part is taken out of it.
    size = np.abs(study.H[0, below]) * (1 - (f / first) ** 2)[:, None, None]
    clear = (study.sigma[0, below] < 0.25 * size).mean(axis=0) > 0.8
    if not clear.any():
        return None
    x = np.log(f) - np.log(f).mean()
    slopes = np.einsum("f,foi->oi", x, np.log(np.maximum(size, 1e-300))) / np.sum(x**2)
    chosen = slopes[clear]
    if len(chosen) < 2 and not study.drive_points:
        return None
    middle = float(np.median(chosen))
    return middle if np.median(np.abs(chosen - middle)) < 0.3 else None


def _drive_form(study: Study) -> tuple[int, float] | None:
    """Form that makes all drive points passive, and how much better than the stated one either sign; or None."""
    points = [p for p in study.drive_points if not study.silent[0, p.o, p.i]]
    if not points or not _opposite(study):
        return None
    total = np.array([[sum(_misfit_of(study, p, form, sign) for p in points) for sign in (1, -1)] for form in range(3)])
    own = total[study.power].min()
    others = total[:, 0].copy()
    others[study.power] = np.inf
    best = int(np.argmin(others))
    if others[best] * BETTER < own and _exchanged(study, points) > others[best]:
        return best, float(own / others[best])
    # Several drive points are all opposite: so many sensors are seldom reversed together.
    if len(points) > 1 and others[best] < 1.1 * own and total[study.power, 0] > BETTER * others[best]:
        return best, float(total[study.power, 0] / others[best])
    return None


def _exchanged(study: Study, points: list[DrivePoint]) -> float:
    """Least misfit in the stated form where another output stands in the place of one of the drive points' sensors."""
    own = [_misfit_of(study, p, study.power, 1) for p in points]
    least = np.inf
    for k, p in enumerate(points):
        rest = sum(own) - own[k]
        if rest < least:
            others = (o for o in range(len(study.outputs)) if o != p.o and not study.silent[0, o, p.i])
            least = min([least, *(rest + _misfit_of(study, p._replace(o=o), study.power, 1) for o in others)])
    return float(least)


def _opposite(study: Study) -> bool:
    """Whether the residues at the drive points all lie about one angle that is not 0."""
    angles = angles_of(study)
    drive = angles.take(angles.drive)
    if not len(drive.angle):
        return False
    mean = np.sum(drive.weight * np.exp(1j * drive.angle)) / np.sum(drive.weight)
    return bool(abs(mean) > 0.8 and abs(np.angle(mean)) > 0.9)


def _misfit_of(study: Study, point: DrivePoint, power: int, sign: int) -> float:
    """:func:`passive_misfit` of a drive point in some form and with some sign."""
    H = sign * point.sign * study.H[0, :, point.o, point.i]
    return passive_misfit(study.freq, H, study.sigma[0, :, point.o, point.i], study.modes.poles, power)


def _finding(study: Study, power: int, evidence: str, sure: float) -> Finding:
    point = study.drive_points[0] if study.drive_points else None
    o, i = (point.o, point.i) if point else (0, 0)
    H = study.H[0, :, o, i]
    return Finding(
        "wrong_form", (), sure=sure, size=float(power - study.power), unit="time derivatives",
        evidence=f"{evidence}: these FRFs are {FORMS[power]}, not {study.form}",
        advice=f"correct the form in the file to {FORMS[power]} (--form does where it states none or is a universal "
        "file), or the unit of the responses",
        picture=Picture(
            [("real part", study.freq, H.real), ("imaginary part", study.freq, H.imag)], "Frequency [Hz]",
            f"H({study.outputs[o]}, {study.inputs[i]})",
        ),
    )  # fmt: skip
