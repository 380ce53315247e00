r"""Reciprocity: the response at one place to a force at another place is the same both ways.

Where two channels have been exchanged, one response is compared with another; exchanged back all pairs agree. A
constant factor between the two is a matter of calibration, :math:`H_{pq}/H_{qp} = c_p/c_q` with :math:`c` the gain of
the sensor over that of the hammer at a place, a phase in proportion to frequency of a delay; anything else is a
structure, or a test, that is not reciprocal.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from modalax.check.finding import Finding, Picture, deviations, sureness
from modalax.check.one_shape import other_shape
from modalax.check.study import DrivePoint, Study

# A calibration error is reported from this deviation of the factor from 1 on, if it is this many standard deviations.
SMALLEST_GAIN, SURE = 0.03, 6.0
# Energy of the difference of both directions over that of the FRF, gain taken out, from which on it is reported.
SMALLEST_DIFFERENCE = 0.004
# Relative error of the ratio of two residues that is not in their standard deviations.
MODE_ERROR = 0.02
# Part of the largest difference that an exchange of channels may leave.
MENDED = 0.2
# The noise is known to about this factor.
NOISE_FACTOR = 4.0


def reciprocity(study: Study) -> Iterator[Finding]:
    """Find wrong calibration constants, delays, and pairs of FRFs that differ by more than these."""
    pairs, differs = {}, {}
    for p, q in combinations(study.drive_points, 2):
        fit = ratio(study.H, study.sigma, p, q)
        if fit is not None:
            factor, std, left, excess = fit
            differs[p.name, q.name] = by_modes = _by_modes(study, p, q)
            pairs[p.name, q.name] = (p, q, factor, std, left, max(excess, by_modes.score))
    late = _late(study, differs)
    if late is not None:
        yield late
        return
    wild = {key for key, (*_, excess) in pairs.items() if excess > 1}
    alone = single_frf(study, [pairs[key][:2] for key in wild])
    exchange = _exchange(study, pairs, wild) if wild and not alone else None
    if exchange is not None:
        yield exchange
        return
    yield from _not_reciprocal(study, {key: pairs[key] for key in wild})
    yield from _calibration(study, {key: value for key, value in pairs.items() if key not in wild})


def ratio(H: np.ndarray, sigma: np.ndarray, p: DrivePoint, q: DrivePoint) -> tuple[float, float, float, float] | None:
    """Factor between both directions, its standard deviation, the difference left, and its ratio to the noise.

    FRFs and their noise have the shape ``(run, f, o, i)``; a pair is not reciprocal from a ratio of 1 on. None where
    there is little but noise.
    """
    there, back = p.sign * H[:, :, p.o, q.i], q.sign * H[:, :, q.o, p.i]
    n1, n2 = sigma[:, :, p.o, q.i], sigma[:, :, q.o, p.i]
    weight = 1 / (n1**2 + n2**2)
    # Errors in proportion to the FRF are allowed for, so that a few lines of a resonance do not decide alone.
    weight = 1 / (1 / weight + 0.01 * (np.abs(there) ** 2 + np.abs(back) ** 2))
    aa, bb = np.sum(weight * np.abs(there) ** 2), np.sum(weight * np.abs(back) ** 2)
    ab = np.sum(weight * np.conj(back) * there)
    if aa <= 0 or bb <= 0:
        return None
    share = 0.5 * (np.sum(weight * n1**2) / aa + np.sum(weight * n2**2) / bb)
    if share > 0.7:
        return None
    noise_a, noise_b = np.sum(weight * n1**2), np.sum(weight * n2**2)
    size = np.sqrt(max(aa - noise_a, 1e-300) / max(bb - noise_b, 1e-300))
    factor = np.sign(ab.real) * size if ab.real != 0 else size
    left = np.sum(weight * np.abs(there - factor * back) ** 2)
    expected = noise_a + factor**2 * noise_b
    total = aa + factor**2 * bb
    excess = (left - NOISE_FACTOR * expected) / (SMALLEST_DIFFERENCE * total)
    lines = weight.size
    std = abs(factor) * np.sqrt(max(expected, left) / (2 * total) / lines * 4)
    # Lines at resonances carry all the weight where the noise is large.
    effective = np.sum(weight * np.abs(there) ** 2) ** 2 / np.sum((weight * np.abs(there) ** 2) ** 2)
    std = abs(factor) * np.sqrt(max(expected, left) / total / max(effective, 1.0))
    return float(factor), float(std), float(left / total), float(excess)


def differing(study: Study) -> list[tuple[DrivePoint, DrivePoint]]:
    """Pairs of places that do not answer the same both ways, constant factors apart."""
    found = []
    for p, q in combinations(study.drive_points, 2):
        fit = ratio(study.H, study.sigma, p, q)
        if fit is not None and max(fit[-1], _by_modes(study, p, q).score) > 1:
            found.append((p, q))
    return found


def single_frf(study: Study, pairs: Sequence[tuple[DrivePoint, DrivePoint]]) -> bool:
    """Whether one FRF alone makes the only pair differ: exchanged channels make several, or leave each mode's shape."""
    return len(pairs) == 1 and any(other_shape(study, [(p.o, q.i), (q.o, p.i)]) > 1 for p, q in pairs)


