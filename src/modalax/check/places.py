r"""Signs and places of channels, checked where a place is both driven and measured.

A passive and reciprocal structure obeys two rules: a residue :math:`A_r` of the receptance at a drive point is
:math:`-j` times a positive number for real modes, and stays near it for the complex modes of light damping; residues
between two drive points are the same both ways. Where the data break them, sign changes and exchanges of channels are
tried one by one, and one is reported if it corrects everything: the residues, and the whole curves of the pairs, which
an exchange that only happens to mend a residue or two does not make reciprocal. Of several that do, the one is taken
that also makes the drive points those of a passive structure between the resonances (:mod:`modalax.check.passive`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.passive import passive_misfit
from modalax.check.phases import complexity
from modalax.check.reciprocity import SMALLEST_GAIN, SURE, differing, ratio, single_frf
from modalax.check.study import Study

# A residue may lie off its axis by this share of itself, and by this share of the mode's largest.
TURNED, OF_LARGEST = 0.15, 0.004
# Where the mode hardly moves the drive point, what makes modes complex decides: this many times their scatter.
TIMES_SCATTER = 2.0
# Reciprocity holds for complex modes too; this much is left to errors of the estimate.
RECIPROCAL = 0.04
# Squared deviations over tolerances: most that one term counts, the sum from which on a rule is broken, and the share
# of that sum that a correction may leave.
MOST, BROKEN, MENDED = 40.0, 30.0, 0.2
# Share of the sum within which corrections are as good as each other; by how much more passive a drive point must
# become for another than the first of them; the sum from which on that alone is enough, and by how much then.
ALIKE, BETTER, HINT, CLEARLY = 0.05, 2.0, 10.0, 10.0
LOOKED_AT = 40  # corrections whose curves are compared, the best by their residues
MOST_FAULTS = 3  # sign changes and exchanges that are tried together, at most


@dataclass(frozen=True)
class Mend:
    """A correction of the channels that would explain the violations."""

    what: str
    where: tuple[str, ...]
    change: Callable[[np.ndarray], np.ndarray]


def misplaced(study: Study) -> Iterator[Finding]:
    """Find reversed and swapped channels."""
    _, residues, std = study.summed
    if not study.drive_points or not study.explained:
        return
    mends = list(_mends(study))
    chosen: list[tuple[Mend, float, list[Mend]]] = []
    H, sigma = study.H[0], study.sigma[0]
    first = before = broken(study, residues, std) + _curves_differ(study, H, sigma)
    if before < HINT:
        yield from _turned(study)
        return
    if single_frf(study, differing(study)):
        return  # no channel as a whole is at fault
    while before >= HINT and len(chosen) < MOST_FAULTS:
        left = np.array([broken(study, m.change(residues), np.abs(m.change(std))) for m in mends])
        best = np.argsort(left)
        left[best[LOOKED_AT:]] = np.inf
        for k in best[:LOOKED_AT]:
            m = mends[k]
            left[k] += _curves_differ(study, m.change(H), np.abs(m.change(sigma)), m.what == "swapped")
        alike = [mends[k] for k in np.flatnonzero(left <= left.min() + ALIKE * before)]
        passive = np.array([_not_passive(study, m.change(H), np.abs(m.change(sigma)), m.where) for m in alike])
        k = 0 if passive[0] < BETTER * passive.min() else int(np.argmin(passive))
        best = mends.index(alike[k])
        as_measured = _not_passive(study, H, sigma, alike[k].where)
        if left[best] > 0.7 * before or (before < BROKEN and passive[k] * CLEARLY > as_measured):
            break
        single = len(study.drive_points) == 1  # with several, reciprocity tells exchanges apart
        others = [m for m, p in zip(alike, passive, strict=True) if single and p < BETTER * passive[k]]
        chosen.append((alike[k], before - left[best], others))
        residues, std = alike[k].change(residues), np.abs(alike[k].change(std))
        H, sigma = alike[k].change(H), np.abs(alike[k].change(sigma))
        before = float(left[best])
    # A correction that leaves much is no explanation.
    if chosen and before < max(BROKEN, MENDED * first):
        yield from (_finding(study, mend, gain, others) for mend, gain, others in chosen)


def _turned(study: Study) -> Iterator[Finding]:
    """Find signs that only the curve between the resonances shows, as where no mode in the band moves the place."""
    for mend in _mends(study):
        if mend.what == "reversed" and len(mend.where) == 1:
            H, sigma = study.H[0], study.sigma[0]
            as_measured = _not_passive(study, H, sigma, mend.where)
            turned = _not_passive(study, mend.change(H), sigma, mend.where)
            # In squares of noise: with the sign turned the curve is that of a passive structure, as measured far off.
            if turned < 1 and as_measured > max(HINT, CLEARLY * turned):
                yield _finding(study, mend, as_measured * BROKEN / HINT, [])


def _not_passive(study: Study, H: np.ndarray, sigma: np.ndarray, where: tuple[str, ...]) -> float:
    """Mean misfit of the drive points at some channels, or of all where none is there."""
    points = [p for p in study.drive_points if {study.outputs[p.o], study.inputs[p.i]} & set(where)]
    found = [
        passive_misfit(study.freq, p.sign * H[:, p.o, p.i], sigma[:, p.o, p.i], study.modes.poles, study.power)
        for p in points or study.drive_points
    ]
    return float(np.mean(found))


def _curves_differ(study: Study, H: np.ndarray, sigma: np.ndarray, same: bool = False) -> float:
    """Sum over pairs of drive points of what differs between both directions, each as much as one term at most.

    With ``same`` a constant factor between the two counts as well: an exchange that leaves one explains less than all.
    """
    total = 0.0
    for p, q in combinations(study.drive_points, 2):
        fit = ratio(H[None], sigma[None], p, q)
        if fit is not None:
            factor, std, _, excess = fit
            off = abs(np.log(abs(factor))) / max(SMALLEST_GAIN, SURE * std / abs(factor)) if same else 0.0
            total += MOST * float(np.clip(max(excess, off - 1), 0.0, 1.0))
    return total


def broken(study: Study, residues: np.ndarray, std: np.ndarray) -> float:
    """Sum over modes and drive points of squared violations of passivity and of reciprocal phases."""
    largest = np.abs(residues).max(axis=(1, 2), initial=0.0)
    scatter = TIMES_SCATTER * complexity(study)[0]
    total = 0.0
    points = study.drive_points
    for p in points:
        own = 1j * p.sign * residues[:, p.o, p.i]
        typical = np.sqrt(np.mean(np.abs(residues[:, :, p.i]) ** 2, axis=1))
        tolerance = std[:, p.o, p.i] ** 2 + (OF_LARGEST * largest) ** 2 + (TURNED * np.abs(own)) ** 2
        tolerance += (scatter * typical) ** 2
        total += np.sum(np.minimum(np.minimum(own.real, 0.0) ** 2 / tolerance, MOST))
    for a, p in enumerate(points):
        for q in points[a + 1 :]:
            there, back = p.sign * residues[:, p.o, q.i], q.sign * residues[:, q.o, p.i]
            # The pair may differ by a constant, the calibration of its channels.
            clear = np.maximum(np.minimum(np.abs(there), np.abs(back)) / (std[:, p.o, q.i] + std[:, q.o, p.i]), 1e-9)
            gain = _middle(np.abs(there) / np.maximum(np.abs(back), 1e-300), np.minimum(clear, 10.0))
            back = gain * back
            wrong = np.abs(there - back) ** 2
            tolerance = std[:, p.o, q.i] ** 2 + (gain * std[:, q.o, p.i]) ** 2 + (OF_LARGEST * largest) ** 2
            tolerance += RECIPROCAL**2 * (np.abs(there) + np.abs(back)) ** 2
            total += np.sum(np.minimum(wrong / tolerance, MOST))
    return float(total)


def _middle(values: np.ndarray, weight: np.ndarray) -> float:
    """Weighted median."""
    if not len(values):
        return 1.0
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def _mends(study: Study) -> Iterator[Mend]:
    """All single sign changes and exchanges that drive points could show."""
    points = study.drive_points
    if len(points) > 1 and len(study.inputs) > 1:
        yield Mend("reversed", study.inputs, np.negative)
    for p in points:
        yield Mend("reversed", (p.name,), _flip(p.o))
    for axis, names, driven in (
        (1, study.outputs, {p.o for p in points}),
        (2, study.inputs, {p.i for p in points}),
    ):
        for a in range(len(names)):
            for b in range(a + 1, len(names)):
                if {a, b} & driven:
                    yield Mend("swapped", (names[a], names[b]), _exchange(axis, a, b))


def _flip(o: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[:, o] *= -1
        return values

    return change


def _exchange(axis: int, a: int, b: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        order = np.arange(values.shape[axis])
        order[[a, b]] = b, a
        return np.take(values, order, axis=axis)

    return change


def _finding(study: Study, mend: Mend, gain: float, others: list[Mend]) -> Finding:
    exchanges = [" and ".join(m.where) for m in others if m is not mend and m.what == "swapped"]
    also = f"; an exchange of {', or of '.join(exchanges[:3])} would explain it as well" if exchanges else ""
    name = next(p for p in study.drive_points if mend.what == "swapped" or p.name in mend.where or len(mend.where) > 1)
    if mend.what == "swapped":
        name = next((p for p in study.drive_points if {study.outputs[p.o], study.inputs[p.i]} & set(mend.where)), name)
    part = np.real((1j * 2 * np.pi * study.freq) ** (1 - study.power) * name.sign * study.H[0, :, name.o, name.i])
    picture = Picture([(f"drive point {name.name}", study.freq, part)], "Frequency [Hz]", "Real part of the mobility")
    if mend.what == "reversed":
        return Finding(
            "reversed", mend.where, sure=sureness(gain, BROKEN), size=-1.0, unit="-",
            evidence="with its sign turned, every drive point is that of a passive structure and all reciprocal pairs "
            f"agree; as measured they do not{also}",
            advice="turn the sign of this sensor or hammer (mounting direction, cable, polarity); the data cannot tell "
            "which of the two at this place is wrong",
            picture=picture,
        )  # fmt: skip
    return Finding(
        "swapped", mend.where, sure=sureness(gain, BROKEN), size=None,
        evidence="with the two exchanged, every drive point takes up energy at every resonance and all reciprocal "
        f"pairs agree; as measured they do not{also}",
        advice="exchange the two channels, or their names",
        picture=picture,
    )  # fmt: skip
