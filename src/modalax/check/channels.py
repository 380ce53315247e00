"""Channels without data of their own: dead channels and copies of another channel."""

from collections.abc import Iterator

import numpy as np

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.noise import MEDIAN, off_neighbours
from modalax.check.study import Study

# Correlation of neighbouring lines, in standard deviations, below which a channel is taken to hold noise alone.
ALIKE = 5.0
# n lines in one phase are sqrt(n - 1) standard deviations alike: with so many, those of a live channel are.
MANY = round(4 * ALIKE**2) + 1
# Residue, in standard deviations, that none of hundreds of residues of a channel with noise alone exceeds.
VISIBLE = 4.5
# Root mean square of a channel over the others' below which residues must be twice as clear: a live sensor moves in
# some mode.
QUIET = 0.02
# Two channels share their noise if they differ by less than these parts of the noise of both, and of the FRF.
SHARED, EQUAL = 0.01, 0.05
# Noise below this share of an FRF is rounding, as in calculated FRFs; equal channels are then no sign of a copy.
ROUNDING = 1e-6


def without_numbers(channel: str) -> Finding:
    """A channel all of whose samples are missing in the file, so that nothing else is known of it."""
    return Finding(
        "dead", (channel,), sure=0.99, evidence="its FRFs hold no finite number at any line",
        advice="check the cable, the sensor and the channel's range, and measure it again or leave it out",
    )  # fmt: skip


def dead(study: Study) -> Iterator[Finding]:
    """Find dead channels: in none of their FRFs are neighbouring lines alike, but for a constant, and no mode shows."""
    ratio = np.abs(study.residues) / np.maximum(study.residue_std, np.finfo(float).tiny)
    quiet = np.array([_share(study.H, o, 1) < QUIET for o in range(len(study.outputs))])[:, None]
    quiet = quiet | np.array([_share(study.H, i, 0) < QUIET for i in range(len(study.inputs))])
    seen = ratio.max(axis=0, initial=0.0) > np.where(quiet, 2 * VISIBLE, VISIBLE)
    constant = (_likeness(study.H) > ALIKE).any(axis=0)
    # What a quiet channel has in common at all lines is an offset, or what leaks into it from the force.
    varies = (_likeness(study.H - study.H.mean(axis=1, keepdims=True)) > ALIKE).any(axis=0)
    silent = study.silent.all(axis=0)
    alive = (np.where(quiet, varies, constant) | seen) & ~silent
    if not alive.any():
        yield from _all_dead(study, bool(constant.any()))
        return
    for axis, names in ((1, study.outputs), (0, study.inputs)):
        if len(names) < 2:
            continue
        for k in np.flatnonzero(~alive.any(axis=axis)).tolist():
            zero = silent.take(k, axis=1 - axis).all()
            alike = constant.take(k, axis=1 - axis).any()
            noise = "constant but for noise" if alike else "noise: neighbouring lines are not alike"
            yield Finding(
                "dead", (names[k],), sure=0.99 if zero else 0.95, size=_share(study.H, k, axis),
                unit="rms of the others",
                evidence="its FRFs are zero or constant at all lines" if zero else
                f"its FRFs are {noise}, and no resonance of the other channels is seen",
                advice="check the cable, the sensor and the channel's range, and measure it again or leave it out",
                picture=_spectra(study, k, axis),
            )  # fmt: skip


def _all_dead(study: Study, constant: bool) -> Iterator[Finding]:
    """All channels dead, unless lines are so few that they need not be alike, or those of a rigid body."""
    zero = not study.H.any()
    if constant or not zero and len(study.freq) < MANY:
        return
    yield Finding(
        "dead", study.outputs, sure=0.99 if zero else 0.95,
        evidence="all FRFs are zero at all lines" if zero else
        "all FRFs are noise: neighbouring lines are not alike, and no resonance is seen in any",
        advice="check that the force reaches the structure, the cables and the channels' ranges, and measure again",
    )  # fmt: skip


def _likeness(H: np.ndarray) -> np.ndarray:
    """Sum of products of neighbouring lines in standard deviations of products of noise, ``(run, o, i)``."""
    size = np.abs(H)
    unit = np.divide(H, np.sqrt(size), out=np.zeros_like(H), where=size > 0)
    products = unit[:, 1:] * unit[:, :-1].conj()
    spread = np.sqrt(np.sum(np.abs(products) ** 2, axis=1))
    return np.abs(products.sum(axis=1)) / np.where(spread > 0, spread, 1.0)