class Difference(NamedTuple):
    """How far the ratio of both directions differs from mode to mode: a finding from a score of 1 on.

    Attributes
    ----------
    score, late_score
        As measured, and with the best constant delay [s] between the two taken out.
    delay, std
        Of the first place's sensor over its force, less that of the second's.
    """

    score: float
    late_score: float
    delay: float
    std: float


def _by_modes(study: Study, p: DrivePoint, q: DrivePoint) -> Difference:
    """Compare the residues of both directions."""
    omega, residues, spread = study.summed
    there, back = p.sign * residues[:, p.o, q.i], q.sign * residues[:, q.o, p.i]
    relative = np.hypot(spread[:, p.o, q.i] / np.abs(there), spread[:, q.o, p.i] / np.abs(back))
    clear = relative < 0.1
    if clear.sum() < 2:
        return Difference(0.0, 0.0, 0.0, np.inf)
    logs, std = np.log(there[clear] / back[clear]), np.hypot(relative[clear], MODE_ERROR)
    # A constant factor of either sign comes from the channels.
    turned = min((np.angle(s * np.exp(1j * logs.imag)) for s in (1, -1)), key=lambda t: float(np.sum(t**2 / std**2)))
    middle = np.sum(logs.real / std**2) / np.sum(1 / std**2)
    normal = float(np.sum((omega[clear] / std) ** 2))
    slope = float(np.sum(omega[clear] * turned / std**2)) / normal
    scores = []
    for rest, freedom in ((turned, 1), (turned - slope * omega[clear], 2)):
        off = np.hypot(logs.real - middle, rest) / std
        scores.append(max(float(off.max()), deviations(float(np.sum(off**2)), 2 * len(off) - freedom)) / SURE)
    return Difference(scores[0], scores[1], -slope, 1 / float(np.sqrt(normal)))


def _late(study: Study, differs: dict[tuple[str, str], Difference]) -> Finding | None:
    """A delay that explains every pair that differs; None where none does, or no pair differs."""
    wild = {key: d for key, d in differs.items() if d.score > 1}
    if not wild or any(d.late_score > 1 or abs(d.delay) < SURE * d.std for d in wild.values()):
        return None
    common = [name for name in next(iter(wild)) if all(name in key for key in wild)]
    if not common or any(name in key and key not in wild for name in common for key in differs):
        return None
    name = common[0]
    signed = np.array([(d.delay if key[0] == name else -d.delay, d.std) for key, d in wild.items()])
    weight = 1 / signed[:, 1] ** 2
    tau, std = float(signed[:, 0] @ weight / weight.sum()), float(1 / np.sqrt(weight.sum()))
    score = min(d.score for d in wild.values())
    p, q = (next(x for x in study.drive_points if x.name == name) for name in next(iter(wild)))
    return Finding(
        "delay", tuple(common), sure=sureness(score, 1.0), size=tau, unit="s",
        interval=(tau - 1.96 * std, tau + 1.96 * std),
        evidence=f"reciprocal FRFs of {' and '.join(common)} differ by phases in proportion to frequency, as a delay "
        f"of {tau:.4g} s makes them",
        advice="check filters, sampling clocks and converters of this sensor and this force against the others'; "
        "reciprocity cannot tell which of them is late",
        picture=_both_ways(study, p, q),
    )  # fmt: skip


def _exchange(study: Study, pairs: dict, wild: set[tuple[str, str]]) -> Finding | None:
    """Two channels that make every pair agree when they are exchanged back; None where no two or several do."""
    told = {name for key in wild for name in key}
    driven = [p for p in study.drive_points if p.name in told]
    found: dict[tuple[str, ...], float] = {}
    for axis, names, places in (
        (2, study.outputs, [p.o for p in driven]), (3, study.inputs, [p.i for p in driven]),
    ):  # fmt: skip
        tried = sorted({(min(a, b), max(a, b)) for a in places for b in range(len(names)) if a != b})
        for a, b in tried:
            where = tuple(sorted((names[a], names[b])))
            left = _worst_exchanged(study, pairs, wild, axis, a, b) if where not in found else None
            if left is not None:
                found[where] = left
    if len(found) != 1:
        return None
    (where, left), worst = found.popitem(), max(wild, key=lambda key: pairs[key][-1])
    p, q, *_, excess = pairs[worst]
    return Finding(
        "swapped", where, sure=sureness(excess / max(left, 1.0), 1.0), size=None,
        evidence="with the two exchanged, the FRFs of all pairs of drive points are the same both ways; as measured "
        "they are not",
        advice="exchange the two channels, or their names", picture=_both_ways(study, p, q),
    )  # fmt: skip


def _worst_exchanged(study: Study, pairs: dict, wild: set, axis: int, a: int, b: int) -> float | None:
    """Largest difference over its limit after an exchange of two channels; None where a pair still differs."""
    order = list(range(study.H.shape[axis]))
    order[a], order[b] = b, a
    changed = replace(study, H=np.take(study.H, order, axis), variance=None)
    omega, residues, std = study.summed
    changed.__dict__["sigma"] = np.take(study.sigma, order, axis)
    changed.__dict__["summed"] = omega, *(np.take(a, order, axis - 1) for a in (residues, std))
    if _backward(changed) > _backward(study):
        return None
    before, worst = max(pairs[key][-1] for key in wild), 0.0
    for key in sorted(pairs, key=lambda key: -pairs[key][-1]):
        fit = ratio(changed.H, changed.sigma, *pairs[key][:2])
        if fit is None:
            continue
        factor, std, _, excess = fit
        off = abs(np.log(abs(factor))) / max(SMALLEST_GAIN, SURE * std / abs(factor))
        worst = max(worst, excess, *((off, _by_modes(changed, *pairs[key][:2]).score) if key in wild else ()))
        if factor < 0 or worst > min(1.0, MENDED * before):
            return None
    return float(worst)


def _backward(study: Study) -> int:
    """Number of residues at drive points of which a passive structure has none: a mode that gives off energy."""
    _, residues, std = study.summed
    return sum(int(np.sum(-p.sign * residues[:, p.o, p.i].imag < -SURE * std[:, p.o, p.i])) for p in study.drive_points)


def _not_reciprocal(study: Study, pairs: dict) -> Iterator[Finding]:
    if not pairs:
        return
    names = sorted({name for key in pairs for name in key})
    common = [name for name in names if all(name in key for key in pairs)]
    worst = max(pairs, key=lambda key: pairs[key][-1])
    p, q, factor, _, left, excess = pairs[worst]
    yield Finding(
        "not_reciprocal", tuple(common if len(pairs) > 2 and len(common) == 1 else names),
        sure=sureness(excess, 1.0), size=float(np.sqrt(left)), unit="of the FRF",
        evidence=f"H({p.name}, {q.name}) and H({q.name}, {p.name}) differ by {100 * np.sqrt(left):.3g} % (rms), with "
        f"the constant factor {factor:.4g} taken out; noise does not explain it",
        advice="look for a sensor that loads the structure in one of the two set-ups, a hit beside its point or askew, "
        "gyroscopic or moving parts, or a non-linear joint driven differently",
        picture=_both_ways(study, p, q),
    )  # fmt: skip


def _calibration(study: Study, pairs: dict) -> Iterator[Finding]:
    """Gains at places, from the factors of all pairs; those off the median of all are wrong."""
    names = list(dict.fromkeys(name for key in pairs for name in key))
    if len(names) < 2:
        return
    rows, values, weights = [], [], []
    for (a, b), (_, _, factor, std, _, _) in pairs.items():
        row = np.zeros(len(names))
        row[names.index(a)], row[names.index(b)] = 1, -1
        rows.append(row)
        values.append(np.log(abs(factor)))
        weights.append(1 / (std / abs(factor) + 0.003))
    A, w = np.array(rows), np.array(weights)
    covariance = np.linalg.pinv((A * w[:, None] ** 2).T @ A)
    logs = covariance @ (A.T @ (w**2 * np.array(values)))
    if len(names) == 2:
        logs, spread = logs[0] - logs[1], 1 / w[0]
        if abs(logs) > max(SMALLEST_GAIN, SURE * spread):
            yield _gain(study, tuple(names), float(logs), float(spread), pairs)
        return
    logs = logs - np.median(logs)
    std = np.sqrt(np.diag(covariance) + np.median(np.diag(covariance)))
    for name, value, spread in zip(names, logs, std, strict=True):
        if abs(value) > max(SMALLEST_GAIN, SURE * spread):
            yield _gain(study, (name,), float(value), float(spread), pairs)


def _gain(study: Study, where: tuple[str, ...], value: float, std: float, pairs: dict) -> Finding:
    p, q = next((p, q) for key, (p, q, *_) in pairs.items() if set(where) & set(key))
    factor = float(np.exp(value))
    interval = (float(np.exp(value - 1.96 * std)), float(np.exp(value + 1.96 * std)))
    places = f"at {where[0]} than elsewhere" if len(where) == 1 else f"between {where[0]} and {where[1]}"
    return Finding(
        "calibration", where, sure=sureness(abs(value) / max(SMALLEST_GAIN, SURE * std), 1.0), size=factor, unit="-",
        interval=interval,
        evidence=f"reciprocal FRFs differ by the factor {factor:.4g} ({interval[0]:.4g} to {interval[1]:.4g}) "
        f"{places}, the same at all frequencies",
        advice="check the sensitivities of sensor and hammer at these places; reciprocity cannot tell "
        "which of them is wrong (a hit on a known free mass can)",
        picture=_both_ways(study, p, q),
    )  # fmt: skip


def _both_ways(study: Study, p: DrivePoint, q: DrivePoint) -> Picture:
    there, back = study.H[0, :, p.o, q.i], study.H[0, :, q.o, p.i]
    return Picture(
        [
            (f"{p.name} from {q.name}", study.freq, np.abs(there)),
            (f"{q.name} from {p.name}", study.freq, np.abs(back)),
        ],
        "Frequency [Hz]", "|H|", True,
    )  # fmt: skip