def _share(H: np.ndarray, k: int, axis: int) -> float:
    """Root mean square of a channel over the median of all others."""
    power = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 1, 3 if axis else 2)))
    if len(power) < 2:
        return 1.0
    others = np.median(np.delete(power, k))
    return float(power[k] / others) if others > 0 else 0.0


def _spectra(study: Study, k: int, axis: int) -> Picture:
    size = np.abs(study.H[0]).mean(axis=2 if axis else 1)
    name = (study.outputs if axis else study.inputs)[k]
    rest = np.median(np.delete(size, k, axis=1), axis=1)
    return Picture(
        [(name, study.freq, size[:, k]), ("middle of the others", study.freq, rest)], "Frequency [Hz]", "|H|", True
    )


def duplicated(study: Study) -> Iterator[Finding]:
    """Find pairs of outputs, of inputs and of runs that are copies: they share even their noise."""
    # Between lines wider apart than a mode is wide the FRF itself is off its neighbours, and that is shared.
    left = study.H - study.modes.fitted.reshape(study.H.shape[1:]) if study.explained else study.H
    off = off_neighbours(left.transpose(0, 2, 3, 1)[..., None])[..., 0].transpose(0, 3, 1, 2)
    for axis, names in ((2, study.outputs), (3, study.inputs), (0, None)):
        noise, values = np.moveaxis(off, axis, 0), np.moveaxis(study.H, axis, 0)
        noise, values = noise.reshape(len(noise), -1), values.reshape(len(values), -1)
        titles = names or tuple(f"run {k + 1}" for k in range(len(values)))
        for a in range(len(values)):
            for b in range(a + 1, len(values)):
                found = _copy(values[a], values[b], noise[a], noise[b])
                if found is None:
                    continue
                factor, ratio = found
                yield Finding(
                    "duplicated", (titles[a], titles[b]), sure=float(np.clip(1 - ratio, 0, 0.99)),
                    size=factor, unit="-",
                    evidence=f"the first is {factor:.4g} times the second, noise included (what differs is {ratio:.2g} "
                    "of it): two independent measurements never share their noise",
                    advice="find out which of the two was really measured, and leave the other out",
                    picture=_pair(study, axis, a, b, titles),
                )  # fmt: skip


def _copy(a: np.ndarray, b: np.ndarray, off_a: np.ndarray, off_b: np.ndarray) -> tuple[float, float] | None:
    """Factor between two channels, and their difference relative to the noise; None if the noise is not shared."""
    power = np.vdot(b, b).real
    if power == 0 or not np.any(a):
        return None
    factor = np.vdot(b, a) / power
    if np.linalg.norm(a - factor * b) > EQUAL * np.linalg.norm(a):
        return None
    noise = np.median(np.abs(off_a) ** 2 + np.abs(factor * off_b) ** 2) / MEDIAN
    if np.sqrt(noise) < ROUNDING * np.sqrt(np.mean(np.abs(a) ** 2)):
        return None
    ratio = np.median(np.abs(off_a - factor * off_b) ** 2) / MEDIAN / noise
    return (float(np.real(factor)), float(np.sqrt(ratio))) if ratio < SHARED else None


def _pair(study: Study, axis: int, a: int, b: int, titles: tuple[str, ...]) -> Picture:
    values = np.abs(np.moveaxis(study.H, axis, 0))
    flat = [np.moveaxis(values[k], 1 if axis else 0, 0).reshape(len(study.freq), -1).mean(axis=1) for k in (a, b)]
    return Picture(
        [(titles[k], study.freq, v) for k, v in zip((a, b), flat, strict=True)], "Frequency [Hz]", "|H|", True
    )


def conjugated(study: Study) -> Iterator[Finding]:
    """Find conjugated FRFs, whose response would come before the force."""
    if not study.conjugated:
        return
    yield Finding(
        "conjugated", (), sure=sureness(-study.fall, 4.0), size=None,
        evidence=f"the phase rises through the resonances ({-study.fall:.3g} standard deviations of chance): the "
        "response would come before the force",
        advice="conjugate the FRFs; the file is in the time convention e^-jwt, or force and response were exchanged in "
        "the cross spectrum",
    )  # fmt: skip
